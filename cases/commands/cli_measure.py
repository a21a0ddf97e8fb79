"""The command `granfabric measure` with its options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from granfabric.cases.errors import InputError

from .cli import OutputOption, OverwriteOption, QuietOption, VerboseOption, _folder, _speaking, app, exit_by


@app.command()
def measure(
    packing: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Disks: a data file or dump of LAMMPS, a table of text (CSV, YADE), or packing.npz."
        ),
    ],
    contacts: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--contacts", metavar="FILE", help="Contacts with forces: a dump local of LAMMPS, or a table."),
    ] = None,
    contact_columns: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--contact-columns",
            metavar="NAME,NAME,...",
            help="Meaning of its columns, '-' for what is not wanted: id1, id2, fn, ft, ft_x, ft_y (on id2), ft1_x, "
            "ft1_y (on id1).",
        ),
    ] = None,
    normal_stiffness: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--normal-stiffness",
            metavar="KN",
            help="kn [Pa], N per m of overlap and per m of thickness; follows from normal forces if they are given.",
        ),
    ] = None,
    stiffness_ratio: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--stiffness-ratio", metavar="RATIO", help="kt/kn [-]."),
    ] = None,
    friction: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--friction", metavar="MU", help="Coefficient of friction between disks [-]."),
    ] = None,
    cell: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--cell", metavar="'W H'", help="Periodic cell: width and height, or 'a_x a_y b_x b_y'."),
    ] = None,
    length_unit: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--length-unit", metavar="M", help="Metres per unit of length of the file; 1 if not given."),
    ] = None,
    force_unit: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option(
            "--force-unit", metavar="N", help="N per m of thickness per unit of force of the file; 1 if not given."
        ),
    ] = None,
    form: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--format", metavar="NAME", help="npz, lammps_data, lammps_dump or csv; else the ending tells."),
    ] = None,
    step: Annotated[
        Optional[int],  # noqa: UP045
        typer.Option("--step", metavar="N", help="Time step of a dump; the last if not given."),
    ] = None,
    relax: Annotated[
        bool,
        typer.Option(
            "--relax", help="Hold the packing at its stress first, so that missing tangential forces build up."
        ),
    ] = False,
    rattlers: Annotated[
        str, typer.Option("--rattlers", metavar="WORD", help="Coordination number with them (included) or excluded.")
    ] = "included",
    loop_stress_ratio: Annotated[
        Optional[float],  # noqa: UP045
        typer.Option("--loop-stress-ratio", metavar="RATIO", help="q/p of the loops; 0.05 if not given."),
    ] = None,
    output: OutputOption = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Measure the inputs of the point law on a packing of another code."""
    with _speaking(quiet, verbose) as screen:
        from granfabric.dem_ref.inputs.material import RATTLERS
        from granfabric.dem_ref.inputs.weak_contacts import LOOP_STRESS_RATIO

        from .measure import cell_from, run_measure

        if rattlers not in RATTLERS:
            raise InputError(f"--rattlers {rattlers!r} is not legal, legal are {' and '.join(RATTLERS)}")
        loop = LOOP_STRESS_RATIO if loop_stress_ratio is None else loop_stress_ratio
        if not 0.0 < loop <= 0.5:
            raise InputError(f"--loop-stress-ratio {loop:g} is outside its bounds (0, 0.5]")
        given = {
            "format": form, "contacts": contacts, "normal_stiffness": normal_stiffness,
            "stiffness_ratio": stiffness_ratio, "friction": friction, "length_unit": length_unit,
            "force_unit": force_unit, "step": step, "relax": relax,
            "contact_columns": None if contact_columns is None else contact_columns.replace(",", " ").split(),
            "cell": None if cell is None else cell_from(cell),
        }  # fmt: skip
        exit_by(run_measure(packing, given, _folder(output, packing.stem), screen, rattlers, loop, overwrite).outcome)

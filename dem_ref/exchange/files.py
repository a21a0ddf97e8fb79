"""Packings from and to files: the own format, LAMMPS, tables of text as YADE and spreadsheets write them.

=============  =========================  ==============================================  ==========================
format         endings                    disks                                           contacts
=============  =========================  ==============================================  ==========================
npz            .npz                       with everything, as `granfabric dem` keeps it   in the same file
lammps_data    .data .lmp .lammps         ``read_data``, ``write_data``                   none: dump or table beside it
lammps_dump    .dump .lammpstrj .local    ``dump custom`` as text                         ``dump local`` as text
csv            .csv .tsv .txt .dat        table with names of columns, YADE's text        table with names of columns
=============  =========================  ==============================================  ==========================
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from granfabric.dem_ref.arrays import SampleError, is_within
from granfabric.dem_ref.inputs.probes import ProbeError, settled
from granfabric.dem_ref.sample.disks import Sample, load_sample, save_sample

from .assemble import Imported, assemble
from .lammps_data import lammps_data_text, read_lammps_data
from .lammps_dump import lammps_dump_text, lammps_local_text, read_lammps_dump, read_lammps_local
from .raw import RawContacts, RawDisks
from .table import cell_of, contact_table_text, read_contact_table, read_table, table_text, write_text
from .text import TextFile, read_text_file

ENDINGS = {
    "npz": (".npz",),
    "lammps_data": (".data", ".lmp", ".lammps"),
    "lammps_dump": (".dump", ".lammpstrj", ".local"),
    "csv": (".csv", ".tsv", ".txt", ".dat"),
}
FORMATS = tuple(ENDINGS)
HEAD = 200
"""Lines that are looked at to tell a format."""


def format_of(path: str | Path, named: str | None = None) -> str:
    """Format of a file by its name; empty if the ending tells nothing.

    Raises
    ------
    SampleError
        If `named` is no format.
    """
    if named is not None:
        if named not in FORMATS:
            raise SampleError(f"format = {named!r} is unknown, legal are {', '.join(FORMATS)}")
        return named
    ending = Path(path).suffix.lower()
    return next((name for name, endings in ENDINGS.items() if ending in endings), "")


def _told_by(file: TextFile) -> str:
    """Format of a text by what it holds."""
    head = [line.strip() for line in file.lines[:HEAD]]
    if any(line.startswith("ITEM:") for line in head):
        return "lammps_dump"
    data = any(line.partition("#")[0].strip() == "Atoms" or line.endswith("xlo xhi") for line in head)
    return "lammps_data" if data else "csv"


def import_packing(
    path: str | Path,
    *,
    format: str | None = None,
    contacts: str | Path | None = None,
    contact_columns: Sequence[str] | None = None,
    cell: Sequence[float] | Sequence[Sequence[float]] | None = None,
    normal_stiffness: float | None = None,
    stiffness_ratio: float | None = None,
    friction: float | None = None,
    length_unit: float | None = None,
    force_unit: float | None = None,
    step: int | None = None,
    relax: bool = False,
) -> Imported:
    """`load_packing`, together with what is to be said about it."""
    named = format_of(path, format)
    given = {
        "normal_stiffness": normal_stiffness, "stiffness_ratio": stiffness_ratio, "friction": friction,
        "length_unit": length_unit, "force_unit": force_unit,
    }  # fmt: skip
    for name, value in given.items():
        if value is not None and not is_within(value, 0.0, 1e300):
            raise SampleError(f"{name} is {value}, legal are finite values >= 0")
    if named == "npz":
        told: dict[str, object] = {
            "contacts": contacts, "contact_columns": contact_columns, "cell": cell, "step": step, **given
        }  # fmt: skip
        for name, said in told.items():
            if said is not None:
                raise SampleError(f"{path}: is a stored sample, which knows all of itself; leave out {name}")
        made = Imported(load_sample(path), named, [], True)
    else:
        file = read_text_file(path)
        named = format_of(path, format) or _told_by(file)
        # an ending says less than a content that nothing else has
        if format is None and named in ("csv", "lammps_data") and _told_by(file) == "lammps_dump":
            named = "lammps_dump"
        disks = _disks(file, named, step)
        if cell is not None:
            disks.cell = cell_of(_flat(cell))
        table = None if contacts is None else _contacts(contacts, contact_columns, step)
        made = assemble(disks, table, given)
        made.format = named
    if relax:
        made.sample = _relaxed(made.sample, str(path))
        made.remarks.append(f"{path}: relaxed at its stress; tangential forces are those that built up on the way")
    return made


def load_packing(
    path: str | Path,
    *,
    format: str | None = None,
    contacts: str | Path | None = None,
    contact_columns: Sequence[str] | None = None,
    cell: Sequence[float] | Sequence[Sequence[float]] | None = None,
    normal_stiffness: float | None = None,
    stiffness_ratio: float | None = None,
    friction: float | None = None,
    length_unit: float | None = None,
    force_unit: float | None = None,
    step: int | None = None,
    relax: bool = False,
) -> Sample:
    """A packing from a file of LAMMPS, a table of text (CSV, YADE) or a stored sample.

    Normal forces follow from overlaps by the linear law ``fn = kn x overlap``; forces in a list of contacts are
    compared with it and give the tangential springs. Without such a list tangential forces are unknown and zero. The
    packing is at rest: velocities are not taken over.

    Parameters
    ----------
    path : str or Path
        The ending tells the format, or what the file holds: ``.data`` of LAMMPS, ``.dump``, ``.csv``, ``.txt``,
        ``.npz``.
    format : {"npz", "lammps_data", "lammps_dump", "csv"}, optional
        Where the ending tells something else.
    contacts : str or Path, optional
        List of contacts: a ``dump local`` of LAMMPS, or a table with the columns id1, id2 and any of fn, ft, ft_x, ft_y
        (forces on id2), ft1_x, ft1_y (on id1).
    contact_columns : sequence of str, optional
        Meaning of its columns, one name each, ``"-"`` for what is not wanted; for ``c_1[1]`` and the like.
    cell : (2,) or (2, 2), optional
        Width and height, or the two lattice vectors, in the unit of the file; wins over the file's.
    normal_stiffness : float, optional
        kn [Pa]: N per metre of overlap and per metre of thickness. Follows from normal forces if they are given.
    stiffness_ratio, friction : float, optional
        kt/kn and the coefficient of friction; in a table they may stand as lines ``# friction = 0.5``.
    length_unit, force_unit : float, optional
        Metres per unit of length of the file, and N per metre of thickness per unit of force; 1 if not given.
    step : int, optional
        Time step of a dump; the last if not given.
    relax : bool
        Hold the packing at its stress until it is at rest, so that tangential forces which were not given build up.

    Raises
    ------
    SampleError
        With file, line and value, if the file is damaged, is no periodic packing of disks, or leaves out something that
        is not given either.

    Examples
    --------
    >>> import granfabric as gf, tempfile, pathlib
    >>> folder = pathlib.Path(tempfile.mkdtemp())
    >>> gf.save_packing(folder / "packing.csv", gf.make_packing(100, 1))
    >>> gf.load_packing(folder / "packing.csv").count
    100
    """
    return import_packing(
        path, format=format, contacts=contacts, contact_columns=contact_columns, cell=cell,
        normal_stiffness=normal_stiffness, stiffness_ratio=stiffness_ratio, friction=friction, length_unit=length_unit,
        force_unit=force_unit, step=step, relax=relax,
    ).sample  # fmt: skip


def save_packing(
    path: str | Path, sample: Sample, *, format: str | None = None, contacts: str | Path | None = None
) -> None:
    """Write a packing for LAMMPS, as a table of text, or as a stored sample.

    Every digit is kept: `load_packing` gives the same disks and, with `contacts`, the same forces to the last bit.

    Parameters
    ----------
    path : str or Path
        The ending tells the format: ``.data``, ``.dump``, ``.csv`` or ``.npz``.
    sample : Sample
    format : {"npz", "lammps_data", "lammps_dump", "csv"}, optional
        Where the ending tells something else.
    contacts : str or Path, optional
        Write the contacts as well, as a ``dump local`` (``.dump``, ``.local``) or a table (``.csv``). Data files and
        tables of disks do not hold forces.

    Raises
    ------
    SampleError
        If the ending tells no format, or the file cannot be written.
    """
    named = format_of(path, format)
    if not named:
        endings = ", ".join(ending for several in ENDINGS.values() for ending in several)
        raise SampleError(f"{path}: the ending tells no format; known are {endings}, or give format")
    if contacts is not None and format_of(contacts) not in ("csv", "lammps_dump"):
        raise SampleError(f"{contacts}: contacts are written as .csv, .dump or .local")
    try:
        if named == "npz":
            save_sample(path, sample)
        else:
            write = {"lammps_data": lammps_data_text, "lammps_dump": lammps_dump_text, "csv": table_text}[named]
            write_text(Path(path), write(sample))
        if contacts is not None:
            local = format_of(contacts) == "lammps_dump"
            write_text(Path(contacts), lammps_local_text(sample) if local else contact_table_text(sample))
    except OSError as error:
        raise SampleError(f"{path}: cannot be written ({error.strerror})") from error


def _flat(cell: Sequence[float] | Sequence[Sequence[float]]) -> list[float]:
    numbers = [float(entry) for row in cell for entry in (row if isinstance(row, Sequence) else [row])]  # type: ignore[arg-type]
    for value in numbers:
        if not is_within(value, -1e300, 1e300):
            raise SampleError(f"cell holds {value}, legal are finite numbers")
    return numbers


def _disks(file: TextFile, named: str, step: int | None) -> RawDisks:
    if named == "lammps_dump":
        return read_lammps_dump(file, step)
    if step is not None:
        raise SampleError(f"{file.origin}: holds one state; a time step is for dumps of LAMMPS")
    return read_lammps_data(file) if named == "lammps_data" else read_table(file)


def _contacts(path: str | Path, columns: Sequence[str] | None, step: int | None) -> RawContacts:
    file = read_text_file(path)
    if _told_by(file) == "lammps_dump":
        return read_lammps_local(file, columns, step)
    return read_contact_table(file, columns)


def _relaxed(sample: Sample, origin: str) -> Sample:
    try:
        return settled(sample)
    except ProbeError as error:
        raise SampleError(f"{origin}: does not come to rest at its stress: {error}") from error

"""The command line `granfabric`.

Heavy modules are imported by the commands that need them, so that help and the list of scenes appear at once.
Exit codes: 0 done; 1 the computation could not finish (what was reached is on disk); 2 bad input.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Optional

import typer

from granfabric.cases.errors import InputError, RunError

from .engine_options import MapWorkersOption, PointWorkersOption, SchedulerOption, ThreadsEachOption, ThreadsOption
from .fit_options import CurvesArgument, DataOption, DataSetOption, FitOutputOption, FreeOption, MaterialFileOption
from .hosts import HostOption, assists, leading
from .picture_options import add_to, exit_by
from .verify_options import (
    MaterialsOption,
    MeasuredOption,
    PackingSetOption,
    ParticlesOption,
    PathsOption,
    QuickOption,
    SeedsOption,
    SpecimenParticlesOption,
    SpecimensOption,
    VerifiedScene,
    VerifyOutputOption,
)

INTERRUPTED = 130
"""What the library of the command line makes of Ctrl-C."""

app = typer.Typer(
    name="granfabric",
    help="Contact gain and loss in granular assemblies: at a point, and in boundary-value problems.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _scene_names(context: typer.Context, incomplete: str) -> list[str]:
    """What completes a scene: shipped ones that the command computes, and scene files and folders."""
    from granfabric.cases.scene import catalogue

    with suppress(Exception):  # a shell that completes has no use for errors
        kind = {"point": "point", "run": "field", "dem": "dem", "convergence": "field"}.get(context.info_name or "")
        computed = (kind, "specimen") if kind == "dem" else (kind,)
        names = [entry.name for entry in catalogue.shipped().values() if kind is None or entry.kind in computed]
        return [name for name in names if name.startswith(incomplete)] + catalogue.files_like(incomplete)
    return []


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import PackageNotFoundError, version

        try:
            typer.echo(f"granfabric {version('granfabric')}")
        except PackageNotFoundError:
            typer.echo("granfabric, not installed")
        raise typer.Exit


SceneArgument = Annotated[
    str,
    typer.Argument(metavar="SCENE", help="A shipped scene's name or a scene file.", autocompletion=_scene_names),
]
OutputOption = Annotated[
    Optional[Path],  # noqa: UP045  (typer reads the annotation at run time)
    typer.Option(
        "-o",
        "--output",
        metavar="DIR",
        help="Result folder, results/SCENE if not given; new, empty, or of an earlier run of this scene, which is "
        "replaced.",
    ),
]
OverwriteOption = Annotated[
    bool, typer.Option("--overwrite", help="Replace results of another scene in the result folder.")
]
SetOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a key of the scene, e.g. material.coordination=3.9; files are relative to the working folder.",
    ),
]
UpgradeOption = Annotated[
    bool,
    typer.Option("--upgrade", help="Run again with the effects that the audit found missing."),
]
QuietOption = Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but warnings and errors.")]
VerboseOption = Annotated[bool, typer.Option("-v", "--verbose", help="Say more: steps and notes of the solvers.")]

_said_before: dict[str, bool] = {}
"""Options that stood before the command."""


@app.callback()
def options(
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Contact gain and loss in granular assemblies: at a point, and in boundary-value problems."""
    _said_before.update(quiet=quiet, verbose=verbose)


@contextmanager
def _speaking(quiet: bool, verbose: bool) -> Iterator[Any]:
    """The screen of a command, and its hold on the folders that it writes to."""
    from granfabric.cases.records import lock
    from granfabric.cases.terminal.screen import Screen

    quiet, verbose = quiet or _said_before.get("quiet", False), verbose or _said_before.get("verbose", False)
    if quiet and verbose:
        raise InputError("-q and -v ask for opposite things; give one of them")
    screen = Screen(quiet=quiet, verbose=verbose)
    with screen.listening(), lock.command():
        try:
            yield screen
        except (InputError, RunError, OSError) as error:
            screen.log(f"granfabric: {error}")
            raise


def _upgraded(scene: str, given: list[str], record: Any, screen: Any) -> Any:
    """The scene with what the audit of a run asks for, which is added to the assignments given so far."""
    from granfabric.cases.scene.reader import load

    screen.say(f"running again with {', '.join(record.details['upgrade'])}")
    given += record.details["upgrade"]
    return load(scene, given)


def _folder(output: Path | None, name: str) -> Path:
    return output or Path("results") / name


@app.command()
def run(
    scene: SceneArgument,
    output: OutputOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in the folder.")] = False,
    overwrite: OverwriteOption = False,
    assignments: SetOption = None,
    upgrade: UpgradeOption = False,
    workers: PointWorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: ThreadsOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    host: HostOption = "own",
) -> None:
    """Compute a boundary-value problem."""
    from granfabric.cases.terminal.early_kernels import early_kernels

    if assists(host):
        return
    with leading(host) as team, early_kernels() as kernels, _speaking(quiet, verbose) as screen:
        from granfabric.cases.engine.choice import asked_for
        from granfabric.cases.scene import build
        from granfabric.cases.scene.reader import load

        from . import accuracy_report
        from .run import run_field

        given = list(assignments or [])
        loaded = load(scene, given)
        loaded.require("field")
        kernels.start(build.kernels(loaded)[:1])
        accuracy_report.announce(loaded, screen)
        choice = asked_for(workers, scheduler, threads)
        record = run_field(loaded, _folder(output, loaded.name), screen, resume, kernels, overwrite, team, choice)
        while upgrade and record.outcome == "finished" and record.details.get("upgrade"):
            loaded = _upgraded(scene, given, record, screen)
            record = run_field(loaded, _folder(output, loaded.name), screen, False, kernels, overwrite, team)
        accuracy_report.report(loaded, record, screen)
        exit_by(record.outcome)


@app.command()
def point(
    scene: SceneArgument,
    output: OutputOption = None,
    overwrite: OverwriteOption = False,
    assignments: SetOption = None,
    upgrade: UpgradeOption = False,
    threads: ThreadsOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Compute one point along a path of stress or strain."""
    with _speaking(quiet, verbose) as screen:
        from granfabric.cases.scene.reader import load

        from . import accuracy_report
        from .point import run_point

        given = list(assignments or [])
        loaded = load(scene, given)
        accuracy_report.announce(loaded, screen)
        record = run_point(loaded, _folder(output, loaded.name), screen, overwrite)
        while upgrade and record.outcome == "finished" and record.details.get("upgrade"):
            loaded = _upgraded(scene, given, record, screen)
            record = run_point(loaded, _folder(output, loaded.name), screen, overwrite)
        accuracy_report.report(loaded, record, screen)
        exit_by(record.outcome)


@app.command()
def verify(
    scene: VerifiedScene = None,
    output: VerifyOutputOption = None,
    particles: ParticlesOption = None,
    seeds: SeedsOption = None,
    paths: PathsOption = None,
    materials: MaterialsOption = None,
    assignments: PackingSetOption = None,
    data: DataOption = None,
    quick: QuickOption = False,
    specimens: SpecimensOption = None,
    specimen_particles: SpecimenParticlesOption = None,
    measured: MeasuredOption = False,
    workers: MapWorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: ThreadsEachOption = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Compare the point law with the DEM: the source's four figures and a table of errors, a map, or a field scene.
    With --paths, --materials, --set or --quick a map of materials by paths. With --data the law alone against curves.
    """
    with _speaking(quiet, verbose) as screen:
        from granfabric.cases.engine.choice import Choice

        from .verify_kinds import verify_as_asked

        asked = (particles, seeds, paths, materials, assignments or [], data or [], quick)
        choice, judges = Choice(workers, scheduler, threads), (specimens, specimen_particles, measured)
        exit_by(verify_as_asked(scene, output, *asked, choice, screen, overwrite, judges).outcome)


@app.command()
def fit(
    curves: CurvesArgument,
    output: FitOutputOption = None,
    free: FreeOption = None,
    material_file: MaterialFileOption = None,
    assignments: DataSetOption = None,
    overwrite: OverwriteOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Fit parameters of the point law to measured curves: material file with standard errors, residuals, picture."""
    with _speaking(quiet, verbose) as screen:
        from .fit import curves_of, run_fit

        folder = _folder(output, f"{Path(curves[0]).stem}_fit")
        record, _ = run_fit(curves_of(curves), folder, screen, free or [], material_file, assignments or [], overwrite)
        exit_by(record.outcome)


@app.command()
def convergence(
    scene: SceneArgument,
    refine: Annotated[
        str, typer.Option("--refine", metavar="N,N,...", help="Factors on the numbers of cells, ascending.")
    ] = "1,2,4",
    output: OutputOption = None,
    overwrite: OverwriteOption = False,
    assignments: SetOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Compare a scene with its closed form on finer and finer meshes, at constant stiffness."""
    with _speaking(quiet, verbose) as screen:
        from .convergence import run_convergence

        factors = refine.split(",")
        if not all(factor.isdecimal() for factor in factors):
            raise InputError(f"--refine {refine!r} is not a list of numbers such as 1,2,4")
        folder = _folder(output, f"{Path(scene).stem}_convergence")
        run_convergence(scene, assignments or [], [int(factor) for factor in factors], folder, screen, overwrite)


@app.command()
def mesh(
    target: Annotated[str, typer.Argument(metavar="FILE", help="A Gmsh file (.msh), or a scene with a mesh.")],
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", metavar="FILE.png", help="Picture; NAME_mesh.png if not given."),
    ] = None,
    assignments: SetOption = None,
    parts: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option(
            "--parts", metavar="WORD", help="Of a .msh file: joined (one body), or separate (bodies, cracks)."
        ),
    ] = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Look at a mesh: its boundaries and regions with their sizes, and a picture with their names."""
    with _speaking(quiet, verbose) as screen:
        screen.quiet = False  # what it says is what it is for
        from .mesh import run_mesh

        run_mesh(target, output, assignments or [], parts, screen)


@app.command()
def schema() -> None:
    """Print the JSON schema of scene files, from which editors take completion and checks."""
    from granfabric.cases.scene.schema import schema_text

    typer.echo(schema_text(), nl=False)


@app.command()
def effects(
    scene: SceneArgument,
    assignments: SetOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Decide which effects a scene needs, and say why."""
    with _speaking(quiet, verbose) as screen:
        screen.quiet = False  # what it says is all that it does
        from granfabric.cases.scene.reader import load

        from .effects import show_effects

        show_effects(load(scene, assignments or []), screen)


@app.command()
def scenes(
    name: Annotated[Optional[str], typer.Argument(metavar="[NAME]", help="Show the text of this scene.")] = None,  # noqa: UP045
    copy: Annotated[
        Optional[str],  # noqa: UP045
        typer.Option("--copy", metavar="NAME", help="Copy this scene into a folder to start from."),
    ] = None,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", metavar="DIR", help="Folder for --copy; NAME if not given."),
    ] = None,
) -> None:
    """List the shipped scenes, show the text of one, or copy one."""
    from granfabric.cases.errors import unknown
    from granfabric.cases.scene import catalogue

    if copy is not None:
        for file in catalogue.copy(copy, output if output is not None else Path(copy)):
            typer.echo(str(file))
        return
    entries = catalogue.shipped()
    if name is not None:
        if name not in entries:
            raise InputError(unknown("the shipped scene", name, entries))
        entry = entries[name]
        typer.echo(f"{entry.name} ({entry.kind}): {entry.title}\n\n{entry.description.strip()}")
        return
    for kind, command in (
        ("point", "granfabric point NAME"),
        ("field", "granfabric run NAME"),
        ("dem", "granfabric dem NAME"),
        ("specimen", "granfabric dem NAME, between platens and membranes"),
    ):
        typer.echo(f"{command}")
        group = ""
        for entry in entries.values():
            if entry.kind != kind:
                continue
            if entry.group != group:
                group = entry.group
                typer.echo(f"  {group}")
            typer.echo(f"{'    ' if group else '  '}{entry.name:20} {entry.title}")


@app.command()
def plot(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a finished or interrupted run.")],
) -> None:
    """Make the pictures of a run from its files."""
    from granfabric.cases.pictures.draw import draw_folder
    from granfabric.cases.sweep.pictures import draw_sweep_folder

    for file in draw_sweep_folder(directory) or draw_folder(directory):
        typer.echo(str(file))


from . import cli_many as cli_many  # noqa: E402  (they take what stands above, and add their commands)
from . import cli_measure as cli_measure  # noqa: E402

add_to(app)


def main() -> None:
    """Entry point of the console script."""
    try:
        app()
    except SystemExit as error:
        if error.code != INTERRUPTED:
            raise
        sys.stderr.write("granfabric: interrupted\n")
        sys.exit(1)
    except InputError as error:
        sys.stderr.write("".join(f"granfabric: {line}\n" for line in str(error).split("\n")))
        sys.exit(2)
    except (RunError, OSError) as error:
        sys.stderr.write(f"granfabric: {error}\n")
        sys.exit(1)
    except MemoryError:
        sys.stderr.write("granfabric: there is not enough memory for this\n")
        sys.exit(1)
    except KeyboardInterrupt:
        sys.stderr.write("granfabric: interrupted\n")
        sys.exit(1)

"""Commands that carry out many pieces of work: `granfabric dem`, `sweep` and `cost`, with their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from .cli import (
    OutputOption,
    OverwriteOption,
    QuietOption,
    SceneArgument,
    SetOption,
    VerboseOption,
    _folder,
    _speaking,
    app,
    exit_by,
)
from .engine_options import DemThreadsOption, SchedulerOption, ThreadsEachOption, WorkersIfAskedOption, WorkersOption
from .sweep_options import (
    LatinOption,
    PackingSeedsOption,
    PicturesOption,
    ResultOption,
    SamplesOption,
    SeedOption,
    SweepSetOption,
    TableOption,
)


@app.command()
def dem(
    scene: SceneArgument,
    output: OutputOption = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in the folder.")] = False,
    overwrite: OverwriteOption = False,
    assignments: SetOption = None,
    seeds: PackingSeedsOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: DemThreadsOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Pack and load disks by the discrete element method; measure the inputs of the point law."""
    with _speaking(quiet, verbose) as screen:
        from granfabric.cases.engine.choice import Choice
        from granfabric.cases.scene.reader import load

        from .dem import run_dem
        from .seeds import refuse_without_seeds, run_seeds

        loaded = load(scene, assignments or [])
        choice = Choice(workers, scheduler, threads)
        if seeds is not None:
            folder = _folder(output, f"{loaded.name}_seeds")
            given = assignments or []
            exit_by(run_seeds(loaded, scene, given, seeds, folder, screen, resume, overwrite, choice).outcome)
            return
        refuse_without_seeds(choice)
        exit_by(run_dem(loaded, _folder(output, loaded.name), screen, resume, overwrite).outcome)


@app.command()
def sweep(
    scene: SceneArgument,
    output: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("-o", "--output", metavar="DIR", help="Result folder, results/SCENE_sweep if not given."),
    ] = None,
    assignments: SweepSetOption = None,
    table: TableOption = None,
    latin: LatinOption = None,
    samples: SamplesOption = None,
    seed: SeedOption = None,
    result: ResultOption = None,
    pictures: PicturesOption = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Take what has finished in DIR, go on with what was begun.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is in DIR.")] = False,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    threads: ThreadsEachOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Run a scene many times with other values: one folder a run, a table of results, a picture."""
    with _speaking(quiet, verbose) as screen:
        from granfabric.cases.engine.choice import Choice
        from granfabric.cases.sweep.plan import Request

        from .sweep import Sweep, run_sweep

        request = Request(assignments or [], table, latin or [], samples, seed)
        asked = Sweep(scene, request, result or [], pictures, Choice(workers, scheduler, threads))
        exit_by(run_sweep(asked, _folder(output, f"{Path(scene).stem}_sweep"), screen, resume, overwrite).outcome)


@app.command()
def cost(
    study: Annotated[Optional[str], typer.Argument(metavar="[STUDY]", help="One study; all if not given.")] = None,  # noqa: UP045
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="DIR", help="Result folder; studies in it that are not asked for stay."),
    ] = Path("results/cost"),
    quick: Annotated[bool, typer.Option("--quick", help="Few and small settings, for a first impression.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Skip studies that have finished in DIR.")] = False,
    overwrite: OverwriteOption = False,
    workers: WorkersIfAskedOption = None,
    scheduler: SchedulerOption = None,
    threads: ThreadsEachOption = None,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Measure what accuracy costs in time: tables, work-precision pictures, one page."""
    with _speaking(quiet, verbose) as screen:
        from granfabric.cases.engine.choice import Choice

        from .cost import run_cost

        choice = Choice(workers, scheduler, threads)
        exit_by(run_cost(study, output, screen, quick, resume, overwrite, choice).outcome)

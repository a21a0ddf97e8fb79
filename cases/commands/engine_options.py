"""Who computes: options of all commands that carry out many pieces of work, and threads of any."""

from typing import Annotated, Optional

import typer


def _limit(number: Optional[int]) -> Optional[int]:  # noqa: UP045
    """Before anything that has threads of its own is loaded."""
    if number is not None:
        from granfabric.cases.engine.machine import checked_threads, limit_threads

        limit_threads(checked_threads(number))
    return number


ThreadsOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--threads",
        metavar="N",
        callback=_limit,
        help="Threads of the compiled kernels, all cores if not given; results do not depend on them.",
    ),
]
ThreadsEachOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--threads",
        metavar="N",
        callback=_limit,
        help="Threads of each worker for compiled kernels, 1 if not given; results do not depend on them.",
    ),
]
DemThreadsOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--threads",
        metavar="N",
        callback=_limit,
        help="Cores that one packing may use, two at most; if not given, large packings take them. With --seeds those "
        "of each worker, 1 if not given. Results do not depend on it.",
    ),
]
WorkersOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--workers",
        metavar="N",
        help="Processes at work side by side, one a core if not given; results do not depend on them.",
    ),
]
WorkersIfAskedOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--workers", metavar="N", help="Processes at work side by side, 1 if not given."),
]
PointWorkersOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--workers",
        metavar="N",
        help="With grains at the points: processes that the points are shared out to, with --threads each (1).",
    ),
]
MapWorkersOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--workers",
        "--processes",
        metavar="N",
        help="Processes at work side by side. Map: one a core if not given, else 1, for --seeds.",
    ),
]
SchedulerOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Workers of Dask instead, of the scheduler at this address, such as tcp://HOST:8786.",
    ),
]

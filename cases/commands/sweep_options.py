"""Options of `granfabric sweep`."""

from pathlib import Path
from typing import Annotated, Optional

import typer

SweepSetOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--set",
        metavar="KEY=V,V,...",
        help="Values of a key, parted by commas outside brackets and quotation marks; LO:HI:N and LO:HI:N:log for N "
        "numbers. All combinations of several --set.",
    ),
]
TableOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "--table",
        metavar="FILE.csv",
        help="One run a line; the heads are keys, one of them may be 'name'. An empty entry leaves the scene's value.",
    ),
]
LatinOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--latin",
        metavar="KEY=LO:HI",
        help="Range of a key of a Latin hypercube with --samples runs; KEY=LO:HI:log for equal ratios.",
    ),
]
SamplesOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--samples", metavar="N", help="Runs of the Latin hypercube."),
]
SeedOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--seed", metavar="S", help="Of the Latin hypercube; 1 if not given."),
]
ResultOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--result",
        metavar="COLUMN[:HOW]",
        help="A number for the table: column of history.csv or q/p; last (if not given), first, max, min, mean or "
        "at:COLUMN=VALUE. Of a DEM run also material.KEY.",
    ),
]
PicturesOption = Annotated[
    bool, typer.Option("--pictures", help="Make the pictures of each run too; `granfabric plot DIR/RUN` does later.")
]
PackingSeedsOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--seeds",
        metavar="K",
        help="Packings of K seeds, from the scene's on: one folder each, their mean and scatter. --workers and "
        "--scheduler go with it.",
    ),
]

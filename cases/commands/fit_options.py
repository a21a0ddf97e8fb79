"""Arguments and options of the commands that take a user's curves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

CurvesArgument = Annotated[
    list[str], typer.Argument(metavar="FILE.csv", help="Curves with a header: q/p or stresses, z, a_c, strain.")
]
FitOutputOption = Annotated[
    Optional[Path],  # noqa: UP045  (typer reads the annotation at run time)
    typer.Option("-o", "--output", metavar="DIR", help="Result folder, results/FILE_fit if not given."),
]
FreeOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option("--free", metavar="NAME,...", help="Parameters to fit; those that the curves tell if not given."),
]
MaterialFileOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option(
        "--material-file", metavar="NAME", help="Where the fit begins, and what is held: a file or a shipped name."
    ),
]
DataSetOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Of curves: material_file, keys of material, closure, effects, integration; initial.stress, "
        "control=stress|strain, start=material|row, scale.COLUMN.",
    ),
]
DataOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--data", metavar="FILE.csv", help="Instead of the DEM: a curve of yours (or several); nothing is fitted."
    ),
]

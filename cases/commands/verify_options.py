"""Options of `granfabric verify`."""

from pathlib import Path
from typing import Annotated, Optional

import typer

VerifiedScene = Annotated[
    Optional[str],  # noqa: UP045
    typer.Argument(metavar="[SCENE]", help="A field scene: the law against grains at its points."),
]
VerifyOutputOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option(
        "-o",
        "--output",
        metavar="DIR",
        help="Result folder, results/verify if not given, with a scene results/verify_SCENE; DEM runs in it are used "
        "again.",
    ),
]
ParticlesOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--particles", metavar="N", help="Disks of a packing; 2500 if not given, 400 with --quick or SCENE."),
]
SeedsOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--seeds",
        metavar="K",
        help="Packings, for the scatter of the DEM. 1 if not given, 2 with --quick, 8 with SCENE.",
    ),
]
PathsOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--paths", metavar="NAMES", help="Map: paths, comma separated, or all."),
]
MaterialsOption = Annotated[
    Optional[str],  # noqa: UP045
    typer.Option("--materials", metavar="NAMES", help="Map: materials, comma separated, or all."),
]
PackingSetOption = Annotated[
    Optional[list[str]],  # noqa: UP045
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Map: a key of every packing, e.g. material.friction=0.3. With --data: keys of the law, see fit. With "
        "SCENE: keys of the scene.",
    ),
]
SpecimensOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--specimens", metavar="N", help="SCENE: also by N specimens of grains between platens and membranes."
    ),
]
SpecimenParticlesOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--specimen-particles", metavar="M", help="Disks of such a specimen, about; 3000 if not given."),
]
MeasuredOption = Annotated[
    bool,
    typer.Option(
        "--measured",
        help="SCENE: the law takes what is measured on the packings (of specimens, else of the points), not what the "
        "scene says.",
    ),
]
QuickOption = Annotated[
    bool, typer.Option("--quick", help="Map: small packings, few materials and paths if not given; two minutes.")
]

"""Options of `granfabric verify`."""

from typing import Annotated, Optional

import typer

ParticlesOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option("--particles", metavar="N", help="Disks of a packing; 2500 if not given, 400 with --quick."),
]
SeedsOption = Annotated[
    Optional[int],  # noqa: UP045
    typer.Option(
        "--seeds",
        metavar="K",
        help="Packings, for the scatter of the DEM. 1 if not given, 2 with --quick.",
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
        help="Map: a key of every packing, e.g. material.friction=0.3. With --data: keys of the law, see fit.",
    ),
]
QuickOption = Annotated[
    bool, typer.Option("--quick", help="Map: small packings, few materials and paths if not given; two minutes.")
]

"""A look at a mesh before anything is computed: `granfabric mesh`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError
from granfabric.cases.field import mesh_table
from granfabric.cases.field.prepare import read_or_make_mesh
from granfabric.cases.pictures.mesh import draw_mesh
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen
from granfabric.fem.mesh.host_mesh import HostMesh, MeshError, TopologyError, read_mesh


def run_mesh(target: str, output: Path | None, assignments: Sequence[str], parts: str | None, screen: Screen) -> Path:
    """Print the groups of a mesh and draw it with their names.

    A mesh that is refused because it is not one body is printed and drawn all the same, with the places marked.

    Parameters
    ----------
    target : str
        A `.msh` file, or a scene.
    output : Path, optional
        PNG file; ``NAME_mesh.png`` in the working folder if not given.
    assignments : sequence of str
        ``key=value`` texts that override the scene.
    parts : str, optional
        "joined" or "separate", for a `.msh` file; a scene has its key ``mesh.parts``.
    screen : Screen

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        If there is no such mesh, it is refused, or the picture cannot be written.
    """
    is_file = Path(target).suffix.lower() == ".msh"
    if is_file and assignments:
        raise InputError(f"--set changes keys of a scene, and {target!r} is a mesh; use --parts for its parts")
    if not is_file and parts is not None:
        raise InputError("--parts is for a .msh file; a scene takes --set mesh.parts=separate")
    name, second_order, host, refused = _mesh(target, assignments, parts or "joined", is_file)
    picture = _picture(output, name)
    found = mesh_table.show(host, screen, second_order)
    wrong = None if refused is None else refused[1]
    try:
        draw_mesh(picture, host, found, name, wrong)
    except OSError as error:
        raise InputError(f"the picture {str(picture)!r} cannot be written: {error.strerror}") from error
    if refused is not None:
        raise InputError(f"{refused[0]} (marked in {picture})")
    screen.say(f"picture: {picture}")
    return picture


def _mesh(
    target: str, assignments: Sequence[str], parts: str, is_file: bool
) -> tuple[str, bool, HostMesh, tuple[str, NDArray[np.float64]] | None]:
    """Name, whether curved sides count, mesh, and why and where it is refused."""
    if is_file:
        try:
            return Path(target).stem, True, read_mesh(target, parts), None
        except TopologyError as error:
            return Path(target).stem, True, error.mesh, (str(error), error.places)
        except MeshError as error:
            raise InputError(str(error)) from error
    loaded = load(target, assignments)
    loaded.require("field")
    second_order = loaded.scene.mesh.element.endswith("2")
    try:
        return loaded.name, second_order, read_or_make_mesh(loaded), None
    except InputError as error:
        cause = error.__cause__
        if not isinstance(cause, TopologyError):
            raise
        return loaded.name, second_order, cause.mesh, (str(error), cause.places)


def _picture(output: Path | None, name: str) -> Path:
    picture = output if output is not None else Path(f"{name}_mesh.png")
    if picture.suffix.lower() != ".png":
        raise InputError(f"the picture {str(picture)!r} does not end in .png")
    if picture.is_dir() or not picture.parent.is_dir():
        what = "is a folder" if picture.is_dir() else "lies in a folder that does not exist"
        raise InputError(f"the picture {str(picture)!r} {what}; choose another with -o")
    return picture

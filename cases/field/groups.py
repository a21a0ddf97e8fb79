"""Names of boundaries and regions in a scene, checked against the mesh."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import unknown
from granfabric.cases.scene.reader import LoadedScene
from granfabric.fem.mesh.host_mesh import HostMesh

BOUNDARY_LOADS = ("fixed", "displacement", "pressure", "traction", "closed_form", "rigid", "spring")


def _named(scene: Any) -> Iterator[tuple[list[Any], str, str]]:
    """Every group that a scene names: keys, "boundary" or "region", name."""
    for place, stage in enumerate(scene.stage):
        for kind in BOUNDARY_LOADS:
            for number, load in enumerate(getattr(stage, kind)):
                yield ["stage", place, kind, number, "boundary"], "boundary", load.boundary
        for number, load in enumerate(stage.body_force):
            if load.region is not None:
                yield ["stage", place, "body_force", number, "region"], "region", load.region
        for key in ("deactivate", "activate"):
            for number, name in enumerate(getattr(stage, key)):
                yield ["stage", place, key, number], "region", name
    if isinstance(scene.initial.k0, dict):
        for name in scene.initial.k0:
            yield ["initial", "k0", name], "region", name
    for name, material in scene.materials.items():
        yield ["materials", name, "region"], "region", material.region


def _owner(keys: list[Any]) -> list[Any]:
    """Where a group is named: the load, which is counted, or the list; of materials the key."""
    return keys if keys[0] == "materials" else keys[:-1]


def check_groups(loaded: LoadedScene, mesh: HostMesh) -> None:
    """Refuse names that the mesh does not have.

    Raises
    ------
    InputError
        Naming each such key, the legal groups of the mesh and the nearest.
    """
    groups = {"boundary": mesh.boundaries, "region": mesh.regions}
    why = "".join(f" ({text})" for text in mesh.remarks[:2])
    wrong = [
        (keys, f"{loaded.label(_owner(keys))}: {unknown(f'the {what}', name, groups[what])}{why}")
        for keys, what, name in _named(loaded.scene)
        if name not in groups[what]
    ]
    if wrong:
        raise loaded.errors(wrong)


def named_boundaries(scene: Any) -> tuple[list[str], list[str]]:
    """Boundaries that carry loads or supports, and those of them that are supported, in order of appearance."""
    named = [(keys[2], name) for keys, what, name in _named(scene) if what == "boundary"]
    supported = [name for kind, name in named if kind in ("fixed", "displacement", "rigid")]
    return list(dict.fromkeys(name for _, name in named)), list(dict.fromkeys(supported))


def material_index(loaded: LoadedScene, mesh: HostMesh) -> NDArray[np.int32] | None:
    """Row of the parameter table for each element; None if there is one material.

    Raises
    ------
    InputError
        If regions overlap or leave elements without material.
    """
    scene = loaded.scene
    if not scene.materials:
        return None
    index = np.full(mesh.mesh.t.shape[1], -1, dtype=np.int32)
    names = list(scene.materials)
    for row, name in enumerate(names):
        cells = mesh.regions[scene.materials[name].region]
        taken = index[cells]
        if (taken >= 0).any():
            other = names[int(taken[taken >= 0][0])]
            raise loaded.error(["materials"], f"materials {other!r} and {name!r} share elements of the mesh")
        index[cells] = row
    if (index < 0).any():
        bare = int(np.count_nonzero(index < 0))
        raise loaded.error(
            ["materials"],
            f"{bare} elements of the mesh lie in no region with a material (regions: {', '.join(mesh.regions)})",
        )
    return index

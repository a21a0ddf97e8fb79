"""Loads that add to what an earlier stage left on the same sides or cells under another name.

A load replaces one of its kind on the boundary, or region, of the same name. On a part of a boundary, or on one that
holds others, it adds to what is there, which may be meant as well as not, and which no result shows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from granfabric.cases.scene.reader import LoadedScene
from granfabric.fem.mesh.host_mesh import HostMesh
from granfabric.fem.mesh.summary import cell_areas, side_lengths

KINDS = ("pressure", "traction", "body_force")


def adding(loaded: LoadedScene, mesh: HostMesh) -> list[str]:
    """A note for each load that begins on top of one of its kind which an earlier stage left under another name.

    Two that one stage gives side by side are meant, and so is what has acted together in the stage before.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "field", its names checked against the mesh.
    mesh : HostMesh
    """
    left: dict[tuple[str, str | None], int] = {}
    said = []
    for place, stage in enumerate(loaded.scene.stage):
        new = {
            (kind, load.region if kind == "body_force" else load.boundary): (number, load)
            for kind in KINDS
            for number, load in enumerate(getattr(stage, kind))
        }
        beginning = {key: number for key, (number, load) in new.items() if _acts(load) and key not in left}
        left = {key: since for key, since in left.items() if stage.keep and key not in new}
        for (kind, name), number in beginning.items():
            where, what = loaded.label(["stage", place, kind, number]), kind.replace("_", " ")
            for (other_kind, other), since in left.items():
                size, unit = _shared(mesh, kind, name, other) if other_kind == kind else (0.0, "")
                if size > 0.0:
                    said.append(
                        f"note: {where}: the {what} on {_shown(name)} adds to that on {_shown(other)}, which "
                        f"{loaded.label(['stage', since])} left; they share {size:.4g} {unit}"
                    )
        left |= {key: place for key, (_, load) in new.items() if _acts(load)}
    return said


def _shown(name: str | None) -> str:
    return "the whole mesh" if name is None else repr(name)


def _acts(load: Any) -> bool:
    values = load.value if isinstance(load.value, list) else [load.value]
    return any(isinstance(value, str) or value != 0.0 for value in values) or bool(
        np.any(getattr(load, "gradient", 0.0))
    )


def _shared(mesh: HostMesh, kind: str, one: str | None, other: str | None) -> tuple[float, str]:
    """Length or area of what two boundaries or regions have in common, and its unit."""
    if kind != "body_force":
        both = np.intersect1d(mesh.boundaries[str(one)], mesh.boundaries[str(other)])
        return float(side_lengths(mesh)[both].sum()), "m"
    every = np.arange(mesh.mesh.t.shape[1])
    first, second = (every if name is None else mesh.regions[name] for name in (one, other))
    both = np.intersect1d(first, second)
    return float(cell_areas(mesh)[both].sum()), "m^2"

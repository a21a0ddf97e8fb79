"""A point that failed in a boundary-value problem, as a point scene that replays it alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from constitutive.contract import LawDescription
from fem.results import FailedPoint

from . import files
from .toml_text import to_toml

FAILED_POINT = "failed_point.toml"


def failed_point_scene(point: FailedPoint, description: LawDescription, scene: dict[str, Any]) -> dict[str, Any]:
    """Point scene that starts from the stress, coordination number and fabric at which the point failed.

    The force anisotropies and the mean force follow from these by the closure of the law, as they did in the run.

    Parameters
    ----------
    point : FailedPoint
    description : LawDescription
    scene : dict
        The field scene as resolved.
    """
    if "material" in scene:
        material = dict(scene["material"])
    else:
        material = dict(list(scene["materials"].values())[point.material_index])
        material.pop("region")
    material["coordination"] = float(point.state_start[description.columns("coordination")][0])
    fabric = point.state_start[description.columns("fabric_anisotropy")].tolist()
    material["initial_fabric_xx"] = fabric[0]
    material["initial_fabric_xy"] = fabric[1] if len(fabric) > 1 else 0.0
    x, y = point.position
    return {
        "title": f"Point {point.point} at ({x:.6g}, {y:.6g}) m, which failed",
        "kind": "point",
        "description": f"From {scene['title']!r}: {point.message}",
        "material": material,
        **{section: scene[section] for section in ("closure", "effects", "integration") if section in scene},
        "initial": {"stress": point.stress_start.tolist()},
        "path": [
            {
                "control": ["strain", "strain", "strain"],
                "target": point.strain_increment.tolist(),
                "increments": 1,
            }
        ],
    }


def write_failed_point(folder: Path, point: FailedPoint, description: LawDescription, scene: dict[str, Any]) -> Path:
    """Write `failed_point.toml`, to be run with ``granfabric point``."""
    path = folder / FAILED_POINT
    files.write_text(path, to_toml(failed_point_scene(point, description, scene)))
    return path

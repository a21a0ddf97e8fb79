"""A point that failed in a boundary-value problem, as a point scene that replays it alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import unknown
from granfabric.cases.grains.law import GrainsLaw
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.toml_text import to_toml
from granfabric.constitutive.contract import Law, LawDescription
from granfabric.constitutive.effective_stress import effective_stress
from granfabric.dem_ref.measures.contacts import love_weber_stress
from granfabric.dem_ref.sample.disks import save_sample
from granfabric.fem.equilibrium.results import FailedPoint

from . import files


def failed_point_scene(point: FailedPoint, description: LawDescription, scene: dict[str, Any]) -> dict[str, Any]:
    """Point scene that starts from the stress and the whole state at which the point failed.

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
    state = {}
    effective = effective_stress(point.stress_start, point.state_start, description)
    for variable in description.state:
        values = point.state_start[description.columns(variable.name)].tolist()
        state[variable.name] = values if len(values) > 1 else values[0]
    return {
        **_heading(point, scene),
        "material": material,
        **{section: scene[section] for section in ("closure", "effects", "integration") if section in scene},
        "initial": {"stress": effective.tolist(), "state": state},
        "path": _increment(point),
    }


def write_failed_point(folder: Path, point: FailedPoint, law: Law, scene: dict[str, Any]) -> Path:
    """Write `failed_point.toml`, to be run with ``granfabric point``; with grains also the packing, beside it."""
    path = folder / files.FAILED_POINT
    if isinstance(law, GrainsLaw):
        save_sample(folder / files.FAILED_PACKING, law.packing(point.state_start))
        made = failed_grains(point, law, scene)
    else:
        made = failed_point_scene(point, law.description, scene)
    files.write_text(path, to_toml(made))
    return path


def failed_grains(point: FailedPoint, law: GrainsLaw, scene: dict[str, Any]) -> dict[str, Any]:
    """Point scene that starts from the packing with which a point failed, kept in a file of its own.

    Parameters
    ----------
    point : FailedPoint
    law : GrainsLaw
    scene : dict
        The field scene as resolved.
    """
    own = {key: value for key, value in scene["law"].items() if key not in ("packings", "packing_file")}
    return {
        **_heading(point, scene),
        "law": {**own, "packing_file": files.FAILED_PACKING, "lost_pressure": law.lost_pressure(point.state_start)},
        "initial": {"stress": love_weber_stress(law.packing(point.state_start)).tolist()},
        "path": _increment(point),
    }


def _heading(point: FailedPoint, scene: dict[str, Any]) -> dict[str, Any]:
    x, y = point.position
    return {
        "title": f"Point {point.point} at ({x:.6g}, {y:.6g}) m, which failed",
        "kind": "point",
        "description": f"From {scene['title']!r}: {point.message}",
    }


def _increment(point: FailedPoint) -> list[dict[str, Any]]:
    strains = ["strain", "strain", "strain"]
    return [{"control": strains, "target": point.strain_increment.tolist(), "increments": 1}]


def start_state(loaded: LoadedScene, description: LawDescription) -> NDArray[np.float64] | None:
    """State from which a point scene starts, shape (1, nstate); None if it is that of the packing before loading.

    Raises
    ------
    InputError
        If `initial.state` does not hold every state variable of the law within its bounds, and nothing else.
    """
    given = loaded.scene.initial.state
    if given is None:
        return None
    state = np.zeros((1, description.nstate))
    names = [variable.name for variable in description.state]
    for name in given:
        if name not in names:
            raise loaded.error(["initial", "state"], unknown("the state variable", name, names))
    for variable in description.state:
        key = f"initial.state.{variable.name}"
        if variable.name not in given:
            raise loaded.error(["initial", "state"], f"{key!r} is missing ({variable.meaning})")
        values = np.atleast_1d(np.array(given[variable.name], dtype=np.float64))
        if len(values) != variable.components:
            raise loaded.error(["initial", "state"], f"{key} needs {variable.components} numbers, not {len(values)}")
        if not ((values >= variable.lower) & (values <= variable.upper)).all():
            raise loaded.error(
                ["initial", "state"],
                f"{key} = {given[variable.name]} is outside its bounds [{variable.lower:g}, {variable.upper:g}]",
            )
        state[:, description.columns(variable.name)] = values
    return state

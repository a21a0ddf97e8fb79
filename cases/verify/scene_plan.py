"""Whether a field scene is a compressed rectangle that a specimen of disks can follow, and what the specimen does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from granfabric.cases.errors import InputError
from granfabric.cases.field.prepare import read_or_make_mesh
from granfabric.cases.scene.reader import LoadedScene
from granfabric.fem.mesh.host_mesh import HostMesh

NEAR = 1e-9
"""Over the size of the rectangle."""
SIDES = ("left", "right")
ENDS = ("bottom", "top")
OTHER_LOADS = ("traction", "body_force", "closed_form", "rigid", "spring")
ROUGH, SMOOTH = 1000.0, 0.0
"""Friction of a platen where the scene holds the ends sideways: nothing slips, and where it does not."""


@dataclass(frozen=True)
class SpecimenPlan:
    """A rectangle between two platens under a constant lateral pressure.

    Attributes
    ----------
    width, height : float
        m.
    pressure : float
        Pa.
    is_rough : bool
    strains : dict of str to float
        Axial strain at the end of each stage, compression positive.
    """

    width: float
    height: float
    pressure: float
    is_rough: bool
    strains: dict[str, float]

    def strain_at(self, stage: str, fraction: float) -> float:
        """Axial strain within a stage."""
        names = list(self.strains)
        place = names.index(stage)
        before = self.strains[names[place - 1]] if place else 0.0
        return before + fraction * (self.strains[stage] - before)

    def targets(self, stage: str, fraction: float) -> list[float]:
        """Axial strains from turn to turn up to there."""
        names = list(self.strains)
        found = [self.strains[name] for name in names[: names.index(stage)]]
        targets = [0.0, *found, self.strain_at(stage, fraction)]
        kept = [targets[0]]
        for value in targets[1:]:
            if value == kept[-1]:
                continue
            if len(kept) > 1 and (value - kept[-1]) * (kept[-1] - kept[-2]) > 0.0:
                kept.pop()
            kept.append(value)
        return kept[1:]


def plan_of(loaded: LoadedScene) -> SpecimenPlan:
    """The plan of a scene.

    Raises
    ------
    InputError
        If a specimen of disks between platens and membranes cannot follow it; the key, and why.
    """
    scene = loaded.scene

    def refused(keys: Sequence[Any], why: str) -> InputError:
        text = f"--specimens: {why}; a specimen is a rectangle compressed between platens under a constant pressure"
        return loaded.error(list(keys), text)

    if scene.material is None:
        raise refused(["materials"], "the scene has several materials")
    stress = scene.initial.stress
    gradients = [*scene.initial.stress_gradient_x, *scene.initial.stress_gradient_y]
    if stress is None or any(gradients) or stress[2] != 0.0 or abs(stress[0] - stress[1]) > 1e-6 * abs(stress[0]):
        raise refused(["initial"], "its initial stress is not the same in all directions and places")
    pressure = -float(stress[0])
    mesh = read_or_make_mesh(loaded)
    low, high = _rectangle(mesh, refused)
    supports: dict[str, set[str]] = {}
    reached, strains = 0.0, {}
    pressed: set[str] = set()
    for number, stage in enumerate(scene.stage):
        keys = ["stage", number]
        for name in OTHER_LOADS:
            if getattr(stage, name):
                raise refused([*keys, name], f"stage {stage.name!r} has {name}")
        if stage.control is not None or stage.activate or stage.deactivate or not stage.keep:
            raise refused(keys, f"stage {stage.name!r} has a control, or takes parts or loads away")
        if stage.amplitude not in (None, "ramp") or stage.cycles is not None:
            raise refused([*keys, "amplitude"], f"stage {stage.name!r} has an amplitude")
        for fixed in stage.fixed:
            if fixed.boundary not in ENDS:
                raise refused([*keys, "fixed"], f"boundary {fixed.boundary!r} is held")
            supports.setdefault(fixed.boundary, set()).update(fixed.components)
        for load in stage.pressure:
            if load.boundary not in SIDES or load.value != pressure or any(load.gradient) or load.amplitude is not None:
                raise refused(
                    [*keys, "pressure"], f"the pressure on {load.boundary!r} is not the initial one of {pressure:g} Pa"
                )
            pressed.add(load.boundary)
        for load in stage.displacement:
            plain = isinstance(load.value, float | int) and not any(load.gradient)
            if (load.boundary, load.component) != ("top", "y") or not plain or load.amplitude is not None:
                raise refused(
                    [*keys, "displacement"], f"{load.component} of boundary {load.boundary!r} is moved, not y of 'top'"
                )
            reached = -float(load.value) / float(high[1] - low[1])
        strains[stage.name] = reached
    if pressed != set(SIDES):
        raise refused(["stage"], "'left' and 'right' are not both under pressure")
    if set(supports) != set(ENDS) or not all("y" in held for held in supports.values()):
        raise refused(["stage"], "'bottom' and 'top' are not both held along y from the start")
    rough = {"x" in held for held in supports.values()}
    if len(rough) != 1:
        raise refused(["stage"], "one of its ends is held sideways, the other not")
    if not any(strains.values()):
        raise refused(["stage"], "nothing is compressed")
    return SpecimenPlan(float(high[0] - low[0]), float(high[1] - low[1]), pressure, rough.pop(), strains)


def _rectangle(mesh: HostMesh, refused: Any) -> tuple[Any, Any]:
    """Corners of the rectangle that a mesh fills, its sides named as they lie."""
    points = np.asarray(mesh.mesh.p)
    low, high = points.min(axis=1), points.max(axis=1)
    size = float(np.max(high - low))
    for name, axis, value in (
        ("left", 0, low[0]), ("right", 0, high[0]), ("bottom", 1, low[1]), ("top", 1, high[1])
    ):  # fmt: skip
        if name not in mesh.boundaries:
            raise refused(["mesh"], f"the mesh has no boundary {name!r}")
        nodes = np.unique(mesh.mesh.facets[:, mesh.boundaries[name]])
        if np.abs(points[axis, nodes] - value).max() > NEAR * size:
            raise refused(["mesh"], f"boundary {name!r} is not a straight side of a rectangle")
    named = np.concatenate([np.asarray(mesh.boundaries[name]) for name in ("left", "right", "bottom", "top")])
    if len(np.setdiff1d(mesh.mesh.boundary_facets(), named)):
        raise refused(["mesh"], "the mesh has other sides than those of a rectangle")
    return low, high

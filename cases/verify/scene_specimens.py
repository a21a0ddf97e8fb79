"""Specimens of disks that follow a field scene: reactions, and fields averaged to the nodes and points of its mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import RunError
from granfabric.cases.grains.store import PackingStore
from granfabric.cases.verify.scene_plan import ROUGH, SMOOTH, SpecimenPlan
from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.specimen.cut import SpecimenOptions
from granfabric.dem_ref.specimen.fields import SpecimenFields, specimen_fields
from granfabric.dem_ref.specimen.run import COMPRESSION, REST, SpecimenLeg, SpecimenRun
from granfabric.dem_ref.specimen.specimen import Specimen

Array = NDArray[np.float64]

INERTIAL_NUMBER = 1e-6
LEAST_REACH = 4.0
"""Of the kernel, mean diameters."""
CELLS = 1.5
"""Reach of the kernel over the distance of integration points."""
RECORDS = 20
KERNEL = "lucy"


@dataclass(frozen=True)
class OneSpecimen:
    """What became of one specimen.

    Attributes
    ----------
    disks : int
    coordination : (2,)
        Before and after, over the disks between the membranes.
    fabric : (2,)
        Component of a_c along x, likewise.
    reaction : float
        Increment of the mean force of both platens over the initial one.
    before, after : dict of str to SpecimenFields
        At the places asked for.
    reach : float
        Of the kernel, m of the scene.
    """

    disks: int
    coordination: Array
    fabric: Array
    reaction: float
    before: dict[str, SpecimenFields]
    after: dict[str, SpecimenFields]
    reach: float


def packings_for(disks: int, plan: SpecimenPlan, stiffness: float, stiffness_ratio: float) -> PackingStore:
    """Packings from which specimens of about so many disks are cut."""
    shape = plan.height / plan.width
    options = PackingOptions(
        normal_stiffness=stiffness, stiffness_ratio=stiffness_ratio, stiffness_to_pressure=stiffness / plan.pressure
    )
    return PackingStore(max(50, round(disks * max(shape, 1.0 / shape))), options)


def compressed(
    packing: Sample,
    plan: SpecimenPlan,
    end: tuple[str, float],
    places: dict[str, Array],
    points: int,
    progress: Callable[[float, str], None],
    stop: Callable[[], bool],
) -> OneSpecimen:
    """One specimen, consolidated and compressed as the scene is up to a stage and a fraction of it.

    Parameters
    ----------
    packing : Sample
    plan : SpecimenPlan
    end : tuple
        Stage and fraction.
    places : dict of str to ndarray, shape (m, 2)
        Coordinates in the scene [m] at which fields are averaged.
    points : int
        Integration points of the mesh, whose distance the kernel covers.
    progress, stop : callable

    Raises
    ------
    RunError
        If it does not come to rest, or was stopped.
    """
    options = SpecimenOptions(
        platen_friction=ROUGH if plan.is_rough else SMOOTH, lateral_pressure=plan.pressure,
        inertial_number=INERTIAL_NUMBER, height_to_width=plan.height / plan.width,
    )  # fmt: skip
    legs: list[SpecimenLeg] = []
    for target in plan.targets(*end):
        legs.append(SpecimenLeg(COMPRESSION, axial_strain=target))
    legs.append(SpecimenLeg(REST))
    largest = max(abs(leg.axial_strain) for leg in legs)
    run = SpecimenRun(packing, options, tuple(legs), largest / RECORDS)
    reduced = {name: at / [plan.width, plan.height] for name, at in places.items()}
    before: dict[str, SpecimenFields] = {}
    reach = 0.0

    def on_record(state: SpecimenRun) -> None:
        nonlocal reach
        if not before and state.specimen.start is not None:
            start = state.specimen.start
            diameter = state.specimen.sample.mean_diameter
            spacing = sqrt(start.width * start.height / points) / diameter
            reach = max(LEAST_REACH, CELLS * spacing)
            before.update(_fields(state.specimen, reduced, reach))
            reach *= diameter / start.height

    def tell(state: SpecimenRun) -> None:
        progress(state.completed_fraction(), f"axial strain {state.specimen.axial_strain:.3g}")

    run.execute(tell, stop, on_record)
    if not run.finished:
        raise RunError("stopped")
    if run.reason:
        raise RunError(f"a specimen was given up: {run.reason}")
    after = _fields(run.specimen, reduced, reach * run.specimen.start.height / run.specimen.sample.mean_diameter)  # type: ignore[union-attr]
    h = run.history()
    force = h["upper_force"] + h["lower_force"]
    first = next(iter(before))
    return OneSpecimen(
        run.specimen.sample.count,
        np.array([_mean(fields[first].coordination, fields[first].disks) for fields in (before, after)]),
        -h["fabric_anisotropy"][[0, -1]],
        float(force[-1] / force[0] - 1.0),
        before, after, reach * plan.height,
    )  # fmt: skip


def _mean(values: Array, weights: Array) -> float:
    told = weights > 0.0
    return float(values[told] @ weights[told] / weights[told].sum())


def _fields(specimen: Specimen, reduced: dict[str, Array], reach: float) -> dict[str, SpecimenFields]:
    return {name: specimen_fields(specimen, at, reach, KERNEL) for name, at in reduced.items()}


def mean_fields(found: Sequence[OneSpecimen], place: str) -> dict[str, Array]:
    """Means over the specimens: changes of z and of a_c along x, and q/p of the mean stress."""

    def mean(of: Callable[[OneSpecimen], Any]) -> Array:
        return np.asarray(np.mean([of(one) for one in found], axis=0), dtype=np.float64)

    stress = mean(lambda one: one.after[place].stress)
    p = -0.5 * (stress[:, 0] + stress[:, 1])
    return {
        "coordination": mean(lambda one: one.after[place].coordination - one.before[place].coordination),
        "fabric_anisotropy": mean(lambda one: one.after[place].fabric[:, 0] - one.before[place].fabric[:, 0]),
        "stress_ratio": np.hypot(0.5 * (stress[:, 0] - stress[:, 1]), stress[:, 2]) / p,
    }


def with_error(values: Sequence[float]) -> tuple[float, float | str]:
    """Mean and its standard error; none of a single specimen."""
    mean = float(np.mean(values))
    return mean, float(np.std(values, ddof=1) / sqrt(len(values))) if len(values) > 1 else ""

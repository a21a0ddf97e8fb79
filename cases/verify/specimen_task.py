"""One specimen of a comparison as a piece of work of its own, for any process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from numpy.typing import NDArray

from granfabric.cases.errors import RunError
from granfabric.cases.verify.scene_plan import SpecimenPlan
from granfabric.cases.verify.scene_specimens import OneSpecimen, compressed, packings_for
from granfabric.dem_ref.dynamics.motion import UnstableMotionError
from granfabric.dem_ref.dynamics.packing import PackingError
from granfabric.dem_ref.inputs.probes import ProbeError
from granfabric.dem_ref.sample.disks import SampleError
from granfabric.dem_ref.sample.neighbours import CellTooSmallError
from granfabric.dem_ref.specimen.membrane import MembraneError

WITHOUT_REST = (
    RunError, PackingError, ProbeError, SampleError, CellTooSmallError, UnstableMotionError, MembraneError
)  # fmt: skip
"""What ends a specimen with a sentence."""


@dataclass(frozen=True)
class SpecimenTask:
    """What a specimen is made of and follows; see `scene_specimens.compressed`.

    Attributes
    ----------
    seed : int
    disks : int
        About so many.
    plan : SpecimenPlan
    stiffness, stiffness_ratio : float
        kn [Pa], kt/kn.
    end : tuple
        Stage and fraction.
    places : dict of str to ndarray, shape (m, 2)
    points : int
    """

    seed: int
    disks: int
    plan: SpecimenPlan
    stiffness: float
    stiffness_ratio: float
    end: tuple[str, float]
    places: dict[str, NDArray]
    points: int


def carry_out(
    task: SpecimenTask, report: Callable[[float], None], stop: Callable[[], bool]
) -> OneSpecimen | str | None:
    """The specimen, or why there is none; None if it was stopped."""
    store = packings_for(task.disks, task.plan, task.stiffness, task.stiffness_ratio)
    try:
        packing = store.at_rest(task.seed)
        return compressed(
            packing, task.plan, task.end, task.places, task.points, lambda part, text: report(part), stop
        )
    except WITHOUT_REST as error:
        return None if stop() else str(error)

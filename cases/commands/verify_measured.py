"""The law of a comparison with what is measured on the packings that it is compared with: `verify SCENE --measured`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from granfabric.cases.errors import RunError
from granfabric.cases.grains.store import PackingStore
from granfabric.cases.records import files
from granfabric.cases.scene.material_file import material_text, refusal
from granfabric.cases.scene.measured import mean_of, measure_inputs, warnings
from granfabric.cases.scene.reader import LoadedScene, load
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify.scene_plan import SpecimenPlan
from granfabric.cases.verify.scene_specimens import packings_for
from granfabric.dem_ref.dynamics.packing import PackingError, PackingOptions
from granfabric.dem_ref.inputs.probes import ProbeError
from granfabric.dem_ref.sample.disks import SampleError
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

if TYPE_CHECKING:
    from .verify_scene import Judges


def measured_scene(
    loaded: LoadedScene,
    scene: str,
    assignments: Sequence[str],
    at_points: tuple[int, int],
    plan: SpecimenPlan | None,
    judges: Judges,
    folder: Path,
    screen: Screen,
) -> LoadedScene:
    """The scene with the material measured on packings, which is written to `material.toml`; sliding stays its own.

    Of specimens the packings that they are cut from, which are large, else those of the points.

    Parameters
    ----------
    at_points : tuple of int
        Disks and packings at the points.

    Raises
    ------
    RunError
        If the packings cannot be made or measured, or the law refuses what they give.
    """
    from .verify_scene import SPECIMEN_PARTICLES

    material = loaded.scene.material
    if plan is not None and judges.specimens:
        disks = judges.disks or SPECIMEN_PARTICLES
        store, count = packings_for(disks, plan, material.normal_stiffness, material.stiffness_ratio), judges.specimens
    else:
        stress: Any = loaded.scene.initial.stress
        if stress is None:
            raise loaded.error(["initial"], "--measured: packings are measured under one initial stress")
        options = PackingOptions(
            normal_stiffness=material.normal_stiffness,
            stiffness_ratio=material.stiffness_ratio,
            stiffness_to_pressure=material.normal_stiffness / (-0.5 * (stress[0] + stress[1])),
        )
        store, count = PackingStore(at_points[0], options), at_points[1]
    found = []
    with screen.progress("measuring", float(count)) as advance:
        for number in range(count):
            advance(number, f"packing {number + 1} of {count}")
            try:
                found.append(measure_inputs(store.at_rest(number + 1)))
            except (PackingError, ProbeError, SampleError, CellTooSmallError) as error:
                raise RunError(f"packing {number + 1} cannot be measured: {error}") from error
    mean = mean_of(found)
    if complaint := refusal(mean.values):
        raise RunError(f"the law refuses what is measured on the packings: {complaint}")
    many = f"mean of {count} packings of {store.particles} disks" if count > 1 else f"{store.particles} disks"
    path = folder / files.MATERIAL
    files.write_text(path, material_text(mean.values, f"{loaded.scene.title}, {many}", mean.errors, mean.missing))
    for line in warnings(mean):
        screen.say(f"{files.MATERIAL}: {line}")
    return load(scene, [*assignments, f"material_file='{path.resolve()}'"])

"""From a checked scene with grains at its points to the law and the packings that the points begin as."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import RunError
from granfabric.cases.grains import packing_columns
from granfabric.cases.grains.drive import Pace
from granfabric.cases.grains.law import MEASURES, GrainsLaw
from granfabric.cases.grains.store import NotCarriedError, OnePacking, PackingStore
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_dem import Packing
from granfabric.cases.terminal.screen import Screen
from granfabric.dem_ref.dynamics.packing import PackingError, PackingOptions
from granfabric.dem_ref.inputs.probes import ProbeError, at_rest
from granfabric.dem_ref.preparation.grading import read_grading
from granfabric.dem_ref.sample.disks import Sample, SampleError, load_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError
from granfabric.fem.loads.problem import Problem

from . import memory
from .prepare import Prepared

Array = NDArray[np.float64]

COPIES = 6
"""Of the state of a point in memory at a time: start and end of a step, results and files."""
SOFTEST, STIFFEST = 50.0, 1e6
"""kn over p for which packings are made."""


def options_of(loaded: LoadedScene, pressure: float) -> PackingOptions:
    """Options of the packings of a scene under a mean pressure [Pa].

    Raises
    ------
    InputError
        If kn over p is out of bounds, or a grading cannot be read.
    """
    section = loaded.scene.packing or Packing()
    ratio = section.normal_stiffness / pressure
    if not SOFTEST <= ratio <= STIFFEST:
        raise loaded.error(
            ["packing", "normal_stiffness"],
            f"packing.normal_stiffness = {section.normal_stiffness:g} Pa over the initial mean pressure {pressure:g} "
            f"Pa is {ratio:.3g}; packings are made for {SOFTEST:g} to {STIFFEST:g}",
        )
    values = section.model_dump(exclude={"particles", "seed", "grading_file", "stiffness_to_pressure"})
    if section.grading_file is not None:
        try:
            values["grading"] = read_grading(loaded.file.parent / Path(section.grading_file).expanduser())
        except SampleError as error:
            raise loaded.error(["packing", "grading_file"], str(error)) from error
    return PackingOptions(**values, stiffness_to_pressure=ratio)


def grains_law(
    loaded: LoadedScene, stress: Array, screen: Screen, stop: Callable[[], bool] = lambda: False
) -> tuple[GrainsLaw, Array]:
    """The law of a scene with grains, and the state of its points.

    Parameters
    ----------
    loaded : LoadedScene
    stress : ndarray, shape (npt, 3)
        Initial stress of the points [Pa], tension positive.
    screen : Screen
    stop : callable
        Asked between two packings.

    Returns
    -------
    law : GrainsLaw
    state : ndarray, shape (npt, nstate)

    Raises
    ------
    InputError
        If a packing cannot be made as asked for, or does not carry the stress of its point.
    RunError
        If it was stopped; what was made is kept.
    """
    section = loaded.scene.law
    pace = Pace(section.strain_step, section.rest, section.longest_rest)
    packing = loaded.scene.packing or Packing()
    given = None if section.packing_file is None else _from_file(loaded)
    count = packing.particles if given is None else given.count
    _refuse_too_many(loaded, count, len(stress))
    source: PackingStore | OnePacking
    if given is None:
        source = store = PackingStore(count, options_of(loaded, float(-0.5 * stress[:, :2].sum(axis=1).mean())))
        packings, place = min(section.packings, len(stress)), store.folder
    else:
        source, packings, place = OnePacking(given), 1, None
    samples: list[Sample] = []
    # points of the same packing and the same stress share one that is loaded once
    keys = [(point % packings, *row) for point, row in enumerate(stress.tolist())]
    wanted = list(dict.fromkeys(keys))
    found: dict[tuple[Any, ...], Sample] = {}
    with screen.progress("packings", packings + len(wanted)) as advance:

        def go_on(done: float, text: str) -> None:
            advance(done, text)
            if stop():
                raise RunError("stopped while packing; what was made is kept, and used when it is asked for again")

        try:
            for number in range(packings):
                go_on(number, f"packing {number + 1} of {packings}")
                samples.append(
                    source.at_rest(packing.seed + number, lambda text, part, at=number: go_on(at + part, text))  # type: ignore[misc]
                )
            for done, key in enumerate(wanted):
                go_on(packings + done, f"initial stress {done + 1} of {len(wanted)}")
                found[key] = source.under(packing.seed + key[0], np.array(key[1:]))
        except (PackingError, ProbeError, CellTooSmallError, SampleError) as error:
            raise loaded.error(["packing"], f"packing: {error}") from error
        except NotCarriedError as error:
            carried = ", ".join(f"{value:.6g}" for value in key[1:])
            raise loaded.error(["initial"], f"initial.stress = [{carried}] Pa: {error}") from error
    if source.made:
        screen.say(f"{source.made} packings of {count} disks made or loaded, and kept in {place}")

    def under(number: int, at: Array) -> Sample:
        key = (number, *at.tolist())
        if key not in found:
            found[key] = source.under(packing.seed + number, at)
        return found[key]

    secant = section.tangent == "secant"
    law = GrainsLaw(samples, pace, secant, lost_pressure=section.lost_pressure, under=under)
    return law, _rows(loaded, law, [found[key] for key in keys], stress)


def _rows(loaded: LoadedScene, law: GrainsLaw, samples: list[Sample], stress: Array) -> Array:
    try:
        return law.rows(samples, stress)
    except ValueError as error:
        raise loaded.error(["initial"], f"initial.stress: {error}") from error


def _from_file(loaded: LoadedScene) -> Sample:
    path = loaded.file.parent / Path(loaded.scene.law.packing_file).expanduser()
    try:
        sample = load_sample(path)
        if sample.count > packing_columns.MOST_DISKS:
            raise SampleError(f"{sample.count} disks at a point are more than {packing_columns.MOST_DISKS}")
        return at_rest(sample)
    except (SampleError, ProbeError) as error:
        raise loaded.error(["law", "packing_file"], f"law.packing_file: {error}") from error


def _refuse_too_many(loaded: LoadedScene, disks: int, points: int) -> None:
    needed = COPIES * 8.0 * (MEASURES + packing_columns.width(disks)) * points
    memory.refuse_beyond(needed, f"{loaded.file}: {points} points with {disks} disks each")


def _refuse_without_pressure(loaded: LoadedScene) -> None:
    for number, stage in enumerate(loaded.scene.stage):
        if stage.activate and not stage.fill_pressure > 0.0:
            keys = ["stage", number]
            raise loaded.error(
                keys,
                f"{loaded.label(keys)}: fill_pressure = {stage.fill_pressure:g} Pa: without pressure a packing carries "
                "nothing; give the pressure under which the fill is placed, of the order of its unit weight times the "
                "height of a layer",
            )


def with_grains(
    loaded: LoadedScene,
    prepared: Prepared,
    screen: Screen,
    stop: Callable[[], bool],
    spread: Callable[[GrainsLaw, Array], tuple[GrainsLaw, Array]] = lambda law, state: (law, state),
) -> Prepared:
    """The problem with grains at its points, which `spread` may share out to workers.

    Raises
    ------
    InputError, RunError
        As `grains_law`.
    """
    problem = prepared.problem
    _refuse_without_pressure(loaded)
    law, state = spread(*grains_law(loaded, problem.initial_stress, screen, stop))
    try:
        made = Problem(
            problem.space,
            law,
            problem.stages,
            initial_stress=problem.initial_stress,
            initial_state=state,
            balance_initial_stress=problem.balance_initial_stress,
        )
    except ValueError as error:  # material that is placed where there was some before begins as a packing anew
        raise loaded.error(["stage"], f"stage: with grains at the points: {error}") from error
    return replace(prepared, problem=made)

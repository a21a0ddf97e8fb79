"""Study: the effects that are decided for each shipped scene, against everything: error and time saved."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.cases.effects.compare import Outcome, distance, run_field, run_point
from granfabric.cases.effects.decision import Decision, decide_field, decide_point
from granfabric.cases.field.prepare import prepare
from granfabric.cases.pictures.style import BLUE, ORANGE, picture
from granfabric.cases.scene import catalogue, effects_choice
from granfabric.cases.scene.effects_choice import MEMORY, EffectSet, all_names, everything
from granfabric.cases.scene.reader import LoadedScene, load
from granfabric.cases.scene.schema_law_kind import is_grains

from .front import mark_fronts
from .study import COMMON_COLUMNS, Column, Effort, Row, Study, StudyError

KINDS = {"point": "point scenes", "field": "boundary-value problems"}
LEFT_OPEN = "0.01"
"""Tolerance with which scenes are decided that ask for more digits than anyone needs."""

QUICK = ("p_constant", "simple_shear", "biaxial", "pressurised_cavity")


def scene_names() -> list[str]:
    """Shipped scenes that have effects: grains at the points have none to leave out."""
    names = [name for name, entry in catalogue.shipped().items() if entry.kind in KINDS]
    return [name for name in names if not is_grains(load(name).scene)]


def coarse(name: str, every: Sequence[str] = ()) -> LoadedScene:
    """A shipped scene with linear elements, decided with a tolerance of one percent if it has one of its own."""
    loaded = load(name, every)
    settings = list(every)
    if loaded.scene.kind == "field":
        settings.append(f"mesh.element={loaded.scene.mesh.element[0]}1")
    return load(name, settings)


def compared(loaded: LoadedScene, rounds: int = 1) -> Row:
    """Decide a scene, run it as decided and with everything, and compare.

    Raises
    ------
    StudyError
        If neither run comes to an end.
    """
    effects_choice.check(loaded)
    field = loaded.scene.kind == "field"
    prepared = prepare(loaded) if field else None
    full = everything(loaded.scene)
    weights = np.ones(1)
    if prepared is not None:
        weights = prepared.problem.space.weights / prepared.problem.space.weights.sum()

    def decide() -> Decision:
        return decide_point(loaded) if prepared is None else decide_field(loaded, prepared)

    def run(chosen: EffectSet) -> Outcome:
        return run_point(loaded, chosen) if prepared is None else run_field(loaded, prepared, chosen)

    decide()
    probe, as_decided, with_all = [], [], []
    for _ in range(rounds):
        since = time.process_time()
        decision = decide()
        probe.append(time.process_time() - since)
        as_decided.append(run(decision.chosen))
        with_all.append(run(full))
    ours, theirs = as_decided[-1], with_all[-1]
    if len(ours.keys) == 0 and len(theirs.keys) == 0:
        raise StudyError(f"scene {loaded.name} takes no step")
    found = distance(theirs, ours, weights)
    seconds = [min(outcome.seconds for outcome in outcomes) for outcomes in (as_decided, with_all)]
    off = [name for name in all_names() if full.has(name) and not decision.chosen.has(name)]
    return {
        "facet": loaded.scene.kind,
        "series": loaded.name,
        "setting": loaded.name,
        "error": found.error,
        "seconds": seconds[0],
        "count": ours.counters.get("law_calls", len(ours.keys)),
        "tolerance": decision.tolerance,
        "estimate": decision.error,
        "error_at_worst_point": found.largest,
        "quantity": found.quantity,
        "left_out": ", ".join(off) or "nothing",
        "memory": "on" if decision.chosen.has(MEMORY) else "off",
        "seconds_everything": seconds[1],
        "seconds_probe": min(probe),
        "speedup": seconds[1] / max(seconds[0], 1e-9),
        "uncoupled": int(ours.uncoupled),
        "finished": int(ours.finished and theirs.finished),
        "within": int(found.error <= decision.tolerance),
    }


def rows(effort: Effort) -> list[Row]:
    """All shipped scenes; see `Study.rows`."""
    names = [name for name in scene_names() if not effort.quick or name in QUICK]
    table: list[Row] = []
    for place, name in enumerate(names):
        effort.advance(place, len(names), name)
        settings = ["effects.tolerance=" + LEFT_OPEN]
        loaded = coarse(name, settings) if effort.quick else load(name, settings)
        table.append(compared(loaded, effort.rounds))
    for kind in KINDS:
        mark_fronts([row for row in table if row["facet"] == kind])
    return table


def draw(path: Path, table: Sequence[Row]) -> None:
    """Bars: speed-up of the computation, and error with its estimate and the tolerance."""
    members = list(table)[::-1]
    with picture(path, 11.0, 1.4 + 0.34 * len(members)) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        heights = np.arange(len(members))
        left.barh(heights, [row["speedup"] for row in members], color=BLUE)
        left.set_yticks(heights, [row["setting"] for row in members])
        left.set(xlabel="time with everything over time as decided", xlim=(0.0, None))
        left.axvline(1.0, color="#888888", linewidth=1.0)
        left.set_title("(a) time saved")
        right.barh(heights, [max(row["error"], 1e-8) for row in members], color=ORANGE)
        right.plot([max(row["estimate"], 1e-8) for row in members], heights, "|", color="#222222", markersize=12)
        right.plot([row["tolerance"] for row in members], heights, "d", color="#888888", markersize=5)
        right.set(xscale="log", xlim=(1e-7, 1.0), xlabel="error (bar), estimate beforehand (|), tolerance (diamond)")
        right.set_title("(b) error against everything, 99 % of the area")
        figure.suptitle("Effects as decided, on every shipped scene", x=0.01, ha="left", fontsize=13)


def findings(table: Sequence[Row]) -> list[str]:
    """What the numbers say."""
    beyond = [row["setting"] for row in table if not row["within"]]
    said = [
        f"{len(table) - len(beyond)} of {len(table)} scenes stay within their tolerance"
        + (f"; not {', '.join(beyond)}." if beyond else ".")
    ]
    ways = [row["setting"] for row in table if row["uncoupled"]]
    if ways:
        said.append(f"Displacements by one linear solve a stage: {', '.join(ways)}.")
    fields: list[Any] = [row for row in table if row["facet"] == "field"]
    if fields:
        saved = max(fields, key=lambda row: row["speedup"])
        said.append(f"Most is saved in {saved['setting']}: {saved['speedup']:.1f} times faster.")
    return said


STUDY = Study(
    name="decisions",
    title="Effects decided for the shipped scenes",
    question="Are the effects that a scene is given on auto enough, and what time do they save?",
    knobs=(
        ("scenes", "all shipped point and field scenes; what they set themselves stays"),
        ("tolerance", f"{LEFT_OPEN}, also where the scene asks for less"),
        ("reference", "everything on that the scene does not rule out"),
        ("error", "as in the study `effects`"),
        ("time", "of the computation alone, the best of the rounds; the probe is told apart"),
    ),
    columns=(
        *COMMON_COLUMNS,
        Column("tolerance", "error that may be left"),
        Column("estimate", "error expected beforehand"),
        Column("error_at_worst_point", "the largest of all points"),
        Column("quantity", "quantity with the largest error"),
        Column("left_out", "what was decided to be left out"),
        Column("memory", "whether the closure has a memory of weak forces"),
        Column("seconds_everything", "processor time with everything", "s"),
        Column("seconds_probe", "processor time of the decision", "s"),
        Column("speedup", "time with everything over time as decided"),
        Column("uncoupled", "1 if displacements come from one linear solve a stage"),
        Column("finished", "1 if both runs came to their end"),
        Column("within", "1 if the error is within the tolerance"),
    ),
    rows=rows,
    draw=draw,
    findings=findings,
)

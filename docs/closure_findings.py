"""Figure `docs/figures/closure_findings.png`: what contacts do, and what the closure makes of it.

    python docs/closure_findings.py [DISKS] [SEEDS]

Left: slip k and irreversible scatter c_i from loops of different size, over the square of the stress ratio. Middle: a_t
on loading at constant p against ``c_t s - k s^2`` with c_t from elastic probes and k from a loop to q/p = 0.05. Right:
shift and standard deviation of the forces of contacts that began with 0.3 to 0.5 of the mean force, and the closure's
for weak contacts.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from granfabric.cases.pictures.style import BLACK, BLUE, ORANGE, picture
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material
from granfabric.constitutive.path import Leg, drive
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.inputs.material import CLOSURE_KEYS, MATERIAL_KEYS, measure_material
from granfabric.dem_ref.inputs.weak_contacts import measure_slip
from granfabric.dem_ref.loading.path import biaxial_test
from granfabric.dem_ref.loading.run import DemRun, RunOptions
from granfabric.dem_ref.measures.contacts import contacts_of, force_harmonics
from granfabric.dem_ref.measures.events import match_contacts

AMPLITUDES = (0.0125, 0.025, 0.05, 0.1)
CLASS = (0.3, 0.5)
CLASS_RATIO = 1.15
"""Contacts of that class feel more of the mean change than those at zero force: 1.15 times in elastic probes, up to 1.3
times in a loading to q/p = 0.2."""


def shift_and_deviation(start, now, scale):
    """X_1 along y and the standard deviation about it, of the contacts of `CLASS`; lost ones have no force."""
    match = match_contacts(start, now)
    force = np.zeros(start.count)
    force[match.persisting_before] = now.normal_force[match.persisting_after]
    before = start.normal_force / scale
    chosen = (before > CLASS[0]) & (before < CLASS[1])
    change = (force / scale - before)[chosen]
    basis = np.column_stack([np.ones(len(change)), -start.double_angle[chosen, 0]])
    harmonic = np.linalg.lstsq(basis, change, rcond=None)[0]
    return harmonic[1], np.std(change - basis @ harmonic)


def follow(packing):
    """q/p, a_t, X_1 and S along a loading at constant p."""
    start = contacts_of(packing)
    scale = force_harmonics(start).mean
    run = DemRun(packing, RunOptions(tuple(biaxial_test("constant_pressure", 0.3, 0.02))))
    rows = [(0.0, 0.0, 0.0, 0.0)]

    def record(state):
        row = dict(zip(("q", "p"), (state.history()["q"][-1], state.history()["p"][-1])))
        a_t = state.history()["tangential_force_anisotropy"][-1]
        rows.append((row["q"] / row["p"], a_t, *shift_and_deviation(start, contacts_of(state.sample), scale)))

    run.execute(on_record=record)
    return np.array(rows)


@dataclass(frozen=True)
class Findings:
    """What is drawn; means over the packings.

    Attributes
    ----------
    loops : ndarray, shape (4, 2)
        Slip k and irreversible scatter c_i of loops to each of `AMPLITUDES`.
    levels : ndarray, shape (n,)
        Stress ratios q/p of all curves.
    grains : ndarray, shape (3, n)
        a_t, X_1 and S of the class of contacts, of the DEM.
    tangential_ratio : float
        c_t of elastic probes.
    tangential, shift, spread : ndarray, shape (n,)
        a_t, X_1 and S of the closure, along the major compression.
    """

    loops: np.ndarray
    levels: np.ndarray
    grains: np.ndarray
    tangential_ratio: float
    tangential: np.ndarray
    shift: np.ndarray
    spread: np.ndarray


def compute(disks, seeds):
    """Loops and loadings of packings, and the closure with what was measured on them."""
    levels = np.linspace(0.0, 0.3, 31)
    loops, curves, inputs = [], [], []
    for seed in range(1, seeds + 1):
        packing = make_packing(disks, seed)
        small = [measure_slip(packing, s) for s in AMPLITUDES]
        loops.append([(loop.slip, loop.irreversible_scatter) for loop in small])
        inputs.append(measure_material(packing))
        rows = follow(packing)
        curves.append([np.interp(levels, rows[:, 0], column) for column in rows[:, 1:].T])
        print(f"packing {seed} of {seeds} done", flush=True)
    mean = {name: float(np.mean([one[name] for one in inputs])) for name in inputs[0]}
    law = ContactLaw(
        [Material(**{name: mean[name] for name in MATERIAL_KEYS})],
        Closure(
            force_change="shifted_distribution", tangential="frictional", **{name: mean[name] for name in CLOSURE_KEYS}
        ),
    )
    history = drive(law, (-1e5, -1e5, 0.0), [])
    names = ("force_shift_anisotropy", "tangential_force_anisotropy", "force_spread")
    states = [history.state]
    for s in levels[1:]:
        legs = [Leg(target=(-1e5 * (1 - s), -1e5 * (1 + s), 0.0))]
        history = drive(law, tuple(history.stress[0]), legs, state=history.state)
        states.append(history.state)
    x1, a_t, irreversible = (
        np.array([state[0, law.description.columns(name)][0] for state in states]) for name in names
    )
    x1, a_t = -x1, -a_t
    spread = np.hypot(irreversible, mean["elastic_scatter"] * x1)
    return Findings(
        np.mean(loops, axis=0), levels, np.mean(curves, axis=0), mean["tangential_force_ratio"], a_t, x1, spread
    )


def draw(target, found, title):
    """The figure."""
    levels = found.levels
    with picture(target, 15.0, 4.4) as figure:
        left, middle, right = figure.subplots(1, 3)
        left.plot(AMPLITUDES, found.loops[:, 0], "o-", color=BLACK, label="slip $k = -2 a_t/s^2$")
        left.plot(AMPLITUDES, found.loops[:, 1], "s--", color=ORANGE, label="scatter $c_i = S_i/s^2$")
        left.set(xlabel="stress ratio $s$ of the loop [-]", title="Left by loops, over $s^2$", ylim=(0.0, None))
        left.legend()
        middle.plot(levels, found.grains[0], "o", color=BLACK, markersize=3.5, label="DEM")
        middle.plot(levels, found.tangential_ratio * levels, ":", color=ORANGE, label="elastic, $c_t s$")
        middle.plot(levels, found.tangential, color=BLUE, label="$c_t s - k s^2$, then constant")
        middle.set(xlabel="stress ratio $q/p$ [-]", title="Tangential-force anisotropy $a_t$ [-]")
        middle.legend()
        right.plot(levels, found.grains[1] / CLASS_RATIO, "o", color=BLACK, markersize=3.5, label="DEM, shift $X_1$")
        right.plot(levels, found.grains[2], "s", color=ORANGE, markersize=3.5, label="DEM, standard deviation $S$")
        right.plot(levels, found.shift, color=BLACK, linewidth=1.2, label="closure, shift")
        right.plot(
            levels, found.spread, color=ORANGE, linestyle="--", linewidth=1.2, label="closure, standard deviation"
        )
        right.set(xlabel="stress ratio $q/p$ [-]", title="Shift and standard deviation of weak forces [$f$]")
        right.legend()
        figure.suptitle(title, x=0.01, ha="left", fontsize=13)


def main(disks=2000, seeds=2):
    """Compute and draw."""
    target = Path(__file__).parent / "figures" / "closure_findings.png"
    draw(target, compute(disks, seeds), f"What contacts do: {seeds} packings of {disks} disks")
    print(target)


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:]))

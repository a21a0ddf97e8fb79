"""Uncoupled against coupled solution: a biaxial test of about 50,000 degrees of freedom in 50 steps.

The same scene is run with the stiffness following the state (Newton's method, a law call an iteration) and with the
stiffness of the initial state (one linear solve a stage, states afterwards), in one process, by processor time. The
states of the second are asked for at every step, at every tenth, and at the ends of stages alone; nothing is written in
any of them. Run with
``NUMBA_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/uncoupled.py [nx] [--steps 50]``.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import RunSummary, StepResult
from granfabric.fem.equilibrium.stepping import StepControl, solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle

PRESSURE = 100e3
CLOSURES = {
    "mean field": Closure(),
    "mean field, self-consistent": Closure(tangential="self_consistent"),
    "mean field, maximum entropy": Closure(distribution="maximum_entropy"),
    "shifted distribution": Closure(force_change="shifted_distribution"),
}
MATERIAL = Material(
    coordination=4.06,
    solid_fraction=0.846,
    normal_stiffness=1e4 * PRESSURE,
    bulk_reduction=0.88,
    shear_reduction=0.69,
)


def run(
    space: Space, closure: Closure, steps: int, feedback: bool, every: int, strain: float
) -> tuple[float, RunSummary, StepResult]:
    """Seconds, summary and last step of one run."""
    effects = Effects(contact_gain=False, stiffness_feedback=feedback)
    stages = [
        Stage("initial", [Fixed("bottom"), Fixed("top"), Pressure("left", PRESSURE), Pressure("right", PRESSURE)]),
        Stage("compression", [Displacement("top", "y", -2.0 * strain)], steps),
    ]
    law = ContactLaw([MATERIAL], closure, effects)
    problem = Problem(space, law, stages, initial_stress=(-PRESSURE, -PRESSURE, 0.0))
    last: list[StepResult] = []

    def keep(step: StepResult) -> None:
        last[:] = [step]

    start = time.process_time()
    summary = solve(problem, StepControl(report_every=every), on_step=keep)
    return time.process_time() - start, summary, last[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("nx", nargs="?", type=int, default=57)
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--strain", type=float, default=9e-5)
    parser.add_argument("--closure", choices=list(CLOSURES), action="append")
    arguments = parser.parse_args()
    space = Space(rectangle(1.0, 2.0, arguments.nx, 2 * arguments.nx), "P2")
    small = Space(rectangle(1.0, 2.0, 2, 4), "P2")
    print(f"{space.ndofs} degrees of freedom, {space.npoints} points, {arguments.steps} steps")
    for name in arguments.closure or list(CLOSURES):
        closure = CLOSURES[name]
        for feedback in (True, False):
            run(small, closure, 1, feedback, 1, 1e-6)  # compile first
        both, counts, end = run(space, closure, arguments.steps, True, 1, arguments.strain)
        print(f"{name}: coupled {both:.2f} s, {_counts(counts)}", flush=True)
        for every in (1, 10, arguments.steps + 1):
            one, counts, other = run(space, closure, arguments.steps, False, every, arguments.strain)
            change = np.abs(other.state[:, 0] / end.state[:, 0] - 1.0).max()
            move = np.abs(other.displacement - end.displacement).max() / np.abs(end.displacement).max()
            print(
                f"  uncoupled, results every {every}: {one:.2f} s, {both / one:.1f} times faster, {_counts(counts)}; "
                f"largest change of z {change:.1e}, of displacement {move:.1e}",
                flush=True,
            )


def _counts(summary: RunSummary) -> str:
    names = ("law_calls", "factorisations", "linear_solves")
    return ", ".join(f"{summary.counters[name]} {name.replace('_', ' ')}" for name in names)


if __name__ == "__main__":
    main()

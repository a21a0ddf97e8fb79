"""Where the time of a biaxial test with the contact law goes: phases of a run of about 50,000 degrees of freedom.

Rough platens, lateral pressure kept, axial strain 2e-4 in 10 steps; P2 triangles. Asked of it: assembly, state handling
and boundary conditions together take no longer than the law, all of that no longer than the linear solver, and at most
two factorisations a step. Run with ``python tests/benchmarks/host_phases.py [nx]``; set ``NUMBA_NUM_THREADS=1
OPENBLAS_NUM_THREADS=1`` for figures of one core.
"""

from __future__ import annotations

import argparse
import time

from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import RunSummary
from granfabric.fem.equilibrium.stepping import StepControl, StepResult, solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle

PRESSURE = 100e3


def run_biaxial(
    nx: int, steps: int, solver: str = "auto", strain: float = 2e-4
) -> tuple[RunSummary, list[StepResult], Space]:
    """Biaxial compression of a 1 x 2 specimen in nx by 2 nx halved squares."""
    space = Space(rectangle(1.0, 2.0, nx, 2 * nx), "P2")
    # Softer in shear than uniform strain has it, as packings are; without this nu = 0 and the platens do not matter.
    material = Material(
        coordination=4.06,
        solid_fraction=0.846,
        normal_stiffness=1e4 * PRESSURE,
        bulk_reduction=0.88,
        shear_reduction=0.69,
    )
    law = ContactLaw([material])
    stages = [
        Stage(
            "initial",
            [Fixed("bottom"), Fixed("top"), Pressure("left", PRESSURE), Pressure("right", PRESSURE)],
        ),
        Stage("compression", [Displacement("top", "y", -2.0 * strain)], steps),
    ]
    problem = Problem(space, law, stages, initial_stress=(-PRESSURE, -PRESSURE, 0.0))
    results: list[StepResult] = []
    summary = solve(problem, StepControl(linear_solver=solver), on_step=results.append)
    return summary, results, space


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("nx", nargs="?", type=int, default=57)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--solver", default="auto")
    arguments = parser.parse_args()
    run_biaxial(4, 1)  # compile first
    start = time.perf_counter()
    summary, results, space = run_biaxial(arguments.nx, arguments.steps, arguments.solver)
    total = time.perf_counter() - start
    seconds = summary.seconds
    print(f"{space.ndofs} dofs, {space.npoints} points, {summary.message}, solver {summary.solver}, {total:.2f} s")
    print("  " + ", ".join(f"{name} {value}" for name, value in summary.counters.items() if value))
    print("  " + ", ".join(f"{name} {value:.3f} s" for name, value in seconds.items()))
    host = seconds["assembly"] + seconds["state"] + seconds["boundary"]
    linear = seconds["factorise"] + seconds["solve"]
    print(f"  host without solver {host:.3f} s, law {seconds['law']:.3f} s, linear solver {linear:.3f} s")
    print(f"  factorisations a step {summary.counters['factorisations'] / summary.counters['steps']:.2f}")
    print(f"  million points a second {summary.counters['law_calls'] * space.npoints / seconds['law'] / 1e6:.2f}")
    print(f"  iterations by step {[result.iterations for result in results]}")
    print(f"  last residuals {[f'{value:.1e}' for value in results[-1].residuals]}")
    print(f"  axial reaction over width {results[-1].reactions['top'][1] / PRESSURE:.6f} of the pressure")


if __name__ == "__main__":
    main()

"""Strip footing on a von Mises half square: the host's time and counts beside published-grade reference values.

Square 5 x 5 (half of a symmetric problem), n x n squares halved into P2 triangles, three points a triangle; bottom
fixed, sides rollers, the top edge x <= 1 pressed down by 0.05 in 20 equal steps and free to slide; E = 1000, nu = 0.3,
yield stress sqrt(3), H = 10; relative residual 1e-8. Run with ``python tests/benchmarks/footing.py [n ...]``; set
``NUMBA_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1`` for figures of one core.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import RunSummary
from granfabric.fem.equilibrium.stepping import StepControl, StepResult, solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Stage
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import HostMesh, rectangle

# Mean footing pressure on which FEniCSx, CalculiX and an independent prototype agree, by n.
REFERENCE = {35: 6.181832, 50: 6.146729, 80: 6.117441}


def footing_mesh(n: int) -> HostMesh:
    """The square with its loaded edge as boundary ``footing``."""
    host = rectangle(5.0, 5.0, n, n)
    middle = host.mesh.p[:, host.mesh.facets].mean(axis=1)
    top = host.facets("top")
    return replace(host, boundaries={**host.boundaries, "footing": top[middle[0, top] < 1.0]})


def run_footing(
    n: int, steps: int = 20, solver: str = "auto", keep_factor: bool = True
) -> tuple[float, RunSummary, list[StepResult], int]:
    """Mean footing pressure at the end, summary, steps, degrees of freedom."""
    space = Space(footing_mesh(n), "P2")
    law = VonMisesLaw(VonMisesMaterial(1000.0, 0.3, float(np.sqrt(3.0)), 10.0))
    loads = [
        Fixed("bottom"),
        Fixed("left", ("x",)),
        Fixed("right", ("x",)),
        Displacement("footing", "y", -0.05),
    ]
    problem = Problem(space, law, [Stage("press", loads, steps)])
    results: list[StepResult] = []
    control = StepControl(tolerance=1e-8, linear_solver=solver, keep_factor=keep_factor)
    summary = solve(problem, control, on_step=results.append)
    return -results[-1].reactions["footing"][1], summary, results, space.ndofs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("n", nargs="*", type=int, default=[35, 50, 80])
    parser.add_argument("--solver", default="auto")
    parser.add_argument("--factorise-always", action="store_true")
    arguments = parser.parse_args()
    run_footing(5, 2)  # compile first
    for n in arguments.n:
        start = time.perf_counter()
        pressure, summary, results, ndofs = run_footing(n, 20, arguments.solver, not arguments.factorise_always)
        total = time.perf_counter() - start
        print(f"n = {n}: {ndofs} dofs, {summary.message}, solver {summary.solver}, {total:.2f} s")
        print(f"  mean footing pressure {pressure:.6f}, reference {REFERENCE.get(n, float('nan')):.6f}")
        print("  " + ", ".join(f"{name} {value}" for name, value in summary.counters.items() if value))
        print("  " + ", ".join(f"{name} {value:.3f} s" for name, value in summary.seconds.items()))
        print(f"  iterations by step {[result.iterations for result in results]}")


if __name__ == "__main__":
    main()

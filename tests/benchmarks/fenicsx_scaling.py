"""Time by phase and bytes moved of both hosts on growing meshes: mpiexec -n N python fenicsx_scaling.py [REFINE ...].

The shipped strip footing, with a law whose stiffness follows the network, refined so many times; writes nothing. The
processor time of rank 0. It holds waiting for other ranks too, because MPI waits busily: on a machine with other work
only `law` tells something.
"""

from __future__ import annotations

import argparse
import resource
import time
from typing import Any

import numpy as np

from granfabric.cases.effects.resolve import resolve_field
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene.reader import load
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.fenicsx.team import Team

PHASES = ("setup", "law", "assembly", "state", "factorise", "solve")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("refinements", nargs="*", type=int, default=[1, 2, 4])
    parser.add_argument("--own", action="store_true", help="the own host too, on one rank")
    arguments = parser.parse_args()
    team = Team()
    if not team.leads:
        team.assist()
        return
    with team:
        print(f"{'host':8} {'ranks':>5} {'unknowns':>9} {'total':>7} " + " ".join(f"{name:>9}" for name in PHASES)
              + f" {'its':>4} {'krylov':>6} {'factors':>7} {'MB':>6}")  # fmt: skip
        for refine in arguments.refinements:
            loaded = load("strip_footing", [f"mesh.refine={refine}"])
            loaded, prepared, _ = resolve_field(loaded, prepare(loaded))
            hosts: list[tuple[str, int, Any]] = [("fenicsx", team.comm.size, team.solve)]
            if arguments.own:
                hosts.append(("own", 1, solve))
            for name, ranks, solved in hosts:
                since = time.process_time()
                summary = solved(prepared.problem, prepared.control, clock=time.process_time)
                total = time.process_time() - since
                times = " ".join(f"{summary.seconds[phase]:9.2f}" for phase in PHASES)
                counts = summary.counters
                memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                print(f"{name:8} {ranks:5} {prepared.problem.space.ndofs:9} {total:7.2f} {times} "
                      f"{counts['newton_iterations']:4} {counts['krylov_iterations']:6} {counts['factorisations']:7} "
                      f"{memory:6.0f}", flush=True)  # fmt: skip
    assert np.isfinite(total)


if __name__ == "__main__":
    main()

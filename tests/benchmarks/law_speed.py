"""Points a second of the contact law, with and without its propagated tangent.

Random strain increments of size 1e-6 at kn/p = 1e4 and tolerance 1e-6, points with random stress up to q/p = 0.4, one
thread: ``NUMBA_NUM_THREADS=1 python tests/benchmarks/law_speed.py``. Beside it, in the same run, the linear-elastic and
the von Mises law, so that ratios do not depend on the machine.
"""

import sys
import time
from pathlib import Path

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "constitutive"))

from contact_law_cases import CLOSURES, anisotropic_stress, closure_name, law

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial

NUMBER = 100_000
REPEATS = 7


def rate(contact_law, tangent: bool, number: int = NUMBER, size: float = 1e-6) -> tuple[float, float]:
    """Million points a second (best of `REPEATS`) and mean substeps."""
    rng = np.random.default_rng(0)
    stress = anisotropic_stress(rng, number)
    state = contact_law.initial_state(stress)
    increment = rng.uniform(-size, size, (number, 3))
    stress_end, state_end = np.zeros_like(stress), np.zeros_like(state)
    stiffness = np.zeros((number, 3, 3)) if tangent else None
    best, report = np.inf, None
    for _ in range(REPEATS):
        start = time.perf_counter()
        report = contact_law.update(increment, stress, state, stress_end, state_end, stiffness)
        best = min(best, time.perf_counter() - start)
    return number / best / 1e6, float(report.substeps.mean())


def main() -> None:
    """Print the table."""
    laws = {
        "contact law, elastic effects only": (law(effects=Effects(contact_loss=False, contact_gain=False)), NUMBER),
        "contact law, loss only": (law(effects=Effects(contact_gain=False)), NUMBER),
        **{
            f"contact law, {closure_name(closure)}": (
                law(closure=closure),
                NUMBER if closure.distribution == "harmonic" else NUMBER // 10,
            )
            for closure in CLOSURES
        },
        "linear elastic": (LinearElasticLaw(ElasticMaterial(2e8, 0.2)), NUMBER),
        "von Mises": (VonMisesLaw(VonMisesMaterial(2e8, 0.2, 1e2, 1e6)), NUMBER),
    }
    print(f"{numba.get_num_threads()} thread(s); million points a second")
    print(f"{'':58s}{'with tangent':>14s}{'without':>10s}{'substeps':>10s}")
    for name, (which, number) in laws.items():
        with_tangent, substeps = rate(which, True, number)
        without, _ = rate(which, False, number)
        print(f"{name:58s}{with_tangent:14.2f}{without:10.2f}{substeps:10.2f}", flush=True)


if __name__ == "__main__":
    main()

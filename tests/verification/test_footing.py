"""Strip footing on a von Mises half space: six digits on which three other codes agree.

Mean pressure 6.181832 at n = 35 (10,082 degrees of freedom): FEniCSx, CalculiX and an independent prototype. The set-up
and the further figures at n = 50, 80 are in ``tests/benchmarks/footing.py``.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

_FILE = Path(__file__).resolve().parents[1] / "benchmarks" / "footing.py"


def footing():
    spec = importlib.util.spec_from_file_location("footing_benchmark", _FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("n", [35, pytest.param(50, marks=pytest.mark.slow)])
def test_mean_footing_pressure(n):
    module = footing()
    pressure, summary, results, ndofs = module.run_footing(n)
    assert summary.finished and ndofs == {35: 10_082, 50: 20_402}[n]
    assert len(results) == 20 and summary.counters["cuts"] == 0
    # Half a unit of the last digit quoted, which is also beyond what the residual of 1e-8 leaves open.
    assert pressure == pytest.approx(module.REFERENCE[n], abs=6e-7)
    assert summary.counters["factorisations"] <= 2 * len(results)
    # As many linear solves as careful codes need (99 with the last converged tangent, 127 with the elastic one).
    assert summary.counters["linear_solves"] <= 115

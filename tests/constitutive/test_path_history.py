"""Columns of a point's history against the law's own state, step by step; signs of magnitudes; bookkeeping apart."""

from __future__ import annotations

import numpy as np
import pytest
from contact_law_cases import PRESSURE, Points, law, material

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import Closure
from granfabric.constitutive.path import POINT_COLUMNS, SLIDING_COLUMNS, Leg, drive

START = (-0.9e5, -1.1e5, 0.1e5)
ENDS = [(-0.8e5, -1.25e5, 0.15e5), (-0.95e5, -1.15e5, -0.06e5), (-1.3e5, -1.5e5, 0.05e5), (-0.9e5, -1.0e5, 0.0)]
VECTORS = ("fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy")


@pytest.mark.parametrize(
    "closure",
    [Closure(tangential="self_consistent"), Closure(force_change="shifted_distribution", tangential="frictional")],
    ids=lambda closure: closure.force_change,
)
def test_every_column_is_the_state_of_its_step(closure: Closure) -> None:
    """One leg at a time, each from the end state of the last: gained is not lost, and vectors are in their places."""
    sliding = material(peak_stress_ratio=0.5, gap_density_at_zero=2000.0)
    contact_law = law(Effects(sliding=True), closure, [sliding])
    whole = drive(contact_law, START, [Leg(target=end) for end in ENDS])
    assert whole.finished, whole.message
    columns = whole.columns
    assert tuple(columns) == POINT_COLUMNS + SLIDING_COLUMNS
    axis = np.array([0.5 * (START[1] - START[0]), -START[2]])
    axis /= np.hypot(*axis)  # of the initial major compression
    description = contact_law.description
    first = contact_law.initial_state(np.array([START]))
    stress, state, strain = np.array([START]), first, np.zeros((1, 3))
    for row in range(len(ENDS) + 1):
        if row:
            increment = np.array([ENDS[row - 1]]) - stress
            stress, state, step, report = Points(contact_law, stress, state).mixed((1, 1, 1), increment)
            strain = strain + step
            assert columns["substeps"][row] == report.substeps[0] >= 1
            assert columns["rejected_substeps"][row] == report.rejected[0]

        def of(name: str, state=state) -> np.ndarray:
            return state[0, description.columns(name)]

        c = {name: values[row] for name, values in columns.items()}
        xx, yy, xy = stress[0]
        assert (c["stress_xx"], c["stress_yy"], c["stress_xy"]) == pytest.approx((xx, yy, xy))
        assert (c["strain_xx"], c["strain_yy"], c["strain_xy"]) == pytest.approx(tuple(strain[0]), abs=1e-12)
        assert c["p"] == pytest.approx(-(xx + yy) / 2)
        assert c["q"] == pytest.approx(np.sqrt(((xx - yy) / 2) ** 2 + xy**2))
        for name in ("coordination", "coordination_gained", "coordination_lost", *SLIDING_COLUMNS):
            assert c[name] == pytest.approx(of(name)[0], abs=1e-9), name
        assert c["mean_normal_force"] == pytest.approx(
            of("mean_normal_force")[0] / first[0, description.columns("mean_normal_force")][0]
        )
        for name in VECTORS:
            np.testing.assert_allclose([c[f"{name}_1"], c[f"{name}_2"]], of(name), atol=1e-9)
        for name in (*VECTORS, "fabric_gained", "fabric_lost"):
            size = np.hypot(*of(name))
            assert c[name] == pytest.approx(np.sign(of(name) @ axis) * size, abs=1e-9), name
    # both kinds of change are there, and they are not each other
    last = {name: values[-1] for name, values in columns.items()}
    assert last["coordination_gained"] > 0.01 and last["coordination_lost"] > 0.01
    assert abs(last["coordination_gained"] - last["coordination_lost"]) > 0.01
    assert last["fabric_gained"] * last["fabric_lost"] != 0.0
    change = last["coordination_gained"] - last["coordination_lost"]
    assert last["coordination"] == pytest.approx(columns["coordination"][0] + change, abs=1e-9)


def test_signs_are_along_the_initial_major_compression_or_the_first_deviator() -> None:
    """Loading in extension of y is negative for a start compressed along y, positive from an isotropic start."""
    contact_law = law()
    extension = Leg(target=(-1.2 * PRESSURE, -0.8 * PRESSURE, 0.0), increments=4)
    isotropic = drive(contact_law, (-PRESSURE, -PRESSURE, 0.0), [extension]).columns
    assert (isotropic["normal_force_anisotropy"][1:] > 0).all() and isotropic["normal_force_anisotropy"][0] == 0.0
    pressed = drive(contact_law, (-0.9 * PRESSURE, -1.1 * PRESSURE, 0.0), [extension]).columns
    assert pressed["normal_force_anisotropy"][0] == pytest.approx(0.1)
    assert pressed["normal_force_anisotropy"][-1] == pytest.approx(-0.2)
    assert pressed["normal_force_anisotropy_1"][-1] == pytest.approx(0.2)

"""Signs, axes and sums of the comparison of model and DEM, each side against numbers that are known."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from granfabric.cases.commands import verify
from granfabric.cases.cost import closures as cost_closures
from granfabric.cases.scene.measured import Inputs, mean_of
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify import (
    cost as verify_cost,
)
from granfabric.cases.verify import (
    evaluate as verify_evaluate,
)
from granfabric.cases.verify import (
    model_side as verify_model,
)
from granfabric.cases.verify import (
    probes as verify_probes,
)
from granfabric.cases.verify import (
    text as verify_text,
)
from granfabric.cases.verify.closures import CLOSURE_COLUMNS, PROBE_COLUMNS, closure_rows, probe_rows
from granfabric.cases.verify.dem_side import LOADINGS, STRESS_RATIO, loading_options
from granfabric.cases.verify.model_side import SOURCE, SOURCE_CLOSED, closures, follow, targets
from granfabric.cases.verify.paths import (
    AMPLITUDE,
    FRACTIONS,
    PATH_COLUMNS,
    PATHS,
    PathRow,
    compare_path,
    dem_columns,
    model_columns,
    positions,
    sampled,
)
from granfabric.cases.verify.study import Study
from granfabric.cases.verify.table import QUANTITIES, TABLE_LEVELS, Comparison
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure
from granfabric.constitutive.path import Leg, drive
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS

P = 1e5
INPUTS = {
    "coordination": 4.06, "solid_fraction": 0.846, "normal_stiffness": 1e9, "force_density_at_zero": 0.5,
    "gap_density_at_zero": 3.0, "force_anisotropy_ratio": 1.2,
}  # fmt: skip


# loadings


def test_both_loadings_press_along_y() -> None:
    ratio = 0.25
    for loading, p in (("constant_pressure", P), ("constant_lateral_stress", P / (1 - ratio))):
        ((xx, yy, xy),) = targets(loading, P, [ratio])
        assert (xx, yy, xy) == pytest.approx((-p * (1 - ratio), -p * (1 + ratio), 0.0))
        if loading == "constant_lateral_stress":
            assert xx == pytest.approx(-P)
        (segment,) = loading_options(loading).segments
        assert (segment.path, segment.angle) == (loading, pytest.approx(np.pi / 2))
        assert segment.stress_ratio == STRESS_RATIO == 0.302 and segment.shear_strain > 0


@pytest.mark.parametrize("closure", [SOURCE, SOURCE_CLOSED])
@pytest.mark.parametrize("loading", LOADINGS)
def test_quantities_of_the_model_along_the_major_compression(loading: str, closure: str) -> None:
    """a_n = c_n q/p, a_t = 2 q/p - a_c - a_n, f/f0 = (p/p0)(z0/z): positive along y, where grains are pressed."""
    levels = np.linspace(0.0, 0.3, 7)
    curve = follow(closures(INPUTS)[closure], INPUTS, loading, P, levels)
    found = curve.columns
    p = np.ones(7) if loading == "constant_pressure" else 1 / (1 - levels)
    assert (found["fabric_anisotropy"][1:] > 0).all() and (np.diff(found["coordination"]) < 0).all()
    np.testing.assert_allclose(found["normal_force_anisotropy"], 1.2 * levels, atol=1e-12)
    tangential = 2 * levels - found["fabric_anisotropy"] - found["normal_force_anisotropy"]
    np.testing.assert_allclose(found["tangential_force_anisotropy"], tangential, atol=1e-9)
    np.testing.assert_allclose(found["mean_normal_force"], p * 4.06 / found["coordination"], rtol=1e-9)
    assert curve.message == "" and set(found) == set(QUANTITIES)


# probes


PROBES = {
    "dp = +0.1 p": (0.1, 0.0), "dp = -0.1 p": (-0.1, 0.0), "dq = 0.1 p": (0.0, 0.1),
    "dp = +0.1 p, dq = 0.1 p": (0.1, 0.1), "dp = -0.1 p, dq = 0.1 p": (-0.1, 0.1),
}  # fmt: skip


def test_probes_of_the_dem_are_what_they_are_called(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stress changes as named; dz is gained minus lost, da_c the component along y."""
    asked = []

    def probe(sample: Any, dp: float, dq: float, *more: Any) -> Any:
        asked.append((dp, dq, *more))
        number = len(asked)
        return SimpleNamespace(
            before=np.array([0.02, 0.7]), after=np.array([0.02 - 0.1 * number, -0.5]),
            change=SimpleNamespace(coordination_gained=0.01, coordination_lost=0.2 * number),
        )  # fmt: skip

    monkeypatch.setattr(verify_probes, "stress_probe", probe)
    monkeypatch.setattr(verify_probes, "fabric_anisotropy", lambda contacts: contacts)
    monkeypatch.setattr(verify_probes, "love_weber_stress", lambda sample: np.array([-1.2 * P, -0.8 * P, 0.0]))
    found = verify_probes.dem_probes(None)  # type: ignore[arg-type]
    assert verify_probes.PROBES == PROBES
    np.testing.assert_allclose(asked, [(dp * P, dq * P) for dp, dq in PROBES.values()])
    for number, name in enumerate(PROBES, 1):
        assert found[name] == pytest.approx([0.01 - 0.2 * number, 0.1 * number])


def test_probes_of_the_model_against_closed_forms() -> None:
    """Isotropic: z (p/p0)^P0 of loss, gain next to none; at constant p the published digits, a_c positive along y."""
    found = verify_probes.model_probes(Closure(), {**INPUTS, "force_anisotropy_ratio": 1.0}, P)
    assert set(found) == set(PROBES)
    assert found["dp = -0.1 p"] == pytest.approx([4.06 * (0.9**0.5 - 1), 0.0], abs=1e-4)
    gained = (6.0 - 4.06) / 4.06 * 3.0 * np.pi * 0.1 * P / (0.846 * 1e9)
    assert found["dp = +0.1 p"] == pytest.approx([gained, 0.0], rel=1e-2, abs=1e-9)
    assert found["dq = 0.1 p"] == pytest.approx([3.9303 - 4.06, 0.0520], abs=1e-4)
    # to the first order, from isotropy: the arc of loss has the half-width arccos(dp/(2 dq))/2
    for sign, name in ((1.0, "dp = +0.1 p, dq = 0.1 p"), (-1.0, "dp = -0.1 p, dq = 0.1 p")):
        d, w = sign * 0.1, 0.2
        y = np.linspace(0, 2 * np.pi, 20001)
        fall = np.maximum(-(d + w * np.cos(y)), 0)
        loss = 0.5 * np.trapezoid(fall, y) / (2 * np.pi)
        fabric = -2 * 0.5 * np.trapezoid(fall * np.cos(y), y) / (2 * np.pi)
        assert found[name][0] == pytest.approx(-4.06 * loss, rel=0.15)
        assert found[name][1] == pytest.approx(fabric, rel=0.2)
    assert 0 < found["dp = +0.1 p, dq = 0.1 p"][1] < found["dp = -0.1 p, dq = 0.1 p"][1] + 0.05


def test_an_update_is_told_in_microseconds_a_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five batches of 2,000 points; the fastest takes 40 ms."""
    now, spent = [0.0], iter([0.09, 0.05, 0.04, 0.06, 0.07])

    def update(self: Any, *arguments: Any) -> None:
        assert len(arguments[0]) == 2000 and arguments[5].shape == (2000, 3, 3)
        now[0] += next(spent)

    monkeypatch.setattr(ContactLaw, "update", update)
    monkeypatch.setattr(verify_cost.time, "process_time", lambda: now[0])
    assert verify_cost.microseconds_per_update(Closure(), INPUTS) == pytest.approx(20.0)


# paths that turn


def turned(angle: np.ndarray, ratio: float = 0.2, segment: Any = 0.0) -> dict[str, np.ndarray]:
    """History whose major compression lies at an angle from the x axis [degree]."""
    double = 2 * np.radians(angle)
    rows = len(angle)
    history = {name: np.zeros(rows) for name in HISTORY_COLUMNS}
    history |= {
        "stress_xx": -P * (1 + ratio * np.cos(double)), "stress_yy": -P * (1 - ratio * np.cos(double)),
        "stress_xy": -P * ratio * np.sin(double), "p": np.full(rows, P), "q": np.full(rows, ratio * P),
        "coordination": 4.0 - 0.01 * np.arange(rows), "mean_normal_force": 1.0 + 0.01 * np.arange(rows),
        "segment": np.broadcast_to(np.asarray(segment, dtype=float), (rows,)),
    }  # fmt: skip
    return history


def test_harmonics_of_the_dem_along_and_across_the_major_compression() -> None:
    """A fabric that lags behind the turning axis by 10 degrees: cos 20 along, minus sin 20 across."""
    angle = np.linspace(90.0, 180.0, 7)
    history = turned(angle)
    for prefix, size, lag in (("fabric", 0.1, 10.0), ("normal_force", 0.3, 4.0), ("tangential_force", 0.2, 7.0)):
        behind = 2 * np.radians(angle - lag)
        history[f"{prefix}_xx"], history[f"{prefix}_xy"] = size * np.cos(behind), size * np.sin(behind)
    found = dem_columns(history, turning=True)
    np.testing.assert_allclose(found["fabric_along"], 0.1 * np.cos(np.radians(20)))
    np.testing.assert_allclose(found["fabric_across"], -0.1 * np.sin(np.radians(20)))
    np.testing.assert_allclose(found["normal_along"], 0.3 * np.cos(np.radians(8)))
    np.testing.assert_allclose(found["tangential_along"], 0.2 * np.cos(np.radians(14)))
    np.testing.assert_allclose(found["coordination"], history["coordination"])
    np.testing.assert_allclose(found["mean_normal_force"], history["mean_normal_force"])
    # of cycles the axis is the one of first loading, along y
    fixed = dem_columns(history, turning=False)
    np.testing.assert_allclose(fixed["fabric_along"], -history["fabric_xx"])
    np.testing.assert_allclose(fixed["fabric_across"], -history["fabric_xy"])


def test_the_model_is_turned_like_the_dem() -> None:
    """One point turned from y: what a fabric that lags behind does, with the same signs as of the DEM.

    The model's fabric is fed to the other side as if it were measured, and has to come out the same.
    """
    angle = np.concatenate([np.full(4, 90.0), 90.0 + np.linspace(0, 60, 13)[1:]])
    history = turned(angle)
    ramp = np.ones(16)
    ramp[:4] = [0.0, 0.25, 0.5, 1.0]
    for name, isotropic in (("stress_xx", -P), ("stress_yy", -P), ("stress_xy", 0.0)):
        history[name] = isotropic + ramp * (history[name] - isotropic)
    for turning in (True, False):
        found, message = model_columns(closures(INPUTS)[SOURCE_CLOSED], INPUTS, history, turning)
        assert message == ""
        stress = np.column_stack([history[f"stress_{name}"] for name in ("xx", "yy", "xy")])
        alone = drive(
            ContactLaw([verify_model.material(INPUTS)], closures(INPUTS)[SOURCE_CLOSED]),
            tuple(stress[0]), [Leg(target=tuple(target)) for target in stress[1:]],
        ).columns  # fmt: skip
        measured = dict(history)
        for prefix in ("fabric", "normal_force", "tangential_force"):
            measured[f"{prefix}_xx"] = alone[f"{prefix}_anisotropy_1"]
            measured[f"{prefix}_xy"] = alone[f"{prefix}_anisotropy_2"]
        measured["coordination"], measured["mean_normal_force"] = alone["coordination"], alone["mean_normal_force"]
        expected = dem_columns(measured, turning)
        assert set(found) == set(expected)
        for name, values in expected.items():
            np.testing.assert_allclose(found[name], values, atol=1e-12, err_msg=name)
    # loaded along y: positive along it; turned on by 60 degrees the fabric lags behind
    along = model_columns(closures(INPUTS)[SOURCE_CLOSED], INPUTS, history, True)[0]
    assert along["fabric_along"][3] > 0.05 and along["normal_along"][3] == pytest.approx(0.24)
    assert along["fabric_across"][-1] < -0.02


def test_a_model_that_ends_early_has_no_numbers_beyond() -> None:
    history = turned(np.full(5, 90.0))
    history["stress_xx"][3:] = 2 * P
    found, message = model_columns(Closure(), INPUTS, history, False)
    assert message and np.isfinite(found["coordination"][:3]).all() and np.isnan(found["coordination"][3:]).all()


def test_places_along_segments_are_fractions_of_the_way_of_the_deviator() -> None:
    """Two segments with uneven records: a tenth of the way is a tenth of the stress path, not of the records."""
    q = np.array([0.0, 1.0, 4.0, 10.0, 7.0, 0.0]) * 1e3
    history = {
        "segment": np.array([0, 0, 0, 1, 1, 2]), "stress_xx": -P + q, "stress_yy": -P - q, "stress_xy": np.zeros(6)
    }  # fmt: skip
    places, numbers = positions(history)
    assert numbers.tolist() == [1] * 11 + [2] * 11
    expected = [*(1e4 * FRACTIONS), *(1e4 * (1 - FRACTIONS))]
    np.testing.assert_allclose(sampled({"q": q}, places)["q"], expected, atol=1e-9)
    assert places[0] == 0 and places[10] == 3 and places[11] == 3 and places[-1] == 5
    # shear alone counts in full
    history["stress_xx"] = history["stress_yy"] = np.full(6, -P)
    history["stress_xy"] = q
    np.testing.assert_allclose(sampled({"q": q}, positions(history)[0])["q"][:11], 1e4 * FRACTIONS, atol=1e-9)


def test_paths_are_cycles_with_a_reversal_and_half_a_turn() -> None:
    assert AMPLITUDE == 0.2 and set(PATHS) == {"cycles", "rotation"}
    ends = [segment.stress_ratio for segment in PATHS["cycles"][1]]
    assert ends == [0.2, 0.0, 0.2, 0.0, -0.2]
    assert [np.sign(segment.shear_strain) for segment in PATHS["cycles"][1]] == [1, -1, 1, -1, -1]
    turn = [np.degrees(segment.angle) for segment in PATHS["rotation"][1]]
    assert turn == pytest.approx([90, 135, 180, 225, 270])
    assert all(segment.stress_ratio == 0.2 for segment in PATHS["rotation"][1])


def seed(histories: dict[str, dict[str, np.ndarray]]) -> Any:
    runs = {name: SimpleNamespace(history=lambda h=h: h) for name, h in histories.items()}
    return SimpleNamespace(inputs=INPUTS, runs=runs, seed=1, packing=SimpleNamespace(count=7))


def test_stress_ratio_of_cycles_is_signed_and_the_turn_is_counted_from_its_start() -> None:
    ratio = np.array([0.0, 0.1, 0.2, 0.1, 0.0, -0.1, -0.2])
    cycles = turned(np.full(7, 90.0), 1.0, [0, 0, 1, 1, 2, 2, 3])
    cycles["stress_xx"], cycles["stress_yy"] = -P * (1 - ratio), -P * (1 + ratio)
    study, rows, messages = verify_evaluate._along("cycles", [seed({"cycles": cycles})])
    assert not messages
    np.testing.assert_allclose(study.stress_ratio[[0, 10, 21, 32]], [0.0, 0.2, 0.0, -0.2], atol=1e-12)
    end = next(row for row in rows if (row.segment, row.fraction, row.quantity) == (3, 1.0, "coordination"))
    assert end.stress_ratio == pytest.approx(-0.2) and end.dem == pytest.approx(4.0 - 0.06)
    assert end.error == pytest.approx(end.model - end.dem)
    angle = np.array([90.0, 90.0, 90.0, 120.0, 150.0, 180.0, 210.0])
    rotation = turned(angle, 0.2, [0, 0, 1, 1, 1, 1, 2])
    study, rows, _ = verify_evaluate._along("rotation", [seed({"rotation": rotation})])
    np.testing.assert_allclose(study.stress_ratio, 0.2, rtol=0.2)
    assert study.angle[11] == pytest.approx(0.0, abs=1e-9) and study.angle[-1] == pytest.approx(120.0)
    # the other way round
    rotation = turned(180.0 - angle, 0.2, [0, 0, 1, 1, 1, 1, 2])
    assert verify_evaluate._along("rotation", [seed({"rotation": rotation})])[0].angle[-1] == pytest.approx(-120.0)


def test_rows_of_a_path_are_model_minus_dem() -> None:
    segments = np.repeat([1, 2], 11)
    dem = [{name: np.full(22, value) for name in ("a",)} for value in (1.0, 3.0)]
    model = [{name: np.full(22, value) for name in ("a",)} for value in (1.5, 2.5)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("granfabric.cases.verify.paths.QUANTITIES", ("a",))
        rows = compare_path("cycles", "some", dem, model, segments, np.arange(22.0), -np.arange(22.0))
    assert [(row.segment, row.fraction) for row in rows] == [(1, 0.5), (1, 1.0), (2, 0.5), (2, 1.0)]
    assert [row.stress_ratio for row in rows] == [5.0, 10.0, 16.0, 21.0]
    assert [row.angle for row in rows] == [-5.0, -10.0, -16.0, -21.0]
    for row in rows:
        assert (row.dem, row.model, row.error) == (2.0, 2.0, 0.0)
        assert row.dem_scatter == pytest.approx(np.sqrt(2)) and row.error_scatter == pytest.approx(np.sqrt(0.5))
    assert PATH_COLUMNS == (
        "path", "closure", "quantity", "segment", "fraction", "stress_ratio", "angle", "dem", "dem_scatter", "model",
        "error", "error_scatter",
    )  # fmt: skip


# tables


def comparison(loading: str, closure: str, quantity: str, ratio: float, dem: float, error: float) -> Comparison:
    return Comparison(loading, closure, quantity, ratio, dem, 0.5, dem + error, error, 0.1, 2)


def made_inputs(number: int) -> Inputs:
    """Of one packing; the first has no fluctuation, and its error is not known."""
    values = {"coordination": 3.9 + 0.1 * number, "slip": 1.0 + number, "neighbours": 6.0}
    fluctuation = {"fluctuation": 0.3} if number else {}
    return Inputs(
        values | fluctuation, {"coordination": 0.07, "slip": 0.4, "neighbours": 0.0, "fluctuation": np.nan},
        () if number else ("fluctuation",),
    )  # fmt: skip


def made_study() -> Study:
    """Two closures; the errors of the second are ten times those of the first and of the other sign."""
    rows, path_rows = [], []
    for place, closure in enumerate(("one", "two")):
        factor = (1.0, -10.0)[place]
        for number, quantity in enumerate(QUANTITIES):
            for other, loading in enumerate(LOADINGS):
                for step, ratio in enumerate(TABLE_LEVELS):
                    # the first loading errs by one more, and most at its end
                    error = factor * 0.001 * (2 + number - other) * (1 + step)
                    rows.append(comparison(loading, closure, quantity, ratio, 4.0 - 0.1 * number, error))
        for path, size in (("cycles", 0.02), ("rotation", 0.03)):
            for quantity in ("coordination", "fabric_along", "fabric_across"):
                many = 7.0 if quantity == "fabric_across" else 1.0
                path_rows.append(
                    PathRow(path, closure, quantity, 1, 1.0, 0.2, 0.0, 2.0, 0.1, 0.0, factor * size * many, 0.0)
                )
                path_rows.append(PathRow(path, closure, quantity, 2, 1.0, 0.2, 0.0, 2.0, 0.1, 0.0, 0.001, 0.0))
    probes = {
        "down": {"DEM": np.array([[-0.2, 0.001], [-0.1, 0.003]]), "one": np.array([[-0.18, 0.5]] * 2),
                 "two": np.array([[-0.3, 0.5]] * 2)},
        "shear": {"DEM": np.array([[-0.1, 0.04]] * 2), "one": np.array([[-0.1, 0.05]] * 2),
                  "two": np.array([[-0.1, 0.02]] * 2)},
    }  # fmt: skip
    return Study(
        np.linspace(0, 0.3, 61), {}, {loading: {"one": {}, "two": {}} for loading in LOADINGS},
        [SimpleNamespace(packing=SimpleNamespace(count=200, void_ratio=0.18 + 0.02 * k), seed=k + 1,
                         inputs=made_inputs(k).values, measured=made_inputs(k)) for k in range(2)],  # type: ignore
        rows, {"packing": 4.0, "measuring": 2.0, "model": 0.5, "constant_pressure": 6.0}, dict.fromkeys(PATHS),  # type: ignore
        path_rows, probes, {"one": 0.9, "two": 18.0}, [],
    )  # fmt: skip


def test_closures_side_by_side() -> None:
    """Largest sizes: z and f relative in per cent, anisotropies absolute; probes where the DEM changes noticeably."""
    study = made_study()
    one, two = (dict(zip(CLOSURE_COLUMNS, row)) for row in closure_rows(study))
    largest = {
        "loading_z_percent": 100 * 0.012 / 4.0, "loading_a_c": 0.018, "loading_a_n": 0.024, "loading_a_t": 0.030,
        "loading_f_percent": 100 * 0.036 / 3.6, "cycles_z_percent": 1.0, "cycles_a_c": 0.02, "rotation_z_percent": 1.5,
        "rotation_a_c": 0.03,
    }  # fmt: skip
    for name, value in largest.items():
        assert one[name] == pytest.approx(value), name
        assert two[name] == pytest.approx(10 * value), name
    assert one["probes_z_percent"] == pytest.approx(100 * 0.03 / 0.15)
    assert one["probes_a_c_percent"] == pytest.approx(25.0)
    assert two["probes_z_percent"] == pytest.approx(100.0) and two["probes_a_c_percent"] == pytest.approx(50.0)
    assert (one["microseconds_per_update"], two["microseconds_per_update"]) == (0.9, 18.0)
    table = [dict(zip(PROBE_COLUMNS, row)) for row in probe_rows(study)]
    assert [(row["probe"], row["side"]) for row in table[:3]] == [("down", "DEM"), ("down", "one"), ("down", "two")]
    assert table[0]["coordination_change"] == pytest.approx(-0.15)
    assert table[0]["fabric_change"] == pytest.approx(0.002)
    assert table[0]["coordination_scatter"] == pytest.approx(0.1 / np.sqrt(2))
    assert table[0]["fabric_scatter"] == pytest.approx(0.002 / np.sqrt(2))


def test_numbers_of_the_summary() -> None:
    """Per cent where they are relative, signs, units of scatter, probes, inputs, times a packing."""
    study = made_study()
    text = verify_text.summary(study)
    lines = text.splitlines()
    for number, quantity in enumerate(QUANTITIES):
        place = lines.index(next(line for line in lines if line.startswith(f"| {verify_text.NAMES[quantity]}; q/p =")))
        grains, one, two = lines[place + 2 : place + 5]
        dem = 4.0 - 0.1 * number
        relative = quantity in ("coordination", "mean_normal_force")
        scatter = f"{100 * 0.5 / dem:.2f} %" if relative else "0.5000"
        assert grains == "| **DEM** | " + " | ".join([f"{dem:.4f} ± {scatter}"] * 6) + " |"
        for line, name, factor in ((one, "one", 1.0), (two, "two", -10.0)):
            errors = [factor * 0.001 * (2 + number) * (1 + step) for step in range(6)]
            cells = [f"{100 * error / dem:+.2f} %" if relative else f"{error:+.4f}" for error in errors]
            assert line == f"| {name} | " + " | ".join(cells) + " |"
    head = lines.index("| loading: closure | z | a_c | a_n | a_t | f/f0 |")
    # the largest error over its scatter of 0.5
    assert lines[head + 2].startswith("| mean pressure constant: one | +0.30 % (0.0) | +0.0180 (0.0) | +0.0240 (0.0) |")
    assert lines[head + 3].startswith("| mean pressure constant: two | -3.00 % (0.2) | -0.1800 (0.4) | -0.2400 (0.5) |")
    assert "| **down** | DEM | -0.1500 ± 0.0707 | +0.0020 ± 0.0014 |" in lines
    assert "|  | one | -0.1800 | +0.5000 |" in lines
    head = lines.index("| input | mean | scatter | standard error of the mean |")
    # between two packings, and of their mean; what is chosen has none, and one packing no scatter
    assert lines[head + 2 : head + 6] == [
        "| `coordination` | 3.95 | 0.071 | 0.05 |", "| `slip` | 1.5 | 0.71 | 0.5 |", "| `neighbours` | 6 | 0 | - |",
        "| `fluctuation` | 0.3 | - | not known |",
    ]  # fmt: skip
    assert "| DEM packing | 2.000 s |" in lines and "| DEM measuring of the inputs | 1.000 s |" in lines
    assert "| DEM loading, mean pressure constant | 3.000 s |" in lines
    assert "| model, 4 curves of 60 increments | 0.250 s |" in lines
    assert "2 packings of 200 disks (seeds 1 to 2), void ratio 0.1900" in text
    head = lines.index(
        "| closure | z | a_c | a_n | a_t | f/f0 | cycles: z | a_c | rotation: z | a_c | probes: dz | da_c | µs |"
    )
    assert lines[head + 2] == (
        "| one | 0.3 % | 0.0180 | 0.0240 | 0.0300 | 1 % | 1 % | 0.0200 | 1.5 % | 0.0300 | 20 % | 25 % | 0.90 |"
    )


def test_printed_errors_are_model_minus_dem(told: Any, capsys: pytest.CaptureFixture[str]) -> None:
    study = made_study()
    record: Any = SimpleNamespace(
        details={"dem_computed_now": [2]}, scene={"particles": 200}, timing={"compilation": 1.5, "total": 9.0},
        outcome="finished", message="", folder="there",
    )  # fmt: skip
    verify._report(study, record, Screen())
    first, second, side = told.tables
    for table, (other, text) in zip((first, second), enumerate(LOADINGS.values())):
        assert table.title == f"{text}: largest error (model - DEM) at q/p = 0.05, 0.1, 0.15, 0.2, 0.25, 0.3"
        assert table.names == ["closure", "z [%]", "a_c", "a_n", "a_t", "f/f0 [%]"]
        for row, factor in zip(table.rows, (1.0, -10.0), strict=True):
            errors = [factor * 0.006 * (2 + number - other) for number in range(5)]
            assert row[1:] == [
                f"{100 * errors[0] / 4.0:+.2f}", *(f"{error:+.4f}" for error in errors[1:4]),
                f"{100 * errors[4] / 3.6:+.2f}",
            ]  # fmt: skip
    assert side.names == [
        "closure", "z [%]", "a_c", "a_n", "a_t", "f [%]", "z", "a_c", "z", "a_c", "z [%]", "a_c [%]", "us"
    ]  # fmt: skip
    assert side.rows[0] == ["one", *(f"{value:.3g}" for value in closure_rows(study)[0][1:])]
    assert told.lines[0] == (
        "packings of 200 disks: 1 computed, 1 read; DEM 12.0 s, model 0.500 s, compilation 1.5 s"
    )


def test_mean_inputs_leave_out_packings_without_a_value() -> None:
    """The error of a mean is the scatter over the root of the number; of one packing it is its own."""
    found = mean_of(
        Inputs(values, {"a": 0.7, "b": 0.25}, missing)
        for values, missing in (({"a": 1.0, "b": 2.0}, ("c",)), ({"a": 3.0}, ("b", "c")), ({"a": 5.0}, ("b", "c")))
    )
    assert found.values == {"a": 3.0, "b": 2.0} and found.missing == ("c",)
    assert found.errors == {"a": pytest.approx(2.0 / np.sqrt(3)), "b": 0.25}


def test_doubtful_inputs_are_marked_with_their_packing(monkeypatch: pytest.MonkeyPatch, told: Any) -> None:
    """One line for each doubtful value of each packing, before the model is asked."""
    measured = {
        1: Inputs({"slip": 0.2, "neighbours": 6.0}, {"slip": 0.3, "neighbours": 0.0}),
        2: Inputs({"isostatic_coordination": 7.0}, {"isostatic_coordination": 0.1}, ("fluctuation",)),
    }
    results = {number: SimpleNamespace(measured=inputs) for number, inputs in measured.items()}
    store: Any = SimpleNamespace(complete=lambda number, report, stop: results[number])
    assert verify._measured(store, [1, 2], Screen(), SimpleNamespace(requested=False)) == [*results.values()]  # type: ignore
    assert told.lines == [
        "seed 1: slip = 0.2 +- 0.3: its error is larger than itself",
        "seed 2: fluctuation is not measured: this packing does not give it",
        "seed 2: isostatic_coordination = 7 +- 0.1: outside the bounds [0, 5] of the law, which will refuse it",
    ]


# the cost study of closures


def test_grains_and_law_are_read_along_the_same_axis() -> None:
    """A DEM loop along y by its definition, and the law along the same one; both with a_c positive when loaded."""
    ratio = np.concatenate([np.linspace(0, 0.2, 21), np.linspace(0.2, 0, 21)[1:], np.linspace(0, 0.2, 21)[1:]])
    history = turned(np.full(61, 90.0), 0.2, np.r_[np.zeros(20), np.ones(20), np.full(20, 2), 3])
    history["stress_xx"], history["stress_yy"] = -P * (1 - ratio), -P * (1 + ratio)
    history["coordination"] = 4.0 - ratio - 0.001 * np.arange(61)
    history["fabric_anisotropy"] = 0.5 * ratio + 0.0001 * np.arange(61)
    test = cost_closures.TESTS["loop"]
    found = cost_closures.of_grains(history, test)
    assert found.shape == (3, 6, 2)
    levels = np.arange(0.0, 0.2001, 0.04)
    records = np.array([100 * levels, 40 - 100 * levels, 40 + 100 * levels])
    np.testing.assert_allclose(found[..., 0], 4.0 - levels - 0.001 * records, atol=1e-9)
    np.testing.assert_allclose(found[..., 1], 0.5 * levels + 0.0001 * records, atol=1e-9)
    for name, test in cost_closures.TESTS.items():
        made = cost_closures.stresses(test, P)
        ends = [stress for stress, turning in made if turning]
        for (xx, yy, xy), turn in zip(ends, test.turns, strict=True):
            p = P / (1 - turn) if name == "constant_lateral_stress" else P
            assert (xx, yy, xy) == pytest.approx((-p * (1 - turn), -p * (1 + turn), 0.0))
    law = cost_closures._law({**INPUTS, "force_anisotropy_ratio": 1.0}, Closure(), 1e-8)
    answer = cost_closures.follow(law, cost_closures.TESTS["constant_pressure"], P, 1)
    assert not answer.failed and answer.evaluations > 0
    # published digits at q/p = 0.2
    assert answer.values[0, -1] == pytest.approx([3.7995, 0.1081], abs=1e-4)
    assert answer.values[0, 0] == pytest.approx([4.06, 0.0])


def test_distances_of_a_closure_from_grains() -> None:
    """z relative, a_c as it is; the mean over the packings of the largest of each."""
    goal = np.zeros((1, 6, 2))
    goal[..., 0] = 4.0
    first, second = goal.copy(), goal.copy()
    first[0, 2, 0], first[0, 3, 1], first[0, -1] = 4.4, 0.05, (4.08, 0.03)
    second[0, 1, 0], second[0, 4, 1] = 3.8, -0.2
    counts = ((10.0, first), (20.0, second))
    answers = [(cost_closures.Answer(values, number, False), goal) for number, values in counts]
    row = cost_closures._row("loop", "some", 1e-4, answers, 0.01)
    assert row["error_coordination"] == pytest.approx((0.1 + 0.05) / 2)
    assert row["error_fabric"] == pytest.approx((0.05 + 0.2) / 2)
    assert row["error"] == pytest.approx((0.1 + 0.2) / 2)
    assert row["error_at_end"] == pytest.approx((0.03 + 0.0) / 2)
    assert (row["count"], row["scatter_of_packings"], row["failed_packings"]) == (15.0, 0.01, 0)

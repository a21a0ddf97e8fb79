"""Fitting: curves of the law itself give its parameters back, with honest standard errors, or a refusal by name."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from fit_curves import (
    COMPRESSION,
    CONSTANT_P,
    CYCLE,
    HELD,
    KNOWN,
    LATERAL,
    SOURCE,
    START,
    TRUTH,
    columns,
    fitted,
    noisy,
    some,
)  # fmt: skip

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.fit import identification, law_side, solving, study
from granfabric.cases.fit.deviations import StoppedError
from granfabric.cases.fit.law_side import Answer, LawSide
from granfabric.cases.fit.parameters import candidates, free_parameter, named, told_by
from granfabric.cases.fit.reading import curve_of
from granfabric.cases.fit.settings import NUMBERS, given
from granfabric.constitutive.path import Leg

SHIFTED = {"force_change": "shifted_distribution", "slip": 0.8, "irreversible_scatter": 2.6}
EXACT = 2e-6
"""Relative error of parameters from curves without noise: differences of curves are not exact."""


def test_the_source_gives_its_parameters_back() -> None:
    found = fitted(some(columns(CONSTANT_P), "p", "q", "coordination", "fabric_anisotropy", "normal_force_anisotropy"))
    assert {"coordination", "force_density_at_zero", "force_anisotropy_ratio"} <= set(found.errors)
    assert found.converged and not found.on_bound
    for name in found.errors:
        assert found.values[name] == pytest.approx(TRUTH.get(name, 0.0), rel=EXACT, abs=1e-7), name
    assert found.values["solid_fraction"] == 0.846 and found.base.origins["solid_fraction"] == "set"


def test_the_shifted_distribution_with_stiffness_from_two_paths() -> None:
    """A cycle at constant p and a path at constant lateral stress, all columns: memory, slip and both moduli."""
    names = ("stress_xx", "stress_yy", "stress_xy", "strain_xx", "strain_yy", "coordination", "fabric_anisotropy",
             "normal_force_anisotropy", "tangential_force_anisotropy", "mean_normal_force")  # fmt: skip
    found = fitted([some(columns(CYCLE, SHIFTED), *names), some(columns(LATERAL, SHIFTED), *names)], HELD)
    truth = {**TRUTH, **SHIFTED, "weak_contact_ratio_isotropic": 0.6, "tangential_force_ratio": 0.78}
    told = {"force_density_at_zero", "shear_reduction", "bulk_reduction", "slip", "irreversible_scatter"}
    assert told <= set(found.errors)
    for name in found.errors:
        assert found.values[name] == pytest.approx(truth.get(name, found.base.values[name]), rel=1e-5, abs=1e-7), name


@pytest.mark.parametrize(
    ("names", "legs", "free"),
    [
        (("p", "q", "coordination"), CONSTANT_P, {"coordination", "force_density_at_zero"}),
        (("p", "stress_ratio", "fabric_anisotropy"), CONSTANT_P, {"force_density_at_zero"}),
        (("p", "q", "normal_force_anisotropy"), CONSTANT_P, {"force_anisotropy_ratio"}),
        (("stress_xx", "stress_yy", "strain_yy", "strain_xx"), LATERAL, {"bulk_reduction", "shear_reduction"}),
        (("stress_xx", "stress_yy", "volumetric_strain"), COMPRESSION, {"bulk_reduction"}),
        (("stress_xx", "stress_yy", "shear_strain"), CONSTANT_P, {"shear_reduction"}),
    ],
)
def test_a_subset_of_columns_tells_what_it_tells(names: tuple[str, ...], legs: list[Leg], free: set[str]) -> None:
    table = columns(legs)
    table["volumetric_strain"] = table["strain_xx"] + table["strain_yy"]
    table["shear_strain"] = np.abs(table["strain_xx"] - table["strain_yy"])
    more = [f"material.{name}={TRUTH[name]}" for name in TRUTH if name not in free and f"material.{name}" not in SOURCE]
    if "coordination" in names:
        more = [text for text in more if "coordination" not in text]
    found = fitted(some(table, *names), (*SOURCE, *more))
    assert free <= set(found.errors)
    for name in free:
        assert found.values[name] == pytest.approx(TRUTH[name], rel=1e-5), name


def test_a_stiffness_that_nobody_gave_comes_from_the_strains() -> None:
    table = columns(LATERAL, bulk_reduction=1.0, shear_reduction=1.0)
    curve = some(table, "p", "q", "strain_xx", "strain_yy", "coordination")
    settings = [text for text in KNOWN if "normal_stiffness" not in text]
    found = fitted(curve, settings)
    assert "normal_stiffness" in found.errors and "bulk_reduction" not in found.errors
    assert found.values["normal_stiffness"] == pytest.approx(1e9, rel=1e-5)


def test_a_strain_driven_curve() -> None:
    """Only strains prescribe; the pressure at the start is given; z and the stresses are compared."""
    legs = [Leg(control=("strain", "strain", "stress"), target=(1e-5, -4e-5, 0.0), increments=12)]
    table = columns(legs)
    curve = some(table, "strain_xx", "strain_yy", "coordination", "fabric_anisotropy")
    settings = (*KNOWN, "initial.stress=[-100e3, -100e3, 0.0]", "material.bulk_reduction=0.9")
    found = fitted(curve, (*settings, "material.shear_reduction=0.7"), "coordination,force_density_at_zero")
    assert found.curves[0].driven == ["strain_xx", "strain_yy"]
    assert found.values["force_density_at_zero"] == pytest.approx(0.62, rel=EXACT)
    curve = some(table, "strain_xx", "strain_yy", "p", "q", "coordination")
    found = fitted(curve, (*KNOWN, "control=strain"), "shear_reduction,bulk_reduction")
    assert set(found.curves[0].compared) == {"p", "q", "coordination"}
    assert found.values["shear_reduction"] == pytest.approx(0.7, rel=0.1)


def test_principal_axes_that_turn_are_followed() -> None:
    """Half a turn at q/p = 0.1 by components, and by p, q and direction in coarse rows."""
    table = columns([Leg(target=(-9e4, -11e4, 0.0), increments=4), Leg(rotation_degrees=90.0, increments=18)])
    names = ("stress_xx", "stress_yy", "stress_xy", "coordination", "fabric_anisotropy_1", "fabric_anisotropy_2")
    by_parts = fitted(some(table, *names), KNOWN, "coordination,force_density_at_zero")
    assert by_parts.curves[0].turns
    assert by_parts.values["force_density_at_zero"] == pytest.approx(0.62, rel=EXACT)
    angle = 0.5 * np.degrees(np.arctan2(-table["stress_xy"], -0.5 * (table["stress_xx"] - table["stress_yy"]))) % 180.0
    angle[0] = 90.0
    thin = [0, 1, 2, 3, 4, 8, 12, 16, 20, 22]
    rows = {"p": table["p"], "q": table["q"], "major_stress_angle": np.unwrap(angle, period=180.0),
            "z": table["coordination"]}  # fmt: skip
    turned = curve_of({name: np.asarray(values)[thin] for name, values in rows.items()})
    by_angle = fitted(turned, KNOWN, "coordination,force_density_at_zero")
    assert len(by_angle.curves[0].legs) > len(thin)
    # chords of 5 degrees both times, but not the same ones between these rows
    assert by_angle.values["force_density_at_zero"] == pytest.approx(0.62, rel=1e-3)


def test_sliding_is_fitted_under_strain_control() -> None:
    sliding = {"peak_stress_ratio": 0.4, "reference_plastic_strain": 8e-5, "dilatancy": 0.9}
    legs = [Leg(control=("stress", "strain", "stress"), target=(-1e5, -8e-4, 0.0), increments=20)]
    table = columns(legs, sliding=True, **sliding)
    curve = some(table, "stress_xx", "stress_yy", "strain_xx", "strain_yy")
    more = [f"material.{name}={TRUTH[name]}" for name in ("coordination", "bulk_reduction", "shear_reduction")]
    settings = (*KNOWN, *more, "material.force_density_at_zero=0.62", 'control=["stress", "strain", "stress"]')
    found = fitted(curve, settings, *sliding)
    assert found.base.effects.sliding and set(found.curves[0].compared) == {"stress_yy", "strain_xx"}
    for name, value in sliding.items():
        assert found.values[name] == pytest.approx(value, rel=1e-4), name


NOISE = {"coordination": 0.01, "fabric_anisotropy": 0.004}


def coverage(repeats: int, stated: bool) -> np.ndarray:
    """(fitted - true)/(standard error), shape (repeats, nfree), with noise of known size."""
    table = columns(CONSTANT_P)
    for name, size in NOISE.items():
        table[f"{name}_error"] = np.full(len(table["p"]), size)
    more = [f"{name}_error" for name in NOISE] if stated else []
    found = []
    for seed in range(repeats):
        curve = some(noisy(table, seed, **NOISE), "p", "q", *NOISE, *more)
        result = fitted(curve, KNOWN, "coordination,force_density_at_zero")
        found.append(
            [(result.values[name] - TRUTH[name]) / error for name, error in result.errors.items()]
        )
    return np.array(found)


@pytest.mark.parametrize("stated", [True, False], ids=["errors given", "errors from the scatter"])
def test_standard_errors_are_honest(stated: bool) -> None:
    """The root mean square of deviations over their standard errors is one: within a factor of two here."""
    scaled = coverage(24, stated)
    size = np.sqrt(np.mean(scaled**2, axis=0))
    assert ((size > 0.5) & (size < 2.0)).all(), size


@pytest.mark.slow
@pytest.mark.parametrize("stated", [True, False])
def test_standard_errors_are_honest_over_many_repeats(stated: bool) -> None:
    scaled = coverage(300, stated)
    size = np.sqrt(np.mean(scaled**2, axis=0))
    assert ((size > 0.85) & (size < 1.2)).all(), size
    within = np.mean(np.abs(scaled) < 1.0, axis=0)
    assert ((within > 0.6) & (within < 0.76)).all(), within


def test_each_row_counts_by_its_own_error() -> None:
    """A row that is wrong, and known to be, changes nothing."""
    table = columns(CONSTANT_P)
    table["coordination_error"] = np.full(16, 1e-3)
    table["coordination"][7], table["coordination_error"][7] = 5.0, 1e6
    found = fitted(some(table, "p", "q", "coordination", "coordination_error"), KNOWN, "z,P0")
    assert found.values["force_density_at_zero"] == pytest.approx(0.62, rel=1e-5)


def test_the_error_of_a_stiffness_in_closed_form() -> None:
    """Strain is inverse to kn: its relative error is that of one number that scales a column with known errors."""
    table = columns(COMPRESSION)
    table["strain_yy_error"] = np.full(11, 2e-7)
    settings = [text for text in KNOWN if "normal_stiffness" not in text]
    more = ("material.coordination=4.06", "material.bulk_reduction=0.9", "material.shear_reduction=0.7")
    more = (*more, "material.force_density_at_zero=0.62")
    found = fitted(some(table, "p", "q", "strain_yy", "strain_yy_error"), (*settings, *more), "kn")
    exact = 1e9 / np.linalg.norm(table["strain_yy"] / 2e-7)
    assert found.errors["normal_stiffness"] == pytest.approx(exact, rel=1e-3)


def test_a_column_that_the_law_misses_counts_for_less() -> None:
    """Strains ten times too large do not spoil what z says, and this is told."""
    table = noisy(columns(CONSTANT_P), 3, coordination=0.003)
    table["strain_yy"] = table["strain_yy"] * (1.0 + 30.0 * table["stress_ratio"])
    names = ("p", "q", "coordination", "strain_yy")
    missed = fitted(some(table, *names), KNOWN, "z,P0,shear_reduction")
    plain = fitted(some(table, *names[:3]), KNOWN, "z,P0")
    difference = missed.values["force_density_at_zero"] - plain.values["force_density_at_zero"]
    assert abs(difference) < plain.errors["force_density_at_zero"]
    (line,) = [line for line in missed.remarks if "misses this column" in line]
    assert line.startswith("strain_yy: ") and "give peak_stress_ratio for sliding" in line


def test_nothing_but_parameters_on_bounds() -> None:
    table = columns(CONSTANT_P)
    table["coordination"] = 4.06 + 0.3 * table["stress_ratio"]
    found = fitted(some(table, "p", "q", "coordination"), (*KNOWN, "material.coordination=4.06"), "P0")
    assert found.on_bound and found.inner == [] and found.uncertainty is not None
    assert found.uncertainty.correlation.shape == (0, 0)


def test_deviations_that_follow_each_other_widen_the_errors() -> None:
    """A slow wave on the curve of the same size as the noise counts more than noise."""
    table = columns([Leg(target=(-7e4, -13e4, 0.0), increments=60)])
    scatter = noisy(table, 1, coordination=0.01)
    wave = {**table, "coordination": table["coordination"] + 0.014 * np.sin(np.arange(61) / 5.0)}
    of = "coordination,force_density_at_zero"
    plain = fitted(some(scatter, "p", "q", "coordination"), KNOWN, of)
    wide = fitted(some(wave, "p", "q", "coordination"), KNOWN, of)
    assert plain.uncertainty is not None and not plain.uncertainty.connected
    assert wide.errors["force_density_at_zero"] > 2.0 * plain.errors["force_density_at_zero"]
    assert any("more than scatter" in line for line in wide.remarks)


@pytest.mark.parametrize(
    ("names", "legs", "free", "words"),
    [
        (("p", "q", "coordination"), CONSTANT_P, "shear_reduction",
         ["shear_reduction cannot be identified", "do not change with it at all", "shear strain under a change of q"]),
        (("p", "q", "coordination"), CONSTANT_P, "P_xi0",
         ["gap_density_at_zero cannot be identified", "standard error would be", "pressure grows many times"]),
        (("p", "q", "strain_yy"), LATERAL, "normal_stiffness,bulk_reduction,shear_reduction",
         ["cannot be identified together", "normal_stiffness", "_reduction", "condition number", "hold one of them"]),
        (("p", "q", "coordination"), CONSTANT_P, "z,peak_stress_ratio", ["peak_stress_ratio cannot be identified"]),
    ],
)  # fmt: skip
def test_what_cannot_be_identified_is_refused_by_name(
    names: tuple[str, ...], legs: list[Leg], free: str, words: list[str]
) -> None:
    more = () if "coordination" in names else ("material.coordination=4.06",)
    settings = tuple(text for text in KNOWN if "normal_stiffness" not in text or "normal_stiffness" not in free)
    with pytest.raises(InputError) as told:
        fitted(some(columns(legs), *names), (*settings, *more), free)
    for word in words:
        assert word in str(told.value), told.value


def test_smaller_errors_identify_more() -> None:
    """What the usual scales hide is told by a curve with errors of its own."""
    table = columns(COMPRESSION, normal_stiffness=1e7, gap_density_at_zero=8.0)
    table["coordination_error"] = np.full(11, 1e-4)
    settings = ("material.solid_fraction=0.846", "material.normal_stiffness=1e7", "closure.force_change=mean_field")
    found = fitted(some(table, "p", "q", "coordination", "coordination_error"), settings, "z,P_xi0")
    assert found.values["gap_density_at_zero"] == pytest.approx(8.0, rel=1e-4)


def test_expected_errors_are_those_of_a_straight_line() -> None:
    x = np.linspace(0.0, 1.0, 11)
    jacobian = np.column_stack([np.ones(11), x])
    exact = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    np.testing.assert_allclose(identification.expected_errors(jacobian), exact, rtol=1e-12)
    assert np.isinf(identification.expected_errors(np.column_stack([x, 2.0 * x]))).all()
    assert identification.condition(np.column_stack([x, np.zeros(11)])) == np.inf
    assert identification.condition(np.eye(3)) == pytest.approx(1.0)


def test_a_parameter_on_a_bound_is_told() -> None:
    """z grows while q/p does: P0 would have to be below zero."""
    table = columns(CONSTANT_P)
    table["coordination"] = 4.06 + 0.3 * table["stress_ratio"]
    found = fitted(some(table, "p", "q", "coordination"), KNOWN, "z,P0")
    assert found.on_bound == {"force_density_at_zero": "lower"} and found.values["force_density_at_zero"] < 1e-5
    assert np.isnan(found.errors["force_density_at_zero"]) and np.isfinite(found.errors["coordination"])
    assert any("force_density_at_zero is on its lower bound 0" in line for line in found.remarks)


def refuse(monkeypatch: pytest.MonkeyPatch, low: float, high: float = np.inf) -> list[float]:
    """Make the law refuse force densities within an interval; the values it was asked for."""
    own, asked = LawSide.answers, []

    def answers(self: LawSide, values: Any, stop: Any = None) -> list[Answer]:
        asked.append(values["force_density_at_zero"])
        if low < values["force_density_at_zero"] < high:
            return [self._refused(curve, "it refuses") for curve in self.curves]
        return own(self, values, stop)

    monkeypatch.setattr(law_side.LawSide, "answers", answers)
    return asked


def test_points_that_the_law_refuses_do_not_end_a_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first step from 1 goes to 0.75; there is a second one, shorter, and the end is the same."""
    asked = refuse(monkeypatch, 0.74, 0.77)
    settings = (*KNOWN, "material.force_density_at_zero=1.0")
    found = fitted(some(columns(CONSTANT_P), "p", "q", "coordination", "fabric_anisotropy"), settings, "z,P0")
    assert any(0.74 < value < 0.77 for value in asked)
    assert found.converged and found.values["force_density_at_zero"] == pytest.approx(0.62, rel=1e-5)


def test_a_start_that_the_law_refuses_is_replaced_by_another(monkeypatch: pytest.MonkeyPatch) -> None:
    curve = some(columns(CONSTANT_P), "p", "q", "coordination")
    settings = (*KNOWN, "material.force_density_at_zero=0.8")
    refuse(monkeypatch, 0.7)
    assert fitted(curve, settings, "z,P0").values["force_density_at_zero"] == pytest.approx(0.62, rel=1e-5)
    refuse(monkeypatch, 0.01)
    with pytest.raises(RunError, match=r"the law does not get to line 1: it refuses \(tried with other values"):
        fitted(curve, settings, "z,P0")


def test_a_fit_that_does_not_converge_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solving, "MOST_STEPS", 2)
    found = fitted(some(columns(CONSTANT_P), "p", "q", "coordination"), KNOWN, "z,P0")
    assert not found.converged and found.message == "not converged within 2 trials"
    assert found.values["force_density_at_zero"] == pytest.approx(0.62, abs=0.05)


@pytest.mark.parametrize("after", [1, 8, 12])
def test_a_fit_that_is_stopped_keeps_the_best(after: int) -> None:
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > after * 18  # asked before and within each evaluation

    curve = some(columns(CONSTANT_P), "p", "q", "coordination")
    if after == 1:
        with pytest.raises(StoppedError):
            study.fit([curve], given(KNOWN), ["z,P0"], lambda fraction, text: None, stop)
        return
    found = study.fit([curve], given(KNOWN), ["z,P0"], lambda fraction, text: None, stop)
    assert found.stopped and not found.converged and found.message.startswith("stopped after")
    assert np.isfinite(list(found.errors.values())).all()


def test_it_is_deterministic() -> None:
    curve = some(noisy(columns(CONSTANT_P), 5, **NOISE), "p", "q", *NOISE)
    one, two = fitted(curve, KNOWN), fitted(curve, KNOWN)
    assert one.values == two.values and one.errors == two.errors


def test_each_curve_may_start_from_its_own_first_row() -> None:
    """Two packings with the same force density, but other coordination numbers and fabrics."""
    tables = [columns(CONSTANT_P), columns(CONSTANT_P, coordination=3.8, initial_fabric_xx=-0.05)]
    for table in tables:  # of an isotropic first row the law does not know along which axis a_c will count
        table["fabric_anisotropy"] = -table["fabric_anisotropy_1"]
    curves = [some(table, "p", "q", "coordination", "fabric_anisotropy") for table in tables]
    own = fitted(curves, (*KNOWN, "start=row"))
    assert own.values["force_density_at_zero"] == pytest.approx(0.62, rel=EXACT)
    assert own.values["coordination"] == pytest.approx(3.93) and "coordination" not in own.errors
    common = fitted(curves, KNOWN)
    assert any("first rows have z from 3.8 to 4.06: with --set start=row" in line for line in common.remarks)
    with pytest.raises(InputError, match="it is that of the first row of each curve"):
        fitted(curves, (*KNOWN, "start=row"), "z")
    with pytest.raises(InputError, match="which has neither"):
        fitted(some(tables[0], "p", "q", "normal_force_anisotropy"), (*KNOWN, "material.coordination=4", "start=row"))


def test_where_the_information_comes_from() -> None:
    """P0 from z and a_c, c_n from a_n; parts add up to one."""
    names = ("coordination", "fabric_anisotropy", "normal_force_anisotropy")
    found = fitted(some(columns(CONSTANT_P), "p", "q", *names), SOURCE, "z,P0,c_n")
    assert found.uncertainty is not None
    total = sum(found.uncertainty.shares[name] for name in names)
    np.testing.assert_allclose(total, 1.0, rtol=1e-9)
    assert found.uncertainty.shares["normal_force_anisotropy"][found.inner.index("force_anisotropy_ratio")] > 0.95
    assert found.uncertainty.shares["coordination"][found.inner.index("coordination")] > 0.5


def test_every_parameter_has_bounds_a_scale_and_words() -> None:
    base = fitted(some(columns(CONSTANT_P), "p", "q", "coordination"), KNOWN, "P0").base
    for name in NUMBERS:
        free = free_parameter(name, base.values[name], 1e5)
        assert free.outside(free.inside(free.first)) == pytest.approx(free.first)
        assert free.size > 0.0 and free.limits[0] < free.limits[1] and told_by(name)
        low, high = free.limits
        assert low <= free.inside(free.first) <= high
    columns_of_all = ("coordination", "fabric_anisotropy", "normal_force_anisotropy", "strain_yy")
    every = candidates(base, False, columns_of_all)
    assert set(candidates(base, True, columns_of_all)) < set(every) and "solid_fraction" not in every
    assert "coordination" not in candidates(base, False, ["strain_yy"]) and "bulk_reduction" in every


@pytest.mark.parametrize(
    ("free", "said"),
    [
        (["P"], "--free: the parameter 'P' is unknown"),
        (["force_density_at"], "the nearest is 'force_density_at_zero'"),
        (["closure.slipp"], "the nearest is 'slip'"),
        ([""], "--free: the parameter '' is unknown"),
        (["integration.tolerance"], "is unknown"),
    ],
)
def test_names_of_free_parameters(free: list[str], said: str) -> None:
    with pytest.raises(InputError) as told:
        named(free)
    assert said in str(told.value)
    assert named(["material.coordination, P0", "slip,z"]) == ["coordination", "force_density_at_zero", "slip"]


def test_what_set_gives_is_held_and_what_a_file_gives_is_a_start() -> None:
    curve = some(columns(CONSTANT_P, {"force_change": "shifted_distribution"}), "p", "q", "coordination")
    held = fitted(curve, ("material_file=dense_disks", "material.force_density_at_zero=0.62"))
    assert "force_density_at_zero" not in held.errors and "coordination" in held.errors
    assert held.base.origins["gap_density_at_zero"] == "file" and held.base.closure["shear_stiffness"] == "isostatic"
    free = fitted(curve, ("material_file=dense_disks",))
    assert "force_density_at_zero" in free.errors
    first = next(entry.first for entry in free.free if entry.name == "force_density_at_zero")
    assert first == 0.6475


def test_the_start_is_isotropic_where_the_first_row_is() -> None:
    found = fitted(some(columns(CONSTANT_P), "stress_ratio", "coordination"), (*KNOWN, f"initial.stress={list(START)}"))
    np.testing.assert_allclose(found.curves[0].initial_stress, START)
    np.testing.assert_allclose(found.curves[0].pressure, 1e5)

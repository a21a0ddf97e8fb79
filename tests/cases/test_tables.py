"""Printed tables and sentences against the files and numbers behind them: columns, units, signs, rows."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import pytest

from granfabric.cases.commands import accuracy_report, convergence, dem
from granfabric.cases.commands.convergence import Level
from granfabric.cases.effects import audit as effects_audit
from granfabric.cases.effects import report as effects_report
from granfabric.cases.effects.audit import Audit, Neglected
from granfabric.cases.effects.decision import AssessedEffect, Decision
from granfabric.cases.effects.numbers import Numbers
from granfabric.cases.field import closed_forms, comparison, mesh_error_estimate
from granfabric.cases.records import files
from granfabric.cases.scene import catalogue, measured
from granfabric.cases.scene.effects_choice import EffectSet
from granfabric.cases.scene.material_file import closure_table, material_text, refusal
from granfabric.cases.scene.measured import Inputs, as_data
from granfabric.cases.scene.schema_closed_form import ClosedForm, HoleInPlate
from granfabric.cases.scene.schema_law import ClosureSection
from granfabric.cases.terminal.screen import Screen, spread
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Closure, Material
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.measures.uncertainty import Measured
from granfabric.fem.discretisation.mesh_error import stress_error


def history(folder: Path) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def test_rows_that_are_shown_are_spread_over_all() -> None:
    assert spread(5, 8) == [0, 1, 2, 3, 4]
    assert spread(101, 6) == [0, 20, 40, 60, 80, 100]
    for count in (9, 17, 1000):
        shown = spread(count, 8)
        assert len(shown) == 8 and shown[0] == 0 and shown[-1] == count - 1 and shown == sorted(set(shown))


def test_table_of_a_point(granfabric: Callable, told: Any, tmp_path: Path) -> None:
    """A path on which p, q, z, a_c, a_n and f all differ."""
    changes = ("--set", "closure.tangential=self_consistent", "--set", "material.force_anisotropy_ratio=1.2")
    result = granfabric("point", "lateral_constant", "-o", tmp_path, "--set", "output.pictures=false", *changes)
    assert result.code == 0
    (table,), c = told.tables, history(tmp_path)
    assert table.names == ["step", "p [kPa]", "q/p", "z", "a_c", "a_n", "f/f0"]
    assert len(table.rows) == 8 and table.rows[-1][0] == str(int(c["step"][-1]))
    for row in table.rows:
        at = int(row[0])
        assert row[1:] == [
            f"{c['p'][at] / 1e3:.2f}", f"{c['q'][at] / c['p'][at]:.3f}", f"{c['coordination'][at]:.4f}",
            f"{c['fabric_anisotropy'][at]:.4f}", f"{c['normal_force_anisotropy'][at]:.4f}",
            f"{c['mean_normal_force'][at]:.4f}",
        ]  # fmt: skip
    assert len({tuple(row[1:]) for row in table.rows}) == 8
    seconds = json.loads((tmp_path / "run.json").read_text())["timing"]
    line = next(text for text in told.lines if "results in" in text)
    assert line.startswith(f"{len(c['step']) - 1} steps in {seconds['path']:.2f} s (compilation ")


def test_limited_steps_of_a_point_are_told(granfabric: Callable, told: Any, tmp_path: Path) -> None:
    """a_n = 2 q/p is beyond 0.98 from q/p = 0.49 on: of 40 increments to 0.6 the last eight."""
    path = 'path=[{control=["stress","stress","stress"], target=[-40e3, -160e3, 0.0], increments=40}]'
    changes = [path, "material.force_anisotropy_ratio=2", "material.force_density_at_zero=0.1", "output.pictures=false"]
    changes += ["effects.stiffness_feedback=false", "effects.sliding=false", "closure.force_change=mean_field"]
    result = granfabric("point", "p_constant", "-o", tmp_path, *(part for text in changes for part in ("--set", text)))
    assert result.code == 0, result.err
    limited = history(tmp_path)["limited"]
    assert limited.sum() == 8 and limited[33] == 1 and limited[32] == 0
    assert "rates were clipped at the limit of realisability in 8 of 40 steps, first in step 33" in told.lines


# the DEM


def test_table_of_a_dem_run(told: Any) -> None:
    """Strain difference in millionths, pressure in kPa; a leg's last record still belongs to it."""
    random = np.random.default_rng(3)
    names = ("strain_xx", "strain_yy", "p", "q", "coordination", "fabric_anisotropy", "normal_force_anisotropy",
             "tangential_force_anisotropy", "mean_normal_force", "sliding_fraction", "inertial_number",
             "unbalanced_force")  # fmt: skip
    h = {name: random.uniform(0.1, 1.0, 9) for name in names}
    h |= {"strain_xx": 1e-5 * np.arange(9.0), "strain_yy": -3e-5 * np.arange(9.0), "p": 1e5 + 1e3 * np.arange(9)}
    h["segment"] = np.array([0, 0, 0, 1, 1, 1, 1, 2, 3])
    values = {"slip": 0.2, "coordination": 3.9, "solid_fraction": 0.85, "normal_stiffness": 1e9,
              "peak_stress_ratio": 0.4, "dilatancy": 3.0, "constant_volume_stress_ratio": 0.1}  # fmt: skip
    record: Any = SimpleNamespace(
        scene={"title": "Disks"}, outcome="finished", message="", folder="there",
        details={
            "packing": {"particles": 300, "void_ratio": 0.182, "coordination": 3.876,
                        "coordination_without_rattlers": 4.061},
            "not_reached": ["leg 2 ended at its largest strain"],
            "measured": as_data(Inputs(values, dict.fromkeys(values, 0.0) | {"slip": 0.3}, ("fluctuation",))),
        },
        timing={"packing": 1.0, "measuring": 2.0, "loading": 3.25, "compilation": 0.5},
    )  # fmt: skip
    dem._report(SimpleNamespace(history=lambda: h), record, Screen())  # type: ignore[arg-type]
    (table,) = told.tables
    assert table.names == ["part", "e_xx-e_yy [1e-6]", "p [kPa]", "q/p", "z", "a_c", "a_n", "a_t", "f/f0", "sliding"]
    for at, row in enumerate(table.rows):
        shown = [f"{h[name][at]:.4f}" for name in names[4:10]]
        ratio = f"{h['q'][at] / h['p'][at]:.4f}"
        assert row[1:] == [f"{40.0 * at:.1f}", f"{100 + at:.2f}", ratio, *shown]
    assert table.column("part") == ["1", "1", "1", "1", "2", "2", "2", "2", "3"]
    assert told.lines == [
        "300 disks, void ratio 0.1820, z 3.876 (4.061 without rattlers); inertial number up to "
        f"{h['inertial_number'].max():.1e}, unbalanced force up to {h['unbalanced_force'].max():.1e}",
        "leg 2 ended at its largest strain",
        "material.toml: slip = 0.2 +- 0.3: its error is larger than itself",
        "material.toml: fluctuation is not measured: this packing does not give it",
        f"material.toml: the law will refuse it: {refusal(values)}",
        "packing 1.0 s, measuring 2.0 s, loading 3.2 s, compilation 0.5 s; results in there; 3 warnings on "
        "material.toml",
    ]
    assert "give back work" in refusal(values)
    # nothing measured, a leg given up, no pressure left
    told.lines.clear()
    h["q"], h["p"] = 0.0 * h["q"], np.where(np.arange(9) < 8, h["p"], 0.0)
    record.details |= {"measured": {}, "not_reached": []}
    record.outcome, record.message = "failed", "leg 3: lost"
    dem._report(SimpleNamespace(history=lambda: h), record, Screen())  # type: ignore[arg-type]
    assert told.tables[1].column("q/p") == [*8 * ["0.0000"], "-"]
    assert told.lines[1] == "failed: leg 3: lost"
    assert told.lines[2].endswith("compilation 0.5 s; results in there") and len(told.lines) == 3


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_legs_that_end_at_their_largest_strain_are_told(sign: float) -> None:
    """Loading and unloading; a leg within 0.01 has reached its ratio, and others have none to reach."""
    segments = [
        Segment(shear_strain=sign * 0.01, stress_ratio=sign * 0.3),
        Segment(shear_strain=sign * 0.02, stress_ratio=sign * 0.35),
        Segment(shear_strain=sign * 0.03, stress_ratio=sign * 0.4),
        Segment(shear_strain=sign * 0.03, stress_ratio=None),
        Segment(shear_strain=-sign * 0.04, stress_ratio=-sign * 0.2),
        Segment(shear_strain=sign * 0.05, stress_ratio=sign * 0.5),
    ]
    # the last record of a leg bears the number of the next: what each of the first five ended with
    ratio = sign * np.array([0.0, 0.27, 0.345, 0.31, 0.31, 0.1, 0.2])
    history = {
        "segment": np.array([0, 1, 2, 3, 4, 5, 6]), "stress_xx": -1e5 * (1 - ratio), "stress_yy": -1e5 * (1 + ratio),
        "stress_xy": 0.0 * ratio,
    }  # fmt: skip
    options = SimpleNamespace(segments=segments)
    run: Any = SimpleNamespace(history=lambda: history, options=options, reason="it was given up", segment=6)
    assert dem._not_reached(run, [1, 2, 3, 4, 4, 5]) == [
        f"leg 1 ended at its largest strain of 0.01, at q/p = {sign * 0.27:.3f} instead of {sign * 0.3:g}",
        f"leg 3 ended at its largest strain of 0.03, at q/p = {sign * 0.31:.3f} instead of {sign * 0.4:g}",
        f"leg 4 ended at its largest strain of 0.04, at q/p = {sign * 0.1:.3f} instead of {-sign * 0.2:g}",
    ]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_legs_that_run_past_their_end_are_told(sign: float) -> None:
    """Loaded too fast, a packing is far beyond the stress ratio when the loading is stopped."""
    segments = [Segment(shear_strain=sign * 0.01, stress_ratio=sign * 0.2)] * 2
    ratio = sign * np.array([0.0, 0.66, 0.209])
    history = {
        "segment": np.array([0, 1, 2]), "stress_xx": -1e5 * (1 - ratio), "stress_yy": -1e5 * (1 + ratio),
        "stress_xy": 0.0 * ratio,
    }  # fmt: skip
    options = SimpleNamespace(segments=segments)
    run: Any = SimpleNamespace(history=lambda: history, options=options, reason="", segment=2)
    assert dem._not_reached(run, [1, 2]) == [
        f"leg 1 ran past its end, to q/p = {sign * 0.66:.3f} instead of {sign * 0.2:g}: the loading is too fast for "
        "the packing (see [rates])"
    ]


def test_doubts_are_told_to_those_who_want_it_quiet(told: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """What could not be measured, what the law will refuse and a leg that was not ended."""
    insisted: list[str] = []
    monkeypatch.setattr(Screen, "say", lambda _, text, insist=False: insisted.append(text) if insist else None)
    values = Inputs({"weak_contact_ratio": -1.9}, {"weak_contact_ratio": 17.0})
    details = {"measured": as_data(values), "not_reached": ["leg 1 ran past its end"], "packing": {
        "particles": 50, "void_ratio": 0.2, "coordination": 3.9, "coordination_without_rattlers": 4.0}}  # fmt: skip
    columns = ("strain_xx", "strain_yy", "q", "inertial_number", "unbalanced_force", *dem._TABLE)
    h = {name: np.zeros(2) for name in columns} | {"p": np.ones(2), "segment": np.array([0, 1])}
    record: Any = SimpleNamespace(
        details=details, outcome="finished", timing={}, folder="there", scene={"title": "made up"}
    )
    dem._report(SimpleNamespace(history=lambda: h), record, Screen())  # type: ignore[arg-type]
    assert insisted[0] == "leg 1 ran past its end" and insisted[1].startswith("material.toml: weak_contact_ratio")
    assert len(insisted) == 2


def test_sliding_is_measured_on_the_first_leg_and_told(
    told: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last record of a leg bears the number of the next; parameters and their misfit in per cent."""
    asked: list[Any] = []
    values = {"peak_stress_ratio": 0.412, "first_yield_stress_ratio": 0.0, "reference_plastic_strain": 5.4e-5,
              "hardening_exponent": 2.0, "dilatancy": 1.06, "constant_volume_stress_ratio": 0.171}  # fmt: skip

    def measure(history: Any, measured: Any, rattlers: str) -> Any:
        asked.append((history, measured, rattlers))
        return {name: Measured(value, errors[name]) for name, value in values.items()}, 0.0234

    monkeypatch.setattr(dem, "measure_sliding_with_errors", measure)
    errors = dict.fromkeys(values, 0.0) | {"peak_stress_ratio": 0.012, "reference_plastic_strain": 6e-5,
                                           "dilatancy": np.nan}  # fmt: skip
    earlier = Inputs({"coordination": 3.9, "slip": 1.1}, {"coordination": 0.05, "slip": 0.2}, ("fluctuation",))
    packing = {"coordination": 3.9, "solid_fraction": 0.85, "normal_stiffness": 1e9, "slip": 1.1}
    (tmp_path / files.MATERIAL).write_text(material_text(packing, "made up"))
    history = {"segment": np.array([0, 0, 0, 1, 1, 2]), "q": np.arange(6.0)}
    record: Any = SimpleNamespace(
        folder=tmp_path, details={"measured": as_data(earlier)}, scene={"title": "made up"}
    )
    scene: Any = SimpleNamespace(measure=SimpleNamespace(rattlers="excluded"))
    dem._measure_sliding(scene, SimpleNamespace(history=lambda: history), record, Screen())  # type: ignore[arg-type]
    ((given, measured, rattlers),) = asked
    assert given["q"].tolist() == [0, 1, 2, 3] and rattlers == "excluded"
    assert measured == packing
    assert told.lines == [
        "sliding: peak 0.412, reference strain 5.40e-05, dilatancy 1.06 from q/p = 0.17 on; q/p at given strain within "
        "2.3 % of the run"
    ]
    assert record.details["sliding"] == {**values, "misfit": 0.0234}
    stored = tomllib.loads((tmp_path / files.MATERIAL).read_text())
    assert stored["material"] == {**{k: v for k, v in packing.items() if k != "slip"}, **values}
    # with their errors and doubts, beside those of what was measured before
    lines = (tmp_path / files.MATERIAL).read_text().splitlines()
    assert "# fluctuation could not be measured on this packing" in lines
    for line in (
        "coordination = 3.9  # +- 0.05", "slip = 1.1  # +- 0.2", "peak_stress_ratio = 0.412  # +- 0.012",
        "reference_plastic_strain = 5.4e-05  # +- 6e-05; its error is larger than itself",
        "hardening_exponent = 2.0", "dilatancy = 1.06  # +- ?; its error is not known: too few contacts or records",
    ):  # fmt: skip
        assert line in lines
    kept = record.details["measured"]
    assert kept["slip"] == {"value": 1.1, "standard_error": 0.2}
    assert kept["peak_stress_ratio"] == {"value": 0.412, "standard_error": 0.012}
    assert kept["dilatancy"]["standard_error"] is None and kept["fluctuation"]["value"] is None


def test_inputs_that_go_to_a_material_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """The packing's own fabric beside what was measured, on the packing at rest; what is no number is told apart."""
    found = {
        "coordination": Measured(3.9, 0.1), "slip": Measured(1.1, np.inf),
        "isostatic_coordination": Measured(np.nan, np.nan),
    }  # fmt: skip

    def measure(sample: Any, rattlers: str, size: float) -> Any:
        assert sample == "held"
        return {**found, "asked": Measured(len(rattlers) + size, 0.0)}

    def fabric(sample: Any) -> Any:
        assert sample == "held"
        return Measured(0.02, 0.03), Measured(-0.03, 0.04)

    monkeypatch.setattr(measured, "at_rest", lambda sample: "held")
    monkeypatch.setattr(measured, "measure_material_with_errors", measure)
    monkeypatch.setattr(measured, "measure_fabric", fabric)
    inputs = measured.measure_inputs(None, "excluded", 0.04)  # type: ignore[arg-type]
    assert inputs.values == {
        "coordination": 3.9, "slip": 1.1, "asked": 8.04, "initial_fabric_xx": 0.02, "initial_fabric_xy": -0.03
    }  # fmt: skip
    assert inputs.missing == ("isostatic_coordination",)
    unknown = inputs.errors.pop("slip")
    assert np.isnan(unknown)
    assert inputs.errors == {"coordination": 0.1, "asked": 0.0, "initial_fabric_xx": 0.03, "initial_fabric_xy": 0.04}
    assert dem.measured_inputs(None, "excluded", 0.04) == inputs.values  # type: ignore[arg-type]


def test_closure_that_a_material_file_names() -> None:
    """With all its numbers the closure that disks agree with; isostatic only below the coordination number."""
    numbers = dict.fromkeys(CLOSURE_NUMBERS, 0.5)
    packing = {"coordination": 3.9, "solid_fraction": 0.85, "normal_stiffness": 1e9}
    for isostatic, expected in ((2.6, "isostatic"), (4.0, None)):
        tables = tomllib.loads(material_text({**packing, "isostatic_coordination": isostatic, **numbers}, "made up"))
        assert tables["closure"]["force_change"] == "shifted_distribution"
        assert tables["closure"].get("shear_stiffness") == expected
        assert tables["material"] == {**packing, "isostatic_coordination": isostatic}
    # files of before they were measured, and packings without friction, do not have these two
    newest = ("weak_contact_gradient", "tangential_force_loss")
    older = {name: value for name, value in numbers.items() if name not in newest}
    tables = {"material": {**packing, "isostatic_coordination": 2.6}, "closure": older}
    assert closure_table(tables) == {"force_change": "shifted_distribution", "shear_stiffness": "isostatic", **older}
    closure = Closure(**closure_table(tables))
    assert (closure.weak_contact_gradient, closure.tangential_force_loss) == (0.5, 1.5)
    assert Material(**tables["material"]).force_density_slope == 0.0
    for name in older:
        assert "force_change" not in closure_table({**tables, "closure": {k: v for k, v in older.items() if k != name}})
    few = tomllib.loads(material_text({**packing, "slip": 1.0, "peak": 2.0}, "made up"))
    assert few["closure"] == {"slip": 1.0} and few["measured"] == {"peak": 2.0}


# closed forms


def test_table_of_a_closed_form(told: Any, tmp_path: Path) -> None:
    """Both stresses side by side in kPa at places spread over the line."""
    random = np.random.default_rng(1)
    names = ["x", "y", "distance", "stress_xx", "closed_form_xx", "stress_yy", "closed_form_yy"]
    table = {name: 1e5 * random.normal(size=21) for name in names}
    files.write_text(
        tmp_path / files.COMPARISON, files.csv_text(names, list(zip(*(v.tolist() for v in table.values()))))
    )
    record: Any = SimpleNamespace(
        folder=tmp_path, details={"closed_form": {"stress_error": 0.0123, "displacement_error": 0.00456}},
        scene={"closed_form": {"hole_in_plate": {}}},
    )  # fmt: skip
    comparison.report(record, Screen())
    assert told.lines[0] == (
        "difference from Kirsch's hole in a plate (constant stiffness): 1.2 % in stress, 0.46 % in displacement"
    )
    (found,) = told.tables
    assert found.names == [
        "x [m]", "y [m]", "s_xx [kPa]", "closed form_xx [kPa]", "s_yy [kPa]", "closed form_yy [kPa]"
    ]  # fmt: skip
    for row, at in zip(found.rows, (0, 4, 8, 12, 16, 20), strict=True):
        values = [f"{table[name][at] / 1e3:.2f}" for name in names[3:]]
        assert row == [f"{table['x'][at]:.4g}", f"{table['y'][at]:.4g}", *values]
    record.details["closed_form"]["displacement_error"] = None
    comparison.report(record, Screen())
    assert told.lines[-1].endswith(": 1.2 % in stress")


def test_numbers_of_a_comparison(tmp_path: Path) -> None:
    """Errors by their norms over the body, weighted; the line with the initial stress on both sides."""
    form = ClosedForm(
        hole_in_plate=HoleInPlate(radius=0.5, centre=[0.0, 0.0], stress=[-20e3, 7e3, 5e3]),
        line=[[0.6, 0.1], [1.4, 0.5]], components=["yy", "xy"],
    )  # fmt: skip
    random = np.random.default_rng(2)
    radius, angle = random.uniform(0.55, 1.6, 4000), random.uniform(-0.3, 1.2, 4000)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    initial = np.tile([-1e5, -2e5, 3e4], (4000, 1))
    exact = closed_forms.stress(form, points[:, 0], points[:, 1])
    wrong = np.zeros_like(exact)
    wrong[:, 1] = np.where(points[:, 0] > 1.0, 2e3, 0.0)
    weights = np.where(points[:, 0] > 1.0, 3.0, 1.0)
    space: Any = SimpleNamespace(points=points, weights=weights)
    loaded: Any = SimpleNamespace(scene=SimpleNamespace(closed_form=form, material=None, random_state=None))
    problem: Any = SimpleNamespace(space=space, initial_stress=initial)
    step: Any = SimpleNamespace(stress=initial + exact + wrong, active=None)
    found = comparison.compare(loaded, problem, step)
    expected = np.sqrt((weights[:, None] * wrong**2).sum() / (weights[:, None] * exact**2).sum())
    assert found.stress_error == pytest.approx(expected, rel=1e-12) and found.displacement_error is None
    line = {name: np.array(values) for name, values in found.line.items()}
    assert list(line) == ["x", "y", "distance", "stress_yy", "closed_form_yy", "stress_xy", "closed_form_xy"]
    np.testing.assert_allclose(line["x"], np.linspace(0.6, 1.4, 61))
    np.testing.assert_allclose(line["y"], np.linspace(0.1, 0.5, 61))
    np.testing.assert_allclose(line["distance"], np.hypot(0.8, 0.4) * np.linspace(0, 1, 61))
    at = closed_forms.stress(form, line["x"], line["y"])
    np.testing.assert_allclose(line["closed_form_yy"], -2e5 + at[:, 1])
    np.testing.assert_allclose(line["closed_form_xy"], 3e4 + at[:, 2])
    far = line["x"] > 1.1
    np.testing.assert_allclose(line["stress_yy"][far], (line["closed_form_yy"] + 2e3)[far], atol=300)
    np.testing.assert_allclose(line["stress_xy"], line["closed_form_xy"], atol=300)
    record: Any = SimpleNamespace(details={})
    comparison.write(tmp_path, record, found)
    assert record.details["closed_form"] == {"stress_error": found.stress_error, "displacement_error": None}
    stored = files.read_csv(tmp_path / files.COMPARISON)
    assert stored == found.line


def test_moduli_of_a_closed_form() -> None:
    material: Any = SimpleNamespace(
        coordination=4.0, solid_fraction=0.85, normal_stiffness=1e9, stiffness_ratio=0.5, bulk_reduction=0.9,
        shear_reduction=0.7,
    )  # fmt: skip
    bulk, shear = comparison.moduli(material)
    assert bulk == pytest.approx(4.0 * 0.85 * 1e9 / (2 * np.pi) * 0.9)
    assert shear == pytest.approx(4.0 * 0.85 * 1.5e9 / (4 * np.pi) * 0.7)


def test_table_of_convergence(
    told: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pictures: dict[str, Any]
) -> None:
    """Printed and stored: sizes, errors and orders each in its own column."""
    made = {n: Level(n, 0.4 / n, 10 * n, 0.1 / n**2, 0.03 / n**3) for n in (1, 2, 4)}
    monkeypatch.setattr(convergence, "solve_level", lambda loaded, factor: made[factor])
    convergence.run_convergence("hole_in_plate", [], [1, 2, 4], tmp_path / "out", Screen())
    (table,) = told.tables
    assert table.names == ["refine", "h [m]", "dofs", "stress", "order", "displacement", "order"]
    assert table.title.endswith("relative error against Kirsch's hole in a plate, and its order in the mesh size")
    assert table.rows == [
        ["1", "0.4", "10", "0.1", "", "0.03", ""],
        ["2", "0.2", "20", "0.025", "2", "0.00375", "3"],
        ["4", "0.1", "40", "0.00625", "2", "0.000469", "3"],
    ]
    stored = files.read_csv(tmp_path / "out" / "convergence.csv")
    assert list(stored) == [
        "refine", "size", "degrees_of_freedom", "stress_error", "stress_order", "displacement_error",
        "displacement_order",
    ]  # fmt: skip
    assert stored["stress_order"][0] == "" and stored["displacement_order"][1:] == pytest.approx([3.0, 3.0])
    assert stored["stress_error"] == pytest.approx([0.1, 0.025, 0.00625])
    assert stored["size"] == pytest.approx([0.4, 0.2, 0.1]) and stored["degrees_of_freedom"] == [10, 20, 40]


# effects

FACTS = Numbers(
    stress_ratio=0.31, stress_ratio_way=0.6, off_axis=0.042, turn_degrees=33.0, pressure_rise=0.2, pressure_fall=0.5,
    turning_back=0.08, reversal=0.11, gain_bound=3.2e-4, loss=0.145, stiffness_change=0.27, low_pressure_fraction=0.012,
    excess_pressure=0.0,
)  # fmt: skip


def assessed(name: str, on: bool, error: float, largest: float, quantity: str, **more: Any) -> AssessedEffect:
    values = {"asked": "auto", "columns": 2, "time_ratio": 1.37, **more}
    return AssessedEffect(name, values["asked"], on, error, largest, quantity, values["columns"], values["time_ratio"])


def decision() -> Decision:
    chosen = EffectSet(
        Effects(contact_gain=False, principal_rotation=False, stiffness_feedback=True), "shifted_distribution"
    )
    return Decision(
        chosen,
        [
            assessed("contact_loss", True, 0.21, 0.33, "coordination"),
            assessed("contact_gain", False, 2e-4, 4e-4, "fabric", columns=0, time_ratio=np.nan),
            assessed("principal_rotation", False, 0.05, 0.09, "stress", asked=False),
            assessed("sliding", False, 0.0, 0.0, "", columns=5),
            assessed("force_change", True, np.inf, np.inf, "strain", asked=True, columns=-1),
        ],
        3e-4, 0.01, FACTS,
    )  # fmt: skip


def test_table_of_effects() -> None:
    heads, rows = effects_report.table(decision(), 1000)
    assert heads == ["effect", "scene", "is", "number", "error", "of", "worst", "columns", "memory", "time"]
    assert rows == [
        ["contact_loss", "auto", "on", "first-order loss 14.5%", "2.1e-01", "z", "3.3e-01", "+2", "+0.03 MB", "x 1.37"],
        ["contact_gain", "auto", "off", "gain within 3.2e-04", "2.0e-04", "a_c", "4.0e-04", "+0", "+0.00 MB", ""],
        ["principal_rotation", "false", "off", "off axes 0.042, turn 33 deg", "5.0e-02", "stress/p", "9.0e-02", "+2",
         "+0.03 MB", "x 1.37"],
        ["sliding", "auto", "off", "q/p reaches 0.31", "", "", "", "+5", "+0.08 MB", "x 1.37"],
        ["force_change", "true", "on", "q/p, ln p fall by 0.11", "not followed", "strain", "not followed", "-1",
         "-0.02 MB", "x 1.37"],
    ]  # fmt: skip
    assert effects_report.table(decision(), 1)[1][0][8] == "+32 B"
    assert effects_report.number_of("stiffness_feedback", FACTS) == "stiffness within 27.0%"
    assert effects_report.number_of("tangential_memory", FACTS) == "s turns back by 0.08"


def test_lines_on_effects() -> None:
    first, second, third = effects_report.lines(decision(), False)
    assert first == (
        "effects: contact_loss, stiffness_feedback, irreversible_spread, tangential_memory; "
        "force_change = shifted_distribution"
    )
    assert second == (
        "left out (estimated error of each): contact_gain 2.0e-04; together 3.0e-04, tolerance 0.01; switched off by "
        "the scene, error above the tolerance: principal_rotation 5.0e-02"
    )
    assert third == (
        "elastic probe: q/p to 0.31, principal stress rotation 33 deg, ln p -0.5 to +0.2, "
        "pressure nearly gone on 1.2% of the area; "
        "stiffness follows the state"
    )
    assert effects_report.lines(decision(), True)[2].endswith("; displacements by one linear solve a stage")
    data = effects_report.as_data(decision())
    assert (data["tolerance"], data["error_left_out"]) == (0.01, 3e-4)
    entry = data["effects"][0]
    assert (entry["name"], entry["on"], entry["error_if_left_out"], entry["error_at_worst_point"]) == (
        "contact_loss", True, 0.21, 0.33
    )  # fmt: skip
    assert data["effects"][4]["error_if_left_out"] == "not followed"
    assert data["numbers"]["pressure_fall"] == 0.5


def test_sentences_of_the_audit() -> None:
    def entry(name: str, warn: bool, quantity: str = "stress", largest: float = 0.4) -> Neglected:
        return Neglected(name, 0.02, 0.03, largest, quantity, 0.25, "x = 0 ... 1 m", warn)

    scene: Any = SimpleNamespace(
        effects=SimpleNamespace(tolerance=0.01, **dict.fromkeys(Effects.names(), False)), accuracy=None,
        closure=ClosureSection(force_change="mean_field"),
    )  # fmt: skip
    for quantity, words in (
        ("stress", "stress over p by up to 4.0e-01"), ("strain", "strain by up to 4.0e-01"),
        ("coordination", "z by up to 4.0e-01"), ("fabric", "a_c by up to 4.0e-01"),
    ):  # fmt: skip
        audit = Audit([entry("contact_gain", True, quantity), entry("principal_rotation", False)], 0.1)
        warning, rest = effects_audit.messages(audit, scene)
        assert warning == (
            f"warning: contact_gain is off and would have changed {words} on 25% of the area (x = 0 ... 1 m); on the "
            "mean 2.0e-02, tolerance 0.01; --upgrade turns it on"
        )
        assert rest == "audit of what was left out: principal_rotation 3.0e-02"
    audit = Audit([entry("force_change", True), entry("contact_gain", True)], 0.31)
    assert effects_audit.to_upgrade(audit) == [
        'closure.force_change="shifted_distribution"', "effects.contact_gain=true"
    ]  # fmt: skip
    assert effects_audit.messages(audit, scene)[-1].startswith("audit: q/p reaches 0.31 without sliding; beyond 0.25")
    # friction 0.2 is used up earlier; where it carries more, or does not slip at all, the usual bound stays
    used_up = "beyond 0.17, tangential_force_ratio/(2 slip), tangential forces"
    for slip, known in ((2.3, used_up), (1.0, "beyond 0.25 s"), (0.0, "beyond 0.25 s")):
        scene.closure = ClosureSection(force_change="shifted_distribution", tangential_force_ratio=0.78, slip=slip)
        assert f"q/p reaches 0.31 without sliding; {known}" in effects_audit.messages(audit, scene)[-1]
    scene.closure = ClosureSection(force_change="shifted_distribution", slip=2.3)
    assert not any("sliding" in text for text in effects_audit.messages(Audit([], 0.16), scene))
    data = effects_audit.as_data(Audit([entry("contact_gain", True, largest=np.inf)], 0.1))[0]
    assert (data["mean"], data["most"], data["largest"], data["fraction"]) == (0.02, 0.03, "without bound", 0.25)


# the mesh, accuracy, scenes


def test_the_mesh_is_judged_by_the_change_of_stress_region_by_region(
    solve_scene: Callable, tmp_path: Path
) -> None:
    """Worst cell, error of each cell and of the whole, against the estimate itself."""
    problem, steps = solve_scene("layered_oedometer", "stage.1.increments=1")
    space, last = problem.space, steps[-1]
    region = problem.material_index.reshape(space.nelements, -1)[:, 0]
    assert len(np.unique(region)) > 1
    found = stress_error(space, last.stress - problem.initial_stress, region)
    record: Any = SimpleNamespace(details={})
    mesh_error_estimate.estimate(tmp_path, record, problem, last)
    assert record.details["mesh_error"]["stress"] == found.relative
    worst = space.host_mesh.mesh.p[:, space.host_mesh.mesh.t[:, found.of_cells.argmax()]].mean(axis=1)
    assert record.details["mesh_error"]["place"] == pytest.approx(worst.tolist())
    written = meshio.read(tmp_path / "mesh_error.vtu")
    np.testing.assert_array_equal(written.cell_data["stress_error"][0], found.of_cells)
    # without regions, or of the whole stress, it would be another
    assert stress_error(space, last.stress - problem.initial_stress).relative != found.relative
    assert stress_error(space, last.stress, region).relative != found.relative


def test_line_on_the_mesh(told: Any) -> None:
    record: Any = SimpleNamespace(details={"mesh_error": {"stress": 0.0123, "place": [0.25, 1.5]}})
    mesh_error_estimate.report(record, Screen())
    assert told.lines == [
        "mesh: estimated error of the stress changes 1.2 % of their norm, largest near (0.25, 1.5) m: mesh_error.vtu"
    ]


def test_lines_on_accuracy(told: Any) -> None:
    choice: Any = SimpleNamespace(wanted=1e-4, kept={}, settings=SimpleNamespace(measured=3e-5), chosen={})
    entry = {"expected": 3e-5, "mesh": 2e-4, "load_steps": {"largest": 7e-5}}
    record: Any = SimpleNamespace(timing={"accuracy": 1.5, "run": 4.0})
    assert accuracy_report._field_text(choice, entry, record) == (
        "error estimate: point law 3.0e-05 in each increment (measured by `granfabric cost`), load steps 7.0e-05 in "
        "the means (against half as many, 1.5 s; the run itself: 4.0 s); mesh 2.0e-04 in the stresses, more than "
        "wanted: refine it where mesh_error.vtu says"
    )
    entry = {"expected": None, "mesh": 2e-5, "load_steps": {"largest": 7e-4}}
    text = accuracy_report._field_text(choice, entry, record)
    assert "load steps 7.0e-04 in the means, more than the 0.0001 wanted: take more increments" in text
    assert text.startswith("error estimate: point law not known") and text.endswith("mesh 2.0e-05 in the stresses")


def test_list_of_scenes(granfabric: Callable) -> None:
    """Each scene below the command that runs it, with its own title."""
    out = granfabric("scenes").out.splitlines()
    commands = {"granfabric point NAME": "point", "granfabric run NAME": "field", "granfabric dem NAME": "dem"}
    kind, found = "", {}
    for line in out:
        if line in commands:
            kind = commands[line]
        elif line.split() and line.split()[0] in catalogue.shipped():
            name = line.split()[0]
            found[name] = (kind, line.strip()[len(name) :].strip())
    # specimens are scenes of disks
    kinds = {name: "dem" if entry.kind == "specimen" else entry.kind for name, entry in catalogue.shipped().items()}
    assert found == {name: (kinds[name], entry.title) for name, entry in catalogue.shipped().items()}


def test_units_stay_in_the_head_of_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    """A unit in brackets that begins with a letter looks like markup."""
    Screen().table("Title [Pa]", ["group", "p [kPa]", "x [m]"], [["[a]", "1", "2"]], ("group",))
    out = capsys.readouterr().out
    assert "Title [Pa]" in out and "p [kPa]" in out and "x [m]" in out and "[a]" in out

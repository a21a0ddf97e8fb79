"""The audit after a run: what was wrongly left out is named, where it is, and turned on by --upgrade."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_effects import BACK, HEAD, INITIAL, PRESS, SIDEWAYS

from granfabric.cases.effects.audit import StressPaths, audit_field
from granfabric.cases.effects.resolve import resolve_field
from granfabric.cases.field.prepare import prepare
from granfabric.cases.records.files import read_csv
from granfabric.cases.scene.reader import load
from granfabric.fem.equilibrium.stepping import solve

# the top is pulled sideways: shear and bending, largest at the foot
HALVES = """
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }]
pressure = [
  { boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }, { boundary = "top", value = 100e3 },
]

[[stage]]
name = "pull"
increments = 6
traction = [{ boundary = "top", value = [3e3, 0.0] }]
"""


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "scene.toml"
    file.write_text(HEAD + text)
    return file


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())


def audited(folder: Path) -> dict:
    return {entry["name"]: entry for entry in record(folder)["audit"]}


def test_a_wrongly_forced_effect_is_named_and_upgraded(granfabric: Callable, tmp_path: Path) -> None:
    file = written(tmp_path, INITIAL + SIDEWAYS)
    forced = ["--set", "effects.principal_rotation=false", "--set", "closure.force_change=shifted_distribution"]
    plain = granfabric("run", file, "-o", tmp_path / "off", *forced)
    assert plain.code == 0
    assert "warning: principal_rotation is off and would have changed a_c" in plain.out and "--upgrade" in plain.out
    entry = audited(tmp_path / "off")["principal_rotation"]
    assert entry["warn"] and entry["most"] > 1e-2 and 0.01 < entry["fraction"] <= 1.0
    assert entry["mean"] <= entry["most"] <= entry["largest"]
    assert record(tmp_path / "off")["upgrade"] == ["effects.principal_rotation=true"]
    # the audit's number is the error of that run, found by really running with the effect on
    upgraded = granfabric("run", file, "-o", tmp_path / "on", *forced, "--upgrade")
    assert upgraded.code == 0 and "running again with effects.principal_rotation=true" in upgraded.out
    data = record(tmp_path / "on")
    assert data["scene"]["effects"]["principal_rotation"] is True and data["upgrade"] == []
    means = [read_csv(tmp_path / name / "history.csv") for name in ("off", "on")]
    change = abs(means[0]["fabric_anisotropy"][-1] - means[1]["fabric_anisotropy"][-1])
    assert 0 < change <= entry["largest"]


def test_unloading_without_memory_is_called_to_account(granfabric: Callable, tmp_path: Path) -> None:
    source = ("--set", "effects.tolerance=0.02", "--set", "closure.force_change=mean_field")
    loading = written(tmp_path, INITIAL + PRESS)
    assert granfabric("run", loading, "-o", tmp_path / "a", *source).code == 0
    # the closure was the scene's choice, and the path gives no reason to doubt it
    assert not audited(tmp_path / "a")["force_change"]["warn"]
    back = written(tmp_path, INITIAL + PRESS + BACK)
    result = granfabric("run", back, "-o", tmp_path / "b", *source)
    assert "warning: force_change is off" in result.out and audited(tmp_path / "b")["force_change"]["warn"]
    assert record(tmp_path / "b")["upgrade"] == ['closure.force_change="shifted_distribution"']


@pytest.mark.parametrize("name", ["contact_loss", "stiffness_feedback", "principal_rotation"])
def test_the_audit_of_a_field_is_the_difference_to_a_run_with_the_effect(tmp_path: Path, name: str) -> None:
    """At every kept point, but for what stress does elsewhere in consequence."""
    file = written(tmp_path, HALVES)
    settings = [f"effects.{name}=false", "closure.shear_stiffness=isostatic", "effects.contact_gain=false"]
    outcomes = {}
    for on in (False, True):
        others = [f"effects.{other}=true" for other in ("contact_loss", "stiffness_feedback", "principal_rotation")]
        loaded = load(str(file), [*others, *settings[1:], f"effects.{name}={str(on).lower()}"])
        loaded, prepared, _ = resolve_field(loaded, prepare(loaded))
        stress_paths, steps = StressPaths(prepared.problem), []
        summary = solve(
            prepared.problem,
            prepared.control,
            on_step=lambda step: (stress_paths.add(step), steps.append(step)),  # noqa: B023
        )
        assert summary.finished
        outcomes[on] = (loaded, prepared, stress_paths, steps)
    loaded, prepared, stress_paths, steps = outcomes[False]
    (entry,) = [entry for entry in audit_field(loaded, prepared.problem, stress_paths).neglected if entry.name == name]
    columns = [outcomes[on][1].problem.law.description.columns("coordination") for on in (False, True)]
    coordination = [
        np.array([step.state[:, column][:, 0] for step in outcomes[on][3]])
        for on, column in zip((False, True), columns)
    ]
    stress = [np.array([step.stress for step in outcomes[on][3]]) for on in (False, True)]
    pressure = -0.5 * (stress[1][..., 0] + stress[1][..., 1])
    real = {
        "coordination": np.abs(coordination[0] / coordination[1] - 1.0).max(axis=0),
        "stress": (np.linalg.norm(stress[0] - stress[1], axis=-1) / pressure).max(axis=0),
    }
    if entry.quantity in real:
        assert entry.largest == pytest.approx(real[entry.quantity].max(), rel=0.35)
    else:  # strain and a_c have no second way to be looked at here; the run must differ as well
        assert real["coordination"].max() + real["stress"].max() > 0
    assert entry.largest > 0


def test_what_was_kept_on_is_not_audited_and_a_resumed_run_says_nothing(granfabric: Callable, tmp_path: Path) -> None:
    file = written(tmp_path, INITIAL + PRESS)
    assert granfabric("run", file, "-o", tmp_path / "out").code == 0
    on = {name for name, value in record(tmp_path / "out")["scene"]["effects"].items() if value is True}
    assert on and not on & set(audited(tmp_path / "out"))
    assert "contact_gain" in audited(tmp_path / "out")


def test_the_region_is_where_it_happens(granfabric: Callable, tmp_path: Path) -> None:
    """A corner that is pushed: the far end of the specimen is not in the bounding box."""
    push = """
[[stage]]
name = "push"
increments = 4
pressure = [{ boundary = "top", value = 115e3 }]
"""
    text = HALVES.split("[[stage]]\nname")[0] + "[[stage]]\nname" + HALVES.split("[[stage]]\nname")[1] + push
    file = written(tmp_path, text)
    settings = ["effects.contact_loss=false", "effects.tolerance=2e-3"]
    result = granfabric("run", file, "-o", tmp_path / "out", *(word for one in settings for word in ("--set", one)))
    assert result.code == 0
    entry = audited(tmp_path / "out")["contact_loss"]
    assert entry["warn"] and "x = " in entry["region"] and "y = " in entry["region"] and entry["region"] in result.out

"""What a field run says about the balance of its initial state: on the screen, in `run.json`, in a failure."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from granfabric.cases.field.initial_balance import Balance, doubtful_units, percent, pulling, unchanged, unheld
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene.catalogue import shipped
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen

COLUMN = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[initial]
stress = [-100e3, -100e3, 0.0]
stress_gradient_y = [8e3, 17e3, 0.0]
reference_point = [0.0, 5.0]
[mesh]
rectangle = { width = 10.0, height = 5.0, nx = 4, ny = 4 }
element = "P1"
[output]
pictures = false
[[stage]]
name = "initial"
increments = 2
fixed = [{ boundary = "bottom" }, { boundary = "left", components = ["x"] }, { boundary = "right", components = ["x"] }]
body_force = [{ value = [0.0, -17e3] }]
pressure = [{ boundary = "top", value = 100e3 }]
[[stage]]
name = "more"
increments = 1
pressure = [{ boundary = "top", value = 101e3 }]
"""

SPECIMEN = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[initial]
stress = [-100e3, -100e3, 0.0]
[mesh]
rectangle = { width = 0.05, height = 0.1, nx = 2, ny = 4 }
element = "P1"
[output]
pictures = false
[[stage]]
name = "initial"
increments = 2
fixed = [{ boundary = "bottom", components = ["y"] }, { boundary = "top", components = ["y"] }]
fixed_point = [{ point = [0.0, 0.0], components = ["x"] }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
[[stage]]
name = "compression"
increments = 2
displacement = [{ boundary = "top", component = "y", value = -2e-6 }]
"""

FEEDBACK = ("closure.force_change=mean_field", "effects.stiffness_feedback=true", "effects.contact_loss=true")
FREE = 15 / 16
"""Fraction of the sides that is free: half a cell at the node that is held takes the rest."""
UNCOUPLED = ("closure.force_change=mean_field", "effects.stiffness_feedback=false")
EARLY = ("solver.smallest_factor=0.1", "integration.maximum_substeps=30")
"""Give up early."""
BOTH_SOLUTIONS = pytest.mark.parametrize("effects", [FEEDBACK, UNCOUPLED], ids=["coupled", "uncoupled"])


@pytest.fixture
def run(granfabric: Callable, tmp_path: Path) -> Callable:
    def started(text: str, *assignments: str, options: tuple[str, ...] = ()):
        (tmp_path / "own.toml").write_text(text)
        words = [word for text in assignments for word in ("--set", text)]
        result = granfabric("run", tmp_path / "own.toml", "-o", tmp_path / "out", *words, *options)
        told = json.loads((tmp_path / "out" / "run.json").read_text())
        return result, told

    return started


def line(out: str) -> str:
    found = [text for text in out.splitlines() if "initial stress and loads" in text and not text.startswith("failed")]
    assert len(found) == 1, out
    return found[0]


def test_percent() -> None:
    shown = [percent(fraction) for fraction in (2.0, 0.384, 0.0951, 0.0123, 0.00034, 3e-15)]
    assert shown == ["200 %", "38 %", "9.5 %", "1.2 %", "0.034 %", "3e-13 %"]


@pytest.mark.parametrize("name", sorted(entry.name for entry in shipped().values() if entry.kind == "field"))
def test_shipped_scenes_are_in_balance_or_say_what_balances_them(name: str) -> None:
    loaded = load(name)
    problem = prepare(loaded).problem
    balance = Balance(problem, getattr(loaded.scene.initial, "from") == "gravity")
    assert not balance.warned and pulling(loaded, problem) == []
    if name == "strip_footing":
        assert balance.found.fraction > 0.5 and "constant reference forces" in balance.text()
    elif name == "slope":
        assert balance.found.fraction > 0.2 and "from whose end displacements count" in balance.text()
    elif name == "tunnel":  # three points do not integrate exactly over elements with a curved side
        assert balance.found.fraction < 2e-5
    else:
        # measured: 2e-15 to 9e-14
        assert balance.found.fraction < 1e-12
        assert re.fullmatch(r"initial stress and loads are in balance \(to \de-\d\d of .* forces\)", balance.text())


@BOTH_SOLUTIONS
@pytest.mark.parametrize(("weight", "fraction"), [(-17e3, 0.0), (17e3, 42.7), (-1.7e3, 19.2), (-16.9e3, 0.125)])
def test_weights(run: Callable, effects: tuple, weight: float, fraction: float) -> None:
    """The right one, one upwards, one ten times too small, and one rounded: a warning from 1 % on."""
    result, told = run(COLUMN, f"stage.0.body_force=[{{value=[0.0, {weight}]}}]", *effects)
    assert result.code == 0, result.err
    said = line(result.out)
    entry = told["initial_imbalance"]
    if fraction == 0.0:
        assert "are in balance" in said and entry["fraction"] < 1e-12 and not entry["warned"]
        return
    assert said.startswith("warning: ") == entry["warned"] == (fraction > 1.0)
    assert f"out of balance by {percent(entry['fraction'])} of the nodal forces, most near (" in said
    assert said.endswith('it fades out over stage "initial"')
    assert 100 * entry["fraction"] == pytest.approx(fraction, rel=0.02)
    # before the first step, and beside the results
    assert result.out.index(said) < result.out.index("means and extremes")
    assert said in (Path(told["scene_file"]).parent / "out" / "run.log").read_text()


@BOTH_SOLUTIONS
def test_a_pressure_of_the_wrong_sign_is_told_and_told_again_when_the_run_fails(run: Callable, effects: tuple) -> None:
    wrong = "stage.0.pressure=[{boundary='left', value=-100e3}, {boundary='right', value=100e3}]"
    both = "stage.0.pressure=[{boundary='left', value=-100e3}, {boundary='right', value=-100e3}]"
    result, told = run(SPECIMEN, both, *effects, *EARLY)
    said = line(result.out)
    assert said.startswith("warning: ") and f"by {200 * FREE:.0f} % of the nodal forces" in said
    assert 'warning: stage 1 "initial": pressure 1: the pressure on \'left\' is -1e+05 Pa, tension' in result.out
    assert "pressure 2: the pressure on 'right'" in result.out
    assert result.code == 1 and told["outcome"] == "failed"
    assert f"were out of balance by {200 * FREE:.0f} % of the nodal forces, most near" in told["message"]
    assert 'fades out over stage "initial"' in told["message"] and told["message"] in result.out
    assert re.search(r"\(point \d+ at \(\S+, \S+\) m.*; failed_point.toml holds it\)", told["message"])
    result, _ = run(SPECIMEN, wrong, *effects, *EARLY)
    assert "by 88 % of the nodal forces" in line(result.out) and "pressure 2: the" not in result.out


def test_a_gradient_that_turns_a_pressure_into_a_pull(run: Callable) -> None:
    result, _ = run(SPECIMEN, "stage.0.pressure.0.gradient=[0.0, -3e6]", *UNCOUPLED)
    assert "pressure 1: the pressure on 'left' is -2e+05 Pa, tension" in result.out


@pytest.mark.parametrize(
    ("traction", "said"), [("[5e3, 1e5]", True), ("[-5e3, 1e5]", False), ("[0.0, 1e5]", False), ("[5e3, 0.0]", True)]
)
def test_tractions_that_pull(tmp_path: Path, traction: str, said: bool) -> None:
    """Outwards on a side without pressure; what acts beside a pressure cannot be told by itself."""
    (tmp_path / "own.toml").write_text(SPECIMEN)
    loads = [f"stage.1.traction=[{{boundary='right', value={traction}}}]", "stage.0.pressure=[]"]
    loaded = load(str(tmp_path / "own.toml"), loads)
    warnings = pulling(loaded, prepare(loaded).problem)
    expected = 'warning: stage 2 "compression": traction 1: the traction on \'right\' is tensile, 5000 Pa'
    assert warnings == ([expected] if said else [])
    loaded = load(str(tmp_path / "own.toml"), loads[:1])
    assert pulling(loaded, prepare(loaded).problem) == []


def test_a_failure_that_has_other_reasons_does_not_speak_of_the_initial_state(run: Callable) -> None:
    result, told = run(SPECIMEN, "stage.1.displacement.0.value=-5e-3", *FEEDBACK, *EARLY)
    assert result.code == 1 and told["outcome"] == "failed" and "balance" not in told["message"]


@BOTH_SOLUTIONS
def test_reference_forces_are_told_and_not_warned_of(run: Callable, effects: tuple) -> None:
    result, told = run(SPECIMEN, "stage.0.pressure=[]", "initial.balance=true", *effects)
    said = line(result.out)
    assert not said.startswith("warning") and f"by {100 * FREE:.0f} % of" in said
    assert "constant reference forces" in said
    assert not told["initial_imbalance"]["warned"] and result.code == 0


@BOTH_SOLUTIONS
@pytest.mark.parametrize(("value", "rest"), [(100e3, 0.0), (50e3, 50.0), (0.0, 100.0)])
def test_a_first_stage_of_another_name(run: Callable, effects: tuple, value: float, rest: float) -> None:
    """Its loads come up while the imbalance fades out: a warning only if they do not take its place."""
    loads = f"stage.0.pressure=[{{boundary='left', value={value}}}, {{boundary='right', value={value}}}]"
    result, told = run(SPECIMEN, "stage.0.name=press", loads, *effects)
    said = line(result.out)
    assert f"by {100 * FREE:.0f} % of" in said and 'fades out over stage "press"' in said
    assert 'not named "initial"' in said
    assert said.startswith("warning: ") == (rest > 1.0)
    assert ("the loads balance it" if not rest else f"the loads leave {FREE * rest:.0f} % unbalanced") in said
    assert 100 * told["initial_imbalance"]["fraction_at_end_of_first_stage"] == pytest.approx(FREE * rest, abs=1e-9)


@BOTH_SOLUTIONS
def test_a_resumed_run_keeps_what_was_said(
    run: Callable, effects: tuple, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upwards = ("stage.0.body_force=[{value=[0.0, 17e3]}]", *effects)
    whole, told = run(COLUMN, *upwards)
    assert whole.code == 0

    with monkeypatch.context() as patch:
        from contextlib import contextmanager

        from granfabric.cases.terminal.interruption import InterruptRequest

        patch.setattr(InterruptRequest, "__call__", lambda self: self.requested)

        @contextmanager
        def interrupting(self: Screen, what: str, total: float):
            import signal

            yield lambda done, text: signal.raise_signal(signal.SIGINT) if "step 1," in text else None

        patch.setattr(Screen, "progress", interrupting)
        stopped, _ = run(COLUMN, *upwards)
        assert stopped.code == 1
    resumed, again = run(COLUMN, *upwards, options=("--resume",))
    assert resumed.code == 0 and again["resumed_after_step"] == 1
    assert again["initial_imbalance"] == told["initial_imbalance"]
    assert line(resumed.out) == line(whole.out)


@BOTH_SOLUTIONS
def test_released_supports_are_told_with_what_they_carried(run: Callable, effects: tuple) -> None:
    last = '\n[[stage]]\nname = "free"\nkeep = false\nincrements = 1\n' + SPECIMEN.split("increments = 2\n")[1].replace(
        ', { boundary = "top", components = ["y"] }', ""
    ).split("[[stage]]")[0]
    result, told = run(SPECIMEN + last, *effects, "solver.smallest_factor=0.5", "stage.1.displacement.0.value=0.0")
    said = [text for text in result.out.splitlines() if "releases supports" in text]
    # 100 kPa on 0.05 m
    assert len(said) == 1 and 'stage "free" releases supports that carried 5000 N/m (resultant' in said[0]
    assert told["released"][0]["sum"] == pytest.approx(5000.0, rel=1e-9)
    assert told["released"][0]["resultant"] == pytest.approx([0.0, -5000.0], abs=1e-6)
    assert ("(stage \"free\" releases supports that carried 5000 N/m)" in told["message"]) == (result.code == 1)


@pytest.mark.parametrize(
    ("assignments", "said"),
    [
        ([], ""),
        (
            ["stage.0.fixed=[]", "stage.0.fixed_point=[]"],
            'warning: stage 1 "initial": the supports leave the body free to move along x and to move along y and to '
            "turn; hold it by fixed, displacement or fixed_point",
        ),
        (
            ["stage.0.fixed_point=[]"],
            'warning: stage 1 "initial": the supports leave the body free to move along x; hold it by fixed, '
            "displacement or fixed_point",
        ),
        (
            ["stage.0.fixed_point=[]", "stage.1.fixed_point=[{point=[0.0, 0.0]}]"],
            'warning: stage 1 "initial": the supports leave the body free to move along x; hold it by fixed, '
            "displacement or fixed_point",
        ),
        (
            ["stage.1.keep=false"],
            'warning: stage 2 "compression": the supports leave the body free to move along x; hold it by fixed, '
            "displacement or fixed_point",
        ),
    ],
)
def test_a_body_that_is_not_held_is_told(tmp_path: Path, assignments: list[str], said: str) -> None:
    (tmp_path / "own.toml").write_text(SPECIMEN)
    loaded = load(str(tmp_path / "own.toml"), assignments)
    assert unheld(loaded, prepare(loaded).problem) == ([said] if said else [])


def test_a_stage_without_loads_is_told(run: Callable, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(SPECIMEN)
    for assignments in ([], ["stage.1.displacement=[]", "stage.1.keep=false"]):
        loaded = load(str(tmp_path / "own.toml"), assignments)
        assert unchanged(loaded, prepare(loaded).problem) == []
    result, _ = run(SPECIMEN, "stage.1.displacement=[]", *UNCOUPLED)
    assert 'warning: stage 2 "compression": the stage has no loads: nothing changes in it' in result.out


def test_a_pressure_in_kilopascals_is_told(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(SPECIMEN)
    found = {}
    for pressure in (100e3, 1e3, 100.0):
        loaded = load(str(tmp_path / "own.toml"), [f"initial.stress=[{-pressure}, {-pressure}, 0.0]"])
        found[pressure] = doubtful_units(loaded, prepare(loaded).problem)
    assert found[100e3] == found[1e3] == []
    assert found[100.0] == [
        "warning: mean initial pressure 100 Pa, kn/p = 1e+07: stresses are in Pa, not kPa (100 kPa is 100e3)"
    ]

"""`granfabric point`: published numbers, closed forms, files, interruption."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from drawn import unnamed
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from granfabric.cases.records import files
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw

COLUMNS = [
    *("step", "strain_xx", "strain_yy", "strain_xy", "stress_xx", "stress_yy", "stress_xy", "p", "q"),
    *("coordination", "fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy"),
    *("mean_normal_force", "coordination_gained", "coordination_lost", "fabric_gained", "fabric_lost", "substeps"),
]

NO_PICTURES = ("--set", "output.pictures=false")


def history(folder: Path) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())


# Two independent implementations agree on these digits: z and a_c at q/p = 0.1, 0.2, 0.3 from an isotropic start.
REFERENCE = [
    ("p_constant", 0.50, [3.9303, 3.7995, 3.6674], [0.0520, 0.1081, 0.1692]),
    ("p_constant", 0.75, [3.8690, 3.6836, 3.5043], [0.0777, 0.1608, 0.2498]),
    ("lateral_constant", 0.50, [4.0150, 3.9683, 3.9195], [0.0202, 0.0419, 0.0653]),
]


@pytest.mark.parametrize(("scene", "density", "coordination", "fabric"), REFERENCE)
def test_reference_values(
    granfabric: Callable, tmp_path: Path, scene: str, density: float, coordination: list, fabric: list
) -> None:
    result = granfabric(
        "point", scene, "-o", tmp_path, "--set", f"material.force_density_at_zero={density}", *NO_PICTURES
    )
    assert result.code == 0, result.err
    columns = history(tmp_path)
    ratio = columns["q"] / columns["p"]
    rows = [int(np.argmin(np.abs(ratio - wanted))) for wanted in (0.1, 0.2, 0.3)]
    np.testing.assert_allclose(ratio[rows], [0.1, 0.2, 0.3], atol=1e-9)
    # The references are rounded to four decimals; the tolerance of the integration is 1e-6.
    np.testing.assert_allclose(columns["coordination"][rows], coordination, rtol=0, atol=0.5e-4 + 1e-5)
    np.testing.assert_allclose(columns["fabric_anisotropy"][rows], fabric, rtol=0, atol=0.5e-4 + 1e-5)


@pytest.mark.parametrize(
    ("scene", "drawn"),
    [
        ("p_constant", True),
        ("lateral_constant", False),
        ("isotropic", True),
        ("unload_reload", False),
        ("axes_rotation", True),
        ("simple_shear", True),
    ],
)
def test_files_columns_and_bookkeeping_of_every_point_scene(
    granfabric: Callable, tmp_path: Path, scene: str, drawn: bool, is_drawn: Callable
) -> None:
    result = granfabric("point", scene, "-o", tmp_path, *(() if drawn else NO_PICTURES))
    assert result.code == 0, result.err
    pictures = {"microvariables.png", "fabric_decomposition.png", "stress_strain.png"} if drawn else set()
    assert {file.name for file in tmp_path.iterdir()} == {"history.csv", "run.json", "run.log", "scene.toml"} | pictures
    columns = history(tmp_path)
    assert list(columns)[: len(COLUMNS)] == COLUMNS
    np.testing.assert_array_equal(columns["step"], np.arange(len(columns["step"])))
    change = columns["coordination_gained"] - columns["coordination_lost"]
    np.testing.assert_allclose(columns["coordination"], 4.06 + change, rtol=0, atol=1e-12)
    np.testing.assert_allclose(columns["p"], -(columns["stress_xx"] + columns["stress_yy"]) / 2, rtol=1e-13)
    for name in pictures:
        assert is_drawn(tmp_path / name)
    data = record(tmp_path)
    assert (data["outcome"], data["kind"], data["name"]) == ("finished", "point", scene)
    assert data["scene"]["material"]["coordination"] == 4.06
    assert data["effects"]["contact_loss"] is True
    assert {"path", "compilation", "total"} <= set(data["timing"])
    assert "numba" in data["versions"]


def test_isotropic_loading_gains_and_unloading_loses_by_their_closed_forms(
    granfabric: Callable, tmp_path: Path
) -> None:
    assert granfabric("point", "isotropic", "-o", tmp_path, *NO_PICTURES).code == 0
    columns = history(tmp_path)
    z, p = columns["coordination"], columns["p"]
    # gain: dz = (6 - z)/z P_xi0 pi dp/(phi kn), all but linear here
    dp = 25e3
    gained = (6.0 - 4.06) / 4.06 * 3.0 * np.pi * dp / (0.846 * 1e9)
    np.testing.assert_allclose(z[25] - z[0], gained, rtol=1e-3)
    # loss: dz/z = P0 dp/p
    np.testing.assert_allclose(z[25:], z[25] * (p[25:] / p[25]) ** 0.5, rtol=2e-5)
    np.testing.assert_allclose(columns["fabric_anisotropy"], 0.0, atol=1e-12)


def _network_rates(z: float, fabric: np.ndarray, p: float, s: np.ndarray, dlnp: float, ds: np.ndarray) -> tuple:
    """Rates of z and a_c, coded once more: mean over 4000 directions, material of the shipped point scenes."""
    angle = (np.arange(4000) + 0.5) * 2 * np.pi / 4000  # twice the direction
    e = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    change = dlnp + e @ (s * dlnp + 2 * ds)  # a_n = s as c_n = 1
    weight = 1 + e @ fabric
    lost = 0.5 * weight * np.maximum(-change, 0) / (1 + e @ s)
    gained = (6 - z) / z * 3.0 * weight * np.maximum(change, 0) * np.pi * p / (z * 0.846 * 1e9)
    dz = z * (gained - lost).mean()
    return dz, 2 * ((gained - lost)[:, None] * e).mean(axis=0) - fabric * dz / z


def _follow(start: np.ndarray, ratio: Callable, rate: Callable, ends: list[float]) -> np.ndarray:
    """z and a_c at the given times of a path at constant p = 100 kPa, stress ratio vector as function of time."""

    def slope(t: float, y: np.ndarray) -> list[float]:
        dz, da = _network_rates(y[0], y[1:], 1e5, ratio(t), 0.0, rate(t))
        return [dz, *da]

    return solve_ivp(slope, (0, ends[-1]), start, method="DOP853", rtol=1e-8, atol=1e-10, t_eval=ends).y.T


def test_a_loop_at_constant_pressure_against_an_independent_integration(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("point", "unload_reload", "-o", tmp_path, *NO_PICTURES).code == 0
    columns = history(tmp_path)
    state = np.array([4.06, 0.0, 0.0])
    for row, begin, end in ((20, 0.0, 0.2), (40, 0.2, 0.0), (60, 0.0, 0.2)):
        step = np.array([begin - end, 0.0])
        state = _follow(state, lambda t: np.array([-begin, 0.0]) + t * step, lambda t: step, [1.0])[0]  # noqa: B023
        np.testing.assert_allclose(columns["coordination"][row], state[0], rtol=0, atol=5e-5)
        np.testing.assert_allclose(columns["fabric_anisotropy"][row], -state[1], rtol=0, atol=5e-5)
    np.testing.assert_allclose(state, [3.3447, -0.1225, 0.0], atol=5e-5)  # as the scene tells


def test_rotation_against_an_independent_integration(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("point", "axes_rotation", "-o", tmp_path, *NO_PICTURES).code == 0
    columns = history(tmp_path)
    turn = slice(20, None)
    np.testing.assert_allclose(columns["p"][turn], 100e3, rtol=1e-9)
    np.testing.assert_allclose(columns["q"][turn], 20e3, rtol=1e-9)
    for name, value in (("stress_xx", -80e3), ("stress_yy", -120e3)):
        np.testing.assert_allclose(columns[name][[20, -1]], value, rtol=1e-9)

    def ratio(t: float) -> np.ndarray:
        return -0.2 * np.array([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)])

    def rate(t: float) -> np.ndarray:
        return -0.4 * np.pi * np.array([-np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)])

    start = [columns[name][20] for name in ("coordination", "fabric_anisotropy_1", "fabric_anisotropy_2")]
    expected = _follow(np.array(start), ratio, rate, [0.25, 0.5, 0.75, 1.0])
    np.testing.assert_allclose(expected[:, 0], [3.4336, 3.0994, 2.7996, 2.5319], atol=2e-4)  # as the scene tells
    rows = [65, 110, 155, 200]
    # The path goes along chords of one degree, shorter than the arc by 5e-5; z changes by 1.3.
    np.testing.assert_allclose(columns["coordination"][rows], expected[:, 0], rtol=0, atol=3e-4)
    for place, name in ((1, "fabric_anisotropy_1"), (2, "fabric_anisotropy_2")):
        np.testing.assert_allclose(columns[name][rows], expected[:, place], rtol=0, atol=3e-4)


def test_simple_shear_against_an_independent_integration(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("point", "simple_shear", "-o", tmp_path, *NO_PICTURES).code == 0
    columns = history(tmp_path)
    np.testing.assert_allclose(columns["strain_xy"], np.linspace(0.0, 5e-5, 51), rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(columns["strain_xx"], 0.0, atol=1e-18)

    def slope(t: float, y: np.ndarray) -> list[float]:
        z, _, a2, p, shear = y
        scale = 2 * z * 0.846 / np.pi * 1e9 * 5e-5  # uniform-strain stiffness, kt = kn
        dp, dshear = -scale * a2 / 8, scale / 4
        ds = np.array([0.0, -(dshear / p - shear * dp / p**2)])
        dz, da = _network_rates(z, y[1:3], p, np.array([0.0, -shear / p]), dp / p, ds)
        return [dz, *da, dp, dshear]

    y = solve_ivp(slope, (0, 1), [4.06, 0, 0, 1e5, 0], method="DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    np.testing.assert_allclose(columns["coordination"][-1], y[0], rtol=2e-5)
    np.testing.assert_allclose(columns["fabric_anisotropy_2"][-1], y[2], rtol=0, atol=2e-5)
    np.testing.assert_allclose(columns["p"][-1], y[3], rtol=2e-5)
    np.testing.assert_allclose(columns["stress_xy"][-1], y[4], rtol=2e-5)
    np.testing.assert_allclose(y[[0, 2]], [3.7285, -0.1411], atol=5e-5)  # as the scene tells


def test_the_scene_as_resolved_gives_the_same_run(granfabric: Callable, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    options = ("--set", "path.0.increments=7", "--set", "closure.tangential=self_consistent", *NO_PICTURES)
    assert granfabric("point", "p_constant", "-o", first, *options).code == 0
    assert granfabric("point", first / "scene.toml", "-o", second).code == 0
    assert (first / "history.csv").read_bytes() == (second / "history.csv").read_bytes()
    assert len(history(second)["step"]) == 8


def test_plot_makes_the_pictures_again_from_the_files(
    granfabric: Callable, tmp_path: Path, pictures: dict[str, Figure]
) -> None:
    """What the run drew and what `plot` draws is the history; with another history in the folder it is that one."""
    assert granfabric("point", "p_constant", "-o", tmp_path).code == 0
    first = dict(pictures)
    assert set(first) == {"microvariables.png", "fabric_decomposition.png", "stress_strain.png"}

    def drawn() -> np.ndarray:
        return unnamed(pictures["microvariables.png"].axes[0])[0][1]

    columns = history(tmp_path)
    np.testing.assert_array_equal(drawn(), columns["coordination"])
    columns["coordination"] = columns["coordination"] * 1.01
    rows = list(zip(*(values.tolist() for values in columns.values())))
    files.write_text(tmp_path / "history.csv", files.csv_text(list(columns), rows))
    pictures.clear()
    result = granfabric("plot", tmp_path)
    assert result.code == 0 and set(pictures) == set(first)
    assert result.out.split() == [str(tmp_path / name) for name in first]
    np.testing.assert_allclose(drawn(), columns["coordination"], rtol=1e-15)


def test_pictures_have_no_date_in_them(granfabric: Callable, tmp_path: Path, is_drawn: Callable) -> None:
    """The same history gives the same bytes at another time."""
    assert granfabric("point", "p_constant", "-o", tmp_path).code == 0
    before = {file.name: file.read_bytes() for file in tmp_path.glob("*.png")}
    assert len(before) == 3 and all(is_drawn(tmp_path / name) for name in before)
    for name in before:
        (tmp_path / name).unlink()
    assert granfabric("plot", tmp_path).code == 0
    assert {file.name: file.read_bytes() for file in tmp_path.glob("*.png")} == before


def test_plot_refuses_a_folder_that_is_no_result(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("plot", tmp_path)
    assert result.code == 2 and "not a result folder" in result.err


@contextmanager
def _interrupting(after: int, times: int) -> Iterator[Callable[[float, str], None]]:
    def advance(completed: float, text: str) -> None:
        if completed == after:
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)

    yield advance


def test_interruption_leaves_what_was_computed(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_drawn: Callable
) -> None:
    monkeypatch.setattr(Screen, "progress", lambda self, what, total: _interrupting(5, 1))
    before = signal.getsignal(signal.SIGINT)
    result = granfabric("point", "p_constant", "-o", tmp_path)
    assert result.code == 1
    assert "stopping after this step" in result.out
    data = record(tmp_path)
    assert data["outcome"] == "stopped" and data["steps"] == 5
    columns = history(tmp_path)
    assert columns["step"].tolist() == [0, 1, 2, 3, 4, 5]
    assert is_drawn(tmp_path / "microvariables.png")
    assert signal.getsignal(signal.SIGINT) is before


def test_impatience_does_not_lose_the_history(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Screen, "progress", lambda self, what, total: _interrupting(5, 3))
    write = files.write_text

    def interrupted(path: Path, text: str) -> None:
        if path.name == "history.csv":
            signal.raise_signal(signal.SIGINT)
        write(path, text)

    monkeypatch.setattr(files, "write_text", interrupted)
    result = granfabric("point", "p_constant", "-o", tmp_path, *NO_PICTURES)
    assert result.code == 1
    assert record(tmp_path)["outcome"] == "stopped"
    assert history(tmp_path)["step"].tolist() == [0, 1, 2, 3, 4, 5]


ALL = ("contact_loss", "contact_gain", "principal_rotation", "stiffness_feedback")


def test_two_interruptions_before_the_first_step_is_done_end_at_once(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def update(*arguments: object) -> None:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(ContactLaw, "update_mixed", update)
    # nothing to decide, so that the first call of the law is that of the first step
    decided = [word for name in Effects.names() for word in ("--set", f"effects.{name}={str(name in ALL).lower()}")]
    result = granfabric("point", "p_constant", "-o", tmp_path, *decided)
    assert result.code == 1 and "interrupted" in result.err
    assert record(tmp_path)["outcome"] == "stopped"


def test_a_path_that_cannot_be_followed_ends_with_code_1(granfabric: Callable, tmp_path: Path) -> None:
    # Isotropic extension beyond the strain at which the pressure is gone.
    strain = ["--set", 'path=[{control=["strain","strain","strain"], target=[2e-4, 2e-4, 0.0], increments=40}]']
    result = granfabric("point", "isotropic", "-o", tmp_path, *strain)
    assert result.code == 1
    data = record(tmp_path)
    assert data["outcome"] == "failed" and data["message"]
    columns = history(tmp_path)
    assert 1 < len(columns["p"]) < 41 and (columns["p"] > 0).all()
    assert data["message"] in result.out


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("p_constnat",), ["'p_constnat' is unknown", "nearest is 'p_constant'"]),
        (("missing.toml",), ["'missing.toml' does not exist"]),
        (("p_constant", "--set", "material.cordination=4"), ["--set", "nearest is 'coordination'"]),
        (("p_constant", "--set", "material.coordination"), ["form key=value"]),
        (("biaxial",), ["kind = 'field' is not a point scene", "granfabric run"]),
        (("p_constant", "--set", "material.initial_fabric_xx=1.5"), ["initial_fabric"]),
    ],
)
def test_bad_input_gives_code_2_one_sentence_and_no_files(
    granfabric: Callable, tmp_path: Path, arguments: tuple, parts: list[str]
) -> None:
    output = tmp_path / "out"
    result = granfabric("point", *arguments, "-o", output)
    assert result.code == 2
    assert result.err.startswith("granfabric: ") and result.err.count("\n") == 1
    for part in parts:
        assert part in result.err
    assert not output.exists()


def test_an_unwritable_output_gives_code_2(granfabric: Callable, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for output in (tmp_path / "file", tmp_path / "file" / "inside"):
        result = granfabric("point", "p_constant", "-o", output)
        assert result.code == 2 and "is a file" in result.err
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    result = granfabric("point", "p_constant", "-o", tmp_path / "full")
    assert result.code == 2 and "not a result of granfabric" in result.err
    assert [file.name for file in (tmp_path / "full").iterdir()] == ["thesis.txt"]

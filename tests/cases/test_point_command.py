"""`granfabric point`: published numbers, closed forms, files, interruption."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from cases import files
from cases.screen import Screen

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
    "scene", ["p_constant", "lateral_constant", "isotropic", "unload_reload", "axes_rotation", "simple_shear"]
)
def test_files_columns_and_bookkeeping_of_every_point_scene(
    granfabric: Callable, tmp_path: Path, scene: str, is_drawn: Callable
) -> None:
    result = granfabric("point", scene, "-o", tmp_path)
    assert result.code == 0, result.err
    names = {"history.csv", "run.json", "scene.toml", "microvariables.png", "fabric_decomposition.png"}
    assert {file.name for file in tmp_path.iterdir()} == names
    columns = history(tmp_path)
    assert list(columns)[: len(COLUMNS)] == COLUMNS
    np.testing.assert_array_equal(columns["step"], np.arange(len(columns["step"])))
    change = columns["coordination_gained"] - columns["coordination_lost"]
    np.testing.assert_allclose(columns["coordination"], 4.06 + change, rtol=0, atol=1e-12)
    np.testing.assert_allclose(columns["p"], -(columns["stress_xx"] + columns["stress_yy"]) / 2, rtol=1e-13)
    for name in ("microvariables.png", "fabric_decomposition.png"):
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


def test_rotation_brings_the_stress_back_and_loses_contacts_steadily(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("point", "axes_rotation", "-o", tmp_path, *NO_PICTURES).code == 0
    columns = history(tmp_path)
    turn = slice(20, None)
    np.testing.assert_allclose(columns["p"][turn], 100e3, rtol=1e-9)
    np.testing.assert_allclose(columns["q"][turn], 20e3, rtol=1e-9)
    for name, value in (("stress_xx", -80e3), ("stress_yy", -120e3)):
        np.testing.assert_allclose(columns[name][[20, -1]], value, rtol=1e-9)
    assert (np.diff(columns["coordination"][turn]) < 0).all()


def test_simple_shear_prescribes_strain(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("point", "simple_shear", "-o", tmp_path, *NO_PICTURES).code == 0
    columns = history(tmp_path)
    np.testing.assert_allclose(columns["strain_xy"], np.linspace(0.0, 5e-5, 51), rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(columns["strain_xx"], 0.0, atol=1e-18)
    # At the start the shear modulus is z phi (kn + kt)/(4 pi) [uniform strain].
    modulus = 4.06 * 0.846 * 2e9 / (4 * np.pi)
    np.testing.assert_allclose(columns["stress_xy"][1], modulus * 1e-6, rtol=1e-2)


def test_the_scene_as_resolved_gives_the_same_run(granfabric: Callable, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    options = ("--set", "path.0.increments=7", "--set", "closure.tangential=self_consistent", *NO_PICTURES)
    assert granfabric("point", "p_constant", "-o", first, *options).code == 0
    assert granfabric("point", first / "scene.toml", "-o", second).code == 0
    assert (first / "history.csv").read_bytes() == (second / "history.csv").read_bytes()
    assert len(history(second)["step"]) == 8


def test_plot_makes_the_pictures_again_and_bit_identically(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("point", "p_constant", "-o", tmp_path).code == 0
    before = {file.name: file.read_bytes() for file in tmp_path.glob("*.png")}
    for name in before:
        (tmp_path / name).unlink()
    result = granfabric("plot", tmp_path)
    assert result.code == 0
    assert {file.name: file.read_bytes() for file in tmp_path.glob("*.png")} == before
    assert all(name in result.out for name in before)


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
    result = granfabric("point", "p_constant", "-o", tmp_path)
    assert result.code == 1
    assert "stopping after this step" in result.out
    data = record(tmp_path)
    assert data["outcome"] == "stopped" and data["steps"] == 5
    columns = history(tmp_path)
    assert columns["step"].tolist() == [0, 1, 2, 3, 4, 5]
    assert is_drawn(tmp_path / "microvariables.png")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_interruption_ends_at_once(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Screen, "progress", lambda self, what, total: _interrupting(5, 2))
    result = granfabric("point", "p_constant", "-o", tmp_path)
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

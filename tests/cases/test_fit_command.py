"""`granfabric fit` and `granfabric verify --data`: files, words, codes, damaged input, Ctrl-C."""

from __future__ import annotations

import json
import signal
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fit_curves import COMPRESSION, CONSTANT_P, CYCLE, KNOWN, LATERAL, columns, noisy, written
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from mutations import one_sentence

from granfabric.cases.fit import deviations, solving
from granfabric.cases.fit.report import ROW_COLUMNS, numbers
from granfabric.cases.records import files

NOISE = {"coordination": 0.01, "fabric_anisotropy": 0.004}
NAMES = ("p", "stress_ratio", "coordination", "fabric_anisotropy")
SET = [part for text in KNOWN for part in ("--set", text)]
FAST = settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two noisy curves of the source's closure."""
    folder = tmp_path_factory.mktemp("curves")
    return [
        written(folder / f"{name}.csv", noisy(columns(legs), seed, **NOISE), *NAMES)
        for seed, (name, legs) in enumerate([("constant_p", CYCLE), ("lateral", LATERAL)])
    ]


def test_files_and_words_of_a_fit(
    granfabric: Callable, told: Any, two: list[Path], tmp_path: Path, is_drawn: Callable
) -> None:
    out = tmp_path / "out"
    result = granfabric("fit", *two, "-o", out, *SET)
    assert result.code == 0, result.err
    assert {file.name for file in out.iterdir()} == {"fit.csv", "fit.png", "material.toml", "run.json", "run.log"}
    assert is_drawn(out / "fit.png")
    record = json.loads((out / "run.json").read_text())
    assert (record["kind"], record["outcome"]) == ("fit", "finished")
    parameters = record["parameters"]
    free = {name: entry for name, entry in parameters.items() if entry["free"]}
    assert {"coordination", "force_density_at_zero"} <= set(free)
    for name, truth in (("coordination", 4.06), ("force_density_at_zero", 0.62)):
        assert abs(free[name]["value"] - truth) < 4.0 * free[name]["standard_error"] < 0.05 * truth
        assert free[name]["sources"]["coordination"] > 0.1 and free[name]["told_by"]
    assert parameters["force_anisotropy_ratio"] == {"value": 0.93, "free": False, "from": "set"}
    matrix = np.array(record["correlation"]["matrix"])
    assert set(record["correlation"]["names"]) == set(free)
    assert np.allclose(matrix, matrix.T) and (abs(matrix) <= 1.0).all()
    table = files.read_csv(out / "fit.csv")
    assert tuple(table) == ROW_COLUMNS and set(table["curve"]) == {"constant_p.csv", "lateral.csv"}
    assert len(table["data"]) == 2 * (26 + 16)
    np.testing.assert_allclose(np.subtract(table["law"], table["data"]), table["residual"], atol=1e-15)
    np.testing.assert_allclose(np.divide(table["residual"], table["scale"]), table["deviation"], atol=1e-12)
    assert np.std(np.array(table["residual"])[np.array(table["quantity"]) == "coordination"]) < 0.02
    shown = told.tables[0]
    assert shown.names == ["parameter", "value", "standard error", "began at", "determined by"]
    assert set(shown.column("parameter")) == set(free) and all("%" in cell for cell in shown.column("determined by"))
    assert shown.column("parameter")[0] == "coordination"
    assert float(shown.column("value")[0]) == pytest.approx(free["coordination"]["value"], abs=1e-3)
    assert told.tables[1].names[:4] == ["quantity", "curve", "values", "largest"]


def test_the_material_file_is_read_by_scenes(granfabric: Callable, two: list[Path], tmp_path: Path) -> None:
    """A point scene with it follows the curve as the fit did."""
    out = tmp_path / "out"
    assert granfabric("fit", two[0], "-o", out, *SET, "--free", "z,P0").code == 0
    text = (out / "material.toml").read_text()
    assert "coordination = " in text and "# +- " in text and "# held, by --set [Pa]" in text
    assert "peak_stress_ratio" not in text  # a scene would take it for a wish to slide
    tables = tomllib.loads(text)
    assert tables["closure"]["force_change"] == "mean_field" and tables["material"]["force_anisotropy_ratio"] == 0.93
    point = tmp_path / "point"
    result = granfabric(
        "point", "p_constant", "--set", f"material_file={out / 'material.toml'}", "-o", point,
        "--set", "path.0.increments=15", "--set", "output.pictures=false",
    )  # fmt: skip
    assert result.code == 0, result.err
    history, table = files.read_csv(point / "history.csv"), files.read_csv(out / "fit.csv")
    law = [value for value, name in zip(table["law"], table["quantity"]) if name == "coordination"]
    # different increments and a looser tolerance, on the same path to q/p = 0.3
    assert history["coordination"][-1] == pytest.approx(law[15], abs=2e-5)


def test_a_law_is_compared_with_a_curve(
    granfabric: Callable, told: Any, two: list[Path], tmp_path: Path, is_drawn: Callable
) -> None:
    out = tmp_path / "out"
    own = written(tmp_path / "exact.csv", columns(CYCLE), *NAMES)
    settings_ = ["--set", "material.coordination=4.06", "--set", "material.force_density_at_zero=0.62", *SET]
    result = granfabric("verify", "--data", own, "-o", out, *settings_)
    assert result.code == 0, result.err
    assert {file.name for file in out.iterdir()} == {"data.csv", "data.png", "run.json", "run.log"}
    assert is_drawn(out / "data.png")
    assert max(abs(float(cell)) for cell in told.tables[-1].column("largest")) < 1e-12
    result = granfabric("verify", "--data", two[0], "--data", two[1], "-o", out, "--overwrite",
                        "--set", "material_file=dense_disks")  # fmt: skip
    assert result.code == 0, result.err
    shown = told.tables[-1]
    assert shown.column("curve") == ["constant_p.csv"] * 2 + ["lateral.csv"] * 2
    table = files.read_csv(out / "data.csv")
    here = [abs(value) for value, curve, name in zip(table["residual"], table["curve"], table["quantity"])
            if (curve, name) == ("lateral.csv", "coordination")]  # fmt: skip
    place = shown.column("curve").index("lateral.csv")
    assert abs(float(shown.column("largest")[place])) == pytest.approx(max(here), rel=1e-3)
    assert float(shown.column("rms")[place]) == pytest.approx(np.sqrt(np.mean(np.square(here))), rel=1e-3)
    assert int(shown.column("in line")[place]) == 2 + int(np.argmax(here))


def test_a_curve_that_the_law_does_not_follow(granfabric: Callable, tmp_path: Path) -> None:
    """A pressure that nearly vanishes: what was reached is written, the line is told, the code is 1."""
    file = tmp_path / "c.csv"
    file.write_text("p,q,z\n1e5,0,4.0\n9e4,0,3.9\n8e4,0,3.8\n1e-300,0,3\n")
    more = ["--set", "material.force_density_at_zero=1.0", "--set", "material.coordination=4"]
    result = granfabric("verify", "--data", file, "-o", tmp_path / "out", *SET, *more)
    assert result.code == 1
    assert f"{file}: the law does not get to line 5: " in result.out
    table = files.read_csv(tmp_path / "out" / "data.csv")
    assert np.isfinite(table["law"][:3]).all() and np.isnan(table["law"][3])
    assert json.loads((tmp_path / "out" / "run.json").read_text())["outcome"] == "failed"
    assert granfabric("plot", tmp_path / "out").code == 0


def test_pictures_are_drawn_again_and_damage_is_told(granfabric: Callable, two: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert granfabric("fit", two[0], "-o", out, *SET, "--free", "z,P0").code == 0
    before = (out / "fit.png").read_bytes()
    (out / "fit.png").unlink()
    assert granfabric("plot", out).out.strip() == str(out / "fit.png") and (out / "fit.png").read_bytes() == before
    whole = (out / "fit.csv").read_text()
    for text, words in (
        (whole.replace("deviation", "x"), "no column 'deviation'"), (whole.split("\n")[0], "nothing in it"),
        (whole.replace("coordination,4", "coordination,x", 1), "something that is not a number"),
    ):  # fmt: skip
        (out / "fit.csv").write_text(text)
        result = granfabric("plot", out)
        assert result.code == 2 and words in result.err and one_sentence(result.err)
    (out / "fit.csv").unlink()
    assert "holds no fit.csv" in granfabric("plot", out).err


def test_the_picture_shows_data_law_and_deviations(
    granfabric: Callable, pictures: Any, two: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert granfabric("fit", *two, "-o", out, *SET, "--free", "z,P0").code == 0
    figure = pictures["fit.png"]
    table = files.read_csv(out / "fit.csv")
    assert [axes.get_ylabel() for axes in figure.axes[::2]] == ["$z$ [-]", "$a_c$ [-]"]
    for place, quantity in enumerate(("coordination", "fabric_anisotropy")):
        upper, lower = figure.axes[2 * place : 2 * place + 2]
        assert lower.get_xlabel() == "$q/p$ [-]"
        for number, curve in enumerate(("constant_p.csv", "lateral.csv")):
            rows = [n for n, name in enumerate(table["quantity"]) if (name, table["curve"][n]) == (quantity, curve)]
            law, data, left = upper.lines[2 * number], upper.lines[2 * number + 1], lower.lines[number]
            for line, column in ((law, "law"), (data, "data"), (left, "deviation")):
                np.testing.assert_array_equal(line.get_ydata(), [table[column][n] for n in rows])
                np.testing.assert_array_equal(line.get_xdata(), [table["stress_ratio"][n] for n in rows])


def test_an_isotropic_path_is_drawn_over_p(granfabric: Callable, pictures: Any, tmp_path: Path) -> None:
    file = written(tmp_path / "c.csv", columns(COMPRESSION), "p", "q", "coordination")
    more = ["--set", "material.coordination=4.06"]
    assert granfabric("verify", "--data", file, "-o", tmp_path / "out", *SET, *more).code == 0
    lower = pictures["data.png"].axes[1]
    assert lower.get_xlabel() == "$p$ [kPa]" and lower.lines[0].get_xdata()[-1] == pytest.approx(200.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--free", "shear_reduction"], "shear_reduction cannot be identified"),
        (["--free", "P"], "the parameter 'P' is unknown"),
        (["--material-file", "dense_disk"], "the nearest is 'dense_disks'"),
        (["--material-file", "dense_disks", "--set", "material_file=dense_disks"], "give it once"),
        (["--set", "material_file=3"], "3 is not the name of a material file"),
        (["--set", "path.0.increments=3"], "the key 'path' is unknown (legal: material_file, material,"),
        (["--set", "material.cordination=4"], "the nearest is 'coordination'"),
        (["--set", "material.coordination=9"], "material.coordination = 9 is outside its bounds [0.001, 6]"),
        (["--set", "material=3"], "3 is not a table"),
        (["--set", "control=both"], "'both' is neither of 'stress', 'strain' nor three of them"),
        (["--set", "start=rows"], "the nearest is 'row'"),
        (["--set", "scale.zz=1"], "the nearest is 'z'"),
        (["--set", "scale.z=0"], "coordination = 0 is outside [1e-12, 1e+12]"),
        (["--set", "scale=2"], "is not a table"),
        (["--set", "effects.sliding=true"], "needs material.peak_stress_ratio"),
        (["--set", "closure.force_change=auto"], "a fit needs one of them by name"),
        (["--set", "nonsense"], "is not of the form key=value"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_nothing_is_written(
    granfabric: Callable, two: list[Path], tmp_path: Path, arguments: list[str], words: str
) -> None:
    result = granfabric("fit", two[0], "-o", tmp_path / "out", *SET, *arguments)
    assert result.code == 2 and words in result.err and one_sentence(result.err), result.err
    assert not (tmp_path / "out").exists()


def test_what_no_curve_tells_is_asked_for(granfabric: Callable, tmp_path: Path) -> None:
    table = columns(CONSTANT_P)
    file = written(tmp_path / "c.csv", table, "p", "q", "fabric_anisotropy")
    result = granfabric("fit", file, "-o", tmp_path / "out")
    assert result.code == 2 and len(result.err.splitlines()) == 3
    for name in ("coordination", "normal_stiffness", "solid_fraction"):
        assert f"material.{name} is not given, and no" in result.err


def test_a_bound_of_the_material_file_names_it(granfabric: Callable, two: list[Path], tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text("[material]\nsolid_fraction = 8.4\nnormal_stiffness = 1e9\n")
    result = granfabric("fit", two[0], "--material-file", file, "-o", tmp_path / "out")
    assert result.code == 2 and f"{file}: material.solid_fraction = 8.4 is outside its bounds" in result.err


def test_folders_are_kept_from_others(granfabric: Callable, two: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = [*SET, "--free", "z,P0"]
    assert granfabric("fit", two[0], "-o", out, *arguments).code == 0
    assert granfabric("fit", two[0], "-o", out, *arguments).code == 0
    result = granfabric("fit", two[1], "-o", out, *arguments)
    assert result.code == 2 and "of another scene, fit 'constant_p'" in result.err and "--overwrite" in result.err
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    assert granfabric("fit", two[0], "-o", tmp_path / "full", *arguments).code == 2


def test_nothing_of_a_fit_stays_when_its_folder_is_used_again(
    granfabric: Callable, two: list[Path], tmp_path: Path
) -> None:
    out, more = tmp_path / "out", ["--set", "material.coordination=4.06"]
    for command in (["fit", two[0], "--free", "z,P0"], ["verify", "--data", two[0], *more]):
        assert granfabric(*command, "-o", out, *SET, "--overwrite").code == 0
        (out / "notes.txt").write_text("mine")
        files.prepare_output(out, overwrite=True)
        assert [file.name for file in out.iterdir()] == ["notes.txt"]
        (out / "notes.txt").unlink()


def test_the_same_input_gives_the_same_files(granfabric: Callable, two: list[Path], tmp_path: Path) -> None:
    for name in ("one", "other"):
        assert granfabric("fit", *two, "-o", tmp_path / name, *SET, "-q").code == 0
    for name in ("fit.csv", "material.toml", "fit.png"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()


@pytest.mark.parametrize("after", [9, 0])
def test_ctrl_c_keeps_the_best_so_far(
    granfabric: Callable, two: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    own, done = deviations.Deviations.of, 0

    def interrupted(self: Any, values: Any) -> Any:
        nonlocal done
        done += 1
        if done == after + 1:
            signal.raise_signal(signal.SIGINT)
        return own(self, values)

    monkeypatch.setattr(deviations.Deviations, "of", interrupted)
    result = granfabric("fit", two[0], "-o", tmp_path / "out", *SET, "--free", "z,P0")
    assert result.code == 1 and "Traceback" not in result.err
    if after == 0:
        assert "nothing was written" in result.err and not (tmp_path / "out").exists()
        return
    assert "stopped after" in result.out and "best so far" in result.out
    assert json.loads((tmp_path / "out" / "run.json").read_text())["outcome"] == "stopped"
    text = (tmp_path / "out" / "material.toml").read_text()
    assert "# stopped after" in text and tomllib.loads(text)["material"]["coordination"] > 3.0


def test_what_does_not_converge_ends_with_code_1(
    granfabric: Callable, two: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(solving, "MOST_STEPS", 2)
    result = granfabric("fit", two[0], "-o", tmp_path / "out", *SET, "--free", "z,P0")
    assert result.code == 1 and "failed: not converged within 2 trials" in result.out
    assert (tmp_path / "out" / "material.toml").is_file()


GOOD = b"p [kPa],q/p,z,a_c,z_error\n100,0.0,4.06,0.0,0.01\n100,0.1,3.93,0.05,0.01\n100,0.2,3.80,0.11,0.01\n"
PIECES = [b"", b",", b"\n", b"nan", b"1e999", b"-1", b"0", b"\x00", b"\xff\xfe", b'"', b";", b"\t", b"#", b"_", b"[",
          b"kPa]", b"z", b"-100", b"1e300", b"1e-300", b"\r", "é".encode(), b"9" * 400]  # fmt: skip


@FAST
@given(
    st.lists(
        st.tuples(st.integers(0, len(GOOD) - 1), st.integers(0, 12), st.sampled_from(PIECES)), min_size=1, max_size=4
    )
)
@example([(0, len(GOOD), b"")])
@example([(26, 3, b"1e300")])
@example([(26, 3, b"1e-300")])
@example([(34, 4, b"1e300")])
def test_damaged_curves_end_in_a_sentence(granfabric: Callable, tmp_path: Path, damage: list) -> None:
    """Whatever a bad editor does: a result, or one sentence, code 2 and nothing written; never a traceback."""
    data = GOOD
    for place, length, piece in damage:
        data = data[:place] + piece + data[place + length :]
    file, out = tmp_path / "c.csv", tmp_path / "out"
    file.write_bytes(data)
    for name in list(out.iterdir()) if out.exists() else []:
        name.unlink()
    if out.exists():
        out.rmdir()
    more = ["--set", "material.coordination=4", "--set", "initial.stress=[-1e5, -1e5, 0.0]", "-q"]
    result = granfabric("verify", "--data", file, "-o", out, *SET, *more)
    assert result.code in (0, 1, 2)
    if result.code == 2:
        assert one_sentence(result.err), result.err
        assert not out.exists()
    else:
        assert (out / "data.csv").is_file()


@pytest.mark.parametrize("option", [("--paths", "loop"), ("--particles", "300"), ("--quick",)])
def test_options_of_the_dem_do_not_go_with_curves(granfabric: Callable, tmp_path: Path, option: tuple) -> None:
    (tmp_path / "a.csv").write_text("q/p,coordination\n0,4\n0.1,3.9\n")
    result = granfabric("verify", "--data", tmp_path / "a.csv", *option, "-o", tmp_path / "out")
    assert result.code == 2 and f"{option[0]} is of comparisons with the DEM" in result.err
    assert not (tmp_path / "out").exists()


def test_keys_of_the_law_are_none_of_a_packing(granfabric: Callable, tmp_path: Path) -> None:
    result = granfabric("verify", "--set", "material_file=dense_disks", "-o", tmp_path / "out")
    assert result.code == 2 and "material_file" in result.err and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (0.61638, 0.0053, ("0.6164", "0.0053")), (1e9, 1.23e6, ("1.00000e+09", "1.2e+06")),
        (4.0, float("nan"), ("4", "-")), (4.06, 0.0, ("4.06", "0")), (0.001, 0.1, ("0.001", "0.10")),
    ],
)  # fmt: skip
def test_digits_that_mean_something(value: float, error: float, shown: tuple[str, str]) -> None:
    found = numbers(value, error)
    assert float(found[0]) == pytest.approx(float(shown[0]), rel=1e-12) and found[1] == shown[1]

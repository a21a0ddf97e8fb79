"""`granfabric verify`: arithmetic of the table on made-up data, the model against published numbers, files, reuse."""

from __future__ import annotations

import json
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.commands import verify
from granfabric.cases.engine.choice import Choice
from granfabric.cases.records import files
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify.dem_side import LOADINGS, DemStore
from granfabric.cases.verify.model_side import SOURCE, closures, follow
from granfabric.cases.verify.paths import PATH_COLUMNS, PATHS, positions, sampled
from granfabric.cases.verify.table import COLUMNS, QUANTITIES, TABLE_LEVELS, compare, largest_errors
from granfabric.cases.verify.text import table

LEVELS = np.linspace(0.0, 0.3, 7)
PARTICLES = 200


def synthetic(values: list[list[float]]) -> dict[str, np.ndarray]:
    return {quantity: np.array(values) for quantity in QUANTITIES}


def test_errors_and_scatter_of_a_made_up_history() -> None:
    """DEM: two packings, 4 - eta and 4.2 - eta; model too high by 0.1 and 0.3."""
    dem = synthetic([list(4.0 - LEVELS), list(4.2 - LEVELS)])
    model = synthetic([list(4.1 - LEVELS), list(4.5 - LEVELS)])
    rows = compare("constant_pressure", "some", dem, model, LEVELS)
    assert len(rows) == len(QUANTITIES) * len(TABLE_LEVELS)
    row = next(row for row in rows if row.quantity == "fabric_anisotropy" and row.stress_ratio == 0.2)
    assert row.packings == 2
    assert row.dem == pytest.approx(3.9, abs=1e-12) and row.model == pytest.approx(4.1, abs=1e-12)
    assert row.error == pytest.approx(0.2, abs=1e-12)
    # standard deviation of two values is their distance over sqrt(2)
    assert row.dem_scatter == pytest.approx(0.2 / np.sqrt(2), abs=1e-12)
    assert row.error_scatter == pytest.approx(0.2 / np.sqrt(2), abs=1e-12)
    assert row.error_over_scatter == pytest.approx(np.sqrt(2), abs=1e-10)
    assert dict(zip(COLUMNS, row.row()))["error_over_scatter"] == row.error_over_scatter


def test_packings_and_curves_that_end_early_are_left_out() -> None:
    short = np.where(LEVELS > 0.22, np.nan, 4.0 - LEVELS)
    dem, model = synthetic([list(4.0 - LEVELS), list(short)]), synthetic([list(4.0 - LEVELS)] * 2)
    by_ratio = {row.stress_ratio: row for row in compare("x", "y", dem, model, LEVELS)}
    assert by_ratio[0.2].packings == 2 and by_ratio[0.25].packings == 1
    assert np.isnan(by_ratio[0.25].dem_scatter) and np.isnan(by_ratio[0.25].error_over_scatter)
    nothing = compare("x", "y", synthetic([list(short)]), model := synthetic([list(4.0 - LEVELS)]), LEVELS, [0.3])
    assert nothing[0].packings == 0 and np.isnan(nothing[0].error)
    assert not largest_errors(nothing)
    with pytest.raises(ValueError, match=r"q/p = 0\.123 is not among the levels"):
        compare("x", "y", model, model, LEVELS, [0.123])


def test_the_largest_error_counts_by_size() -> None:
    error = np.array([0.0, 0.1, -0.3, 0.2, 0.0, 0.0, 0.0])
    rows = compare("x", "y", synthetic([[4.0] * 7]), synthetic([list(4.0 + error)]), LEVELS)
    worst = largest_errors(rows)["x", "y", "coordination"]
    assert worst.stress_ratio == 0.1 and worst.error == pytest.approx(-0.3)


def test_a_markdown_table_has_its_alignment_row() -> None:
    assert table(["a", "b"], [["1", "2"]]) == "| a | b |\n|---|---:|\n| 1 | 2 |"


# Two independent implementations agree on these digits; P0 0.5, c_n 1: z and a_c at q/p = 0.1, 0.2, 0.3.
REFERENCE = {
    "constant_pressure": ([3.9303, 3.7995, 3.6674], [0.0520, 0.1081, 0.1692]),
    "constant_lateral_stress": ([4.0150, 3.9683, 3.9195], [0.0202, 0.0419, 0.0653]),
}


@pytest.mark.parametrize("loading", LOADINGS)
def test_the_source_closure_gives_its_reference_values(loading: str) -> None:
    inputs = {
        **{"coordination": 4.06, "solid_fraction": 0.846, "normal_stiffness": 1e9, "force_density_at_zero": 0.5},
        **{"gap_density_at_zero": 3.0, "force_anisotropy_ratio": 1.0},
    }
    curve = follow(closures(inputs)[SOURCE], inputs, loading, 1e5, np.linspace(0.0, 0.3, 31))
    assert not curve.message
    # rounded to four decimals; the tolerance of the integration is 1e-6
    coordination, fabric = REFERENCE[loading]
    np.testing.assert_allclose(curve.columns["coordination"][10::10], coordination, rtol=0, atol=0.5e-4 + 1e-5)
    np.testing.assert_allclose(curve.columns["fabric_anisotropy"][10::10], fabric, rtol=0, atol=0.5e-4 + 1e-5)


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a comparison on two small packings."""
    folder = tmp_path_factory.mktemp("verify")
    assert verify.run_verify(folder, PARTICLES, 2, Screen()).outcome == "finished"
    return folder


def test_files_of_a_comparison(compared: Path, is_drawn: Callable) -> None:
    figures = {f"figure_{number}.png" for number in range(1, 7)}
    assert {file.name for file in compared.iterdir()} == figures | {
        *("verify.csv", "verify.md", "run.json", "run.log", "material.toml", "dem"),
        *("paths.csv", "probes.csv", "closures.csv"),
    }
    assert all(is_drawn(compared / name) for name in figures)
    told = json.loads((compared / "run.json").read_text())
    assert told["kind"] == "verify" and told["dem_computed_now"] == [1, 2]
    assert set(told["seconds"]) == {"packing", "measuring", "probes", *LOADINGS, *PATHS, "model"}
    columns = files.read_csv(compared / "verify.csv")
    assert tuple(columns) == COLUMNS
    names = set(columns["closure"])
    assert SOURCE in names and len(names) >= 2
    assert len(columns["closure"]) == len(LOADINGS) * len(names) * len(QUANTITIES) * len(TABLE_LEVELS)
    text = (compared / "verify.md").read_text()
    assert all(name in text for name in names) and all(f"({figure})" in text for figure in figures)


def test_packings_side_by_side_give_the_same_numbers(
    compared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("granfabric.cases.verify.pictures.draw_verify", lambda folder, study: [])
    record = verify.run_verify(tmp_path / "out", PARTICLES, 2, Screen(), choice=Choice(workers=2))
    assert record.outcome == "finished" and record.details["dem_computed_now"] == [1, 2]
    for name in ("verify.csv", "paths.csv", "probes.csv", "material.toml"):
        assert (tmp_path / "out" / name).read_bytes() == (compared / name).read_bytes(), name
    again = verify.run_verify(tmp_path / "out", PARTICLES, 2, Screen(), choice=Choice(workers=2))
    assert again.details["dem_computed_now"] == []


def test_nothing_of_a_comparison_stays_beside_what_replaces_it(compared: Path, tmp_path: Path) -> None:
    """But the runs of the DEM, which the next comparison uses again."""
    shutil.copytree(compared, tmp_path / "copy")
    files.prepare_output(tmp_path / "copy", overwrite=True)
    assert [file.name for file in (tmp_path / "copy").iterdir()] == ["dem"]


def test_paths_probes_and_closures_of_a_comparison(compared: Path) -> None:
    """Every closure on every path; a stored history read again gives the same number at the end of a segment."""
    columns = files.read_csv(compared / "paths.csv")
    assert tuple(columns) == PATH_COLUMNS and set(columns["path"]) == set(PATHS)
    closures_told = files.read_csv(compared / "closures.csv")
    assert set(closures_told["closure"]) == set(columns["closure"])
    assert min(closures_told["microseconds_per_update"]) > 0.0
    end = {
        closure: model
        for path, closure, quantity, segment, fraction, model in zip(
            *(columns[name] for name in ("path", "closure", "quantity", "segment", "fraction", "model"))
        )
        if (path, quantity, segment, fraction) == ("cycles", "coordination", 4, 1.0)
    }
    # after two cycles the source's rates, which lose on unloading too, are far below
    assert end[SOURCE] < end["shifted_distribution, frictional"] - 0.3
    found = []
    for file in sorted((compared / "dem").glob("*_cycles.csv")):
        history = {name: np.array(values) for name, values in files.read_csv(file).items()}
        places, segments = positions(history)
        assert set(segments) == {1, 2, 3, 4, 5}
        found.append(sampled(history, places)["coordination"][np.flatnonzero(segments == 2)[-1]])
    told = [
        dem
        for path, quantity, segment, fraction, dem in zip(
            columns["path"], columns["quantity"], columns["segment"], columns["fraction"], columns["dem"]
        )
        if (path, quantity, segment, fraction) == ("cycles", "coordination", 2, 1.0)
    ]
    np.testing.assert_allclose(told, np.mean(found), rtol=1e-12)
    probes = files.read_csv(compared / "probes.csv")
    down = [dz for probe, dz in zip(probes["probe"], probes["coordination_change"]) if probe == "dp = -0.1 p"]
    assert max(down) < 0.0


def test_the_table_tells_what_the_dem_histories_say(compared: Path) -> None:
    """Mean over the stored histories, interpolated where q/p first passes 0.2."""
    columns = files.read_csv(compared / "verify.csv")
    rows = list(zip(columns["loading"], columns["quantity"], columns["stress_ratio"], columns["dem"]))
    for loading in LOADINGS:
        found = []
        for file in sorted((compared / "dem").glob(f"*_{loading}.csv")):
            stored = {name: np.array(values) for name, values in files.read_csv(file).items()}
            ratio = stored["q"] / stored["p"]
            passed = int(np.argmax(ratio >= 0.2))
            found.append(
                np.interp(0.2, ratio[passed - 1 : passed + 1], stored["coordination"][passed - 1 : passed + 1])
            )
        assert len(found) == 2
        told = [dem for one, quantity, at, dem in rows if (one, quantity, at) == (loading, "coordination", 0.2)]
        np.testing.assert_allclose(told, np.mean(found), rtol=1e-12)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the figures."""
    monkeypatch.setattr("granfabric.cases.verify.pictures.draw_verify", lambda folder, study: [])


@pytest.mark.usefixtures("undrawn")
def test_dem_runs_are_used_again(compared: Path, granfabric: Callable, tmp_path: Path) -> None:
    again = tmp_path / "again"
    shutil.copytree(compared, again)
    stamps = {file: file.stat().st_mtime_ns for file in (again / "dem").iterdir()}
    result = granfabric("verify", "-o", again, "--particles", PARTICLES, "--seeds", 2)
    assert result.code == 0 and "0 computed, 2 read" in result.out
    assert (again / "verify.csv").read_bytes() == (compared / "verify.csv").read_bytes()
    assert {file: file.stat().st_mtime_ns for file in (again / "dem").iterdir()} == stamps


def test_other_input_is_not_taken_for_the_same(tmp_path: Path) -> None:
    assert DemStore(tmp_path, 200).path(1, "x") != DemStore(tmp_path, 201).path(1, "x")


@pytest.mark.usefixtures("undrawn")
def test_an_interrupted_comparison_goes_on_to_the_same_numbers(
    compared: Path, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = verify.DemStore._run

    def interrupted(store: DemStore, *arguments: object) -> object:
        signal.raise_signal(signal.SIGINT)
        return measured(store, *arguments)  # type: ignore[arg-type]

    arguments = ("verify", "-o", tmp_path, "--particles", PARTICLES, "--seeds", 1)
    with monkeypatch.context() as patch:
        patch.setattr(DemStore, "_run", interrupted)
        result = granfabric(*arguments)
    assert result.code == 1 and "goes on from here" in result.out
    assert not (tmp_path / "verify.csv").exists()
    assert json.loads((tmp_path / "run.json").read_text())["outcome"] == "stopped"
    assert granfabric(*arguments).code == 0
    for loading in LOADINGS:
        name = next((tmp_path / "dem").glob(f"*_{loading}.csv")).name
        assert (tmp_path / "dem" / name).read_bytes() == (compared / "dem" / name).read_bytes()


@pytest.mark.parametrize("arguments", [("--particles", 10), ("--seeds", 0), ("--particles", "many")])
def test_bad_numbers_are_refused(granfabric: Callable, tmp_path: Path, arguments: tuple) -> None:
    result = granfabric("verify", "-o", tmp_path / "out", *arguments)
    assert result.code == 2 and str(arguments[0]) in result.err
    assert not (tmp_path / "out").exists()


def test_plot_says_how_to_draw_a_comparison(compared: Path, granfabric: Callable) -> None:
    result = granfabric("plot", compared)
    assert result.code == 2 and "granfabric verify -o" in result.err


def _both_sides(path: Path, *keys: str) -> dict[tuple, tuple[float, float]]:
    """DEM and model of a table, by the named columns."""
    rows = files.read_csv(path)
    return {tuple(key): (dem, model) for *key, dem, model in zip(*(rows[name] for name in (*keys, "dem", "model")))}


def test_model_and_grains_move_the_same_way(compared: Path) -> None:
    """Loading, unloading to the other side, a turn and probes: on 200 disks at least the signs and sizes agree."""
    best = "shifted_distribution, frictional"
    at = _both_sides(compared / "verify.csv", "loading", "closure", "quantity", "stress_ratio")
    sizes = {"fabric_anisotropy": 0.1, "normal_force_anisotropy": 0.2, "tangential_force_anisotropy": 0.15}
    for loading in LOADINGS:
        for quantity, size in sizes.items():
            dem, model = at[loading, best, quantity, 0.25]
            assert dem > 0 and model > 0 and abs(dem - model) < size, (loading, quantity)
    found = _both_sides(compared / "paths.csv", "path", "closure", "quantity", "segment", "fraction")
    for quantity in ("fabric_along", "normal_along", "tangential_along"):
        for segment, sign in ((1, 1.0), (3, 1.0), (5, -1.0)):
            dem, model = found["cycles", best, quantity, segment, 1.0]
            assert sign * dem > 0 and sign * model > 0, (quantity, segment)
        dem, model = found["rotation", best, quantity, 5, 1.0]
        assert dem > 0 and model > 0, quantity
    # the fabric lags behind the axes that turn
    dem, model = found["rotation", best, "fabric_across", 3, 1.0]
    assert dem < 0 and model < 0
    rows = files.read_csv(compared / "probes.csv")
    names = ("probe", "side", "coordination_change", "fabric_change")
    probes = {(probe, side): (dz, da) for probe, side, dz, da in zip(*(rows[name] for name in names))}
    for probe in ("dq = 0.1 p", "dp = -0.1 p, dq = 0.1 p"):
        for side in ("DEM", best, SOURCE):
            dz, da = probes[probe, side]
            assert dz < 0 < da, (probe, side)
    assert probes["dp = -0.1 p", "DEM"][0] < -0.05 > probes["dp = -0.1 p", best][0]
    for side in ("DEM", best, SOURCE):  # pressure that rises closes next to nothing
        assert abs(probes["dp = +0.1 p", side][0]) < 0.05

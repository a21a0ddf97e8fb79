"""Arithmetic, tables and figures of the map, on made-up histories of which everything is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drawn import curves, unnamed

from granfabric.cases.scene.measured import Inputs
from granfabric.cases.verify.map import pictures as map_pictures
from granfabric.cases.verify.map.compare import Cell, cell, rows_of
from granfabric.cases.verify.map.materials import chosen_materials
from granfabric.cases.verify.map.paths import MAP_PATHS
from granfabric.cases.verify.map.result import MapPlan, following, result_of
from granfabric.cases.verify.map.sampling import common_reach, is_flowing, places, ratios, reach
from granfabric.cases.verify.map.table import blocks, by_cell, markdown
from granfabric.cases.verify.map.tasks import INPUTS, KERNELS, LAW, PACKING, Done, Task
from granfabric.cases.verify.model_side import BEST, SOURCE
from granfabric.dem_ref.loading.path import Segment

P0 = 1e5
COUNT = 61


def history(pressure: np.ndarray, ratio: np.ndarray, segment: np.ndarray, strain: np.ndarray | None = None) -> dict:
    """Compression along y; z = 4 - q/p, fabric 0.4 q/p, normal forces 0.9 q/p, tangential 0.7 q/p."""
    p = P0 * pressure
    nothing = np.zeros(len(p))
    strain = 0.01 * ratio if strain is None else strain
    along = {"fabric": 0.4, "normal_force": 0.9, "tangential_force": 0.7}
    return {
        "p": p, "q": np.abs(ratio) * p, "stress_xx": -p * (1 - ratio), "stress_yy": -p * (1 + ratio),
        "stress_xy": nothing, "strain_xx": 0.5 * strain, "strain_yy": -0.5 * strain, "strain_xy": nothing,
        "segment": segment.astype(float), "coordination": 4.0 - ratio + (pressure - 1.0), "mean_normal_force": pressure,
        **{f"{name}_xx": -factor * ratio for name, factor in along.items()},
        **{f"{name}_xy": nothing for name in along},
    }  # fmt: skip


def loading(most: float = 0.302, done: bool = True) -> dict:
    segment = np.zeros(COUNT)
    segment[-1] = float(done)
    return history(np.ones(COUNT), np.linspace(0.0, most, COUNT), segment)


def loop() -> dict:
    up = np.linspace(0.0, 0.2, 21)
    ratio = np.concatenate([up, up[::-1][1:], up[1:]])
    segment = np.repeat([0, 1, 2], [20, 20, 20])
    return history(np.ones(COUNT), ratio, np.concatenate([segment, [3]]))


def test_places_are_fractions_of_the_stress_path() -> None:
    found = places(loop(), 3)
    assert found.segment[[0, -1]].tolist() == [1.0, 3.0] and len(found.record) == 3 * 11
    np.testing.assert_allclose(found.record[:11], np.linspace(0, 20, 11))
    np.testing.assert_allclose(found.record[11:22], np.linspace(20, 40, 11))
    # isotropic: the length is that of p
    falling = history(np.linspace(1.0, 0.3, COUNT), np.zeros(COUNT), np.repeat([0, 1], [60, 1]))
    np.testing.assert_allclose(places(falling, 1).record, np.linspace(0, 60, 31))
    uneven = history(np.array([1.0, 0.9, 0.5]), np.zeros(3), np.array([0, 0, 1]))
    assert places(uneven, 1).record[[3, 6, 18]] == pytest.approx([0.5, 1.0, 1.5])


def test_packings_that_do_not_carry_a_path_are_compared_to_a_fraction_of_the_peak() -> None:
    path = MAP_PATHS["constant_pressure"]
    whole, short, other = loading(), loading(0.25), loading(0.2, done=False)
    assert reach(whole, path, "").segment == 1
    assert reach(short, path, "").segment == 0 and reach(short, path, "").ratio == pytest.approx(0.25)
    reaches = [reach(entry, path, "") for entry in (whole, short, other)]
    limit = common_reach(reaches, 1)
    assert limit is not None and limit.ratio == pytest.approx(0.8 * 0.2)
    assert common_reach(reaches[:1], 1) is None
    for entry in (whole, short, other):
        at = places(entry, 1, limit).record
        assert np.interp(at[-1], np.arange(COUNT), ratios(entry)) == pytest.approx(0.16)
        assert at[0] == 0.0 and (np.diff(at) > 0).all()
    # given up in its second segment: the first one is compared whole, of the second nothing that is not common
    pressed = MAP_PATHS["isotropic_falling"]
    begun = history(np.linspace(1.0, 0.4, COUNT), np.zeros(COUNT), np.repeat([0, 1, 2], [51, 9, 1]))
    stopped = reach(begun, pressed, "segment 2: the sample has lost its pressure")
    assert stopped.segment == 1
    found = places(begun, 2, common_reach([stopped], 2))
    assert set(found.segment) == {1.0} and found.record[-1] == 51.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_plateau_ends_a_run(sign: float) -> None:
    """q/p grows to 0.2 at a strain of 1, and stays: nothing new at four times the strain, not before."""
    strain = np.linspace(0.0, 5.0, 101)
    ratio = sign * 0.2 * np.minimum(strain, 1.0)
    segments = (Segment("biaxial", "constant_pressure", sign * 10.0, sign * 0.302),)
    whole = history(np.ones(101), ratio, np.zeros(101), sign * strain)
    assert is_flowing(whole, segments)
    for last, flows in ((41, False), (74, False), (80, True)):
        part = {name: values[:last] for name, values in whole.items()}
        assert is_flowing(part, segments) == flows
    assert not is_flowing(whole, (Segment("invariants"),))
    assert not is_flowing({**whole, "segment": np.ones(101)}, segments)
    still = history(np.ones(101), np.linspace(0, sign * 0.2, 101), np.zeros(101), sign * strain)
    assert not is_flowing(still, segments)


# errors


def answer(of: dict, z: float = 0.0, fabric: float = 0.0, stop: int | None = None) -> dict[str, Any]:
    """The law: as the DEM, but z and a_c grow away from it with q/p; NaN after some record."""
    ratio = ratios(of)
    columns = {
        "coordination": of["coordination"] + z * ratio, "mean_normal_force": of["mean_normal_force"].copy(),
        "fabric_along": -of["fabric_xx"] + fabric * ratio, "fabric_across": np.zeros(COUNT),
        "normal_along": -of["normal_force_xx"], "tangential_along": -of["tangential_force_xx"],
    }  # fmt: skip
    if stop is not None:
        columns = {name: np.where(np.arange(COUNT) <= stop, values, np.nan) for name, values in columns.items()}
    return {"columns": columns, "message": "" if stop is None else "it is not definite"}


REFUSED = {"columns": {}, "message": "slip is out of bounds"}


def made(first: dict, second: dict, closures: tuple[str, ...] = (BEST,), shift: float = 0.1) -> Cell:
    """A cell of two packings; the second one has more contacts by `shift`."""
    one, two = loading(), loading()
    two["coordination"] = two["coordination"] + shift
    dem = {1: {"history": one, "reason": ""}, 2: {"history": two, "reason": ""}}
    law = {1: dict.fromkeys(closures, first), 2: dict.fromkeys(closures, second)}
    return cell("source", "constant_pressure", MAP_PATHS["constant_pressure"], closures, {
        seed: (dem[seed], law[seed]) for seed in dem
    })  # fmt: skip


def row_of(found: Cell, quantity: str) -> Any:
    (row,) = [row for row in rows_of(found) if row.quantity == quantity]
    return row


def test_the_largest_error_is_of_the_mean_over_the_packings() -> None:
    two = loading()
    two["coordination"] = two["coordination"] + 0.1
    found = made(answer(loading(), z=-0.5, fabric=0.1), answer(two, z=-0.3, fabric=-0.5))
    z, a_c, a_n = (row_of(found, name) for name in ("coordination", "fabric_along", "normal_along"))
    assert z.error == pytest.approx(-0.4 * 0.302) and z.stress_ratio == pytest.approx(0.302)
    assert z.error_percent == pytest.approx(-100 * 0.4 * 0.302 / 4.05)
    assert (z.segment, z.fraction, z.pressure_ratio, z.angle) == (1, 1.0, pytest.approx(1.0), 0.0)
    assert z.dem == pytest.approx(4.05 - 0.302) and z.model == pytest.approx(z.dem + z.error)
    assert z.scatter == pytest.approx(0.1 / np.sqrt(2))
    assert z.error_over_scatter == pytest.approx(0.4 * 0.302 / 0.1 * np.sqrt(2))
    assert a_c.error == pytest.approx(-0.2 * 0.302) and np.isnan(a_c.error_percent)
    assert a_n.error == pytest.approx(0.0, abs=1e-12)
    assert (z.packings, z.all_packings, z.refused_packings, z.refused_inputs, z.message) == (2, 2, 0, 0, "")
    assert np.isnan(z.compared_to_stress_ratio) and np.isnan(z.refused_fraction)


def test_refused_packings_are_counted_and_told_where() -> None:
    two = loading()
    two["coordination"] = two["coordination"] + 0.1
    found = made(answer(loading(), z=-0.5, stop=30), answer(two, z=0.1))
    row = row_of(found, "coordination")
    assert (row.refused_packings, row.refused_inputs, row.all_packings) == (1, 0, 2)
    assert row.refused_stress_ratio == pytest.approx(0.151) and row.refused_fraction == pytest.approx(0.5)
    assert row.refused_pressure_ratio == pytest.approx(1.0) and row.message == "it is not definite"
    # both as far as the first one went; then the other alone, which has less of an error
    assert row.error == pytest.approx(-0.2 * 0.151) and row.packings == 2
    found = made(answer(loading(), stop=30), answer(two, stop=12))
    assert row_of(found, "coordination").refused_stress_ratio == pytest.approx(12 * 0.302 / 60)
    found = made(REFUSED, answer(two, z=0.1))
    row = row_of(found, "coordination")
    assert (row.refused_packings, row.refused_inputs, row.packings) == (0, 1, 1)
    assert row.error == pytest.approx(0.0302) and row.message == "slip is out of bounds"
    row = row_of(made(REFUSED, REFUSED), "coordination")
    assert (row.refused_inputs, row.packings) == (2, 0) and np.isnan(row.error)
    empty = cell("source", "loop", MAP_PATHS["loop"], (BEST,), {}, ["source, seed 1: no rest"])
    row = row_of(empty, "coordination")
    assert np.isnan(row.error) and row.message == "source, seed 1: no rest" and row.all_packings == 0


def test_what_the_law_refuses_beyond_the_comparison_does_not_count() -> None:
    short = loading(0.2)
    dem = {"history": short, "reason": ""}
    found = cell("m", "constant_pressure", MAP_PATHS["constant_pressure"], (BEST,), {
        1: (dem, {BEST: answer(short, z=1.0, stop=55)})
    })  # fmt: skip
    row = row_of(found, "coordination")
    assert row.refused_packings == 0 and row.compared_to_stress_ratio == pytest.approx(0.16)
    assert row.error == pytest.approx(0.16)


def test_ratios_are_signed_along_the_first_loading_and_pressures_relative() -> None:
    """A reversal after p has doubled; with axes that turn the ratio is that along the major compression."""
    ratio = np.concatenate([np.linspace(0.0, 0.2, 31), np.linspace(0.2, -0.2, 31)[1:]])
    pressure = np.linspace(1.0, 2.0, COUNT)
    there = history(pressure, ratio, np.repeat([0, 1, 2], [30, 30, 1]))
    for turning, sign in ((False, -1.0), (True, 1.0)):
        path = replace(MAP_PATHS["isotropic_falling"], turning=turning)  # two segments, driven by stress
        found = cell("m", "isotropic_falling", path, (BEST,), {1: ({"history": there, "reason": ""}, {BEST: REFUSED})})
        assert found.segment[[15, 16]].tolist() == [1.0, 2.0]
        assert found.stress_ratio[[15, -1]] == pytest.approx([0.2, sign * 0.2])
        assert found.pressure_ratio[[0, -1]] == pytest.approx([1.0, 2.0])
        assert abs(found.angle[-1]) == pytest.approx(90.0)


# the order of the work


def test_the_law_follows_inputs_and_path_and_waits_for_its_kernels(tmp_path: Any) -> None:
    plan = MapPlan(chosen_materials("source"), {"loop": MAP_PATHS["loop"]}, [1], 200, (BEST,), compiling=True)
    material = plan.materials[0]
    task = Task(tmp_path, 200, material, 1, PACKING)
    next_ones = following(plan, task, Done({"void_ratio": 0.2}))
    assert [one.what for one in next_ones] == [INPUTS, "loop"]
    run = Done({"history": loop(), "reason": ""})
    assert following(plan, replace(task, what="loop"), run) == []
    assert following(plan, replace(task, what=INPUTS), Done({"slip": {"value": 1.0}})) == []
    (law,) = following(plan, replace(task, what=KERNELS), Done())
    assert (law.what, law.path, law.closures) == (LAW, "loop", (BEST,))
    assert law.given["inputs"] == {"slip": {"value": 1.0}} and law.given["history"] is run.values["history"]
    assert following(plan, task, Done(failure="it is not at rest")) == []
    assert plan.failures_of("source", 1) == ["source, seed 1: it is not at rest"]
    assert following(plan, replace(task, what="loop"), Done(stopped=True)) == []


# tables and figures


@pytest.fixture
def result() -> Any:
    """Two materials, two paths, two packings; refused on one, no DEM on another."""
    materials = chosen_materials("source,kt_kn_0.5")
    paths = {name: MAP_PATHS[name] for name in ("constant_pressure", "loop")}
    plan = MapPlan(materials, paths, [1, 2], 200, (SOURCE, BEST))
    for number, material in enumerate(materials):
        for seed in plan.seeds:
            if (number, seed) == (1, 2):
                plan.done[material.name, seed, PACKING, ""] = Done(failure="it is not at rest")
                continue
            plan.done[material.name, seed, INPUTS, ""] = Done({"coordination": {"value": 4.0, "standard_error": 0.1}})
            for name, made_up in (("constant_pressure", loading()), ("loop", loop())):
                plan.done[material.name, seed, name, ""] = Done({"history": made_up, "reason": ""})
                stop = 30 if (number, seed, name) == (0, 1, "loop") else None
                laws = {SOURCE: answer(made_up, -1.0), BEST: answer(made_up, 0.1 * seed, 0.2 * (1 + number), stop)}
                plan.done[material.name, seed, LAW, name] = Done(laws)
    return result_of(plan)


def test_tables_have_materials_down_and_paths_across(result: Any) -> None:
    (table,) = blocks(result, BEST, ("coordination", "fabric_along"), 130)
    assert table[0] == ["material", "p constant", "loop 0, .2, 0, .2"]
    # z of 4 at the start; mean over the packings 0.15 q/p
    assert table[1] == ["source", "+1.1 +0.060", "+1.0 +0.040\n1/2 refused at q/p 0.10"]
    assert table[2] == ["kt_kn_0.5", "+0.8 +0.121", "+0.5 +0.080"]
    narrow = blocks(result, BEST, ("coordination", "fabric_along"), 30)
    assert [block[0] for block in narrow] == [["material", "p constant"], ["material", "loop 0, .2, 0, .2"]]
    assert isinstance(result.inputs["source"], Inputs) and result.inputs["source"].values == {"coordination": 4.0}
    assert result.failures == ["kt_kn_0.5, seed 2: it is not at rest"]
    assert result.refusals == [f"source, loop, {BEST}: 1/2 refused at q/p 0.10: it is not definite"]
    text = markdown(result)
    assert "| as in the source | +1.1 (0.0), +0.060 (0.000) |" in text
    assert "; 1/2 refused at q/p 0.10 |" in text and "- kt_kn_0.5, seed 2: it is not at rest" in text


def test_the_figure_of_the_map_says_what_the_table_says(result: Any, pictures: dict, tmp_path: Any) -> None:
    map_pictures.draw_map(tmp_path, result)
    assert set(pictures) == {"map.png", "map_constant_pressure.png", "map_loop.png"}
    cells = by_cell(result.rows)
    panels = [axes for axes in pictures["map.png"].axes if axes.get_title(loc="left")]
    assert len(panels) == 4
    for axes, quantity in zip(panels, map_pictures.PANELS):
        assert [text.get_text() for text in axes.get_xticklabels()] == ["p constant", "loop 0, .2, 0, .2"]
        assert [text.get_text() for text in axes.get_yticklabels()] == ["as in the source", "kt/kn 0.5"]
        shown = np.asarray(axes.images[0].get_array())
        for i, material in enumerate(result.materials):
            for j, name in enumerate(result.paths):
                row = cells[material.name, name, BEST, quantity]
                size = row.error_percent if quantity == "coordination" else row.error
                assert shown[i, j] == pytest.approx(abs(size))
                (text,) = [text for text in axes.texts if text.get_position() == (j, i)]
                number = f"{size:+.1f}" if quantity == "coordination" else f"{size:+.3f}"
                assert text.get_text().split("\n")[0] == number
                assert ("ref. q/p" in text.get_text()) == (row.refused_packings > 0)
        assert len(axes.patches) == 1  # around what was refused


def test_figures_of_paths_show_both_sides(result: Any, pictures: dict, tmp_path: Any) -> None:
    map_pictures.draw_map(tmp_path, result)
    axes = pictures["map_loop.png"].axes
    assert len(axes) == 2 * 4
    (cell_of,) = [one for one in result.cells if (one.material, one.path) == ("source", "loop")]
    first = axes[0]
    assert first.get_title(loc="left") == "z, as in the source"
    drawn = curves(first)
    assert set(drawn) == {"DEM", SOURCE, BEST}
    np.testing.assert_allclose(drawn["DEM"][0], cell_of.stress_ratio)
    np.testing.assert_allclose(drawn["DEM"][1], 4.0 - cell_of.stress_ratio)
    np.testing.assert_allclose(drawn[SOURCE][1], 4.0 - 2.0 * cell_of.stress_ratio)
    stopped = np.isfinite(drawn[BEST][1])
    assert stopped.sum() == 11 + 6  # as far as the first packing: one and a half legs
    np.testing.assert_allclose(drawn[BEST][1][stopped], (4.0 - 0.85 * cell_of.stress_ratio)[stopped])
    crosses = [(x, y) for x, y in unnamed(first) if len(x) == 1]
    assert len(crosses) == 1 and crosses[0][0][0] == pytest.approx(0.1)
    fabric = curves(axes[1])
    np.testing.assert_allclose(fabric["DEM"][1], 0.4 * cell_of.stress_ratio)
    normal, tangential = curves(axes[2]), curves(axes[3])
    np.testing.assert_allclose(normal[SOURCE][1], 0.9 * cell_of.stress_ratio)
    np.testing.assert_allclose(tangential[SOURCE][1], 0.7 * cell_of.stress_ratio)
    labels = [axes[place].get_ylabel() for place in range(4)]
    assert labels == ["coordination number $z$ [-]", "$a_c$ [-]", "$a_n$ [-]", "$a_t$ [-]"]

"""Columns of a field run's history against the fields themselves: means, extremes, boundaries, counts; its files."""

from __future__ import annotations

import copy
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import meshio
import numpy as np
import pytest
from rich.console import Console

from granfabric.cases.commands.run import run_field
from granfabric.cases.records import files
from granfabric.cases.records.field_history import COUNTS, MEANS, FieldHistory
from granfabric.cases.records.region_columns import BODY, NETWORK
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.contract import LawDescription, Variable
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import rectangle

LAW = LawDescription(
    "made up",
    (Variable("other", ""), Variable("coordination", ""), Variable("fabric_anisotropy", "", components=2)),
    (),
)


@pytest.fixture(scope="module")
def space() -> Space:
    """Cells that differ in size, so that a mean without weights is another one."""
    host = rectangle(2.0, 1.0, 3, 2)
    host.mesh.p[0] = 2.0 * (host.mesh.p[0] / 2.0) ** 2
    return Space(host, "P2")


def step(space: Space, **changed: Any) -> Any:
    random = np.random.default_rng(1)
    n = space.npoints
    stress = np.column_stack([-2e5 + 5e4 * random.normal(size=n), -3e5 + 5e4 * random.normal(size=n),
                              4e4 * random.normal(size=n)])  # fmt: skip
    state = np.column_stack([random.normal(size=n), 4 + 0.2 * random.normal(size=n), 0.2 * random.normal(size=(n, 2))])
    values = {
        "step": 3, "stage": "press", "fraction": 0.25, "stress": stress, "strain": 1e-5 * random.normal(size=(n, 3)),
        "state": state, "iterations": 11, "factorisations": 2, "cuts": 1, "substeps": 130, "limited": 5,
        "displacement": random.normal(size=space.ndofs), "reactions": {"top": (1.5, -2.5), "bottom": (-1.0, 3.0)},
        "active": None,
        "support": random.normal(size=space.ndofs),
    }  # fmt: skip
    return SimpleNamespace(**{**values, **changed})


def test_columns_are_means_and_extremes_over_the_points(space: Space) -> None:
    made = step(space)
    history = FieldHistory(space, LAW, ["left", "top"], ["top"])
    history.add(made)
    row = dict(zip(history.names, history.rows[0], strict=True))
    weights = space.weights / space.weights.sum()
    assert abs(made.stress[:, 0].mean() / (weights @ made.stress[:, 0]) - 1) > 1e-3
    for place, name in enumerate(("xx", "yy", "xy")):
        assert row[f"stress_{name}"] == pytest.approx(weights @ made.stress[:, place])
        assert row[f"strain_{name}"] == pytest.approx(weights @ made.strain[:, place])
    xx, yy, xy = (row[f"stress_{name}"] for name in ("xx", "yy", "xy"))
    assert row["p"] == pytest.approx(-(xx + yy) / 2) and row["p"] > 0
    assert row["q"] == pytest.approx(np.sqrt(((xx - yy) / 2) ** 2 + xy**2))
    z, fabric = made.state[:, 1], np.sqrt(made.state[:, 2] ** 2 + made.state[:, 3] ** 2)
    assert row["coordination"] == pytest.approx(weights @ z)
    assert (row["coordination_smallest"], row["coordination_largest"]) == (z.min(), z.max())
    assert row["fabric_anisotropy"] == pytest.approx(weights @ fabric)
    assert row["fabric_anisotropy_largest"] == pytest.approx(fabric.max())
    s = made.stress
    ratios = np.sqrt(((s[:, 0] - s[:, 1]) / 2) ** 2 + s[:, 2] ** 2) / (-(s[:, 0] + s[:, 1]) / 2)
    assert row["stress_ratio_largest"] == pytest.approx(ratios.max())
    counts = {"iterations": 11, "factorisations": 2, "cuts": 1, "substeps": 130, "limited_points": 5}
    assert {name: row[name] for name in COUNTS} == counts
    assert (row["step"], row["stage"], row["fraction"]) == (3, "press", 0.25)
    moved = made.displacement.reshape(-1, 2)
    x, y = space.nodes.T
    force = made.support.reshape(-1, 2)
    moment = x * force[:, 1] - y * force[:, 0]
    assert row["reaction_top_moment"] == pytest.approx(moment[y == 1].sum())
    assert row["reaction_total_x"] == pytest.approx(force[:, 0].sum())
    assert row["reaction_total_moment"] == pytest.approx(moment.sum())
    for name, nodes in (("left", x == 0), ("top", y == 1)):
        assert row[f"displacement_{name}_x"] == pytest.approx(moved[nodes, 0].mean())
        assert row[f"displacement_{name}_y"] == pytest.approx(moved[nodes, 1].mean())
    assert (row["reaction_top_x"], row["reaction_top_y"]) == (1.5, -2.5)
    ends = ("top_x", "top_y", "top_moment", "total_x", "total_y", "total_moment")
    assert [name for name in row if name.startswith("reaction")] == [f"reaction_{end}" for end in ends]
    assert list(row)[3 : 3 + len(MEANS)] == list(MEANS)


def test_means_over_regions(space: Space) -> None:
    """Of two that overlap: weighted by area within each, p and q those of the mean; one that is everything has none."""
    made = step(space)
    cells = space.nelements
    regions = {"all": np.arange(cells), "lower": np.arange(4), "later": np.arange(3, cells)}
    parted = copy.copy(space)
    parted.host_mesh = replace(space.host_mesh, regions=regions)
    history = FieldHistory(parted, LAW, [], [])
    history.add(made)
    row = dict(zip(history.names, history.rows[0], strict=True))
    of_regions = [name for name in row if name.startswith("region_")]
    assert of_regions == [f"region_{name}_{what}" for name in ("lower", "later") for what in (*BODY, *NETWORK)]
    owner = space.point_cell
    for name in ("lower", "later"):
        inside = np.isin(owner, regions[name])
        weights = space.weights[inside] / space.weights[inside].sum()
        assert abs(weights.max() / weights.min() - 1.0) > 0.1
        stress, strain = weights @ made.stress[inside], weights @ made.strain[inside]
        for place, axes in enumerate(("xx", "yy", "xy")):
            assert row[f"region_{name}_stress_{axes}"] == pytest.approx(stress[place], rel=1e-12)
            assert row[f"region_{name}_strain_{axes}"] == pytest.approx(strain[place], rel=1e-9, abs=1e-20)
        assert row[f"region_{name}_p"] == pytest.approx(-(stress[0] + stress[1]) / 2)
        assert row[f"region_{name}_q"] == pytest.approx(np.hypot((stress[0] - stress[1]) / 2, stress[2]))
        assert row[f"region_{name}_coordination"] == pytest.approx(weights @ made.state[inside, 1])
        magnitude = np.linalg.norm(made.state[inside, 2:4], axis=1)
        assert row[f"region_{name}_fabric_anisotropy"] == pytest.approx(weights @ magnitude)


def test_a_region_that_is_not_there_has_means_of_zero_and_the_others_their_own(space: Space) -> None:
    parted = copy.copy(space)
    regions = {"gone": np.arange(4), "left": np.arange(4, space.nelements)}
    parted.host_mesh = replace(space.host_mesh, regions=regions)
    active = np.ones(space.nelements, dtype=bool)
    active[regions["gone"]] = False
    made, whole = step(space, active=active), step(space)
    for array in (made.stress, made.strain, made.state):
        array[~active[space.point_cell]] = 0.0
    rows = []
    for each in (made, whole):
        history = FieldHistory(parted, LAW, [], [])
        history.add(each)
        rows.append(dict(zip(history.names, history.rows[0], strict=True)))
    gone, there = rows
    assert {gone[name] for name in gone if name.startswith("region_gone")} == {0.0}
    kept = [name for name in gone if name.startswith("region_left")]
    assert kept and [gone[name] for name in kept] == [there[name] for name in kept]
    # the mean of the body is that of what is left
    assert gone["coordination"] == pytest.approx(gone["region_left_coordination"], rel=1e-12)


ROUGH = """
title = "Rough"
kind = "field"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
force_anisotropy_ratio = 2.0
bulk_reduction = 0.88
shear_reduction = 0.6
[effects]
principal_rotation = true
contact_gain = true
stiffness_feedback = true
[closure]
force_change = "mean_field"
[mesh]
rectangle = { width = 0.05, height = 0.1, nx = 3, ny = 6 }
element = "P2"
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "initial"
fixed = [{ boundary = "bottom" }, { boundary = "top" }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
[[stage]]
name = "compression"
increments = 5
displacement = [{ boundary = "top", component = "y", value = -26e-6 }]
[[stage]]
name = "shear"
increments = 2
displacement = [{ boundary = "top", component = "x", value = 4e-6 }]
[output]
pictures = false
"""


@pytest.fixture(scope="module")
def rough(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, np.ndarray], str]:
    """A run between rough platens, at last beyond what the law knows; its folder, its history and what it printed."""
    folder = tmp_path_factory.mktemp("rough")
    (folder / "rough.toml").write_text(ROUGH)
    text = io.StringIO()
    record = run_field(load(str(folder / "rough.toml")), folder / "out", Screen(Console(file=text, width=200)))
    assert record.outcome == "finished", record.message
    table = files.read_csv(folder / "out" / "history.csv")
    return folder / "out", {name: np.array(values) for name, values in table.items()}, text.getvalue()


def test_history_belongs_to_the_files_of_its_steps(rough: Any) -> None:
    """Every step: extremes of the points' file, displacements and nodal stresses of the fields' file."""
    folder, columns, _ = rough
    last = int(columns["step"][-1])
    assert last >= 8
    spread = False
    for row, number in enumerate(columns["step"].astype(int)):
        cloud = meshio.read(folder / f"points_{number:04d}.vtu")
        data = cloud.point_data
        assert columns["coordination_smallest"][row] == pytest.approx(data["coordination"].min(), rel=1e-12)
        assert columns["coordination_largest"][row] == pytest.approx(data["coordination"].max(), rel=1e-12)
        fabric = np.linalg.norm(data["fabric_anisotropy"], axis=1)
        assert columns["fabric_anisotropy_largest"][row] == pytest.approx(fabric.max(), rel=1e-12, abs=1e-15)
        s = data["stress"]
        p, q = -(s[:, 0] + s[:, 4]) / 2, np.hypot((s[:, 0] - s[:, 4]) / 2, s[:, 1])
        assert columns["stress_ratio_largest"][row] == pytest.approx((q / p).max(), rel=1e-12)
        assert columns["limited_points"][row] == np.count_nonzero(data["status"] == 1)
        spread |= columns["coordination_largest"][row] - columns["coordination_smallest"][row] > 0.05
        fields = meshio.read(folder / f"result_{number:04d}.vtu")
        top = fields.points[:, 1] > 0.1 - 1e-12
        moved = fields.point_data["displacement"][top].mean(axis=0)
        assert columns["displacement_top_x"][row] == pytest.approx(moved[0], abs=1e-18)
        assert columns["displacement_top_y"][row] == pytest.approx(moved[1], abs=1e-18)
    assert spread
    # what presses from above is carried below; the platens push on the body
    np.testing.assert_allclose(columns["reaction_top_y"], -columns["reaction_bottom_y"], rtol=1e-5)
    assert (columns["reaction_top_y"] < -0.9 * 0.05 * 100e3).all()
    assert columns["reaction_top_x"][-1] > 0 > columns["reaction_bottom_x"][-1]
    np.testing.assert_allclose(columns["strain_yy"], columns["displacement_top_y"] / 0.1, rtol=1e-8, atol=1e-18)


def test_limited_points_are_counted_in_history_files_and_report(rough: Any) -> None:
    """a_n = 2 q/p passes 0.98 where q/p passes 0.49: some points at the end, none at first."""
    _, columns, text = rough
    limited = columns["limited_points"]
    assert limited[0] == limited[1] == 0 and 0 < limited.max() < 3 * 36
    first = int(columns["step"][np.argmax(limited > 0)])
    where = f"at up to {int(limited.max())} of 108 points, first in step {first}"
    assert f"rates were clipped at the limit of realisability, {where}\n" in text
    assert ((columns["stress_ratio_largest"] > 0.5) <= (limited > 0)).all()
    assert ((limited > 0) <= (columns["stress_ratio_largest"] > 0.45)).all()


def test_the_printed_table_is_the_history(rough: Any) -> None:
    """Rows spread over the run; strain in millionths, q/p, z, a_c and their extremes, iterations."""
    _, columns, text = rough
    lines = text.splitlines()
    head = next(place for place, line in enumerate(lines) if line.strip().startswith("step"))
    assert lines[head - 1] == "Rough: means and extremes"
    assert " ".join(lines[head].split()) == "step stage eps_yy [1e-6] q/p z z min a_c a_c max it."
    rows = [line.split() for line in lines[head + 1 :]]
    rows = rows[: next(place for place, row in enumerate(rows) if len(row) != 9)]
    assert rows[0][0] == "0" and int(rows[-1][0]) == columns["step"][-1] and len(rows) == 8
    for row in rows:
        at = int(row[0])
        c = {name: values[at] for name, values in columns.items()}
        assert row == [
            f"{at}", c["stage"], f"{1e6 * c['strain_yy']:.1f}", f"{c['q'] / c['p']:.4f}", f"{c['coordination']:.4f}",
            f"{c['coordination_smallest']:.4f}", f"{c['fabric_anisotropy']:.4f}",
            f"{c['fabric_anisotropy_largest']:.4f}", f"{int(c['iterations'])}",
        ]  # fmt: skip


def test_a_run_without_clipped_rates_says_nothing_of_them(granfabric: Callable, tmp_path: Path) -> None:
    (tmp_path / "rough.toml").write_text(ROUGH.replace("-26e-6", "-2e-6"))
    result = granfabric("run", tmp_path / "rough.toml", "-o", tmp_path / "out")
    assert result.code == 0 and "rates were clipped" not in result.out
    result = granfabric("point", "p_constant", "-o", tmp_path / "point", "--set", "output.pictures=false")
    assert result.code == 0 and "rates were clipped" not in result.out

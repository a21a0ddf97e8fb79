"""Results read back: what the files hold, without what pads it, and at places through the true map of the cells."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from types import SimpleNamespace

import meshio
import numpy as np
import pytest

import granfabric as gf
from granfabric.fem.discretisation.location import Locator
from granfabric.fem.discretisation.parts import parts
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.shapes import quarter_ring
from granfabric.fem.output.cells import joined, vtk_cells

QUIET = {"output.pictures": False}


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> gf.Results:
    """A cavity with curved second-order cells."""
    return gf.run_scene("pressurised_cavity", QUIET, tmp_path_factory.mktemp("ring") / "out")


def test_the_history_is_the_file(ring: gf.Results) -> None:
    with (ring.folder / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(ring.history.columns) == list(rows[0])
    assert ring.history["p"].tolist() == [float(row["p"]) for row in rows]
    assert ring.history["stage"].tolist() == [row["stage"] for row in rows]
    assert ring.record == json.loads((ring.folder / "run.json").read_text()) and "finished" in repr(ring)


@pytest.mark.parametrize("step", [0, -1])
def test_fields_are_those_of_the_files(ring: gf.Results, step: int) -> None:
    number = ring.steps[step]
    for name, source in (("result", ring), ("points", ring.points)):
        raw = meshio.read(ring.folder / f"{name}_{number:04d}.vtu").point_data
        for key, pick in (("stress", [0, 4, 1]), ("displacement", [0, 1]), ("fabric_anisotropy", [0, 1])):
            assert np.array_equal(source.field(key, number), raw[key][:, pick])
        assert np.array_equal(source.field("strain", number), raw["strain"][:, [0, 4, 1]] * [1.0, 1.0, 2.0])
        assert np.array_equal(source.field("coordination", step), raw["coordination"])


def test_the_table_of_points_has_a_row_each(ring: gf.Results) -> None:
    table = ring.points.table()
    assert len(table) == ring.record["size"]["integration_points"]
    assert np.array_equal(table[["stress_xx", "stress_yy", "stress_xy"]], ring.points.field("stress"))
    assert np.array_equal(table[["x", "y"]], ring.points.position)
    assert np.array_equal(table["fabric_anisotropy_2"], ring.points.field("fabric_anisotropy")[:, 1])


def test_at_a_node_stands_its_value(ring: gf.Results) -> None:
    nodes = ring.nodes
    for node in (0, len(nodes) // 2, len(nodes) - 1):
        found = ring.at(*nodes[node])
        assert found["displacement_x"] == pytest.approx(ring.field("displacement")[node, 0], abs=1e-18, rel=1e-9)
        assert found["stress_yy"] == pytest.approx(ring.field("stress")[node, 1], rel=1e-9)


def test_places_close_to_a_curved_side_are_found(ring: gf.Results) -> None:
    """All around the cavity, a hair inside the ground: cells with straight sides would lose half of them."""
    radius = np.hypot(*ring.nodes.T).min()
    for angle in np.linspace(0.01, np.pi / 2 - 0.01, 25):
        place = radius * (1.0 + 2e-5) * np.array([np.cos(angle), np.sin(angle)])
        values = ring.at(*place)
        radial = values["displacement_x"] * np.cos(angle) + values["displacement_y"] * np.sin(angle)
        assert abs(radial) > 0.0
    with pytest.raises(gf.InputError, match="lies outside of the mesh"):
        ring.at(0.9 * radius, 0.0)


def test_along_a_line_that_leaves_the_mesh(ring: gf.Results) -> None:
    radius = np.hypot(*ring.nodes.T)
    line = ring.along((0.0, 0.5 * radius.min()), (2.0 * radius.min(), 0.5 * radius.min()), number=41)
    inside = np.hypot(line["x"], line["y"]) >= radius.min()
    assert 0 < inside.sum() < 41
    assert np.array_equal(line["coordination"].notna(), inside)
    assert line["distance"].iloc[-1] == pytest.approx(2.0 * radius.min())
    for bad in (((0, 0), (1, 1), -1, 1), ((0, 0, 0), (1, 1), -1, 5)):
        with pytest.raises(gf.InputError, match="a line needs"):
            ring.along(*bad)


@pytest.mark.parametrize(("element", "cell"), [("P1", "triangle"), ("P2", "triangle"), ("Q1", "quad"), ("Q2", "quad")])
def test_fields_that_an_element_holds_are_exact_everywhere(element: str, cell: str) -> None:
    """x and y themselves, mapped by the cells: also where sides are curved and cells turned by scikit-fem's sorting."""
    space = Space(quarter_ring(1.0, 3.0, 3, 4, cell), element)
    made = vtk_cells(space, parts(space))
    blocks = [SimpleNamespace(type=kind, data=data) for kind, data in made.blocks]
    element_of = np.split(made.element, np.cumsum([len(block.data) for block in blocks])[:-1])
    locator = Locator(space.nodes, *joined(blocks, element_of))
    random = np.random.default_rng(1)
    radius, angle = random.uniform(1.1, 2.7, 60), random.uniform(0.05, 1.5, 60)
    places = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    nodes, weights = locator.find(places)
    assert (nodes >= 0).all()
    np.testing.assert_allclose(np.einsum("pn,pnk->pk", weights, space.nodes[nodes]), places, atol=1e-9)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    far, nothing = locator.find(np.array([[0.1, 0.1], [9.0, 9.0]]))
    assert (far == -1).all() and np.isnan(nothing).all()


def test_what_is_not_there_is_told(ring: gf.Results, tmp_path: Path) -> None:
    with pytest.raises(gf.InputError, match=r"the field 'coordinatoin' is unknown .*nearest is 'coordination'"):
        ring.field("coordinatoin")
    with pytest.raises(gf.InputError, match="step 9999 was not written"):
        ring.field("coordination", 9999)
    with pytest.raises(gf.InputError, match="there is no folder"):
        gf.read_results(tmp_path / "none")
    with pytest.raises(gf.InputError, match="holds no results"):
        gf.read_results(tmp_path)


def test_only_what_is_asked_for_is_read(ring: gf.Results, monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Path] = []
    from granfabric.cases.records import series

    original = series.read
    monkeypatch.setattr(series, "read", lambda file, required=(): read.append(file) or original(file, required))
    again = gf.read_results(ring.folder)
    assert again.outcome == "finished" and again.steps and not read
    again.field("coordination"), again.field("stress"), again.at(*again.nodes[3])
    assert len(read) == 1


def test_a_point_has_a_history_and_no_fields(tmp_path: Path) -> None:
    results = gf.run_scene("p_constant", QUIET, tmp_path / "out")
    assert len(results.history) == results.record["steps"] + 1 and results.steps == []
    with pytest.raises(gf.InputError, match="there are none"):
        results.field("stress")

"""Scenes whose stages change the body or whose initial stress comes from weight: numbers, files, going on, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

import granfabric as gf
from granfabric.cases.field.prepare import prepare
from granfabric.cases.pictures import field
from granfabric.cases.records import files, series
from granfabric.cases.scene.reader import load
from granfabric.fem.equilibrium.imbalance import initial_imbalance

REFUSED = gf.InputError


# shipped scenes -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tunnel(tmp_path_factory: pytest.TempPathFactory) -> gf.Results:
    folder = tmp_path_factory.mktemp("tunnel") / "out"
    return gf.run_scene("tunnel", output=folder)


def test_the_tunnel_settles_as_its_text_says(tunnel: gf.Results) -> None:
    last = tunnel.history.groupby("stage", sort=False).last()
    settlement = [-1e3 * tunnel.at(0.0, 0.0, int(step))["displacement_y"] for step in last.step]
    assert settlement == pytest.approx([0.0, 0.258, 0.238, 0.600], abs=0.004)
    assert 1e3 * tunnel.at(0.0, -3.999, int(last.step["crown"]))["displacement_y"] == pytest.approx(-0.344, abs=0.004)
    assert last.reaction_crown_wall_y["lining and building"] == pytest.approx(236e3, rel=0.01)
    assert last.coordination_smallest["lining and building"] == pytest.approx(2.95, abs=0.02)
    assert last.stress_ratio_largest["bench"] == pytest.approx(0.39, abs=0.01)
    beside = tunnel.points.table(int(last.step["bench"]))
    near = beside[np.hypot(beside.x, beside.y + 6.0) < 3.0]
    assert near.coordination.min() == pytest.approx(3.36, abs=0.02)
    # at rest: 0.6 times (20 kPa + weight), over both layers
    first = tunnel.history.iloc[0]
    assert -first.reaction_side_x == pytest.approx(0.6 * (136.5e3 + 2613e3), rel=1e-4)
    assert first.reaction_bottom_y == pytest.approx(20e3 * 16 + 17e3 * 48 + 20e3 * 13 * 16, rel=1e-4)


def test_files_hold_what_is_there(tunnel: gf.Results) -> None:
    last = tunnel.history.groupby("stage", sort=False).last().step
    counts = []
    for step in last:
        file = tunnel.folder / f"result_{int(step):04d}.vtu"
        reader = vtkXMLUnstructuredGridReader()
        reader.SetFileName(str(file))
        reader.Update()
        grid = reader.GetOutput()
        # cells with curved sides are written as four
        counts.append(len(np.unique(vtk_to_numpy(grid.GetCellData().GetArray("element")))))
        places = vtk_to_numpy(grid.GetPoints().GetData())
        assert np.array_equal(places[:, :2], tunnel.nodes_at(int(step)))
        assert np.isfinite(vtk_to_numpy(grid.GetPointData().GetArray("coordination"))).all()
    mesh = prepare(load("tunnel")).problem.space.host_mesh
    numbers = tunnel.record["numbers"]
    assert list(numbers["region"].values()) == list(mesh.regions) and numbers["material"]["1"] == "lower"
    crown, bench = len(mesh.regions["crown"]), len(mesh.regions["bench"])
    whole = mesh.mesh.t.shape[1]
    assert counts == [whole, whole - crown, whole - crown - bench, whole - crown - bench]
    inside = np.hypot(tunnel.nodes_at(-1)[:, 0], tunnel.nodes_at(-1)[:, 1] + 6.0)
    assert inside.min() > 2.0 - 1e-9
    assert tunnel.points.table(-1).shape[0] == 3 * counts[-1]
    number = tunnel.steps[-1]
    with pytest.raises(REFUSED, match=f"lies in no ground at step {number}: the ground there is gone since stage"):
        tunnel.at(0.5, -6.0)
    assert tunnel.at(0.5, -6.0, 1)["coordination"] == pytest.approx(3.896, abs=1e-3)


def test_what_changes_is_told(tunnel: gf.Results) -> None:
    told = tunnel.record["body"]
    assert [entry["stage"] for entry in told] == ["crown", "bench", "lining and building"]
    assert told[0]["deactivated"] == ["crown"] and told[0]["deactivated_area"] == pytest.approx(np.pi, rel=1e-3)
    assert told[0]["held"] == pytest.approx(told[0]["fading"] * 0.7 / 0.3, rel=1e-9)
    log = (tunnel.folder / files.LOG).read_text()
    assert "stage \"crown\" takes away 'crown' (3.142 m^2); forces of 1.568e+05 N/m fade over it" in log
    assert 'stage "lining and building": its supports take over what is held from excavations' in log


def test_the_slope_is_as_its_text_says(tmp_path: Path) -> None:
    results = gf.run_scene("slope", output=tmp_path / "out")
    last = results.history.groupby("stage", sort=False).last()
    assert results.record["initial_imbalance"]["fraction"] == pytest.approx(0.29, abs=0.01)
    assert not results.record["initial_imbalance"]["warned"]
    assert 1e3 * last.displacement_face_x["initial"] == pytest.approx(-0.197, abs=0.003)
    assert 1e3 * last.displacement_load_y["load"] == pytest.approx(-0.485, abs=0.005)
    assert 1e3 * last.displacement_face_x["load"] == pytest.approx(-0.068, abs=0.002)
    assert last.reaction_bottom_y["initial"] == pytest.approx(5072e3, rel=1e-6)
    assert last.reaction_bottom_y["load"] == pytest.approx(5222e3, rel=1e-6)
    assert last.coordination_smallest["initial"] == pytest.approx(3.66, abs=0.01)
    assert last.coordination_smallest["load"] == pytest.approx(3.02, abs=0.02)


def test_changes_are_drawn_material_by_material(tunnel: gf.Results) -> None:
    """Where layers meet each has nodes of its own, and each is compared with its own beginning."""
    last = series.read(series.last_file(tunnel.folder, "result"))
    first = series.read(series.first_file(tunnel.folder, "result"))
    assert len(first.points) > len(last.points)
    begun = field._beginning(tunnel.folder, last, first)
    layers = np.isclose(last.points[:, 1], -3.0)
    assert layers.sum() > 20
    before, after = begun.point_data["coordination"][layers], last.point_data["coordination"][layers]
    assert np.ptp(before) > 0.3  # of two packings
    assert np.abs(after - before).max() < 0.15


# initial stress from weight -----------------------------------------------------------------------------------------

GROUND = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[mesh]
rectangle = { width = 6.0, height = 4.0, nx = 3, ny = 4 }
element = "P2"
[output]
pictures = false
[initial]
from = "weight"
k0 = 0.7
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }, { boundary = "left", components = ["x"] }, { boundary = "right", components = ["x"] }]
body_force = [{ value = [0.0, -17e3] }]
pressure = [{ boundary = "top", value = 30e3 }]
[[stage]]
name = "more"
increments = 2
pressure = [{ boundary = "top", value = 31e3 }]
"""


@pytest.fixture
def ground(tmp_path: Path) -> Path:
    file = tmp_path / "ground.toml"
    file.write_text(GROUND)
    return file


def test_level_ground_is_in_balance(ground: Path) -> None:
    problem = prepare(load(str(ground))).problem
    depth = 4.0 - problem.space.points[:, 1]
    assert np.abs(problem.initial_stress[:, 1] + 30e3 + 17e3 * depth).max() < 1e-6
    assert np.abs(problem.initial_stress[:, 0] - 0.7 * problem.initial_stress[:, 1]).max() < 1e-9
    assert initial_imbalance(problem).fraction < 1e-12


@pytest.mark.parametrize(
    ("assignments", "text"),
    [
        (["initial.stress=[-1e5, -1e5, 0.0]"], 'from = "weight" takes the stress from the weight; leave out stress'),
        (["initial.from='height'"], "initial.from = 'height' is not one of stress, weight, gravity"),
        (["initial.k0=-0.5"], "initial.k0 = -0.5 is outside its bounds (0"),
        (["initial.from='stress'"], "stress is missing"),
        (["stage.0.body_force=[]"], "the first stage gives no weight (body_force) to region 'all'"),
        (["stage.0.body_force=[{value=[1.0, -17e3]}]"], "does not point straight down"),
        (["stage.0.name='start'"], "has to be named 'initial'"),
        (["initial.k0={all=0.5, most=0.6}"], "the region 'most' is unknown (legal: all); the nearest is 'all'"),
        (["initial.k0={}"], "k0 names no region"),
        (["initial.k0={all=-0.5}"], "initial.k0.all = -0.5 is outside its bounds (0"),
        (["initial.k0={all='half'}"], "initial.k0.all = 'half' is not a number"),
        (["initial.from='gravity'", "initial.balance=true"], "leave out balance"),
        (["stage.1.deactivate=['al']"], "the region 'al' is unknown (legal: all); the nearest is 'all'"),
        (["stage.1.deactivate=['all', 'all']"], "deactivate names region 'all' twice"),
        (["stage.1.deactivate=['all']", "stage.1.activate=['all']"], "'all' is both in deactivate and in activate"),
        (["stage.1.deactivate=['all']"], 'stage 2 "more" deactivates everything that is left'),
        (["stage.1.activate=['all']"], "every element is activated by a later stage"),
        (["stage.1.release=1.5"], "release = 1.5 is outside its bounds [0, 1]"),
        (["stage.1.release=0.5"], "release = 0.5, but no stage deactivates a region"),
        (["stage.1.fill_pressure=1e3"], "the stage activates no region"),
        (["stage.1.fill_pressure=-1e3"], "fill_pressure = -1000.0 is outside its bounds"),
        (
            ["effects.sliding=true", "material.peak_stress_ratio=0.17", "material.first_yield_stress_ratio=0.1",
             "material.constant_volume_stress_ratio=0.1", "material.reference_plastic_strain=1e-4"],
            "initial.k0 gives q/(p + c) = 0.1765 somewhere in it, but sliding admits less than "
            "material.peak_stress_ratio = 0.17; without cohesion k0 has to lie between 0.709 and 1.41",
        ),
    ],
)  # fmt: skip
def test_bad_input_gets_one_sentence(ground: Path, assignments: list[str], text: str) -> None:
    with pytest.raises(REFUSED) as caught:
        prepare(load(str(ground), assignments))
    assert text in str(caught.value), str(caught.value)


def test_sloping_ground_is_told_by_how_much(tmp_path: Path) -> None:
    loaded = load("slope", ["initial.from='weight'"])
    with pytest.raises(REFUSED, match=r"it rises by 4 m from \(.*\) to \(.*\).*gravity"):
        prepare(loaded)


# going on -----------------------------------------------------------------------------------------------------------

LAYERS = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[mesh]
file = "layers.msh"
element = "P1"
[output]
pictures = false
every = 2
[initial]
from = "weight"
k0 = 0.7
[effects]
stiffness_feedback = FEEDBACK
contact_loss = true
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }, { boundary = "left", components = ["x"] }, { boundary = "right", components = ["x"] }]
body_force = [{ value = [0.0, -17e3] }]
pressure = [{ boundary = "middle", value = 30e3 }]
[[stage]]
name = "dig"
increments = 3
deactivate = ["trench"]
release = 0.3
[[stage]]
name = "rest"
increments = 2
reset_displacements = true
[[stage]]
name = "fill"
increments = 3
activate = ["trench", "fill"]
fill_pressure = 25e3
pressure = [{ boundary = "middle", value = 0.0 }, { boundary = "top", value = 25e3 }]
"""


def layers_file(folder: Path) -> None:
    """Level ground of 2 m with a trench beside its upper half, and 1 m of fill on it, as a Gmsh file."""
    import meshio

    nx, ny = 4, 6
    x, y = np.meshgrid(np.linspace(0, 4, nx + 1), np.linspace(0, 3, ny + 1))
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    node = np.arange(len(points)).reshape(ny + 1, nx + 1)
    a, b, c, d = (part.ravel() for part in (node[:-1, :-1], node[:-1, 1:], node[1:, 1:], node[1:, :-1]))
    cells = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    centre = points[cells].mean(axis=1)
    region = np.where(centre[:, 1] > 2.0, 12, np.where((centre[:, 1] > 1.0) & (centre[:, 0] < 1.0), 11, 10))
    lines = {1: node[0], 2: node[4], 3: node[-1], 4: node[:, 0], 5: node[:, -1]}
    sides = np.concatenate([np.stack([line[:-1], line[1:]], 1) for line in lines.values()])
    tags = np.concatenate([np.full(len(line) - 1, tag) for tag, line in lines.items()])
    groups = {name: np.array([tag, 1]) for name, tag in zip(("bottom", "middle", "top", "left", "right"), lines)}
    groups |= {name: np.array([tag, 2]) for name, tag in (("ground", 10), ("trench", 11), ("fill", 12))}
    mesh = meshio.Mesh(
        points,
        [("line", sides), ("triangle", cells)],
        cell_data={"gmsh:physical": [tags, region], "gmsh:geometrical": [tags, region]},
        field_data=groups,
    )
    mesh.write(folder / "layers.msh", file_format="gmsh22")


@pytest.mark.parametrize("every", [1, 100])
def test_places_without_ground_name_the_stage(tmp_path: Path, every: int) -> None:
    """As far as what was written tells: with start and end alone a fill can only have come in between."""
    layers_file(tmp_path)
    (tmp_path / "layers.toml").write_text(LAYERS.replace("FEEDBACK", "false"))
    results = gf.run_scene(
        tmp_path / "layers.toml", {"output.pictures": False, "output.every": every}, tmp_path / "out"
    )
    trench, fill, ground, outside = (0.5, 1.5), (2.0, 2.5), (2.0, 1.5), (9.0, 1.0)
    for place in (trench, fill, ground):
        results.at(*place)
    results.at(*ground, 0), results.at(*trench, 0)
    assert results.record["numbers"] == {"region": {"1": "ground", "2": "trench", "3": "fill"}}
    with pytest.raises(REFUSED, match=r'at step 0: the ground there is not there before stage "fill"'):
        results.at(*fill, 0)
    with pytest.raises(REFUSED, match=r"\(9, 1\) lies outside of the mesh, which reaches"):
        results.at(*outside)
    if every > 1:
        return
    for step in (2, 4, 6):
        with pytest.raises(REFUSED, match=rf'at step {step}: the ground there is gone since stage "dig"'):
            results.at(*trench, step)
        with pytest.raises(REFUSED, match=rf'at step {step}: the ground there is not there before stage "fill"'):
            results.at(*fill, step)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({'activate = ["trench", "fill"]': 'activate = ["trench"]'},
         "boundary 'middle' lies inside the body between regions 'ground', 'trench', 'fill', so that"),
        ({'activate = ["trench", "fill"]': 'activate = ["trench"]', 'deactivate = ["trench"]': "",
          "[0.0, -17e3] }": "[0.0, -17e3], region = 'ground' }"},
         r"gives no weight \(body_force\) to region 'fill', .* \(no stage activates it, so that it is there from the"),
        ({'activate = ["trench", "fill"]': 'activate = ["trench"]', "k0 = 0.7": "k0 = { ground = 0.7, trench = 0.7 }"},
         r"k0 leaves out region 'fill' \(no stage activates it, so that it is there from the outset\)"),
    ],
)  # fmt: skip
def test_a_region_that_no_stage_activates_is_named(tmp_path: Path, changes: dict[str, str], said: str) -> None:
    layers_file(tmp_path)
    text = LAYERS.replace("FEEDBACK", "false")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "layers.toml").write_text(text)
    with pytest.raises(REFUSED, match=said):
        prepare(load(str(tmp_path / "layers.toml")))


@pytest.mark.parametrize("feedback", ["true", "false"])
def test_going_on_in_the_middle_of_an_excavation_gives_the_same_files(
    tmp_path: Path, granfabric: Callable, monkeypatch: pytest.MonkeyPatch, feedback: str
) -> None:
    layers_file(tmp_path)
    scene = tmp_path / "layers.toml"
    scene.write_text(LAYERS.replace("FEEDBACK", feedback))
    assert granfabric("run", scene, "-o", tmp_path / "whole").code == 0
    from granfabric.cases.records.field_recorder import FieldRecorder

    save = FieldRecorder.save
    for stop in (2, 3, 5, 7):
        saved = []

        def counted(self, checkpoint, saved=saved, stop=stop):
            save(self, checkpoint)
            saved.append(checkpoint.result.step)
            if checkpoint.result.step >= stop:
                raise KeyboardInterrupt

        monkeypatch.setattr(FieldRecorder, "save", counted)
        folder = tmp_path / f"stopped_{stop}"
        assert granfabric("run", scene, "-o", folder).code != 0
        monkeypatch.setattr(FieldRecorder, "save", save)
        assert granfabric("run", scene, "-o", folder, "--resume").code == 0
        whole = {file.name: file.read_bytes() for file in (tmp_path / "whole").iterdir()}
        names = [name for name in whole if name.endswith((".vtu", ".csv", ".pvd"))]
        assert len(names) > 8
        for name in names:
            assert (folder / name).read_bytes() == whole[name], name
        one, two = (json.loads((place / files.RECORD).read_text())["body"] for place in (tmp_path / "whole", folder))
        assert one == two


def test_means_are_of_what_is_there(tmp_path: Path, granfabric: Callable) -> None:
    layers_file(tmp_path)
    scene = tmp_path / "layers.toml"
    scene.write_text(LAYERS.replace("FEEDBACK", "true"))
    assert granfabric("run", scene, "-o", tmp_path / "out", "--set", "output.every=1").code == 0
    results = gf.read_results(tmp_path / "out")
    problem = prepare(load(str(scene))).problem
    space = problem.space
    for step in (0, 4, 9):
        row = results.history.iloc[step]
        body = problem.program.terms[[s.name for s in problem.stages].index(row.stage)].body
        weights = space.weights[body.active[space.point_cell]]
        table = results.points.table(step)
        assert len(table) == len(weights)
        assert row.stress_yy == pytest.approx(float(weights @ table.stress_yy / weights.sum()), rel=1e-12)
        assert row.coordination_smallest == pytest.approx(table.coordination.min())
    # nothing is left of what was taken away, and a boundary that is not there has not moved
    assert results.history.displacement_top_y.iloc[1] == 0.0 and results.history.displacement_top_y.iloc[-1] != 0.0
    # weight and load of the whole in the end
    assert results.history.reaction_bottom_y.iloc[-1] == pytest.approx(17e3 * 12 + 25e3 * 4, rel=1e-6)


# with what else a scene may have --------------------------------------------------------------------------------------

WATER = ("material.fluid_bulk_stiffness=2.2e9", "initial.water_level=3.0")


def test_wet_ground_has_k0_of_what_the_grains_carry(ground: Path) -> None:
    """Weight gives the total stress, water takes its part, the rest has K0; both are in balance."""
    problem = prepare(load(str(ground), WATER)).problem
    y = problem.space.points[:, 1]
    pressure = 9810.0 * np.maximum(3.0 - y, 0.0)
    total = -30e3 - 17e3 * (4.0 - y)
    assert problem.initial_stress[:, 1] == pytest.approx(total, rel=1e-12)
    assert problem.initial_stress[:, 0] == pytest.approx(0.7 * (total + pressure) - pressure, rel=1e-12)
    assert initial_imbalance(problem).fraction < 1e-12
    with pytest.raises(REFUSED, match="the pore pressure is not below the weight of what lies above"):
        prepare(load(str(ground), [*WATER, "initial.water_level=9.0"]))


def test_a_fill_of_a_random_packing_begins_under_its_pressure(tmp_path: Path) -> None:
    layers_file(tmp_path)
    scene = tmp_path / "layers.toml"
    scene.write_text(LAYERS.replace("FEEDBACK", "true"))
    random = "random_state={seed=1, standard_deviation=0.05, correlation_length=[1.0, 1.0]}"
    problem = prepare(load(str(scene), [random])).problem
    fill = np.isin(problem.space.point_cell, problem.space.host_mesh.cells("fill"))
    z = problem.initial_state[fill][:, problem.law.description.columns("coordination")]
    assert (problem.initial_stress[fill] == (-25e3, -25e3, 0.0)).all() and np.ptp(z) > 0.01


def test_a_stress_that_is_given_need_not_hold_where_nothing_is(tmp_path: Path) -> None:
    layers_file(tmp_path)
    scene = tmp_path / "layers.toml"
    text = LAYERS.replace("FEEDBACK", "true").replace('from = "weight"\nk0 = 0.7\n', "")
    given = "stress = [-21e3, -30e3, 0.0]\nreference_point = [0.0, 2.0]\nstress_gradient_y = [11.9e3, 17e3, 0.0]\n"
    scene.write_text(
        text.replace("[initial]\n", f"[initial]\n{given}").replace("30e3", "10e3").replace("-21e3", "-7e3")
    )
    problem = prepare(load(str(scene))).problem  # at the top of the fill it would be tension
    assert initial_imbalance(problem).fraction < 1e-12

"""Files for ParaView, read back with VTK's own reader."""

from __future__ import annotations

import os
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from fem_meshes import ELEMENTS, PLASTIC, distorted, nodal, run
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import (
    VTK_BIQUADRATIC_QUAD,
    VTK_QUAD,
    VTK_QUADRATIC_TRIANGLE,
    VTK_TRIANGLE,
    vtkPolyData,
)
from vtkmodules.vtkFiltersCore import vtkProbeFilter
from vtkmodules.vtkFiltersVerdict import vtkCellSizeFilter
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from granfabric.constitutive.contract import LawDescription, Variable
from granfabric.fem.discretisation.parts import parts
from granfabric.fem.discretisation.projection import Projection
from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.kinds import Displacement, Fixed, Stage
from granfabric.fem.mesh.shapes import quarter_ring
from granfabric.fem.output.cells import vtk_cells, whole_cells
from granfabric.fem.output.compression import encoded
from granfabric.fem.output.derived import DERIVED, derived
from granfabric.fem.output.fields import FieldWriter, OutputError, padded_tensor, padded_vector, point_fields
from granfabric.fem.output.recovery import Recovery
from granfabric.fem.output.vtu import GridWriter

PRESS = [Fixed("bottom"), Displacement("top", "y", -0.01)]
VTK_CELLS = {"P1": VTK_TRIANGLE, "P2": VTK_QUADRATIC_TRIANGLE, "Q1": VTK_QUAD, "Q2": VTK_BIQUADRATIC_QUAD}


def read(path):
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    assert reader.GetErrorCode() == 0
    return reader.GetOutput()


def array(grid, name):
    found = grid.GetPointData().GetArray(name)
    assert found is not None, name
    return vtk_to_numpy(found)


def vertices(number):
    return [("vertex", np.arange(number).reshape(-1, 1))]


def series(path):
    return [(float(e.attrib["timestep"]), e.attrib["file"]) for e in ElementTree.parse(path).getroot().iter("DataSet")]


@pytest.mark.parametrize("element", ELEMENTS)
def test_every_file_of_both_series_reads_back(element, tmp_path):
    space = Space(distorted(element), element)
    steps, _ = run(space, PLASTIC, [Stage("press", PRESS, 2)])
    writer = FieldWriter(tmp_path / "new" / "folder", space, PLASTIC.description)
    for step in steps:
        writer.write(step, step.fraction)
        # What a series names is complete after each step.
        for name in ("result", "points"):
            for _, file in series(writer.folder / f"{name}.pvd"):
                assert read(writer.folder / file).GetNumberOfPoints() > 0
    assert [time for time, _ in series(writer.folder / "result.pvd")] == [0.5, 1.0]
    for (_, fields), (_, points), step in zip(
        series(writer.folder / "result.pvd"), series(writer.folder / "points.pvd"), steps
    ):
        grid = read(writer.folder / fields)
        assert grid.GetNumberOfPoints() == space.nnodes and grid.GetNumberOfCells() == space.nelements
        assert grid.GetCellType(0) == VTK_CELLS[element]
        displacement = array(grid, "displacement")
        assert displacement.shape == (space.nnodes, 3)
        np.testing.assert_array_equal(displacement[:, :2], nodal(step))
        assert array(grid, "stress").shape == (space.nnodes, 9)
        size = vtkCellSizeFilter()
        size.SetInputData(grid)
        size.Update()
        area = vtk_to_numpy(size.GetOutput().GetCellData().GetArray("Area"))
        assert (area > 0).all() and area.sum() == pytest.approx(2.0, rel=1e-10)
        cloud = read(writer.folder / points)
        assert cloud.GetNumberOfPoints() == space.npoints
        stress = array(cloud, "stress")
        np.testing.assert_array_equal(stress[:, [0, 4, 1, 3]], step.stress[:, [0, 1, 2, 2]])
        np.testing.assert_array_equal(stress[:, 8], step.state[:, 0])  # out-of-plane stress
        np.testing.assert_array_equal(array(cloud, "strain")[:, 1], 0.5 * step.strain[:, 2])
        np.testing.assert_array_equal(array(cloud, "plastic_strain"), step.state[:, 1])
        np.testing.assert_array_equal(array(cloud, "status"), 0)
        moved = array(cloud, "displacement")
        np.testing.assert_allclose(moved[:, :2], space.interpolate(nodal(step)), atol=1e-15)
        assert not moved[:, 2].any()
        # of the nodes, what is projected
        recover = Projection(space)
        np.testing.assert_allclose(array(grid, "stress")[:, [0, 4, 1, 3]], recover(step.stress)[:, [0, 1, 2, 2]])
        strain = recover(step.strain) * [1.0, 1.0, 0.5]
        np.testing.assert_allclose(array(grid, "strain")[:, [0, 4, 1, 3]], strain[:, [0, 1, 2, 2]], atol=1e-15)
        names = {"stress", "strain", "displacement", *DERIVED}
        names |= {variable.name for variable in PLASTIC.description.state}
        for data, more in ((grid, set()), (cloud, {"status", "element", "region", "material"})):
            arrays = data.GetPointData()
            assert {arrays.GetArrayName(place) for place in range(arrays.GetNumberOfArrays())} == names | more
    assert not [name for name in os.listdir(writer.folder) if name.startswith(".")]


def test_midside_nodes_lie_in_the_middle_of_vtk_sides(tmp_path):
    for element in ("P2", "Q2"):
        space = Space(distorted(element), element)
        steps, _ = run(space, PLASTIC, [Stage("press", PRESS)])
        writer = FieldWriter(tmp_path / element, space, PLASTIC.description)
        writer.write(steps[0], 1.0)
        grid = read(writer.folder / "result_0001.vtu")
        corners = 3 if element == "P2" else 4
        for number in range(grid.GetNumberOfCells()):
            cell = grid.GetCell(number)
            place = np.array([cell.GetPoints().GetPoint(i)[:2] for i in range(cell.GetNumberOfPoints())])
            for side in range(corners):
                middle = (place[side] + place[(side + 1) % corners]) / 2
                np.testing.assert_allclose(place[corners + side], middle, atol=1e-14)


def test_state_of_vectors_and_tensors_is_padded_by_description():
    class Record:
        stress = np.ones((2, 3))
        strain = np.ones((2, 3))
        state = np.arange(12.0).reshape(2, 6)

    law = LawDescription(
        "made up", (Variable("a", ""), Variable("b", "", components=2), Variable("c", "", components=3)), ()
    )
    fields = point_fields(Record, law)
    assert set(fields) == {"stress", "strain", "a", "b", "c"}
    np.testing.assert_array_equal(fields["a"], [0.0, 6.0])
    np.testing.assert_array_equal(fields["b"], [[1.0, 2.0, 0.0], [7.0, 8.0, 0.0]])
    np.testing.assert_array_equal(fields["c"][0], [3, 5, 0, 5, 4, 0, 0, 0, 0])
    np.testing.assert_array_equal(padded_tensor(np.array([[1.0, 2.0, 4.0]]), 0.5)[0], [1, 2, 0, 2, 2, 0, 0, 0, 0])


def test_going_on_keeps_the_chosen_steps_of_the_series(tmp_path):
    space = Space(distorted("P1"), "P1")
    steps, _ = run(space, PLASTIC, [Stage("press", PRESS, 4)])
    writer = FieldWriter(tmp_path, space, PLASTIC.description)
    for step in steps[:3]:
        writer.write(step, step.fraction)
    again = FieldWriter(tmp_path, space, PLASTIC.description, keep=lambda step: step <= 2)
    assert not (tmp_path / "result_0003.vtu").exists()
    assert [time for time, _ in series(tmp_path / "points.pvd")] == [0.25, 0.5]
    again.write(steps[2], 0.75)
    again.write(steps[3], 1.0)
    assert [time for time, _ in series(tmp_path / "result.pvd")] == [0.25, 0.5, 0.75, 1.0]
    (tmp_path / "points_0002.vtu").unlink()
    with pytest.raises(OutputError, match=r"names points_0002.vtu, which is gone"):
        FieldWriter(tmp_path, space, PLASTIC.description, keep=lambda step: True)
    (tmp_path / "result.pvd").write_text("<VTKFile")
    with pytest.raises(OutputError, match="is damaged"):
        FieldWriter(tmp_path, space, PLASTIC.description, keep=lambda step: True)
    fresh = FieldWriter(tmp_path, space, PLASTIC.description)
    fresh.write(steps[0], 0.25)
    assert len(series(tmp_path / "points.pvd")) == 1


@pytest.mark.parametrize("element", ELEMENTS)
def test_meshio_reads_the_same(element, tmp_path):
    space = Space(distorted(element), element)
    steps, _ = run(space, PLASTIC, [Stage("press", PRESS, 1)])
    FieldWriter(tmp_path, space, PLASTIC.description).write(steps[0], 1.0)
    for name in ("result", "points"):
        grid, other = read(tmp_path / f"{name}_0001.vtu"), meshio.read(tmp_path / f"{name}_0001.vtu")
        np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), other.points)
        cells = vtk_to_numpy(grid.GetCells().GetConnectivityArray())
        np.testing.assert_array_equal(cells, np.concatenate([block.data.ravel() for block in other.cells]))
        assert grid.GetPointData().GetNumberOfArrays() == len(other.point_data)
        for field, values in other.point_data.items():
            np.testing.assert_array_equal(array(grid, field), values)


def test_a_field_of_another_size_is_refused_and_leaves_nothing(tmp_path):
    writer = GridWriter(np.zeros((2, 3)), vertices(2))
    with pytest.raises(ValueError, match=r"'a' has the shape \(3,\), but there are 2 points"):
        writer.write(tmp_path / "points.vtu", {"a": np.zeros(3)})
    assert not list(tmp_path.iterdir())


def test_random_bytes_survive(tmp_path):
    # Raw data may hold anything, the names of the tags around them included.
    values = np.frombuffer(b"\n</AppendedData>_\n" * 8 + b"12345678" * 2, dtype=np.float64)
    writer = GridWriter(np.zeros((len(values), 3)), vertices(len(values)))
    random = np.random.default_rng(1).integers(0, 2**63, 1000).astype(np.int64)
    writer.write(tmp_path / "a.vtu", {"tags": values})
    np.testing.assert_array_equal(array(read(tmp_path / "a.vtu"), "tags"), values)
    writer = GridWriter(np.zeros((1000, 3)), vertices(1000))
    writer.write(tmp_path / "b.vtu", {"random": random})
    np.testing.assert_array_equal(array(read(tmp_path / "b.vtu"), "random"), random)


def test_folder_that_cannot_be_written_is_one_sentence(tmp_path):
    space = Space(distorted("P1"), "P1")
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(OutputError, match=r"output folder .* cannot be written"):
        FieldWriter(blocked / "inside", space, PLASTIC.description)


def test_extra_fields_are_written_to_both_series(tmp_path):
    space = Space(distorted("P2"), "P2")
    steps, _ = run(space, PLASTIC, [Stage("press", PRESS)])
    writer = FieldWriter(tmp_path, space, PLASTIC.description)
    writer.write(steps[0], 1.0, {"height": space.points[:, 1]})
    np.testing.assert_allclose(array(read(tmp_path / "result_0001.vtu"), "height"), space.nodes[:, 1], atol=1e-11)
    np.testing.assert_array_equal(array(read(tmp_path / "points_0001.vtu"), "height"), space.points[:, 1])


@pytest.mark.parametrize("compression", ["none", "fast", "small"])
def test_arrays_are_read_wherever_they_begin(tmp_path, compression):
    """meshio takes an array for an earlier one if it begins where that one would be in base64, uncompressed."""
    noise = np.random.default_rng(1)
    rows = 64
    one = 4 * -(-(8 + 8 * rows) // 3)  # so long is an array there
    writer = GridWriter(np.zeros((rows, 3)), vertices(rows), compression)
    met = 0
    for repeat in range(300):
        fields = {"zero": np.zeros(rows), "noise": noise.random(rows), "some": np.zeros(rows), "last": np.ones(rows)}
        fields["some"][: 1 + repeat % 8] = noise.random(1 + repeat % 8)
        sizes = [len(encoded(values, compression)) for values in fields.values()]
        if compression == "none":  # arrays of one size begin at 4 times 520 where three of them would end
            met += 1
        elif not {sum(sizes[:last]) for last in range(1, 5)} & {one, 2 * one, 3 * one}:
            continue
        met += 1
        writer.write(tmp_path / "a.vtu", fields)
        grid, other = read(tmp_path / "a.vtu"), meshio.vtu.read(tmp_path / "a.vtu")
        for name, values in fields.items():
            np.testing.assert_array_equal(array(grid, name), values)
            np.testing.assert_array_equal(other.point_data[name], values)
        if repeat > 20 and compression != "fast":
            break
    assert met or compression == "small"


@pytest.mark.parametrize(("element", "cell"), [("P2", "triangle"), ("Q2", "quad")])
def test_vtk_probes_find_every_place_in_curved_cells(tmp_path, element, cell):
    """Whole, VTK misses most of them; the file holds these cells cut into straight ones."""
    space = Space(quarter_ring(1.0, 3.0, 3, 4, cell), element)
    random = np.random.default_rng(1)
    radius, angle = random.uniform(1.03, 2.9, 200), random.uniform(0.02, 1.55, 200)
    places = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(200)])
    nodes = parts(space)
    found = {}
    for name, cells in {"whole": [whole_cells(space, nodes)], "cut": vtk_cells(space, nodes).blocks}.items():
        GridWriter(padded_vector(space.nodes), cells).write(tmp_path / "a.vtu", {"place": padded_vector(space.nodes)})
        points, where, probe = vtkPoints(), vtkPolyData(), vtkProbeFilter()
        points.SetData(numpy_to_vtk(places, deep=True))
        where.SetPoints(points)
        probe.SetInputData(where)
        probe.SetSourceData(read(tmp_path / "a.vtu"))
        probe.Update()
        data = probe.GetOutput().GetPointData()
        found[name] = vtk_to_numpy(data.GetArray("vtkValidPointMask")).astype(bool)
    assert found["cut"].all() and not found["whole"].all()
    np.testing.assert_allclose(vtk_to_numpy(data.GetArray("place")), places, atol=1e-5)


def test_nothing_is_smoothed_across_materials(tmp_path):
    space = Space(distorted("P2"), "P2")
    centre = space.nodes[space.element_nodes[:, :3]].mean(axis=1)
    of_cell = (centre[:, 0] > centre[:, 0].mean()).astype(np.int64)
    index = of_cell[space.point_cell]
    recovery = Recovery(space, index)
    nodes, further = recovery.nodes, len(recovery.nodes.node) - space.nnodes
    assert further > 0 and np.array_equal(nodes.node[: space.nnodes], np.arange(space.nnodes))
    # a field that is linear in each material and jumps between them comes out as it is
    values = np.where(index == 1, 5.0 + space.points[:, 0], -3.0 + space.points[:, 1])
    at_nodes = recovery.field(values)
    for number in (0, 1):
        mine = np.unique(nodes.element_nodes[of_cell == number])
        x, y = space.nodes[nodes.node[mine]].T
        np.testing.assert_allclose(at_nodes[mine], 5.0 + x if number else -3.0 + y, atol=1e-9)
    # one material: as without
    np.testing.assert_array_equal(Recovery(space).field(values), Projection(space)(values))


def test_what_is_read_off_a_stress():
    stress = np.array([[-3.0, -1.0, 0.0], [-1.0, -3.0, 0.0], [-2.0, -2.0, -1.0], [-2.0, -2.0, 0.0], [1.0, 1.0, 0.5]])
    made = derived(stress, stress)
    np.testing.assert_allclose(made["p"], [2.0, 2.0, 2.0, 2.0, -1.0])
    np.testing.assert_allclose(made["q"], [1.0, 1.0, 1.0, 0.0, 0.5])
    np.testing.assert_allclose(made["stress_ratio"], [0.5, 0.5, 0.5, 0.0, np.nan])
    root = np.sqrt(0.5)
    major = [[1, 0, 0], [0, 1, 0], [root, root, 0], [0, 0, 0], [-root, root, 0]]
    np.testing.assert_allclose(made["principal_direction_major"], major, atol=1e-12)
    for name in ("major", "minor"):
        direction, value = made[f"principal_direction_{name}"][:, :2], made[f"principal_stress_{name}"]
        full = np.stack([stress[:, [0, 2]], stress[:, [2, 1]]], axis=1)
        np.testing.assert_allclose(np.einsum("nij,nj->ni", full, direction), value[:, None] * direction, atol=1e-12)
    assert (made["principal_stress_major"] <= made["principal_stress_minor"]).all()

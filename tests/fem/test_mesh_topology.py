"""One body, or a refusal that says where and why: hanging and doubled nodes, parts, overlaps, hinges."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granfabric.fem.mesh.host_mesh import HostMesh, MeshError, TopologyError, build_mesh, rectangle
from granfabric.fem.mesh.near_boxes import overlapping_boxes
from granfabric.fem.mesh.topology import parts_of, twin_sides

SIZES = (1.0, 1e-3, 1e4)


def block(nx: int, ny: int, corner=(0.0, 0.0), size=(1.0, 1.0), cell="quad") -> tuple[np.ndarray, np.ndarray]:
    """Points and cells of a rectangle."""
    host = rectangle(1.0, 1.0, nx, ny, cell)
    return host.mesh.p.T * size + corner, host.mesh.t.T.astype(np.int64)


def together(*blocks, merge: bool = False) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Blocks in one mesh, each a region a, b, ...; nodes at one place become one if asked for."""
    points = np.concatenate([p for p, _ in blocks])
    starts = np.cumsum([0, *(len(p) for p, _ in blocks)])
    cells = np.concatenate([c + start for (_, c), start in zip(blocks, starts)])
    ends = np.cumsum([0, *(len(c) for _, c in blocks)])
    regions = {"abcdefgh"[k]: np.arange(ends[k], ends[k + 1]) for k in range(len(blocks))}
    if merge:
        _, first, inverse = np.unique(points.round(12), axis=0, return_index=True, return_inverse=True)
        points, cells = points[first], inverse.ravel()[cells]
    return points, cells, regions


def built(mesh, parts: str = "joined", scale: float = 1.0, turn: float = 0.0, away: float = 0.0) -> HostMesh:
    points, cells, regions = mesh
    c, s = np.cos(turn), np.sin(turn)
    return build_mesh(scale * points @ np.array([[c, s], [-s, c]]) + away, cells, None, regions, parts=parts)


def refused(mesh, sentence: str, parts: str = "joined", **options) -> TopologyError:
    with pytest.raises(TopologyError, match=sentence) as caught:
        built(mesh, parts, **options)
    return caught.value


HANGING = together(block(2, 2), block(4, 2, (0, 1)), merge=True)
LAYERS = together(block(2, 2), block(2, 2, (0, 1)))
NOT_MATCHING = together(block(2, 2), block(3, 2, (0, 1)))
APART = together(block(2, 2), block(2, 2, (3, 0)))
CORNER = together(block(2, 2), block(2, 2, (1, 1)), merge=True)
SHIFTED = together(block(4, 4), block(4, 4, (0.5, 0)))
ON_TOP = together(block(4, 4), block(3, 3))
INSIDE = together(block(3, 3), block(1, 1, (0.4, 0.4), (0.1, 0.1)))
CROSS = together(block(1, 3, (1, 0), (1, 3)), block(3, 1, (0, 1), (3, 1)))


@pytest.mark.parametrize("scale", SIZES)
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_hanging_nodes_are_refused_whatever_is_asked_for(scale, turn):
    for parts in ("joined", "separate"):
        error = refused(
            HANGING,
            "has hanging nodes: .*between region 'a' and region 'b'; 2 such nodes.*Coherence",
            parts,
            scale=scale,
            turn=turn,
        )
        assert len(error.places) == 2 and error.mesh.mesh.t.shape[1] == 12
        assert "separate" not in str(error)
    place = refused(HANGING, "hanging").places
    np.testing.assert_allclose(place[place[:, 0].argsort()], [[0.25, 1.0], [0.75, 1.0]])
    assert re.search(
        r"node at \(0.25, 1\) lies on the side from \(0(.5)?, 1\) to \(0(.5)?, 1\)", str(refused(HANGING, "hanging"))
    )


def test_a_hanging_node_in_triangles_and_inside_one_region():
    """Red refinement of one of two triangles without its neighbour."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 0.5]])
    cells = np.array([[0, 2, 3], [0, 4, 6], [4, 1, 5], [6, 5, 2], [4, 5, 6]])
    with pytest.raises(
        TopologyError,
        match=r"node at \(0.5, 0.5\) lies on the side from \(0, 0\) to \(1, 1\).*in region 'all'; 1 such node in all",
    ):
        build_mesh(points, cells, regions={"all": np.arange(5)})
    with pytest.raises(TopologyError, match="a cell of no region"):
        build_mesh(points, cells)


@pytest.mark.parametrize("scale", SIZES)
def test_doubled_nodes(scale):
    error = refused(
        LAYERS,
        r"falls into 2 parts that touch: two nodes .* 3 such places.*removeDuplicateNodes.*separate",
        scale=scale,
    )
    assert len(error.places) == 3
    host = built(LAYERS, "separate", scale=scale)
    assert len(twin_sides(host.mesh)) == 2
    # a thousandth of a side apart is still one place; a tenth is a gap
    points, cells, regions = LAYERS
    for gap, touches in ((1e-4, True), (0.1, False)):
        moved = points + np.where(np.arange(len(points)) >= 9, gap, 0.0)[:, None] * [0, 1]
        refused((moved, cells, regions), "that touch" if touches else "that do not touch", scale=scale)


def test_nodes_of_one_body_on_sides_of_another():
    refused(NOT_MATCHING, r"2 parts that touch: the node .* lies on the side.*; 3 such nodes.*separate")
    assert parts_of(built(NOT_MATCHING, "separate").mesh).max() == 1


def test_parts_that_do_not_touch_are_listed():
    error = refused(APART, r"2 parts that do not touch \(region 'a', 4 cells at .*; region 'b', 4 cells at .*separate")
    assert len(error.places) == 2
    built(APART, "separate")
    many = together(*[block(1, 1, (2 * k, 0)) for k in range(5)])
    refused(many, "falls into 5 parts .* and 2 more")


def test_a_hinge():
    error = refused(CORNER, r"hang together at single nodes only, as at a hinge, such as the one at \(1, 1\)")
    np.testing.assert_allclose(error.places, [[1.0, 1.0]])
    built(CORNER, "separate")
    # a node in which two holes meet is no hinge: the body holds together around it
    points, cells = block(4, 4)
    holes = [
        k for k, cell in enumerate(cells) if tuple(points[cell].mean(axis=0)) not in ((0.375, 0.375), (0.625, 0.625))
    ]
    assert len(holes) == 14
    build_mesh(points, cells[holes])


@pytest.mark.parametrize("mesh", [SHIFTED, ON_TOP, INSIDE, CROSS], ids=["shifted", "on top", "inside", "cross"])
@pytest.mark.parametrize("parts", ["joined", "separate"])
@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_overlaps_are_refused_whatever_is_asked_for(mesh, parts, turn):
    for scale in SIZES:
        error = refused(
            mesh, "2 parts that overlap: .*between region 'a' and region 'b'.*Boolean", parts, scale=scale, turn=turn
        )
        assert len(error.places)


@pytest.mark.parametrize("parts", ["joined", "separate"])
def test_a_spike_through_a_side(parts):
    """The middles of all sides are free: only the sides that cross tell."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    spike = np.array([[0.9, 0.9], [0.95, 2], [0.85, 2]]), np.array([[0, 1, 2]])
    refused(together(square, spike), "2 parts that overlap: .*between region 'a' and region 'b'", parts)
    away = spike[0] + [0, 0.11], spike[1]
    refused(together(square, away), "2 parts that do not touch")


def test_a_strip_that_runs_over_itself():
    """One part: a ring of more than one turn."""
    angle = np.linspace(0, 2.4 * np.pi, 40)
    points = np.concatenate([r * np.stack([np.cos(angle), np.sin(angle)], axis=1) for r in (1.0, 1.5)])
    k = np.arange(39)
    cells = np.stack([k, k + 40, k + 41, k + 1], axis=1)
    for parts in ("joined", "separate"):
        refused((points, cells, {}), "the mesh overlaps itself: cells lie over cells", parts)
    # less than a turn is a body
    built((points, cells[:30], {}))


def test_cells_that_share_a_corner_and_lie_over_each_other():
    """They share nodes but no side."""
    points = np.array([[0, 0], [1, 0], [0, 1], [1, 0.2], [0.2, 1.0], [-1, 0.0]])
    refused((points, np.array([[0, 1, 2], [0, 3, 4]]), {}), "overlap")


def test_curved_interfaces_with_different_nodes_may_touch():
    """Chords of a ring and of a disk with other nodes cut into each other by a little."""

    def disk(n):
        angle = 2 * np.pi * np.arange(n) / n
        return np.concatenate([[[0, 0]], np.stack([np.cos(angle), np.sin(angle)], axis=1)]), np.array(
            [[0, 1 + k, 1 + (k + 1) % n] for k in range(n)]
        )

    def ring(n):
        angle = 2 * np.pi * np.arange(n) / n
        around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.concatenate([around, 1.3 * around]), np.array(
            [part for k in range(n) for part in ([k, n + k, n + (k + 1) % n], [k, n + (k + 1) % n, (k + 1) % n])]
        )

    built(together(disk(48), ring(60)), "separate")
    refused(together(disk(48), ring(60)), "2 parts that ")
    points, cells = disk(48)
    refused(together((1.2 * points, cells), ring(60)), "2 parts that overlap", "separate")


def test_a_crack_within_a_body():
    points, cells = block(8, 8)
    on = [k for k, (x, y) in enumerate(points) if y == 0.5 and 0.2 < x < 0.8]
    assert len(on) == 5
    new = len(points) + np.arange(5)
    upper = points[cells].mean(axis=1)[:, 1] > 0.5
    opened = cells.copy()
    for old, other in zip(on, new):
        opened[upper] = np.where(cells[upper] == old, other, opened[upper])
    mesh = np.concatenate([points, points[on]]), opened, {"body": np.arange(64)}
    refused(mesh, r"the mesh has doubled nodes: .*in region 'body'; 5 such places")
    host = built(mesh, "separate")
    assert len(twin_sides(host.mesh)) == 6 and parts_of(host.mesh).max() == 0


def test_a_thin_layer_is_no_pair_of_faces():
    """Cells a thousand times as long as high, nodes above between those below."""
    points, cells = block(4, 2, (0, 0), (4.0, 8e-4))
    points[:, 0] += 0.5 * points[:, 1] / 8e-4
    host = built((points, cells, {}))
    assert not len(twin_sides(host.mesh))


def test_words_for_parts():
    with pytest.raises(MeshError, match="parts = 'apart' is not one of 'joined', 'separate'"):
        built(APART, "apart")


def test_a_region_of_elements_that_are_not_there():
    points, cells = block(1, 1)
    with pytest.raises(MeshError, match=r"region 'a' must be an array of integers in 0 \.\.\. 0 .* but holds 1"):
        build_mesh(points, cells, regions={"a": np.array([0, 1])})


@settings(max_examples=40, deadline=None)
@given(
    n=st.tuples(*[st.integers(1, 6)] * 2),
    cell=st.sampled_from(["triangle", "quad"]),
    stretch=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    turn=st.floats(0, 6.3),
    away=st.floats(-1e3, 1e3),
    grading=st.floats(-3, 3),
    seed=st.integers(0, 1000),
)
def test_good_meshes_are_never_refused(n, cell, stretch, turn, away, grading, seed):
    """Graded, stretched by up to 1e3, turned, moved, cells with nodes in another sequence."""
    points, cells = block(*n, cell=cell)
    points = (np.exp(grading * points) - 1) / (np.exp(grading) - 1) if abs(grading) > 1e-3 else points
    points = points * 10.0 ** np.array(stretch)
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(points))
    place = np.argsort(order)
    host = built((points[order], place[cells][rng.permutation(len(cells))], {}), turn=turn, away=away)
    assert parts_of(host.mesh).max() == 0 and not len(twin_sides(host.mesh))


@settings(max_examples=60, deadline=None)
@given(
    shift=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    size=st.tuples(st.floats(0.2, 3), st.floats(0.2, 3)),
    n=st.tuples(*[st.integers(1, 4)] * 4),
    turn=st.floats(0, 6.3),
)
def test_two_rectangles_overlap_exactly_if_their_areas_do(shift, size, n, turn):
    """The rectangle [0, 1]^2 and another: what "separate" says against the overlap in closed form."""
    mesh = together(block(*n[:2]), block(*n[2:], shift, size))
    depth = [min(1, s + w) - max(0, s) for s, w in zip(shift, size)]
    smallest = min(1 / max(n), min(size) / max(n))
    if min(depth) > 0.15 * smallest * max(1, *size, *(1 / s for s in size)):
        refused(mesh, "overlap", "separate", turn=turn)
    elif min(depth) < -0.01 * smallest:
        built(mesh, "separate", turn=turn)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(0, 60), m=st.integers(0, 60), spread=st.floats(0, 6))
def test_overlapping_boxes_against_all_pairs(seed, n, m, spread):
    rng = np.random.default_rng(seed)

    def boxes(count):
        low = rng.integers(0, 8, (count, 2)) / 8 if seed % 2 else rng.random((count, 2))
        size = 10.0 ** rng.uniform(-spread, 0, (count, 2)) * rng.integers(0, 2, (count, 1))
        return low, low + size

    (a, b), (c, d) = boxes(n), boxes(m)
    found = [pair for i, j in overlapping_boxes(a, b, c, d) for pair in zip(i.tolist(), j.tolist())]
    wanted = {(i, j) for i in range(n) for j in range(m) if (a[i] <= d[j]).all() and (c[j] <= b[i]).all()}
    assert len(found) == len(set(found)) and set(found) == wanted


@pytest.mark.parametrize("cell", ["triangle", "quad"])
def test_the_work_grows_with_the_number_of_cells(cell, monkeypatch):
    """Candidates looked at, counted: four times the cells, at most some four times the pairs."""
    import granfabric.fem.mesh.topology as topology

    counted = []
    original = topology.overlapping_boxes

    def counting(*boxes):
        for i, j in original(*boxes):
            counted.append(len(i))
            yield i, j

    monkeypatch.setattr(topology, "overlapping_boxes", counting)
    totals = []
    for n in (10, 20, 40):
        counted.clear()
        # the hardest: every cell a body of its own, all sides are outline
        points, cells = block(n, n, cell=cell)
        build_mesh(points[cells.ravel()], np.arange(cells.size).reshape(cells.shape), parts="separate")
        totals.append(sum(counted))
    assert totals[1] < 4.5 * totals[0] and totals[2] < 4.5 * totals[1]

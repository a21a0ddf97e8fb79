"""Geometric checks of raw mesh arrays, before anything is built on them."""

from __future__ import annotations

from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

# An element whose area is below this fraction of its longest edge squared carries no usable shape.
DEGENERATE_AREA_RATIO = 1e-9


class MeshError(ValueError):
    """A mesh cannot be used; the text says what is wrong, where, and what is legal."""


def nearest_name(name: str, legal: list[str]) -> str:
    """End of a sentence: the legal names, the nearest first named."""
    if not legal:
        return "the mesh has no such groups at all"
    near = get_close_matches(name, legal, n=1, cutoff=0.0)[0]
    return f"it has {', '.join(repr(entry) for entry in sorted(legal))}; the nearest is {near!r}"


def _corner_areas(points: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Signed parallelogram area spanned by the two edges that meet at each corner, shape (nelem, ncorners)."""
    corners = points[cells]
    forward = np.roll(corners, -1, axis=1) - corners
    backward = np.roll(corners, 1, axis=1) - corners
    return forward[:, :, 0] * backward[:, :, 1] - forward[:, :, 1] * backward[:, :, 0]


def _where(points: NDArray[np.float64], cells: NDArray[np.int64], element: int) -> str:
    corners = ", ".join(f"({x:.6g}, {y:.6g})" for x, y in points[cells[element]])
    return f"element {element + 1} (corners {corners})"


def refuse_doubled_cells(points: NDArray[np.float64], cells: NDArray[np.int64]) -> None:
    """Refuse two cells with the same corners.

    Raises
    ------
    MeshError
    """
    corners = np.sort(cells, axis=1)
    order = np.lexsort(corners.T)
    same = np.flatnonzero((corners[order][1:] == corners[order][:-1]).all(axis=1))
    if same.size:
        one, other = sorted((int(order[same[0]]), int(order[same[0] + 1])))
        raise MeshError(
            f"{_where(points, cells, one)} is there twice, again as element {other + 1} ({same.size} such elements in "
            "all): surfaces lie on top of each other; take one away, or cut them along each other (BooleanFragments)"
        )


def oriented_cells(points: NDArray[np.float64], cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells turned counter-clockwise where they were merely listed clockwise.

    Parameters
    ----------
    points : ndarray, shape (npoints, 2)
        Coordinates [m].
    cells : ndarray of int, shape (nelem, 3 or 4)
        Corner nodes of straight-sided triangles or quadrilaterals.

    Returns
    -------
    ndarray of int, shape (nelem, 3 or 4)

    Raises
    ------
    MeshError
        For a degenerate element, a quadrilateral that is not convex, or an element folded over its neighbour. The
        sense of rotation alone cannot tell the last: two elements that share an edge must lie on opposite sides of it.
    """
    corner = _corner_areas(points, cells)
    area = corner.sum(axis=1)
    edges = points[np.roll(cells, -1, axis=1)] - points[cells]
    longest = np.einsum("eci,eci->ec", edges, edges).max(axis=1)
    degenerate = np.abs(corner).min(axis=1) <= DEGENERATE_AREA_RATIO * longest
    if degenerate.any():
        element = int(np.argmax(degenerate))
        raise MeshError(
            f"{_where(points, cells, element)} is degenerate: three of its corners lie on one line or coincide"
        )
    mixed = (corner > 0).any(axis=1) & (corner < 0).any(axis=1)
    if mixed.any():
        raise MeshError(f"{_where(points, cells, int(np.argmax(mixed)))} is inverted: it is not convex")
    turned = cells.copy()
    clockwise = area < 0
    turned[clockwise] = turned[clockwise][:, ::-1]
    _refuse_folds(points, turned, clockwise)
    return turned


def _refuse_folds(points: NDArray[np.float64], cells: NDArray[np.int64], clockwise: NDArray[np.bool_]) -> None:
    """Refuse neighbours on the same side of their common edge: after turning, both then run along it the same way."""
    first, second = cells, np.roll(cells, -1, axis=1)
    directed = (first * len(points) + second).ravel()
    order = np.argsort(directed, kind="stable")
    repeated = np.flatnonzero(directed[order][1:] == directed[order][:-1])
    if not repeated.size:
        return
    pairs = np.sort(np.stack([order[repeated], order[repeated + 1]], axis=1) // cells.shape[1], axis=1)
    # Of the two the one listed against the majority's sense of rotation is the one that was turned inside out.
    minority = clockwise if clockwise.mean() < 0.5 else ~clockwise
    element, other = pairs[0]
    if minority[other] and not minority[element]:
        element, other = other, element
    raise MeshError(
        f"{_where(points, cells, int(element))} is inverted: it lies on the same side of a common edge as element "
        f"{other + 1}, so that the two overlap"
    )

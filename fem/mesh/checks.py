"""Geometric checks of raw mesh arrays, before anything is built on them."""

from __future__ import annotations

from difflib import get_close_matches

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.arrays import ANY, ArrayError, found, read

# An element whose area is below this fraction of its longest edge squared carries no usable shape.
DEGENERATE_AREA_RATIO = 1e-9


class MeshError(ValueError):
    """A mesh cannot be used; the text says what is wrong, where, and what is legal."""


def nearest_name(name: object, legal: list[str]) -> str:
    """End of a sentence: the legal names, the nearest first named."""
    if not legal:
        return "the mesh has no such groups at all"
    near = get_close_matches(str(name), legal, n=1, cutoff=0.0)[0]
    return f"it has {', '.join(repr(entry) for entry in sorted(legal))}; the nearest is {near!r}"


def coordinates(name: str, value: object) -> NDArray[np.float64]:
    """Places in the plane as a caller gives them, shape (n, 2).

    Raises
    ------
    MeshError
        If they are not numbers of that shape, or not finite.
    """
    try:
        places = read(name, value, (ANY, 2))
    except ArrayError:
        raise MeshError(f"{name} must be an array of numbers of shape (n, 2), got {_came(value)}") from None
    if not np.isfinite(places).all():
        raise MeshError("the mesh holds a coordinate that is not finite")
    return places


def numbers_of(name: str, value: object, widths: tuple[int, ...], count: int, what: str) -> NDArray[np.int64]:
    """Numbers of nodes or elements as a caller gives them.

    A mask, a fraction or a number from the end would name others than are meant, and say nothing.

    Parameters
    ----------
    name : str
        For the message.
    value : array_like of int
    widths : tuple of int
        How many may stand in a row; none for a plain list.
    count : int
        Of the nodes or elements, which are numbered from 0.
    what : str
        "nodes" or "elements".

    Raises
    ------
    MeshError
    """
    shape = f"(n, {' or '.join(map(str, widths))})" if widths else "(n,)"
    wanted = f"an array of integers in 0 ... {count - 1} of shape {shape}, numbers of {what}"
    array = _plain(value)
    if array is not None and array.size == 0:
        return np.empty((0, widths[0]) if widths else 0, dtype=np.int64)
    fits = array is not None and array.ndim == 1 + bool(widths) and (not widths or array.shape[1] in widths)
    if array is None or not fits or array.dtype.kind not in "iu":
        raise MeshError(f"{name} must be {wanted}, got {_came(value)}")
    least, most = int(array.min()), int(array.max())
    if least < 0 or most >= count:
        raise MeshError(f"{name} must be {wanted}, but holds {least if least < 0 else most}")
    return array.astype(np.int64)


def _plain(value: object) -> NDArray[np.generic] | None:
    try:
        return np.asarray(value)
    except (ValueError, TypeError, OverflowError):
        return None


def _came(value: object) -> str:
    array = _plain(value)
    return found(value if array is None or array.dtype.kind == "O" else array)


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

"""Kinds of elements in a `.msh` file: those that are read, and what is said about others."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.mesh.checks import MeshError

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Kind:
    """A kind of element: its dimension, corners, nodes and order, and how many of it are called."""

    dimension: int
    corners: int
    nodes: int
    order: int
    name: str


KINDS = {
    15: Kind(0, 1, 1, 1, "points"),
    1: Kind(1, 2, 2, 1, "lines"),
    8: Kind(1, 2, 3, 2, "lines"),
    2: Kind(2, 3, 3, 1, "triangles"),
    9: Kind(2, 3, 6, 2, "triangles"),
    3: Kind(2, 4, 4, 1, "quadrilaterals"),
    16: Kind(2, 4, 8, 2, "quadrilaterals"),
    10: Kind(2, 4, 9, 2, "quadrilaterals"),
}
"""By Gmsh's number."""

_SOLID = {4: "tetrahedra", 5: "hexahedra", 6: "prisms", 7: "pyramids"}
_SOLID |= {
    11: "tetrahedra",
    12: "hexahedra",
    13: "prisms",
    14: "pyramids",
    17: "hexahedra",
    18: "prisms",
    19: "pyramids",
}
_HIGH_ORDER = (*range(20, 29), *range(36, 39), *range(40, 52), *range(62, 67))


def kind_of(number: int) -> Kind:
    """Kind of element by Gmsh's number.

    Raises
    ------
    MeshError
        If it is none of a plane mesh of first or second order.
    """
    if number in KINDS:
        return KINDS[number]
    if number in _HIGH_ORDER:
        raise MeshError(
            f"it holds elements of an order above the second (Gmsh's type {number}); set Mesh.ElementOrder to 1 or 2"
        )
    name = _SOLID.get(number, f"elements of Gmsh's type {number}")
    raise MeshError(
        f"it is not a plane mesh of triangles or quadrilaterals: it holds {name}; mesh the surfaces only (gmsh -2)"
    )


@dataclass(frozen=True)
class Block:
    """Elements of one kind.

    Parameters
    ----------
    kind : Kind
    nodes : ndarray of int, shape (n, kind.nodes)
        Numbers of the nodes in the file.
    entity : ndarray of int, shape (n,)
        Number of the curve or surface that each is a part of.
    groups : list of (ndarray of int, int)
        Elements of this block, by place, and the number of the physical group that holds them; without sign.
    """

    kind: Kind
    nodes: IntArray
    entity: IntArray
    groups: list[tuple[IntArray, int]]


@dataclass(frozen=True)
class RawFile:
    """What a file says: its nodes by number, and its elements.

    Parameters
    ----------
    tags : ndarray of int, shape (n,)
    points : ndarray, shape (n, 3)
    blocks : list of Block
    missing_parts : str
        What a file that holds one part of a mesh only says about the others; empty for all other files.
    """

    tags: IntArray
    points: NDArray[np.float64]
    blocks: list[Block]
    missing_parts: str = field(default="")

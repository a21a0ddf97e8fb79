"""Nodes for fields that may jump: where cells of several groups meet, each group has a node of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .space import Space


@dataclass(frozen=True)
class Parts:
    """Nodes of the space, and after them the further ones of groups that meet there.

    Parameters
    ----------
    node : ndarray of int, shape (n,)
        Node of the space at the place of each; the first are 0, 1, ... themselves.
    element_nodes : ndarray of int, shape (nelem, nb)
        As `Space.element_nodes`, in this numbering.
    """

    node: NDArray[np.int64]
    element_nodes: NDArray[np.int64]


def parts(space: Space, group: NDArray[np.integer] | None = None) -> Parts:
    """Nodes for fields that jump where two groups of cells meet, and are continuous within each.

    Parameters
    ----------
    space : Space
    group : ndarray of int, shape (nelem,), optional
        Number of each cell's group; all belong together if not given.
    """
    nodes = space.element_nodes.astype(np.int64)
    if group is None or (group == group[0]).all():
        return Parts(np.arange(space.nnodes), nodes)
    _, number = np.unique(group, return_inverse=True)
    groups = int(number.max()) + 1
    pairs, place = np.unique(nodes * groups + number.reshape(-1, 1), return_inverse=True)
    node = pairs // groups
    further = np.concatenate([[False], node[1:] == node[:-1]])
    numbered = node.copy()
    numbered[further] = space.nnodes + np.arange(np.count_nonzero(further))
    return Parts(np.concatenate([np.arange(space.nnodes), node[further]]), numbered[place.reshape(nodes.shape)])

"""Values at places of the body: displacement by the shape functions, what the law knows as recovered at the nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import LawDescription
from granfabric.constitutive.effective_stress import effective_stress
from granfabric.fem.discretisation.location import Locator
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult

from .cells import whole_cells
from .derived import invariants
from .recovery import Recovery
from .shown import shown_part

Array = NDArray[np.float64]

ON_THE_EDGE = 1e-6
"""Distance outside of a cell, over its size, up to which a place counts as on its edge: so written numbers are."""
_AXES = ("xx", "yy", "xy")


class Places:
    """Some places of a body; the cells there are found once, with their true, curved map.

    Parameters
    ----------
    space : Space
    description : LawDescription
    recovery : Recovery
    places : ndarray, shape (n, 2)
        [m].

    Attributes
    ----------
    missing : ndarray of bool, shape (n,)
        Places outside of the mesh.
    columns : list of (str, str)
        Names and units of the values.
    """

    def __init__(self, space: Space, description: LawDescription, recovery: Recovery, places: Array) -> None:
        description, self._shown = shown_part(description)
        self._description = description
        self._nodes_of_space = recovery.nodes.node
        kind, cells = whole_cells(space, recovery.nodes)
        nodes, weights = Locator(space.nodes[recovery.nodes.node], kind, cells).find(places, ON_THE_EDGE)
        self.missing = nodes[:, 0] < 0
        self._nodes, self._weights = np.maximum(nodes, 0), np.nan_to_num(weights)
        self._operator = recovery.at(self._nodes, self._weights)
        self.columns = [
            ("displacement_x", "m"),
            ("displacement_y", "m"),
            *((f"stress_{axis}", "Pa") for axis in _AXES),
            *((f"strain_{axis}", "-") for axis in _AXES),
            *(("p", "Pa"), ("q", "Pa"), ("stress_ratio", "-")),
        ]
        for variable in description.state:
            endings = {1: ("",), 2: ("", "_1", "_2"), 3: tuple(f"_{axis}" for axis in _AXES)}[variable.components]
            self.columns += [(variable.name + ending, variable.unit) for ending in endings]

    def values(self, step: StepResult) -> Array:
        """Values of a step, shape (n, number of columns); not a number outside of the mesh.

        Of a vector in the double-angle plane the magnitude comes before its components.
        """
        nodal = step.displacement.reshape(-1, 2)[self._nodes_of_space[self._nodes]]
        shown = step.state if self._shown is None else step.state[:, self._shown]
        stress, state = self._operator @ step.stress, self._operator @ shown
        carried = effective_stress(stress, state, self._description)
        parts = [np.einsum("pn,pnk->pk", self._weights, nodal), stress, self._operator @ step.strain]
        parts += [column[:, None] for column in invariants(stress, carried).values()]
        for variable in self._description.state:
            columns = state[:, self._description.columns(variable.name)]
            if variable.components == 2:
                parts.append(np.linalg.norm(columns, axis=1)[:, None])
            parts.append(columns)
        table = np.concatenate(parts, axis=1)
        table[self.missing] = np.nan
        return table

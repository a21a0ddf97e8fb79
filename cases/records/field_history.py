"""One row of `history.csv` a load step of a boundary-value problem."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import LawDescription
from granfabric.constitutive.effective_stress import effective_stress
from granfabric.fem.discretisation.active_part import nodes_of
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.load_program import LoadProgram
from granfabric.fem.output.derived import pressure_and_deviator as invariants

from . import pore_columns
from .body_columns import BodyColumns
from .reaction_columns import ReactionColumns
from .region_columns import RegionColumns

Array = NDArray[np.float64]

LEADING = ("step", "stage", "fraction")
BODY = (
    *("strain_xx", "strain_yy", "strain_xy", "stress_xx", "stress_yy", "stress_xy", "p", "q"),
)
NETWORK = (
    *("coordination", "coordination_smallest", "coordination_largest"),
    *("fabric_anisotropy", "fabric_anisotropy_largest", "stress_ratio_largest"),
)
"""Of laws that know a network: others may have no pressure either, of which the stress ratio is taken."""
MEANS = (*BODY, *NETWORK)
COUNTS = ("iterations", "factorisations", "cuts", "substeps", "limited_points")


class FieldHistory:
    """Rows of a field run's history.

    Means are volume averages over what is there at the step, named as the columns of a point's history; p and q belong
    to the mean stress. With pore fluid stress, p and q are the total ones, `effective_p` is p' and the largest stress
    ratio is q/p'. Coordination and fabric anisotropy (magnitudes) have means and extremes over the integration points.
    For each boundary that carries loads or supports: the mean displacement of its nodes that are there [m], zero if
    none is; for each that is supported: the force of the supports on the body [N/m] and its moment about the origin
    [N m/m]; the resultant of all supports. For each region of several: means over its area, zero where it is not there.

    Parameters
    ----------
    space : Space
    description : LawDescription
    boundaries : list of str
        That carry loads or supports.
    supported : list of str
        Those of them that are supported.
    program : LoadProgram, optional
        Of it the rigid bodies, springs and controls, which have columns of their own.
    """

    def __init__(
        self,
        space: Space,
        description: LawDescription,
        boundaries: list[str],
        supported: list[str],
        program: LoadProgram | None = None,
    ) -> None:
        self._space = space
        self._weights = space.weights / space.weights.sum()
        self._description = description
        self._has_network = description.has_state("coordination") and description.has_state("fabric_anisotropy")
        self._bodies = BodyColumns(program)
        self._nodes = {name: space.boundary_nodes(name) for name in boundaries}
        self._area = space.weights
        self._resultants = ReactionColumns(space, supported)
        self._regions = RegionColumns(space, description)
        self.names = [
            *LEADING,
            *BODY,
            *(NETWORK if self._has_network else ()),
            *(pore_columns.PORE if pore_columns.has_pore_pressure(description) else ()),
            *COUNTS,
            *(f"displacement_{name}_{axis}" for name in boundaries for axis in "xy"),
            *(f"reaction_{name}_{axis}" for name in supported for axis in "xy"),
            *self._resultants.names,
            *self._regions.names,
            *self._bodies.names,
        ]
        self._supported = supported
        self.rows: list[list[Any]] = []

    def continue_from(self, names: list[str], rows: list[list[Any]]) -> None:
        """Go on after rows of an earlier part of the run.

        Raises
        ------
        ValueError
            If they have other columns.
        """
        if names != self.names:
            raise ValueError("it has other columns than this run")
        self.rows = rows

    def add(self, step: StepResult) -> None:
        """Row of an accepted load step, or of the initial state as step 0."""
        weights, there = self._weights, None
        fields = step.strain, step.stress, step.state
        if step.active is not None:
            points = step.active[self._space.point_cell]
            weights = self._space.weights[points] / self._space.weights[points].sum()
            fields = step.strain[points], step.stress[points], step.state[points]
            there = nodes_of(self._space, step.active)
        averages = self._averages(weights, *fields)
        counts = [step.iterations, step.factorisations, step.cuts, step.substeps, step.limited]
        displacement = step.displacement.reshape(-1, 2)
        sides: list[float] = []
        for nodes in self._nodes.values():
            present = nodes if there is None else nodes[there[nodes]]
            sides += displacement[present].mean(axis=0).tolist() if len(present) else [0.0, 0.0]
        for name in self._supported:
            sides += [float(force) for force in step.reactions[name]]
        sides += self._resultants.values(step)
        area = self._area if step.active is None else self._area * step.active[self._space.point_cell]
        sides += self._regions.values(step.strain, step.stress, step.state, area)
        sides += self._bodies.values(step)
        self.rows.append([step.step, step.stage, float(step.fraction), *averages, *map(int, counts), *sides])

    def _averages(self, weights: Array, strain: Array, stress: Array, state: Array) -> list[float]:
        mean_strain, mean_stress = weights @ strain, weights @ stress
        p, q = invariants(mean_stress[None, :])
        values = [*mean_strain.tolist(), *mean_stress.tolist(), float(p[0]), float(q[0])]
        wet = pore_columns.has_pore_pressure(self._description)
        water = pore_columns.values(weights, float(p[0]), state, self._description) if wet else []
        if not self._has_network:
            return values + water
        coordination = state[:, self._description.columns("coordination")][:, 0]
        pressures, deviators = invariants(effective_stress(stress, state, self._description))
        fabric = np.linalg.norm(state[:, self._description.columns("fabric_anisotropy")], axis=1)
        values += [float(weights @ coordination), float(coordination.min()), float(coordination.max())]
        values += [float(weights @ fabric), float(fabric.max()), float((deviators / pressures).max())]
        return values + water

"""The point law tried on paths of a scene with different effects, and how far the outcomes lie apart.

The error of leaving an effect out is measured, not guessed: the same points go the same way with and without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.effective_stress import with_pressure
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Integration
from granfabric.constitutive.path import Leg, drive

from .probe import Paths

Array = NDArray[np.float64]

QUANTITIES = ("stress", "strain", "coordination", "fabric")
"""Stress over p, strain over that of the scene, z relative, a_c absolute."""
COARSEST_TOLERANCE, FINEST_TOLERANCE = 1e-4, 1e-10
MOST_SUBSTEPS = 3000
DIRECTIONS = 16
MOST_INCREMENTS, MOST_OF_ALL = 60, 600
"""Increments of one leg of a point scene's path when it is tried, and of all legs."""


@dataclass(frozen=True)
class Trial:
    """Outcome at the nodes of the paths.

    Parameters
    ----------
    stress, strain : ndarray, shape (nodes, npt, 3)
        Tension positive [Pa], engineering shear. With pore fluid the total stress over the pore pressure of the start,
        so that stresses of laws with and without it can be compared, whatever the depth of the water.
    coordination, fabric : ndarray, shapes (nodes, npt), (nodes, npt, 2)
    reached : ndarray of int, shape (npt,)
        Last node up to which the law could follow.
    columns : int
        State columns.
    excess : ndarray, shape (nodes, npt), optional
        Pore pressure over that of the start [Pa]; zero if not given.
    """

    stress: Array
    strain: Array
    coordination: Array
    fabric: Array
    reached: NDArray[np.int64]
    columns: int
    excess: Array | None = None

    @property
    def effective(self) -> Array:
        """Effective stress at the nodes."""
        return self.stress if self.excess is None else with_pressure(self.stress, self.excess)


def with_tolerance(integration: Integration, tolerance: float, directions: int = DIRECTIONS) -> Integration:
    """Numerics of a trial: errors well below the differences that are looked for, and a bound on the work."""
    return replace(
        integration,
        integrator="bogacki_shampine",
        tolerance=min(max(0.01 * tolerance, FINEST_TOLERANCE), COARSEST_TOLERANCE),
        substeps=0,
        maximum_substeps=MOST_SUBSTEPS,
        directions=min(integration.directions, directions),
    )


def follow(law: ContactLaw, paths: Paths) -> Trial:
    """Drive points along their strain paths, all at once; a point that fails stays where it is."""
    nodes, npt = paths.strain.shape[:2]
    description = law.description
    stress, state = paths.start(law)
    datum, drained = paths.datum(law), law.drained()
    made = Trial(
        np.empty((nodes, npt, 3)),
        paths.strain,
        np.empty((nodes, npt)),
        np.zeros((nodes, npt, 2)),
        np.zeros(npt, dtype=np.int64),
        description.nstate,
        np.zeros((nodes, npt)) if law.effects.pore_fluid else None,
    )
    stress_end, state_end = np.empty_like(stress), np.empty_like(state)
    alive = np.ones(npt, dtype=bool)
    fabric = description.columns("fabric_anisotropy")
    for node in range(nodes):
        if node:
            increment = np.where(alive[:, None], paths.strain[node] - paths.strain[node - 1], 0.0)
            going = drained if paths.drained is not None and paths.drained[node] else law
            report = going.update(increment, stress, state, stress_end, state_end, material_index=paths.material_index)
            alive &= report.status <= 1
            stress, stress_end = stress_end, stress
            state, state_end = state_end, state
        made.reached[alive] = node
        made.stress[node] = stress
        if made.excess is not None:
            made.stress[node] = with_pressure(stress, datum)
            made.excess[node] = state[:, -1] - datum
        made.coordination[node] = state[:, description.columns("coordination")][:, 0]
        made.fabric[node, :, : fabric.stop - fabric.start] = state[:, fabric]
    return made


def stiffness(law: ContactLaw, paths: Paths) -> Array:
    """Elastic stiffness of the initial state of each point, shape (npt, 3, 3) [Pa]."""
    stress, state = paths.start(law)
    tangent = np.zeros((len(stress), 3, 3))
    nothing = np.zeros_like(stress)
    law.update(nothing, stress, state, nothing.copy(), np.empty_like(state), tangent, "elastic", paths.material_index)
    return tangent


def shortened(legs: Sequence[Leg]) -> list[Leg]:
    """Legs with fewer increments, as far as that makes no difference to what is compared."""
    most = max(1, min(MOST_INCREMENTS, MOST_OF_ALL // len(legs)))
    return [replace(leg, increments=min(leg.increments, most)) for leg in legs]


def drive_point(
    law: ContactLaw, initial_stress: Sequence[float], legs: Sequence[Leg], pore_pressure: float = 0.0
) -> Trial:
    """Drive the point of a point scene along its own path."""
    datum = pore_pressure if law.effects.pore_fluid else 0.0
    columns = drive(law, initial_stress, legs, pore_pressure=datum).columns
    nodes = 1 + sum(leg.increments for leg in legs)
    rows = len(columns["step"])

    def filled(*names: str) -> Array:
        values = np.stack([columns[name] for name in names], axis=1)
        return np.concatenate([values, np.repeat(values[-1:], nodes - rows, axis=0)])[:, None, :]

    return Trial(
        with_pressure(filled("stress_xx", "stress_yy", "stress_xy"), datum),
        filled("strain_xx", "strain_yy", "strain_xy"),
        filled("coordination")[..., 0],
        filled("fabric_anisotropy_1", "fabric_anisotropy_2"),
        np.array([rows - 1]),
        law.description.nstate,
        filled("pore_pressure")[..., 0] - datum if law.effects.pore_fluid else None,
    )


def size_of_strain(strain: NDArray[Any]) -> NDArray[Any]:
    """Norm of the strain tensor, without the last axis."""
    size: NDArray[Any] = np.sqrt(strain[..., 0] ** 2 + strain[..., 1] ** 2 + 0.5 * strain[..., 2] ** 2)
    return size


def differences(
    reference: Trial, other: Trial, fractions: Array, stiffness_of_points: Array | None = None
) -> dict[str, Array]:
    """How far two outcomes lie apart at each point: the largest along its way, as far as the reference came.

    A point that the other could not follow as far as the reference differs without bound.

    Parameters
    ----------
    reference, other : Trial
        Of the same paths.
    fractions : ndarray, shape (npt,)
        Fraction of the area, for the scene's mean square of strain.
    stiffness_of_points : ndarray, shape (npt, 3, 3), optional
        If strain was prescribed: turns a difference of stress into the strain that it would have caused under
        prescribed loads. Without it strains are compared as they are.

    Returns
    -------
    dict of str to ndarray, shape (npt,)
        One entry for each of `QUANTITIES`.
    """
    carried = reference.effective
    pressure = np.maximum(-0.5 * (carried[..., 0] + carried[..., 1]), 1e-300)
    stress = reference.stress - other.stress
    strain: NDArray[Any]
    if stiffness_of_points is None:
        strain = reference.strain - other.strain
    else:
        strain = np.linalg.solve(stiffness_of_points[None], stress[..., None])[..., 0]
    square = (size_of_strain(reference.strain) ** 2 * fractions).sum(axis=1)
    scale = float(np.sqrt(square.max())) or 1.0
    found = {
        "stress": np.sqrt(stress[..., 0] ** 2 + stress[..., 1] ** 2 + 2.0 * stress[..., 2] ** 2) / pressure,
        "strain": size_of_strain(strain) / scale,
        "coordination": np.abs(other.coordination / reference.coordination - 1.0),
        "fabric": np.linalg.norm(reference.fabric - other.fabric, axis=-1),
    }
    nodes = np.arange(len(stress))[:, None]
    seen = nodes <= np.minimum(reference.reached, other.reached)
    lost = other.reached < reference.reached
    return {name: np.where(lost, np.inf, np.where(seen, values, 0.0).max(axis=0)) for name, values in found.items()}


def largest(found: dict[str, Array]) -> Array:
    """The largest of all quantities at each point, shape (npt,)."""
    return np.max(np.stack(list(found.values())), axis=0)

"""Columns of `history.csv` for the means over each region of the mesh; none where one region is the whole body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import LawDescription
from granfabric.fem.discretisation.space import Space
from granfabric.fem.output.derived import pressure_and_deviator

Array = NDArray[np.float64]

BODY = ("strain_xx", "strain_yy", "strain_xy", "stress_xx", "stress_yy", "stress_xy", "p", "q")
NETWORK = ("coordination", "fabric_anisotropy")


class RegionColumns:
    """Means over the area of each region of stress, strain, coordination and fabric anisotropy (its magnitude).

    p and q belong to the mean stress.

    Parameters
    ----------
    space : Space
    description : LawDescription
    """

    def __init__(self, space: Space, description: LawDescription) -> None:
        self._space, self._description = space, description
        self._regions = {
            name: cells for name, cells in space.host_mesh.regions.items() if 0 < len(cells) < space.nelements
        }
        self._has_network = all(description.has_state(name) for name in NETWORK)
        of_each = [*BODY, *(NETWORK if self._has_network else ())]
        self.names = [f"region_{name}_{what}" for name in self._regions for what in of_each]

    def values(self, strain: Array, stress: Array, state: Array, weights: Array) -> list[float]:
        """Of one step, in the order of the names.

        Parameters
        ----------
        strain, stress : ndarray, shape (npt, 3)
        state : ndarray, shape (npt, nstate)
        weights : ndarray, shape (npt,)
            Area of each integration point [m^2]; zero where nothing is, and means of nothing are zero.
        """
        found: list[float] = []
        area = weights.reshape(self._space.nelements, -1)
        for cells in self._regions.values():
            points = (cells[:, None] * self._space.points_per_cell + np.arange(self._space.points_per_cell)).ravel()
            share = area[cells].ravel()
            share = share / max(share.sum(), np.finfo(float).tiny)
            mean_stress = share @ stress[points]
            p, q = pressure_and_deviator(mean_stress[None, :])
            found += [*(share @ strain[points]).tolist(), *mean_stress.tolist(), float(p[0]), float(q[0])]
            if self._has_network:
                columns = self._description.columns
                fabric = np.linalg.norm(state[points][:, columns("fabric_anisotropy")], axis=1)
                found += [float(share @ state[points][:, columns("coordination")][:, 0]), float(share @ fabric)]
        return found

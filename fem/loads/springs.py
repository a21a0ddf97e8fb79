"""Springs on a boundary: a bed that resists its displacement, normal to it and along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from granfabric.fem.discretisation.space import Space

from .checks import LoadError, Value, scalar, values_at


@dataclass(frozen=True)
class Spring:
    """Springs between a boundary and ground that does not move (Winkler).

    They are without force where the boundary is at the start of the stage that first names them, and stay until a
    stage with ``keep=False`` does not name them, or names others; their force then fades.

    Parameters
    ----------
    boundary : str
    normal, tangential : float, str or callable
        Stiffness per area across and along the boundary [Pa/m], not negative; functions get arrays ``x, y``.
    """

    boundary: str
    normal: Value = 0.0
    tangential: Value = 0.0

    def __post_init__(self) -> None:
        for name in ("normal", "tangential"):
            owner = f"{name} stiffness of the spring on boundary {self.boundary!r}"
            value = scalar(owner, getattr(self, name))
            if not callable(value) and value < 0.0:
                raise LoadError(f"{owner} = {value!r} is negative")
            object.__setattr__(self, name, value)
        if not callable(self.normal) and not callable(self.tangential) and self.normal == self.tangential == 0.0:  # type: ignore[operator]
            raise LoadError(f"the spring on boundary {self.boundary!r} has no stiffness; give normal or tangential")

    def matrix(self, space: Space) -> csr_matrix:
        """Stiffness matrix, shape (ndofs, ndofs) [N/m per m]; minus its product with u is the force on the body.

        Raises
        ------
        LoadError
            If a stiffness is negative or not finite somewhere.
        MeshError
        """
        name = self.boundary

        def stiffness(x: np.ndarray, y: np.ndarray, nx: np.ndarray, ny: np.ndarray) -> np.ndarray:
            sizes = []
            for kind in ("normal", "tangential"):
                owner = f"the {kind} stiffness of the spring on boundary {name!r}"
                size = values_at(owner, getattr(self, kind), (), x, y)
                if (size < 0.0).any():
                    bad = int(np.argmax(size < 0.0))
                    raise LoadError(f"{owner} is negative, {size[bad]:.6g} Pa/m at ({x[bad]:.6g}, {y[bad]:.6g}) m")
                sizes.append(size)
            across, along = sizes
            normal = np.stack([nx, ny], axis=1)
            outer = normal[:, :, None] * normal[:, None, :]
            return across[:, None, None] * outer + along[:, None, None] * (np.eye(2) - outer)

        return space.boundary_matrix(name, stiffness)

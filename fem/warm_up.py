"""Compile the host's kernels ahead of their first use."""

from __future__ import annotations

import numpy as np

from granfabric.fem.discretisation.assembly import ForceAssembler, TangentAssembler
from granfabric.fem.discretisation.space import Space
from granfabric.fem.mesh.host_mesh import rectangle


def warm_up() -> None:
    """Strains, internal forces and tangent of two elements."""
    space = Space(rectangle(1.0, 1.0, 1, 1), "P2")
    forces, matrix = ForceAssembler(space), TangentAssembler(space, np.arange(space.ndofs))
    displacement, tangent = np.zeros(space.ndofs), np.zeros((space.npoints, 3, 3))
    stress = np.zeros((space.npoints, 3))
    forces.strain(displacement, stress)
    forces.internal_force(stress, np.empty(space.ndofs))
    forces.tangent_times(tangent, displacement, np.empty(space.ndofs))
    matrix.assemble(tangent)

"""Springs on a boundary whose nodes several ranks own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from granfabric.fem.loads.load_program import StageTerms

from .distribution import Distribution
from .shared import SharedDofs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlacedSpring:
    """Stands for a `granfabric.fem.loads.springs.Spring`: equal numbers are the same spring.

    Parameters
    ----------
    boundary : str
    number : int
    """

    boundary: str
    number: int


class SpringMatrix:
    """Stiffness of springs; its products with displacements are made by all ranks together.

    Parameters
    ----------
    shared : SharedDofs
    matrix : csr_matrix, shape (m, m)
        Of these degrees of freedom [N/m per m].
    """

    def __init__(self, shared: SharedDofs, matrix: csr_matrix) -> None:
        self.shared = shared
        self.matrix = matrix

    def __matmul__(self, displacement: Array) -> Array:
        return self.shared.own(self.matrix @ self.shared.of(displacement))


class SpringSum:
    """All springs of a stage.

    Parameters
    ----------
    matrices : sequence of SpringMatrix
        At least one.
    """

    def __init__(self, matrices: Sequence[SpringMatrix]) -> None:
        self._matrices = matrices

    def __matmul__(self, displacement: Array) -> Array:
        return np.asarray(sum(matrix @ displacement for matrix in self._matrices))

    def add_to(self, tangent: Any, first: int, held: NDArray[np.bool_]) -> None:
        """Add the stiffness to a matrix of PETSc.

        Parameters
        ----------
        tangent : petsc4py.PETSc.Mat
            Rows and columns of degrees of freedom; its pattern has the places, which lie within elements.
        first : int
            PETSc's number of the first degree of freedom that this rank owns.
        held : ndarray of bool, shape (ndofs,)
            Rows and columns that stay as they are.
        """
        for each in self._matrices:
            shared = each.shared
            number = shared.of(first + np.arange(len(held), dtype=np.float64)).astype(np.int64)
            free = shared.of(held.astype(np.float64)) < 0.5
            entries = csr_matrix(each.matrix[shared.places]).tocoo()
            rows = shared.places[entries.row]
            used = free[rows] & free[entries.col]
            for row, column, value in zip(number[rows[used]], number[entries.col[used]], entries.data[used]):
                tangent.setValue(int(row), int(column), float(value), addv=True)
        tangent.assemble()


def spread_springs(
    distribution: Distribution, whole: Sequence[StageTerms] | None, stages: int
) -> list[tuple[tuple[PlacedSpring, SpringMatrix], ...]]:
    """Springs of each stage, from the terms that rank 0 has."""
    told: Any = None
    if whole is not None:
        numbers: dict[Any, int] = {}
        matrices: list[Any] = []
        for terms in whole:
            for spring, matrix in terms.springs:
                if spring not in numbers:
                    numbers[spring] = len(numbers)
                    dofs = np.unique(matrix.nonzero()[0]).astype(np.int64)
                    matrices.append((spring.boundary, dofs, csr_matrix(matrix[dofs][:, dofs])))
        told = matrices, [[numbers[spring] for spring, _ in terms.springs] for terms in whole]
    matrices, of_stages = distribution.comm.bcast(told, root=0)
    made = [
        (PlacedSpring(boundary, number), SpringMatrix(SharedDofs(distribution, dofs), matrix))
        for number, (boundary, dofs, matrix) in enumerate(matrices)
    ]
    assert len(of_stages) == stages
    return [tuple(made[number] for number in numbers) for numbers in of_stages]

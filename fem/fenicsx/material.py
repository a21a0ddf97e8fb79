"""The law at the points of this rank, and what all ranks make of its answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import STATUS_TEXT, Status, TangentKind, UpdateReport
from granfabric.fem.accounting import Accounting
from granfabric.fem.discretisation.quadrature_material import QuadratureMaterial

from .forces import DistributedForces

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReducedReport(UpdateReport):
    """The report of this rank's points, with the verdict of all ranks: nobody goes on where another one failed.

    Parameters
    ----------
    failures, clipped : int
        Failed and clipped points of all ranks.
    worst_rank, worst_local, worst_number : int
        Where the gravest status is: the rank, its point there, and the point's number on rank 0.
    worst_status : int
    """

    failures: int = 0
    clipped: int = 0
    worst_rank: int = 0
    worst_local: int = 0
    worst_number: int = 0
    worst_status: int = 0

    @property
    def failed(self) -> int:
        return self.failures

    @property
    def limited(self) -> int:
        return self.clipped

    @property
    def worst_point(self) -> int:
        return self.worst_number

    @property
    def message(self) -> str:
        return f"point {self.worst_number}: {STATUS_TEXT[Status(self.worst_status)]}"


class DistributedMaterial(QuadratureMaterial):
    """Double buffers around a law, whose reports are those of all ranks; arguments as of `QuadratureMaterial`.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    """

    def __init__(
        self,
        comm: Any,
        law: Any,
        forces: DistributedForces,
        stress: Array,
        state: Array,
        accounting: Accounting,
        strain: Array | None,
        material_index: NDArray[np.int32] | None,
    ) -> None:
        super().__init__(law, forces, stress, state, accounting, strain, material_index)  # type: ignore[arg-type]
        self._comm = comm
        self._numbers = forces.space.point_numbers

    def _call(self, tangent: Array | None, kind: TangentKind) -> UpdateReport:
        own = super()._call(tangent, kind)
        worst = own.worst_point
        # the gravest status, and among equals the smallest number, as the own host has it
        mine = (-int(own.status[worst]), int(self._numbers[worst])) if worst >= 0 else (1, 0)
        if worst >= 0:
            graves = np.flatnonzero(own.status == own.status[worst])
            worst = int(graves[self._numbers[graves].argmin()])
            mine = (mine[0], int(self._numbers[worst]))
        told = self._comm.allgather((mine, worst, own.failed, own.limited, own.proposed_step_factor))
        rank = min(range(len(told)), key=lambda r: told[r][0])
        (grave, number), local = told[rank][0], told[rank][1]
        self.report = ReducedReport(
            own.status,
            own.substeps,
            own.rejected,
            min(each[4] for each in told),
            own.evaluations,
            failures=sum(each[2] for each in told),
            clipped=sum(each[3] for each in told),
            worst_rank=rank,
            worst_local=local,
            worst_number=number,
            worst_status=max(0, -grave),
        )
        return self.report

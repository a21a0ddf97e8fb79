"""Stress, strain and state at all integration points, at the start and at the end of a step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.arrays import read
from granfabric.constitutive.contract import Law, TangentKind, UpdateReport
from granfabric.fem.accounting import Accounting

from .assembly import ForceAssembler

Array = NDArray[np.float64]


class QuadratureMaterial:
    """Double buffers around a law.

    The law writes the end arrays from the start arrays at each trial; `commit` swaps them, and not committing is all
    that a revert takes. The tangent that belongs to the last commit stays available as `tangent_start`.

    Parameters
    ----------
    law : Law
    assembler : ForceAssembler
    stress, state : ndarray, shapes (npt, 3), (npt, nstate)
        Initial values (copied), tension positive [Pa].
    strain : ndarray, shape (npt, 3), optional
        Initial strain; zero if not given.
    material_index : ndarray of int32, shape (npt,), optional
    accounting : Accounting
    """

    def __init__(
        self,
        law: Law,
        assembler: ForceAssembler,
        stress: Array,
        state: Array,
        accounting: Accounting,
        strain: Array | None = None,
        material_index: NDArray[np.int32] | None = None,
    ) -> None:
        npoints = assembler.space.npoints
        self.law = law
        self.material_index = material_index
        self._assembler = assembler
        self._accounting = accounting
        self.stress_start = read("stress", stress, (npoints, 3)).copy()
        self.state_start = read("state", state, (npoints, law.description.nstate)).copy()
        self.strain_start = np.zeros((npoints, 3)) if strain is None else read("strain", strain, (npoints, 3)).copy()
        self.stress_end = self.stress_start.copy()
        self.state_end = self.state_start.copy()
        self.tangent_start = np.zeros((npoints, 3, 3))
        self.tangent_end = np.zeros((npoints, 3, 3))
        self._increment = np.zeros((npoints, 3))
        self._displacement_increment = np.empty(assembler.space.ndofs)
        self._tangent_of_end = False
        self.report: UpdateReport | None = None
        self.committed_report: UpdateReport | None = None

    def still_tangent(self, kind: TangentKind) -> UpdateReport:
        """Ask for the tangent of the committed state by a zero increment; it becomes `tangent_start`."""
        self._increment[:] = 0.0
        report = self._call(self.tangent_start, kind)
        self.committed_report = report
        return report

    @property
    def last_increment(self) -> Array:
        """Strain increment of the last call, shape (npt, 3)."""
        return self._increment

    def update(self, displacement: Array, committed: Array, kind: TangentKind) -> UpdateReport:
        """Trial state under nodal displacements; one call of the law.

        Parameters
        ----------
        displacement, committed : ndarray, shape (ndofs,)
            Trial displacements and those of the last commit [m].
        kind : {"propagated", "continuum", "elastic"}
            Tangent written to `tangent_end`.
        """
        with self._accounting.phase("state"):
            ndofs = len(self._displacement_increment)
            displacement = read("displacement", displacement, (ndofs,))
            committed = read("committed", committed, (ndofs,))
            np.subtract(displacement, committed, out=self._displacement_increment)
            self._assembler.strain(self._displacement_increment, self._increment)
        return self._call(self.tangent_end, kind)

    def follow(self, increment: Array) -> UpdateReport:
        """Trial state under given strain increments, shape (npt, 3), without tangent; one call of the law."""
        self._increment[:] = read("increment", increment, self._increment.shape)
        return self._call(None, "propagated")

    def _call(self, tangent: Array | None, kind: TangentKind) -> UpdateReport:
        with self._accounting.phase("law"):
            self.report = self.law.update(
                self._increment,
                self.stress_start,
                self.state_start,
                self.stress_end,
                self.state_end,
                tangent,
                kind,
                self.material_index,
            )
        self._accounting.law_calls += 1
        self._tangent_of_end = tangent is self.tangent_end
        return self.report

    def commit(self) -> None:
        """Make the last trial the start of the next step; without a tangent of its own the one before stays."""
        with self._accounting.phase("state"):
            self.stress_start, self.stress_end = self.stress_end, self.stress_start
            self.state_start, self.state_end = self.state_end, self.state_start
            if self._tangent_of_end:
                self.tangent_start, self.tangent_end = self.tangent_end, self.tangent_start
            self.strain_start += self._increment
            self.committed_report = self.report

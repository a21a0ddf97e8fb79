"""Columns of `history.csv` for rigid bodies, springs and controls; none where a run has none of these."""

from __future__ import annotations

from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.loads.load_program import LoadProgram

OF_A_BODY = ("displacement_x", "displacement_y", "rotation", "force_x", "force_y", "moment")


class BodyColumns:
    """What rigid bodies do and bear, what springs bear, and what a control has come to.

    Before its body comes, and after it has gone, a boundary has the motion that fits it best, and bears what supports
    of its own exert.

    Parameters
    ----------
    program : LoadProgram or None
    """

    def __init__(self, program: LoadProgram | None) -> None:
        self._rigid = [] if program is None else list(program.contacts)
        self._springs = [] if program is None else program.spring_boundaries
        self._controlled = program is not None and program.controlled
        self.names = [
            *(f"rigid_{name}_{what}" for name in self._rigid for what in OF_A_BODY),
            *(f"spring_{name}_{axis}" for name in self._springs for axis in "xy"),
            *(("load_factor",) if self._controlled else ()),
        ]

    def values(self, step: StepResult) -> list[float]:
        """Of one step, in the order of the names."""
        found = [float(value) for name in self._rigid for value in step.rigid[name]]
        found += [float(value) for name in self._springs for value in step.springs[name]]
        return [*found, float(step.load_factor)] if self._controlled else found

"""Why a point with grains could not be followed, in the words of grains."""

from __future__ import annotations

from dataclasses import dataclass

from granfabric.constitutive.contract import STATUS_TEXT, Status, UpdateReport

LARGEST_INCREMENT = 5e-3
"""Norm of the strain increment of one call above which a point asks for a smaller one: it would take minutes, and is a
trial far off."""

TEXT: dict[Status, str] = {
    **STATUS_TEXT,
    Status.NO_PRESSURE: "its packing has lost its pressure, the disks have come apart; try a smaller step or more "
    "confinement",
    Status.NOT_ADMISSIBLE: "its packing has more contacts than disks in a plane can have",
    Status.STIFFNESS_LOST: "its contacts no longer hold the packing up; prescribe strain",
    Status.TOO_MANY_SUBSTEPS: f"a strain increment of more than {LARGEST_INCREMENT:g} at once is not followed; try a "
    "smaller step",
    Status.NOT_FINITE: "the motion of its disks lost its stability, or the input holds a value that is not finite; try "
    "a smaller step",
    Status.NOT_CONVERGED: "its packing does not come to rest within law.longest_rest steps: it flows, or law.rest is "
    "finer than it can be; try a smaller step",
}


@dataclass(frozen=True)
class GrainsReport(UpdateReport):
    """What happened in one call, told of packings."""

    @property
    def message(self) -> str:
        """One sentence on the worst point."""
        if not self.status.size:
            return "no points"
        return f"point {self.worst_point}: {TEXT[Status(int(self.status[self.worst_point]))]}"

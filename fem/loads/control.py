"""A displacement that is led, while the loads of the stage follow: past a peak, where no load can be prescribed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .checks import LoadError, check_component, check_finite, pair


@dataclass(frozen=True)
class LoadControl:
    """Lead one displacement to a target; one factor of all loads that the stage names is found for it.

    The displacement goes linearly from where it is to the target. The loads are their values at the start of the stage
    plus the factor times the change that the stage names; the factor begins at 0 and is whatever equilibrium wants: it
    may pass 1, and fall where the body softens. The next stage starts from the loads that were reached.

    Parameters
    ----------
    target : float
        Total displacement at the end of the stage [m]; of ``component="rotation"`` the angle, anticlockwise [rad].
    component : {"x", "y", "rotation"}
    point : (float, float), optional
        The node nearest to it is led [m].
    rigid : str, optional
        Boundary of a rigid body that is led instead, at its point.
    """

    target: float
    component: str = "y"
    point: tuple[float, float] | None = None
    rigid: str | None = None

    def __post_init__(self) -> None:
        if (self.point is None) == (self.rigid is None):
            raise LoadError("a control needs either a point or the boundary of a rigid body")
        if self.point is not None:
            object.__setattr__(self, "point", pair("point of the control", self.point))
        if self.component != "rotation" or self.point is not None:
            check_component("control", self.component)
        check_finite("target of the control", self.target)

    def check(self, stage: Any) -> None:
        """Refuse a stage whose loads cannot follow.

        Raises
        ------
        LoadError
        """
        from .kinds import MOVING, Displacement  # they need this module
        from .rigid import RigidBody

        owner = f"stage {stage.name!r}"
        for load in stage.loads:
            if isinstance(load, Displacement) or (isinstance(load, RigidBody) and load.moves):
                raise LoadError(
                    f"{owner}: with a control the displacement that it leads is the only one that changes, but "
                    f"boundary {load.boundary!r} is displaced too"
                )
            if isinstance(load, MOVING) and stage.amplitude_of(load).kind != "ramp":
                raise LoadError(f"{owner}: with a control loads have no amplitude, they follow the displacement")
        if not any(isinstance(load, MOVING) for load in stage.loads):
            raise LoadError(f"{owner}: a control needs loads in the same stage that follow it")

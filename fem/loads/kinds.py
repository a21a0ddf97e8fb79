"""Loads and stages as data.

A value may be a number, a function of place, or the text of an expression in x and y
(`granfabric.fem.loads.expression`). An ``amplitude`` says how a load goes through its stage
(`granfabric.fem.loads.amplitude`); it is the stage's if None.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .amplitude import RAMP, Amplitude, amplitude
from .checks import COMPONENTS, LoadError, Value, check_component, check_finite, pair, scalar, several
from .control import LoadControl
from .rigid import RigidBody
from .springs import Spring

__all__ = [
    *("COMPONENTS", "INITIAL", "Amplitude", "Array", "BodyForce", "Displacement", "Fixed", "FixedPoint", "Load"),
    *("LoadControl", "LoadError", "Pressure", "RigidBody", "Spring", "Stage", "Traction", "check_stages"),
]


@dataclass(frozen=True)
class Fixed:
    """Hold components of a boundary where they are at the start of the stage (zero in the first stage).

    Parameters
    ----------
    boundary : str
    components : sequence of {"x", "y"}
    """

    boundary: str
    components: Sequence[str] = COMPONENTS

    def __post_init__(self) -> None:
        owner = f"fixed boundary {self.boundary!r}"
        object.__setattr__(self, "components", tuple(several(f"components of {owner}", self.components)))
        for component in self.components:
            check_component(owner, component)


@dataclass(frozen=True)
class FixedPoint:
    """Hold components of the node nearest to a point, to stop a rigid motion.

    Parameters
    ----------
    point : (float, float)
        Coordinates [m].
    components : sequence of {"x", "y"}
    """

    point: tuple[float, float]
    components: Sequence[str] = COMPONENTS

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", pair("fixed point", self.point))
        owner = f"fixed point {self.point}"
        object.__setattr__(self, "components", tuple(several(f"components of {owner}", self.components)))
        for component in self.components:
            check_component(owner, component)


@dataclass(frozen=True)
class Displacement:
    """Prescribed displacement of a boundary.

    Parameters
    ----------
    boundary : str
    component : {"x", "y"}
    value : float, str or callable
        Total displacement at the end of the stage [m]; a callable gets arrays ``x, y`` and returns an array.
    amplitude : str, Amplitude or table, optional
    """

    boundary: str
    component: str
    value: Value
    amplitude: Any = None

    def __post_init__(self) -> None:
        check_component(f"displacement of boundary {self.boundary!r}", self.component)
        object.__setattr__(self, "value", scalar(f"displacement of boundary {self.boundary!r}", self.value))
        _read_amplitude(self)


@dataclass(frozen=True)
class Traction:
    """Force per area of the undeformed boundary.

    Parameters
    ----------
    boundary : str
    value : (float or str, float or str) or callable
        Components at the end of the stage [Pa]; a callable gets arrays ``x, y, nx, ny`` (outward normal) and returns
        an array of shape (n, 2).
    name : str
        Tractions of different names act on one boundary together; one of the same name replaces the other.
    amplitude : str, Amplitude or table, optional
    """

    boundary: str
    value: Any
    name: str = "traction"
    amplitude: Any = None

    def __post_init__(self) -> None:
        if not callable(self.value):
            object.__setattr__(self, "value", pair(f"traction on boundary {self.boundary!r}", self.value, True))
        _read_amplitude(self)


@dataclass(frozen=True)
class Pressure:
    """Pressure on a boundary, compression positive: a force along minus the outward normal.

    Parameters
    ----------
    boundary : str
    value : float, str or callable
        At the end of the stage [Pa]; a callable gets arrays ``x, y`` and returns an array.
    amplitude : str, Amplitude or table, optional
    """

    boundary: str
    value: Value
    amplitude: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", scalar(f"pressure on boundary {self.boundary!r}", self.value))
        _read_amplitude(self)


@dataclass(frozen=True)
class BodyForce:
    """Force per volume, for instance gravity.

    Parameters
    ----------
    value : (float or str, float or str) or callable
        Components at the end of the stage [N/m^3]; a callable gets arrays ``x, y`` and returns (n, 2).
    region : str, optional
        Surface that carries it; everything if not given.
    amplitude : str, Amplitude or table, optional
    """

    value: Any
    region: str | None = None
    amplitude: Any = None

    def __post_init__(self) -> None:
        if not callable(self.value):
            object.__setattr__(self, "value", pair("body force", self.value, True))
        _read_amplitude(self)


def _read_amplitude(load: Any) -> None:
    if load.amplitude is not None:
        object.__setattr__(load, "amplitude", amplitude(load.amplitude))


Load = Fixed | FixedPoint | Displacement | Traction | Pressure | BodyForce | RigidBody | Spring
MOVING = (Displacement, Traction, Pressure, BodyForce, RigidBody)
"""Loads that have an amplitude."""
INITIAL = "initial"


@dataclass(frozen=True)
class Stage:
    """One stage of loading: every load goes from its value at the end of the previous stage to its new one.

    It goes linearly, or as its amplitude says.

    Parameters
    ----------
    name : str
        A first stage named "initial" holds its loads from the outset at full value, in balance with the initial stress.
    loads : list of Fixed, FixedPoint, Displacement, Traction, Pressure, BodyForce, RigidBody, Spring
    increments : int
        Number of load steps to begin with.
    keep : bool
        What an earlier stage set and this one does not name: if True it stays as it is; if False forces fade to zero
        and boundaries are released (their reactions fade to zero).
    drained : bool
        The law is the one without what drains, `law.drained()`; laws that have none stay as they are.
    amplitude : str, Amplitude or table
        Of the loads that have none of their own.
    control : LoadControl, optional
        The loads that the stage names grow or fall together so that a displacement goes as wanted.
    deactivate, activate : sequence of str
        Regions that the stage takes away, and regions that it adds; see `granfabric.fem.loads.bodies`.
    release : float
        Share of the forces that excavated regions had exerted which is released at the end of the stage; they fade
        linearly. A later stage releases the rest, or up to its own share.
    fill_pressure : float
        Isotropic pressure under which what the stage activates is placed [Pa]; what nothing balances of it fades over
        the stage.
    reset_displacements : bool
        Displacements and strains count from the beginning of the stage.
    """

    name: str
    loads: Sequence[Load] = field(default_factory=list)
    increments: int = 1
    keep: bool = True
    drained: bool = False
    amplitude: Any = RAMP
    control: LoadControl | None = None
    deactivate: Sequence[str] = ()
    activate: Sequence[str] = ()
    release: float = 1.0
    fill_pressure: float = 0.0
    reset_displacements: bool = False

    def __post_init__(self) -> None:
        whole = isinstance(self.increments, (int, np.integer)) and not isinstance(self.increments, bool)
        if not whole or self.increments < 1:
            raise LoadError(f"stage {self.name!r}: increments = {self.increments!r} is not a positive integer")
        object.__setattr__(self, "increments", int(self.increments))
        object.__setattr__(self, "loads", several(f"stage {self.name!r}: loads", self.loads))
        for load in self.loads:
            if not isinstance(load, Load):
                raise LoadError(f"stage {self.name!r}: {load!r} is not a load")
        self._check_body()
        try:
            object.__setattr__(self, "amplitude", amplitude(self.amplitude))
        except LoadError as error:
            raise LoadError(f"stage {self.name!r}: {error}") from None
        if self.name == INITIAL and (
            self.control is not None or any(self.amplitude_of(load) != RAMP for load in self.loads)
        ):
            raise LoadError(
                f"stage {self.name!r}: its loads act from the outset; it has neither an amplitude nor a control"
            )
        if self.control is not None:
            self.control.check(self)

    def amplitude_of(self, load: Any) -> Amplitude:
        """Amplitude of a load of this stage."""
        if not isinstance(load, MOVING):
            return RAMP
        own = load.amplitude
        return self.amplitude if own is None else own

    def _check_body(self) -> None:
        owner = f"stage {self.name!r}"
        for key in ("deactivate", "activate"):
            given = getattr(self, key)
            names = [given] if isinstance(given, str) else several(f"{owner}: {key}", given)
            for name in names:
                if names.count(name) > 1:
                    raise LoadError(f"{owner} {key}s region {name!r} twice")
            object.__setattr__(self, key, tuple(names))
        for key, upper in (("release", 1.0), ("fill_pressure", np.inf)):
            value = getattr(self, key)
            check_finite(f"{owner}: {key}", value)
            if not 0.0 <= value <= upper:
                legal = "between 0 and 1" if upper == 1.0 else "zero or above (compression is positive here)"
                raise LoadError(f"{owner}: {key} = {value:g} is not {legal}")
        if self.fill_pressure and not self.activate:
            raise LoadError(f"{owner}: fill_pressure = {self.fill_pressure:g}, but the stage activates no region")


def check_stages(stages: Sequence[Stage]) -> None:
    """Refuse what cannot be run.

    Raises
    ------
    LoadError
    """
    if not stages:
        raise LoadError("there are no stages; give at least one")
    names = [stage.name for stage in stages]
    for name in names:
        if names.count(name) > 1:
            raise LoadError(f"two stages are named {name!r}; names must differ")
    if INITIAL in names[1:]:
        raise LoadError(f"stage {INITIAL!r} must be the first one")

"""Loads and stages as data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Field = Callable[..., Any]

COMPONENTS = ("x", "y")


class LoadError(ValueError):
    """A load or a stage is not possible; the text names it and says what is legal."""


def _check_component(owner: str, component: str) -> None:
    if component not in COMPONENTS:
        raise LoadError(f"{owner}: component {component!r} is not one of 'x', 'y'")


def _check_finite(owner: str, *values: Any) -> None:
    for value in values:
        if callable(value):
            continue
        number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        if not number or not np.isfinite(value):
            raise LoadError(f"{owner} = {value!r} is not a finite number")


def _pair(owner: str, value: Any) -> tuple[float, float]:
    """Two components; one, or three of another code, would be stretched or shifted without a word."""
    if not isinstance(value, (Sequence, np.ndarray)) or isinstance(value, str) or np.shape(value) != (2,):
        raise LoadError(f"{owner} = {value!r} is not a pair of numbers, x and y")
    _check_finite(owner, *value)
    return value[0], value[1]


def _several(owner: str, given: Any) -> list[Any]:
    """A list of what was given, which may be read only once."""
    try:
        return list(given)
    except TypeError:
        raise LoadError(f"{owner} must be in a list, got a {type(given).__name__}") from None


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
        object.__setattr__(self, "components", tuple(_several(f"components of {owner}", self.components)))
        for component in self.components:
            _check_component(owner, component)


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
        object.__setattr__(self, "point", _pair("fixed point", self.point))
        owner = f"fixed point {self.point}"
        object.__setattr__(self, "components", tuple(_several(f"components of {owner}", self.components)))
        for component in self.components:
            _check_component(owner, component)


@dataclass(frozen=True)
class Displacement:
    """Prescribed displacement of a boundary.

    Parameters
    ----------
    boundary : str
    component : {"x", "y"}
    value : float or callable
        Total displacement at the end of the stage [m]; a callable gets arrays ``x, y`` and returns an array.
    """

    boundary: str
    component: str
    value: float | Field

    def __post_init__(self) -> None:
        _check_component(f"displacement of boundary {self.boundary!r}", self.component)
        _check_finite(f"displacement of boundary {self.boundary!r}", self.value)


@dataclass(frozen=True)
class Traction:
    """Force per area of the undeformed boundary.

    Parameters
    ----------
    boundary : str
    value : (float, float) or callable
        Components at the end of the stage [Pa]; a callable gets arrays ``x, y, nx, ny`` (outward normal) and returns
        an array of shape (n, 2).
    name : str
        Tractions of different names act on one boundary together; one of the same name replaces the other.
    """

    boundary: str
    value: tuple[float, float] | Field
    name: str = "traction"

    def __post_init__(self) -> None:
        if not callable(self.value):
            _pair(f"traction on boundary {self.boundary!r}", self.value)


@dataclass(frozen=True)
class Pressure:
    """Pressure on a boundary, compression positive: a force along minus the outward normal.

    Parameters
    ----------
    boundary : str
    value : float or callable
        At the end of the stage [Pa]; a callable gets arrays ``x, y`` and returns an array.
    """

    boundary: str
    value: float | Field

    def __post_init__(self) -> None:
        _check_finite(f"pressure on boundary {self.boundary!r}", self.value)


@dataclass(frozen=True)
class BodyForce:
    """Force per volume, for instance gravity.

    Parameters
    ----------
    value : (float, float) or callable
        Components at the end of the stage [N/m^3]; a callable gets arrays ``x, y`` and returns (n, 2).
    region : str, optional
        Surface that carries it; everything if not given.
    """

    value: tuple[float, float] | Field
    region: str | None = None

    def __post_init__(self) -> None:
        if not callable(self.value):
            _pair("body force", self.value)


Load = Fixed | FixedPoint | Displacement | Traction | Pressure | BodyForce
INITIAL = "initial"


@dataclass(frozen=True)
class Stage:
    """One stage of loading: every load goes linearly from its value at the end of the previous stage to its new one.

    Parameters
    ----------
    name : str
        A first stage named "initial" holds its loads from the outset at full value, in balance with the initial stress.
    loads : list of Fixed, FixedPoint, Displacement, Traction, Pressure, BodyForce
    increments : int
        Number of load steps to begin with.
    keep : bool
        What an earlier stage set and this one does not name: if True it stays as it is; if False forces fade to zero
        and boundaries are released (their reactions fade to zero).
    drained : bool
        The law is the one without what drains, `law.drained()`; laws that have none stay as they are.
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
        object.__setattr__(self, "loads", _several(f"stage {self.name!r}: loads", self.loads))
        for load in self.loads:
            if not isinstance(load, Load):
                raise LoadError(f"stage {self.name!r}: {load!r} is not a load")
        self._check_body()

    def _check_body(self) -> None:
        owner = f"stage {self.name!r}"
        for key in ("deactivate", "activate"):
            given = getattr(self, key)
            names = [given] if isinstance(given, str) else _several(f"{owner}: {key}", given)
            for name in names:
                if names.count(name) > 1:
                    raise LoadError(f"{owner} {key}s region {name!r} twice")
            object.__setattr__(self, key, tuple(names))
        for key, upper in (("release", 1.0), ("fill_pressure", np.inf)):
            value = getattr(self, key)
            _check_finite(f"{owner}: {key}", value)
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

"""Paths of the map: what the DEM is loaded by, and over what the curves are drawn."""

from __future__ import annotations

from dataclasses import dataclass

from granfabric.cases.errors import InputError, unknown
from granfabric.cases.verify.dem_side import LARGEST_STRAIN, LOADINGS, STRESS_RATIO, loading_options, title_of
from granfabric.cases.verify.paths import AMPLITUDE
from granfabric.cases.verify.paths import PATHS as TURNING_PATHS
from granfabric.dem_ref.loading.path import Segment, loading_cycles, principal_rotation
from granfabric.dem_ref.loading.run import RunOptions

ALL = "all"
LAST_RATIO = 0.3
CYCLES = 5
ABSCISSAE = {
    "stress_ratio": "stress ratio $q/p$ [-]",
    "pressure_ratio": "mean pressure $p/p_0$ [-]",
    "angle": "direction of the major compression from its start [degrees]",
}
"""Over what curves are drawn, with the labels of the axes."""


@dataclass(frozen=True)
class MapPath:
    """A path of the map.

    Attributes
    ----------
    title, short : str
        What it is; the head of a column.
    segments : tuple of Segment
        Axis of first loading along y.
    abscissa : str
        One of `ABSCISSAE`.
    turning : bool
        Whether harmonics are told along the major compression, which turns, instead of along y.
    """

    title: str
    short: str
    segments: tuple[Segment, ...]
    abscissa: str = "stress_ratio"
    turning: bool = False

    @property
    def options(self) -> RunOptions:
        """Of the DEM run."""
        return RunOptions(self.segments)


def _to(pressure: float, ratio: float = 0.0) -> Segment:
    """Straight in p and q to p over its first value, and q/p with the major compression along y."""
    return Segment("invariants", pressure=pressure, stress_ratio=ratio)


def _ratio(ratio: float, sign: float = 1.0) -> Segment:
    """To q/p at constant p, driven by strain; sign -1 unloads."""
    return Segment("biaxial", "constant_pressure", sign * LARGEST_STRAIN, ratio)


def _of(name: str, short: str, abscissa: str = "stress_ratio", turning: bool = False) -> MapPath:
    """A path of the comparison without a map, whose runs are used again."""
    return MapPath(title_of(name), short, loading_options(name).segments, abscissa, turning)


MAP_PATHS: dict[str, MapPath] = {
    "constant_pressure": _of("constant_pressure", "p constant"),
    "constant_lateral_stress": _of("constant_lateral_stress", "lateral constant"),
    "lateral_stress_falling": MapPath(
        "lateral stress falling, vertical stress constant",
        "lateral falling",
        # extension across y, seen along x
        (Segment("biaxial", "constant_lateral_stress", -LARGEST_STRAIN, -STRESS_RATIO, angle=0.0),),
    ),
    "isotropic_falling": MapPath(
        "isotropic pressure falling to 0.3", "isotropic 1 to 0.3", (_to(0.5), _to(0.3)), "pressure_ratio"
    ),
    "isotropic_to_tenth": MapPath(
        "isotropic pressure falling to a tenth", "isotropic 1 to 0.1", (_to(0.5), _to(0.3), _to(0.1)), "pressure_ratio"
    ),
    "isotropic_rising": MapPath(
        "isotropic pressure doubled, then falling to 0.3",
        "isotropic 1, 2, 1, 0.3",
        (_to(2.0), _to(1.0), _to(0.5), _to(0.3)),
        "pressure_ratio",
    ),
    "pressure_halved": MapPath(
        "mean pressure halved while q/p grows to 0.3", "p halved, q/p to 0.3", (_to(0.5, LAST_RATIO),), "pressure_ratio"
    ),
    "pressure_doubled": MapPath(
        "q/p to 0.15, then mean pressure doubled and back",
        "q/p 0.15, p 1, 2, 1",
        (_to(1.0, 0.15), _to(2.0, 0.15), _to(1.0, 0.15)),
        "pressure_ratio",
    ),
    "constant_volume": MapPath(
        "volume constant", "volume constant", (Segment("biaxial", "constant_volume", LARGEST_STRAIN, STRESS_RATIO),)
    ),
    "loop": MapPath("loop of q/p: 0, 0.2, 0, 0.2", "loop 0, .2, 0, .2", tuple(loading_cycles(AMPLITUDE, 1))),
    "cycles": _of("cycles", "2 cycles, reversal"),
    "cyclic": MapPath(
        "q/p five times between 0.1 and 0.2",
        "cyclic .1 to .2",
        (_ratio(AMPLITUDE), *[_ratio(0.1, -1.0), _ratio(AMPLITUDE)] * CYCLES),
    ),
    "rotation": _of("rotation", "rotation at q/p 0.2", "angle", turning=True),
    "rotation_small": MapPath(
        "half a turn of the principal axes at q/p = 0.1",
        "rotation at q/p 0.1",
        tuple(principal_rotation(0.1, 0.5)),
        "angle",
        turning=True,
    ),
}
"""By name; those of the comparison without a map among them."""

DEFAULT_PATHS = (*LOADINGS, *TURNING_PATHS)
QUICK_PATHS = (
    *("constant_pressure", "constant_lateral_stress", "lateral_stress_falling", "isotropic_falling"),
    *("pressure_halved", "loop"),
)


def chosen_names(option: str, what: str, text: str, legal: dict[str, object]) -> list[str]:
    """Names of a comma-separated list, each once, in the order given; `all` stands for every one.

    Raises
    ------
    InputError
        If a name is unknown, or there is none.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise InputError(f"{option} names nothing (legal: {', '.join([*legal, ALL])})")
    for name in names:
        if name not in (*legal, ALL):
            raise InputError(unknown(f"{option}: the {what}", name, [*legal, ALL]))
    return list(legal) if ALL in names else list(dict.fromkeys(names))


def chosen_paths(text: str | None, quick: bool = False) -> dict[str, MapPath]:
    """Paths of `--paths`; without it those of the comparison without a map, or a few of all kinds if `quick`.

    Raises
    ------
    InputError
    """
    if text is None:
        names = list(QUICK_PATHS if quick else DEFAULT_PATHS)
    else:
        names = chosen_names("--paths", "path", text, dict(MAP_PATHS))
    return {name: MAP_PATHS[name] for name in names}

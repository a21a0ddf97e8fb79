"""Numbers of a scene that are plainly in another unit than SI: kPa, kN/m3, MPa, percent, millimetres."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from .effects_choice import BULK, material_sections
from .reader import LoadedScene
from .schema_law_kind import is_grains

STIFF, SOFT = 3e6, 10.0
"""kn/p above which a pressure in kPa is suspected, and below which a stiffness in MPa or GPa is; packings of hard
grains have 1e3 to 1e6."""
LIGHT = 1e3
"""Weight per volume [N/m3] below which kN/m3 are suspected; ground has 1e4 to 3e4, also under water."""
TRICKLE = 100.0
"""Rise of a pore pressure [Pa/m] below which kPa/m are suspected."""
THIN = 1e4
"""Bulk modulus [Pa] below which no pore fluid is: air has 1e5, water 2.2e9."""
FAINT, FAINT_SHARE = 1e3, 1e-2
"""Load [Pa], and load over initial pressure, below which kPa are suspected."""
LARGE_STRAIN = 0.2
"""Strain from which percent are suspected: the law is one of small strains."""
FAR = 0.5
"""Displacement over the size of the body from which millimetres are suspected."""
HUGE = 3e3
"""Size of a mesh [m] from which millimetres are suspected."""
KILOPASCALS = "stresses are in Pa, not kPa (100 kPa is 100e3)"

Place = Sequence[Any]


def hints(loaded: LoadedScene, pressure: float, size: float = math.nan) -> list[str]:
    """Warnings on what is hardly meant in the unit in which it is taken; nothing is refused.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "point" or "field".
    pressure : float
        Mean initial pressure [Pa].
    size : float, optional
        Largest extent of the body [m].
    """
    found = doubtful(loaded.scene, pressure, size)
    return [*stiffness(loaded.scene, pressure), *(f"warning: {loaded.label(keys)}: {text}" for keys, text in found)]


def stiffness(scene: Any, pressure: float) -> list[str]:
    """A warning if contacts are so stiff, or so soft, for the pressure that a unit must have been taken for another.

    Parameters
    ----------
    scene : PointScene or FieldScene
    pressure : float
        Mean initial pressure [Pa].
    """
    if is_grains(scene) or not pressure > 0.0:  # packings have bounds of their own
        return []
    values = [section.normal_stiffness for section in material_sections(scene).values()]
    if max(values) / pressure > STIFF:
        return [f"warning: mean initial pressure {pressure:.4g} Pa, kn/p = {max(values) / pressure:.1g}: {KILOPASCALS}"]
    if min(values) / pressure < SOFT:
        return [
            f"warning: normal_stiffness = {min(values):g} Pa, kn/p = {min(values) / pressure:.1g} under the mean "
            f"initial pressure of {pressure:.4g} Pa: stiffnesses are in Pa, not MPa or GPa (1 GPa is 1e9)"
        ]
    return []


def doubtful(scene: Any, pressure: float, size: float = math.nan) -> list[tuple[Place, str]]:
    """Keys of a scene with numbers that are hardly meant in the unit in which they are taken, and what to say of each.

    Parameters
    ----------
    scene : PointScene or FieldScene
    pressure : float
        Mean initial pressure [Pa].
    size : float, optional
        Largest extent of the body [m].
    """
    found = [*_materials(scene), *_initial(scene.initial, pressure)]
    if size > HUGE:
        found.append((["mesh"], f"it is {size:.4g} m long: coordinates are in m, not mm"))
    if scene.kind == "point":
        found += _path(scene, pressure)
    else:
        for place, stage in enumerate(scene.stage):
            found += _stage(["stage", place], stage, pressure, size)
    return found


def _materials(scene: Any) -> Iterator[tuple[Place, str]]:
    if is_grains(scene):
        return
    for name, section in material_sections(scene).items():
        value = getattr(section, BULK)
        if 0.0 < value < THIN:
            yield [*name.split("."), BULK], f"{value:g} Pa is that of no fluid: moduli are in Pa (water has 2.2e9)"


def _initial(initial: Any, pressure: float) -> Iterator[tuple[Place, str]]:
    weight = getattr(initial, "water_unit_weight", 0.0)
    if 0.0 < weight < LIGHT:
        yield ["initial", "water_unit_weight"], f"{weight:g} N/m3: unit weights are in N/m3, not kN/m3 (water has 9810)"
    rise = getattr(initial, "stress_gradient_y", (0.0, 0.0, 0.0))[1]
    if 0.0 < abs(rise) < LIGHT:
        yield (
            ["initial", "stress_gradient_y"],
            f"yy rises by {rise:g} Pa/m: unit weights are in N/m3, not kN/m3 (18 kN/m3 is 18e3)",
        )
    rise = getattr(initial, "pore_pressure_gradient", (0.0, 0.0))[1]
    if 0.0 < abs(rise) < TRICKLE:
        yield ["initial", "pore_pressure_gradient"], f"{rise:g} Pa/m along y: it is in Pa/m, not kPa/m (water has 9810)"
    if _is_faint(initial.pore_pressure, pressure):
        yield ["initial", "pore_pressure"], _faint(initial.pore_pressure, pressure)


def _path(scene: Any, pressure: float) -> Iterator[tuple[Place, str]]:
    for place, leg in enumerate(scene.path):
        if leg.target is None:
            continue
        keys = ["path", place, "target"]
        under = [value for value, kind in zip(leg.target, leg.control) if kind == "stress"]
        largest = max(map(abs, under), default=0.0)
        if not leg.relative and len(under) > 1 and _is_faint(largest, pressure):
            yield keys, _faint(largest, pressure)
        strains = [value for value, kind in zip(leg.target, leg.control) if kind == "strain"]
        if any(abs(value) > LARGE_STRAIN for value in strains):
            yield keys, f"a strain of {max(strains, key=abs):g}: strains are ratios, not percent (1 % is 0.01)"


def _stage(keys: Place, stage: Any, pressure: float, size: float) -> Iterator[tuple[Place, str]]:
    for number, load in enumerate(stage.body_force):
        force = _length(load.value)
        # what is not straight down may be an acceleration, which may be small
        if 0.0 < force < LIGHT and load.value[0] == 0.0 and load.value[1] < 0.0 and _is_steady(load, stage):
            yield (
                [*keys, "body_force", number],
                f"{force:g} N/m3: unit weights are in N/m3, not kN/m3 (18 kN/m3 is [0.0, -18e3])",
            )
    for kind in ("pressure", "traction"):
        for number, load in enumerate(getattr(stage, kind)):
            value = _length(load.value if kind == "traction" else [load.value])
            if _is_faint(value, pressure) and _is_steady(load, stage) and not any(getattr(load, "gradient", ())):
                yield [*keys, kind, number], _faint(value, pressure)
    for number, load in enumerate(stage.displacement):
        if _length([load.value]) > FAR * size:
            yield (
                [*keys, "displacement", number],
                f"{load.value:g} m on a body of {size:.4g} m: lengths are in m, not mm (1 mm is 1e-3)",
            )
    for number, load in enumerate(stage.rigid):
        far = max(abs(load.displacement_x or 0.0), abs(load.displacement_y or 0.0))
        if far > FAR * size:
            yield (
                [*keys, "rigid", number],
                f"{far:g} m on a body of {size:.4g} m: lengths are in m, not mm (1 mm is 1e-3)",
            )


def _is_steady(load: Any, stage: Any) -> bool:
    """Whether a load just comes up: what goes to and fro may be small."""
    return (stage.amplitude if load.amplitude is None else load.amplitude) in ("ramp", "step")


def _length(values: Sequence[Any]) -> float:
    """Length of a vector of numbers; 0 if expressions are among them."""
    return 0.0 if any(isinstance(value, str) for value in values) else math.hypot(*values)


def _is_faint(value: float, pressure: float) -> bool:
    return 0.0 < abs(value) < min(FAINT, FAINT_SHARE * pressure)


def _faint(value: float, pressure: float) -> str:
    return f"{value:g} Pa next to an initial pressure of {pressure:.4g} Pa: {KILOPASCALS}"

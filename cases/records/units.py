"""Units of the columns of `history.csv`, whose names hold none; `run.json` lists them under `columns`."""

from __future__ import annotations

import re
from collections.abc import Iterable

_STRESS = r"stress_(xx|yy|xy|zz)|[pq]"
_UNITS = (
    (r"(reaction|rigid)_.*_moment", "N m/m"),
    (r"rigid_.*_rotation", "rad"),
    (r"(reaction|spring)_.*_[xy]|rigid_.*_force_[xy]|(upper|lower)_(force|shear)", "N/m"),
    (r"displacement_.*_[xy]|rigid_.*_displacement_[xy]|height|width", "m"),
    (rf"(region_.*_|effective_)?({_STRESS})|pore_pressure.*|plastic_dissipation|axial_stress", "Pa"),
    (r"(elastic|kinetic)_energy|energy_error|((platen|given|following)_)?work|friction_heat|drag_heat", "J/m"),
)


def unit(name: str) -> str:
    """SI unit of a column, per metre out of the plane; "-" if it has none."""
    return next((unit for pattern, unit in _UNITS if re.fullmatch(pattern, name)), "-")


def units(names: Iterable[str]) -> dict[str, str]:
    """Unit of each column."""
    return {name: unit(name) for name in names}

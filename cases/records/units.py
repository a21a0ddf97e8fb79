"""Units of the columns of `history.csv`, whose names hold none; `run.json` lists them under `columns`."""

from __future__ import annotations

import re
from collections.abc import Iterable

_UNITS = (
    (r"(.*_)?moment", "N m/m"),
    (r"rigid_.*_rotation", "rad"),
    (r"(reaction|spring)_.*_[xy]|rigid_.*_force_[xy]", "N/m"),
    (r"(.*_)?displacement_.*", "m"),
    (r"(.*_)?stress_(xx|yy|xy|zz)|(region_.*_|effective_)?[pq]|pore_pressure.*", "Pa"),
)


def unit(name: str) -> str:
    """SI unit of a column, per metre out of the plane; "-" if it has none."""
    return next((unit for pattern, unit in _UNITS if re.fullmatch(pattern, name)), "-")


def units(names: Iterable[str]) -> dict[str, str]:
    """Unit of each column."""
    return {name: unit(name) for name in names}

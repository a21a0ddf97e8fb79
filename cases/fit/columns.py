"""What the columns of a user's curve may be called: names, short names, units, and what a deviation is counted in."""

from __future__ import annotations

import re
from dataclasses import dataclass

from granfabric.constitutive.path import POINT_COLUMNS, SLIDING_COLUMNS
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS as DEM_COLUMNS

STRESS = ("stress_xx", "stress_yy", "stress_xy")
STRAIN = ("strain_xx", "strain_yy", "strain_xy")
INVARIANTS = ("p", "q", "stress_ratio", "major_stress_angle")
ERROR = "_error"
"""Ending of the name of a column that holds standard errors of another one."""

UNITS: dict[str, dict[str, float]] = {
    "Pa": {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9},
    "-": {"-": 1.0, "%": 1e-2, "1e-3": 1e-3, "1e-6": 1e-6},
    "degrees": {"degrees": 1.0, "deg": 1.0, "rad": 57.29577951308232},
}
"""Units that may stand in brackets behind a name, by the unit without brackets, each with its factor."""


@dataclass(frozen=True)
class Column:
    """A legal column.

    Attributes
    ----------
    name : str
        As in the files that the program writes.
    short : tuple of str
        Other names that are taken for it.
    unit : str
        Of numbers in a column without a unit in brackets.
    meaning : str
    scale : float
        Deviation that counts as one where the file gives no errors: absolute, of stresses a fraction of the pressure
        at the start, of strains a fraction of the largest in the column. Zero: the column is followed, not compared.
    """

    name: str
    short: tuple[str, ...]
    unit: str
    meaning: str
    scale: float


def _vector(name: str, short: str, old: str, meaning: str) -> list[Column]:
    return [
        Column(name, (short,), "-", f"{meaning}, positive along the first major stress", 0.01),
        Column(f"{name}_1", (f"{short}_1", f"{old}_xx"), "-", f"{meaning}, component along cos 2 theta", 0.01),
        Column(f"{name}_2", (f"{short}_2", f"{old}_xy"), "-", f"{meaning}, component along sin 2 theta", 0.01),
    ]


COLUMNS: tuple[Column, ...] = (
    Column("stress_xx", ("sigma_xx",), "Pa", "stress xx, tension positive", 0.01),
    Column("stress_yy", ("sigma_yy",), "Pa", "stress yy, tension positive", 0.01),
    Column("stress_xy", ("sigma_xy",), "Pa", "shear stress xy", 0.01),
    Column("p", (), "Pa", "mean pressure -(stress_xx + stress_yy)/2, positive in compression", 0.01),
    Column("q", (), "Pa", "half the difference of the principal stresses; below zero: the axes exchanged", 0.01),
    Column("stress_ratio", ("q/p", "eta"), "-", "q/p", 0.005),
    Column(
        "major_stress_angle", ("theta",), "degrees",
        "direction of the major compressive stress from x, anticlockwise; 90 (the y axis) if not given", 0.0,
    ),
    Column("strain_xx", ("eps_xx", "epsilon_xx"), "-", "strain xx, tension positive", 0.02),
    Column("strain_yy", ("eps_yy", "epsilon_yy"), "-", "strain yy, tension positive", 0.02),
    Column("strain_xy", ("gamma_xy",), "-", "engineering shear strain gamma_xy", 0.02),
    Column("volumetric_strain", ("eps_v",), "-", "strain_xx + strain_yy, dilation positive", 0.02),
    Column("shear_strain", ("gamma",), "-", "difference of the principal strains, not below zero", 0.02),
    Column("coordination", ("z",), "-", "coordination number, counted as the material's is", 0.02),
    *_vector("fabric_anisotropy", "a_c", "fabric", "fabric anisotropy"),
    *_vector("normal_force_anisotropy", "a_n", "normal_force", "normal-force anisotropy"),
    *_vector("tangential_force_anisotropy", "a_t", "tangential_force", "tangential-force anisotropy"),
    Column("mean_normal_force", ("f/f0",), "-", "mean normal force over that of the first row", 0.01),
)  # fmt: skip
BY_NAME = {column.name: column for column in COLUMNS}
LEGAL = {other: column.name for column in COLUMNS for other in (column.name, *column.short)}
VECTORS = ("fabric_anisotropy", "normal_force_anisotropy", "tangential_force_anisotropy")

PASSED_OVER = {"time", *POINT_COLUMNS, *SLIDING_COLUMNS, *DEM_COLUMNS} - set(LEGAL)
"""Columns of the program's own histories that no law is compared by."""

HEAD = re.compile(r"\s*(?P<name>[^\[\]()]*?)\s*(?:[\[(]\s*(?P<unit>[^\[\]()]*?)\s*[\])])?\s*")


def legal_names() -> list[str]:
    """Names and short names, each name with its short ones in brackets, for a sentence."""
    return [f"{column.name} ({', '.join(column.short)})" if column.short else column.name for column in COLUMNS]

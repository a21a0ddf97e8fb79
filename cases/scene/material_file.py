"""Measured inputs of the point law in a file of their own, from `granfabric dem` to `granfabric point` and `run`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError, unknown
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Closure, Material

from .toml_file import read_table
from .toml_text import to_toml

LAW_TABLES = ("material", "closure")
MEASURED = "measured"
"""Table of what was measured besides; not read back."""


def read_material(file: Path) -> dict[str, dict[str, Any]]:
    """Tables ``[material]`` and ``[closure]`` of a material file; values are checked with the scene they go into.

    Raises
    ------
    InputError
        If the file cannot be read or has other tables or keys.
    """
    table = read_table(file)
    table.pop(MEASURED, None)
    legal = {"material": [variable.name for variable in Material.variables()], "closure": closure_keys()}
    for section, entries in table.items():
        if section not in LAW_TABLES:
            raise InputError(f"{file}: {unknown('the table', section, LAW_TABLES)}")
        if not isinstance(entries, dict):
            raise InputError(f"{file}: {section} = {entries!r} is not a table")
        for key in entries:
            if key not in legal[section]:
                raise InputError(f"{file}: {unknown('the key', f'{section}.{key}', legal[section], spelled=key)}")
    if "material" not in table:
        raise InputError(f"{file}: the table [material] is missing")
    return table


def closure_keys() -> list[str]:
    """Names of what `Closure` takes."""
    return [entry.name for entry in fields(Closure)]


def law_tables(measured: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Sort measured values into the tables of a material file; what the law does not take goes to ``[measured]``."""
    names = {"material": {variable.name for variable in Material.variables()}, "closure": set(closure_keys())}
    tables: dict[str, dict[str, Any]] = {"material": {}, "closure": {}, MEASURED: {}}
    for key, value in measured.items():
        section = next((section for section in LAW_TABLES if key in names[section]), MEASURED)
        tables[section][key] = float(value)
    return {section: entries for section, entries in tables.items() if entries}


def material_text(measured: dict[str, float], origin: str) -> str:
    """Text of a material file."""
    head = (
        f"# Measured on disks: {origin}\n"
        "# Read by point and field scenes: material_file = ..., or --set material_file=...\n"
    )
    tables = law_tables(measured)
    if all(name in tables.get("closure", {}) for name in CLOSURE_NUMBERS):
        # what these numbers were measured for, and what disks agree with; a scene may say otherwise
        tables["closure"] = {"force_change": "shifted_distribution", **tables["closure"]}
        if tables["material"].get("isostatic_coordination", math.inf) < tables["material"]["coordination"]:
            tables["closure"] = {"shear_stiffness": "isostatic", **tables["closure"]}
    return head + to_toml(tables).lstrip()

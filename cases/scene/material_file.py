"""Measured inputs of the point law in a file of their own, from `granfabric dem` to `granfabric point` and `run`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError, several, short, unknown
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Closure, Material, ParameterError

from .measured import Inputs, bounds, remarks
from .toml_file import read_table
from .toml_text import to_toml

LAW_TABLES = ("material", "closure")
MEASURED = "measured"
"""Table of what was measured besides; not read back."""
OPTIONAL = ("weak_contact_gradient", "tangential_force_loss")
"""Numbers of a closure that measured inputs may lack: files of before they were measured, packings without friction."""


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
    wrong = []
    for section, entries in table.items():
        if section not in LAW_TABLES:
            wrong.append(unknown("the table" if _is_table(entries) else "the key", section, LAW_TABLES))
        elif isinstance(entries, list) and entries and all(isinstance(entry, dict) for entry in entries):
            wrong.append(f"[[{section}]] is there only once: write [{section}] with one bracket")
        elif not isinstance(entries, dict):
            wrong.append(f"{section} = {short(entries)} is not a table")
        else:
            unknown_keys = [key for key in entries if key not in legal[section]]
            wrong += [unknown("the key", f"{section}.{key}", legal[section], spelled=key) for key in unknown_keys]
    if wrong:
        raise several([f"{file}: {text}" for text in [*wrong, *_out_of_bounds(table)]])
    if "material" not in table:
        raise InputError(f"{file}: the table [material] is missing")
    return table


def _is_table(entries: Any) -> bool:
    return isinstance(entries, dict) or (isinstance(entries, list) and any(isinstance(one, dict) for one in entries))


def _out_of_bounds(table: Mapping[str, Any]) -> list[str]:
    """Numbers outside the bounds of the law, for a file that is refused for its keys: the scene's check comes later."""
    limits, found = bounds(), []
    for section in LAW_TABLES:
        entries = table.get(section)
        for key, value in entries.items() if isinstance(entries, dict) else ():
            low, high = limits.get(key, (-math.inf, math.inf))
            if isinstance(value, (int, float)) and not isinstance(value, bool) and not low <= value <= high:
                found.append(f"{section}.{key} = {short(value)} is outside its bounds [{low:g}, {high:g}]")
    return found


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


def refusal(values: Mapping[str, float]) -> str:
    """What the law says against values that are within their bounds each but do not go together; empty if nothing."""
    tables = law_tables(values)
    closure = closure_table(tables)
    try:
        ContactLaw(
            [Material(**tables["material"])], Closure(**closure), Effects(sliding="peak_stress_ratio" in values)
        )
    except ParameterError as error:
        return str(error)
    return ""


def closure_table(tables: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Table [closure] with the choices that the measured numbers are for."""
    closure = tables.get("closure", {})
    if not all(name in closure for name in CLOSURE_NUMBERS if name not in OPTIONAL):
        return closure
    # what these numbers were measured for, and what disks agree with; a scene may say otherwise
    closure = {"force_change": "shifted_distribution", **closure}
    if tables["material"].get("isostatic_coordination", math.inf) < tables["material"]["coordination"]:
        closure = {"shear_stiffness": "isostatic", **closure}
    return closure


def material_text(
    measured: Mapping[str, float],
    origin: str,
    errors: Mapping[str, float] | None = None,
    missing: Sequence[str] = (),
) -> str:
    """Text of a material file.

    Parameters
    ----------
    measured : mapping of str to float
    origin : str
        What it was measured on.
    errors : mapping of str to float, optional
        Standard errors, which stand as comments beside the values, with what is doubtful about them.
    missing : sequence of str
        What could not be measured.
    """
    head = (
        f"# Measured on disks: {origin}\n"
        "# Read by point and field scenes: material_file = ..., or --set material_file=...\n"
    )
    if errors is not None:
        head += "# +- is the standard error of this packing against the mean of many made alike\n"
    if measured.get("gap_density_at_zero"):
        head += (
            "# gap_density_at_zero: of gaps so narrow that a fifth of the mean force closes them, between disks that\n"
            "# bear forces; the line through all gaps in distributions.png is another, smaller number\n"
        )
    head += "".join(f"# {name} could not be measured on this packing\n" for name in missing)
    tables = law_tables(measured)
    if "closure" in tables:
        tables["closure"] = closure_table(tables)
    text = to_toml(tables).lstrip()
    return head + (text if errors is None else _commented(text, Inputs(dict(measured), dict(errors))))


def _commented(text: str, inputs: Inputs) -> str:
    """Errors and remarks at the ends of the lines that they belong to."""
    doubtful = remarks(inputs)
    lines = []
    for line in text.splitlines():
        name = line.partition(" = ")[0]
        if name in inputs.errors and inputs.errors[name] != 0.0:
            error = inputs.errors[name]
            said = [f"+- {error:.2g}" if math.isfinite(error) else "+- ?", *doubtful.get(name, [])]
            line += f"  # {'; '.join(said)}"
        elif name in doubtful:
            line += f"  # {'; '.join(doubtful[name])}"
        lines.append(line)
    return "\n".join(lines) + "\n"

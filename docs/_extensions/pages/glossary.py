"""The glossary: symbol, name in the code, name in files, unit and equation of each quantity, in one table a subject."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from .markdown import code, page, table
from .project import (
    CLOSURE_NUMBERS,
    COUNTS,
    DEM_COLUMNS,
    LEADING,
    MEANS,
    POINT_COLUMNS,
    PORE,
    PORE_COLUMNS,
    SLIDING_COLUMNS,
    SPECIMEN_COLUMNS,
    Effects,
    Material,
    Variable,
    state_variables,
)

DATA = Path(__file__).with_name("glossary.toml")
HEAD = ("symbol", "meaning", "name in the code", "name in files", "unit", "equation")


def everything_on() -> Effects:
    """All effects."""
    return Effects(**dict.fromkeys(Effects.names(), True))


def all_state_variables() -> tuple[Variable, ...]:
    """State variables of any contact law; the reference state, which a law keeps for some choices only, included."""
    return state_variables(everything_on(), shifted=True, remembering=True)


def declared() -> dict[str, Variable]:
    """State variables and parameters by name."""
    return {variable.name: variable for variable in (*all_state_variables(), *Material.variables())}


def columns() -> dict[str, tuple[str, ...]]:
    """Columns of histories with fixed names, by kind of run."""
    return {
        "point": (*POINT_COLUMNS, *SLIDING_COLUMNS, *PORE_COLUMNS),
        "field": (*LEADING, *MEANS, *PORE, *COUNTS),
        "dem": DEM_COLUMNS,
        "specimen": (*SPECIMEN_COLUMNS, "leg"),
    }


def sections() -> list[dict]:
    """The data, with meaning and unit filled in from declarations."""
    known = declared()
    found = tomllib.loads(DATA.read_text(encoding="utf-8"))["section"]
    for section in found:
        for entry in section["quantity"]:
            variables = [known[name] for name in entry["code"] if name in known]
            if variables:
                entry["meaning"] = entry["meaning"] or variables[0].meaning
                entry["unit"] = entry["unit"] or variables[0].unit
    return found


def code_names() -> set[str]:
    """All names that stand in the column of the code."""
    return {name for section in sections() for entry in section["quantity"] for name in entry["code"]}


def file_names() -> set[str]:
    """All names that stand in the column of files."""
    return {name for section in sections() for entry in section["quantity"] for name in entry["files"]}


def legal_code_names() -> set[str]:
    """State variables, parameters and numbers of a closure."""
    return {*declared(), *CLOSURE_NUMBERS}


def meaning_of(column: str) -> tuple[str, str]:
    """Meaning and unit of a column of a file."""
    for section in sections():
        for entry in section["quantity"]:
            if column in entry["files"]:
                return entry["meaning"], entry["unit"]
    raise KeyError(column)


def _code(name: str) -> str:
    if name in legal_code_names():
        return code(name)
    return f"{{py:func}}`~granfabric.constitutive.{name}`"


def _row(entry: dict) -> tuple[str, ...]:
    equation = f"[{entry['equation']}](/theory/equations)" if entry["equation"] else ""
    names = ", ".join(_code(name) for name in entry["code"])
    files = ", ".join(code(name) for name in entry["files"])
    return entry["symbol"], entry["meaning"], names, files, entry["unit"], equation


def pages() -> dict[str, str]:
    """The glossary."""
    parts = []
    for section in sections():
        rows = [_row(entry) for entry in section["quantity"]]
        place = "names-" + "-".join(re.findall(r"\w+", section["title"].lower()))
        names = [name for entry in section["quantity"] for name in (*entry["code"], *entry["files"], entry["symbol"])]
        entries = "\n".join(dict.fromkeys(name for name in names if name and name not in ("stage", "step", "e", "c")))
        parts.append(f"```{{entries}} {place}\n{entries}\n```\n\n## {section['title']}\n\n{table(HEAD, rows)}")
    return {
        "generated/reference/glossary": page(
            "# Glossary",
            "What a quantity is called in formulas, in the code (state variables and keys of a scene have the same "
            "names) and in files, its unit, and the equation of the source that defines or moves it. Stresses and "
            "strains are tension positive, pressures compression positive.",
            *parts,
        )
    }

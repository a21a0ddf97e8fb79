"""Writing plain data as TOML (the standard library only reads it)."""

from __future__ import annotations

import json
import math
import re
from typing import Any

BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def _key(name: str) -> str:
    return name if BARE_KEY.fullmatch(name) else _text(name)


def _text(value: str) -> str:
    """Basic TOML string: JSON's escapes are TOML's, apart from the delete character."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def value_text(value: Any) -> str:
    """One value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        text = repr(value)
        return text if any(letter in text for letter in ".e") else text + ".0"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(value_text(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(name)} = {value_text(item)}" for name, item in value.items()) + " }"
    raise TypeError(f"{value!r} cannot be written as TOML")


def _is_table_array(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(item, dict) for item in value)


def _entry(name: str, item: Any, inside: bool) -> list[str]:
    """Line(s) of one plain value; inside a table a list of small tables gets one line for each."""
    if inside and _is_table_array(item):
        return [f"{_key(name)} = [", *(f"    {value_text(entry)}," for entry in item), "]"]
    return [f"{_key(name)} = {value_text(item)}"]


def _lines(table: dict[str, Any], path: tuple[str, ...]) -> list[str]:
    def has_heading(item: Any) -> bool:
        return isinstance(item, dict) or (not path and _is_table_array(item))

    lines = [line for name, item in table.items() if not has_heading(item) for line in _entry(name, item, bool(path))]
    for name, item in table.items():
        if not has_heading(item):
            continue
        heading = ".".join(_key(part) for part in (*path, name))
        if isinstance(item, dict):
            lines += ["", f"[{heading}]", *_lines(item, (*path, name))]
        else:
            for entry in item:
                lines += ["", f"[[{heading}]]", *_lines(entry, (*path, name))]
    return lines


def to_toml(table: dict[str, Any]) -> str:
    """Text that `tomllib.loads` turns back into the same table.

    Parameters
    ----------
    table : dict
        Tables, lists, texts, numbers and booleans; no None.
    """
    return "\n".join(_lines(table, ())) + "\n"

"""Every key of a scene file, from the JSON schema that `granfabric schema` prints."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

from .markdown import bound, code, number, page, table
from .project import json_schema

SHARED = ("material", "closure", "effects", "integration")
"""Tables that point and field scenes have in common get a page of their own."""

HEAD = ("key", "type", "unit", "bounds", "default", "meaning")

KINDS = {
    "point": ("Scenes of a point", "One material point along a path of stress or strain: `granfabric point`."),
    "field": ("Scenes of a field", "A boundary-value problem: `granfabric run`."),
    "dem": ("Scenes of the DEM", "A packing of disks and its loading: `granfabric dem`."),
    "specimen": (
        "Scenes of a specimen of disks", "Disks between platens and membranes, and their loading: `granfabric dem`."
    ),
}


def _definition(entry: dict[str, Any]) -> tuple[str, str] | None:
    """Name of the table that a key holds, and how it is written: "one", "list" or "named"."""
    for option in (entry, *entry.get("anyOf", ())):
        if "$ref" in option:
            return option["$ref"].rsplit("/", 1)[1], "one"
        for key, shape in (("items", "list"), ("additionalProperties", "named")):
            inner = option.get(key)
            if isinstance(inner, dict) and "$ref" in inner:
                return inner["$ref"].rsplit("/", 1)[1], shape
    return None


def tables(kind: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Heading, dotted path and definition of each table of a kind of scene, the top level first."""
    schema = json_schema()
    root = schema["discriminator"]["mapping"][kind].rsplit("/", 1)[1]

    def below(name: str, path: str, heading: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
        definition = schema["$defs"][name]
        yield heading, path, definition
        for key, entry in definition["properties"].items():
            if found := _definition(entry):
                inner = f"{path}.{key}" if path else key
                written = {"one": f"[{inner}]", "list": f"[[{inner}]]", "named": f"[{inner}.NAME]"}[found[1]]
                yield from below(found[0], f"{inner}.NAME" if found[1] == "named" else inner, written)

    yield from below(root, "", "Top level")


def keys(kind: str) -> list[str]:
    """Dotted names of all keys of a kind of scene."""
    return [f"{path}.{key}" if path else key for _, path, entry in tables(kind) for key in entry["properties"]]


def _type(entry: dict[str, Any]) -> str:
    if "const" in entry:
        return code(json.dumps(entry["const"]))
    if "enum" in entry:
        return ", ".join(code(json.dumps(choice)) for choice in entry["enum"])
    if "anyOf" in entry:
        return " or ".join(_type(option) for option in entry["anyOf"] if option.get("type") != "null")
    if found := _definition(entry):
        return {"one": "table", "list": "list of tables", "named": "tables by name"}[found[1]]
    if entry.get("type") == "array":
        inner = _type(entry["items"])
        least, most = entry.get("minItems"), entry.get("maxItems")
        count = f"{least} " if least is not None and least == most else ""
        return f"list of {count}{inner}"
    if entry.get("type") == "object":
        return "table of numbers"
    return {"number": "number", "integer": "whole number", "string": "text", "boolean": "true, false"}[entry["type"]]


def _bounds(entry: dict[str, Any]) -> str:
    parts = []
    for key, sign in (("minimum", "≥"), ("exclusiveMinimum", ">"), ("maximum", "≤"), ("exclusiveMaximum", "<")):
        if key in entry:
            parts.append(bound(sign, entry[key]))
    parts = [part for part in parts if part]
    if "multipleOf" in entry:
        parts.append(f"multiple of {entry['multipleOf']}")
    if not parts:
        for option in entry.get("anyOf", ()):
            parts += [_bounds(option)] if _bounds(option) else []
        if "items" in entry:
            parts += [_bounds(entry["items"])] if _bounds(entry["items"]) else []
    return ", ".join(parts)


def _default(key: str, entry: dict[str, Any], required: list[str]) -> str:
    if key in required:
        return "required"
    if "default" not in entry:
        return "required, here or in `material_file`"
    value = entry["default"]
    if value is None or _definition(entry):
        return ""
    if isinstance(value, float):
        return code(number(value))
    return code(json.dumps(value))


def _row(key: str, entry: dict[str, Any], required: list[str]) -> tuple[str, ...]:
    meaning = entry.get("description", "")
    unit = entry.get("unit", "")
    meaning = re.sub(r"^\[[^\]]*\],? ?|,? ?\[" + re.escape(unit) + r"\]", "", meaning, count=1) if unit else meaning
    meaning = meaning.replace("*", "\\*").replace("_", "\\_") if "`" not in meaning else meaning
    return code(key), _type(entry), unit, _bounds(entry), _default(key, entry, required), meaning


def _tables_of(kind: str, shared: bool) -> Iterator[str]:
    for heading, path, definition in tables(kind):
        if (path.split(".")[0] in SHARED) != shared:
            continue
        required = definition.get("required", [])
        rows = [_row(key, entry, required) for key, entry in definition["properties"].items()]
        title = heading if not path else f"`{heading}`"
        yield "\n\n".join([f"## {title}", definition.get("description", "").strip(), table(HEAD, rows)])


def pages() -> dict[str, str]:
    """One page a kind of scene, and one of what the law has in each."""
    result = {}
    for kind, (title, text) in KINDS.items():
        see = "" if kind in ("dem", "specimen") else (
            "`[material]`, `[closure]`, `[effects]` and `[integration]`: {doc}`scene_law`."
        )
        result[f"generated/reference/scene_{kind}"] = page(f"# {title}", text, see, *_tables_of(kind, shared=False))
    result["generated/reference/scene_law"] = page(
        "# Material, closure, effects and integration",
        "The tables of the point law are the same in scenes of a point and of a field. A material that is measured by "
        "`granfabric dem` comes from a file (`material_file`); keys of the scene win over those of the file. In a "
        "field scene several materials are written as `[materials.NAME]`, each with the `region` that it fills.",
        *_tables_of("point", shared=True),
    )
    return result

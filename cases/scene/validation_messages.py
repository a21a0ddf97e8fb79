"""From pydantic's list of errors to a sentence for each: the key, the value, what is legal and the nearest name."""

from __future__ import annotations

from difflib import SequenceMatcher
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

from granfabric.cases.errors import LONGEST_NAME, nearest, short, unknown

from .keys import split

TYPE_NAMES = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "an integer",
    "bool_type": "true or false",
    "string_type": "a text in quotes",
    "list_type": "a list in brackets",
    "dict_type": "a table",
    "model_type": "a table",
}

GRAVITY = ("extra_forbidden", "missing")
"""These are told first: a misspelled key explains most errors that follow."""

MISSPELLED = 0.6
"""Likeness of two names (0 to 1) from which one is taken for the other misspelled."""

COUNTERPARTS = {
    "friction_angle": ("peak_stress_ratio", "the sine of the friction angle"),
    "phi": ("solid_fraction", "the friction angle is peak_stress_ratio, its sine"),
    "cohesion": ("apparent_cohesion", "distance of the cone from its apex"),
    "dilatancy_angle": ("dilatancy", "of the stress-dilatancy rule"),
    "dilation_angle": ("dilatancy", "of the stress-dilatancy rule"),
    "void_ratio": ("solid_fraction", "1/(1 + e)"),
    "porosity": ("solid_fraction", "1 - n"),
    "youngs_modulus": ("normal_stiffness", "of a contact; moduli follow from it, z and the solid fraction"),
    "young_modulus": ("normal_stiffness", "of a contact; moduli follow from it, z and the solid fraction"),
    "shear_modulus": ("normal_stiffness", "of a contact; moduli follow from it, z and the solid fraction"),
    "bulk_modulus": ("normal_stiffness", "of a contact; moduli follow from it, z and the solid fraction"),
    "poisson_ratio": ("stiffness_ratio", "kt/kn of a contact"),
    "poissons_ratio": ("stiffness_ratio", "kt/kn of a contact"),
    "unit_weight": ("body_force", "[0.0, -18e3] N/m3 for 18 kN/m3"),
    "gravity": ("body_force", "force per volume, [0.0, -18e3] N/m3 for 18 kN/m3"),
    "direction": ("component", "x or y"),
}
"""Keys that continuum codes have, with the key that takes their place here and what it is."""


def _models(annotation: Any) -> list[type[BaseModel]]:
    """All pydantic models inside an annotation such as ``list[X] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _literals(annotation: Any) -> list[str]:
    """All literal values inside an annotation, and the words for its other types."""
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    if annotation is bool:
        return ["true", "false"]
    return [value for part in get_args(annotation) for value in _literals(part)]


def walk(model: type[BaseModel], location: tuple[Any, ...]) -> tuple[list[Any], type[BaseModel] | None, Any]:
    """Follow an error's location through the models.

    Returns
    -------
    keys : list
        The part of the location that a scene file knows (pydantic adds names of union members).
    owner : type or None
        Model that holds, or should hold, the last key.
    declaration : FieldInfo or None
        Declaration of the last key, if it is declared.
    """
    keys: list[Any] = []
    owner: type[BaseModel] | None = model
    declaration: Any = None
    inside: type[BaseModel] | None = model
    for part in location:
        if isinstance(part, int):
            keys.append(part)
        elif owner is None and inside is not None:
            keys.append(part)  # the free name of a table such as [materials.NAME]
            owner = inside
        elif inside is not None and part in inside.model_fields:
            keys.append(part)
            owner, declaration = inside, inside.model_fields[part]
            found = _models(declaration.annotation)
            inside = found[0] if found else None
            if get_origin(declaration.annotation) is dict:
                owner = None
        elif not _is_union_member(part):
            keys.append(part)
            named = inside is None and declaration is not None and _has_table(declaration.annotation)
            owner, declaration = inside, declaration if named else None  # of `{ NAME = value }` the values are declared
    return keys, owner, declaration


def _is_union_member(part: Any) -> bool:
    text = str(part)
    members = ("literal[", "list[", "dict[", "constrained")
    return text in {"bool", "float", "int", "str", "none"} or text.startswith(members)


def _has_table(annotation: Any) -> bool:
    """Whether one of the types of a key is a table of values by name."""
    return get_origin(annotation) is dict or any(_has_table(part) for part in get_args(annotation))


def messages(error: ValidationError, model: type[BaseModel], data: Any) -> list[tuple[list[Any], str]]:
    """Key and sentence of every error, unknown and missing keys first.

    A key that is missing because another one stands there misspelled is not told a second time.

    Parameters
    ----------
    error : ValidationError
    model : type
        Model that refused the data.
    data : dict
        What was refused.

    Returns
    -------
    list of (list, str)
        Path of the key, for saying where it was given, and the sentence.
    """
    problems = sorted(
        error.errors(include_url=False),
        key=lambda item: GRAVITY.index(item["type"]) if item["type"] in GRAVITY else len(GRAVITY),
    )
    found: dict[tuple[Any, ...], str] = {}
    meant: set[tuple[Any, ...]] = set()
    reached = [tuple(walk(model, problem["loc"])[0]) for problem in problems]
    for problem in problems:
        keys, owner, declaration = walk(model, problem["loc"])
        if problem["type"] in TYPE_NAMES and any(
            len(other) > len(keys) and other[: len(keys)] == tuple(keys) for other in reached
        ):
            continue  # of a key of several types: what was given is of another one, with a mistake inside
        if problem["type"] == "extra_forbidden" and owner is not None:
            given = str(keys[-1])[:LONGEST_NAME]
            counterpart, _ = COUNTERPARTS.get(given.lower(), ("", ""))
            known = counterpart in owner.model_fields
            near = counterpart if known else nearest(given, owner.model_fields)
            if near is not None and (known or SequenceMatcher(None, given, near).ratio() >= MISSPELLED):
                meant.add((*keys[:-1], near))
        if tuple(keys) in found or (problem["type"] == "missing" and tuple(keys) in meant):
            continue
        found[tuple(keys)] = _describe(problem, keys, owner, declaration, data)
    return [(list(keys), text) for keys, text in found.items()]


def _describe(problem: Any, keys: list[Any], owner: type[BaseModel] | None, declaration: Any, data: Any) -> str:
    place, key = split(keys, data)
    text = _message(problem, place, key, keys, owner, declaration)
    return f"{place}: {text}" if place else text


def _message(
    problem: Any, place: str, key: str, keys: list[Any], owner: type[BaseModel] | None, declaration: Any
) -> str:
    kind, context, value = problem["type"], problem.get("ctx", {}), problem["input"]
    if kind == "extra_forbidden":
        legal = list(owner.model_fields) if owner is not None else []
        given = str(keys[-1])
        counterpart, meaning = COUNTERPARTS.get(given.lower(), ("", ""))
        if counterpart in legal:
            return f"{unknown('the key', key, legal, spelled=counterpart)} ({meaning})"
        return unknown("the key", key, legal, spelled=given)
    if kind == "missing":
        meaning = f" ({declaration.description})" if declaration is not None and declaration.description else ""
        return f"{key!r} is missing{meaning}"
    if kind == "value_error":
        text = str(context["error"])
        return f"{key}: {text}" if key and not text.startswith(f"{key}.") else text
    shown = short(value)
    brackets = _brackets(kind, value, keys, declaration)
    if brackets:
        return brackets
    key = key or "this entry"
    choices = _literals(declaration.annotation) if declaration is not None else []
    if kind == "literal_error" or (choices and kind in ("bool_type", "string_type")):
        near = nearest(str(value), choices)
        return f"{key} = {shown} is not one of {', '.join(choices)}; the nearest is {near!r}"
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        meaning = f" ({declaration.description})" if declaration is not None and declaration.description else ""
        return f"{key} = {shown} is outside its bounds {_bounds(declaration, context)}{meaning}"
    if kind in ("too_short", "too_long"):
        least, most = _lengths(declaration)
        wanted = (
            f"exactly {least}" if least == most else f"at least {least}" if kind == "too_short" else f"at most {most}"
        )
        of = "characters" if isinstance(value, str) else "entries"
        return f"{key} = {shown} has {context['actual_length']} {of}, it needs {wanted}"
    if kind in TYPE_NAMES:
        described = kind == "list_type" and declaration is not None and declaration.description
        meaning = f" ({declaration.description})" if described else ""
        return f"{key} = {shown} is not {TYPE_NAMES[kind]}{meaning}"
    return f"{key} = {shown} is not legal: {problem['msg'][:1].lower()}{problem['msg'][1:]}"


def _brackets(kind: str, value: Any, keys: list[Any], declaration: Any) -> str:
    """What to write where one table stands for several or several for one; empty if it is something else."""
    if declaration is None or not _models(declaration.annotation):
        return ""
    heading = ".".join(str(part) for part in keys if not isinstance(part, int))
    if not all(part.isprintable() for part in map(str, keys)):
        return ""
    top = len(keys) == 1
    if kind == "list_type" and isinstance(value, dict):
        inline = "" if top else f", or {keys[-1]} = [{{ ... }}] in one line"
        return (
            f"[{heading}] is one table, but there may be several, one after the other: write [[{heading}]] with two "
            f"brackets{inline}"
        )
    several = isinstance(value, list) and all(isinstance(item, dict) for item in value) and value
    if kind in ("model_type", "model_attributes_type") and several:
        return f"[[{heading}]] is there only once: write [{heading}] with one bracket"
    if kind == "dict_type" and several:
        return f"[[{heading}]] is not a list: write [{heading}.NAME] for each of them, with a name of its own"
    inside = get_origin(declaration.annotation) is dict and len(keys) > 1
    if kind in ("model_type", "model_attributes_type") and inside and not isinstance(value, list):
        outer = ".".join(map(str, keys[:-1]))
        return f"[{outer}] holds values where it should hold tables: write [{outer}.NAME] for each, with its own name"
    return ""


def _constraints(annotation: Any) -> list[Any]:
    """All constraint objects inside an annotation or a field declaration."""
    found = list(getattr(annotation, "__metadata__", ()))
    flat = [inner for item in found for inner in (getattr(item, "metadata", None) or [item])]
    return flat + [item for part in get_args(annotation) for item in _constraints(part)]


def _declared(declaration: Any) -> list[Any]:
    if declaration is None:
        return []
    return list(declaration.metadata) + _constraints(declaration.annotation)


def _bounds(declaration: Any, context: dict[str, Any]) -> str:
    low, high = "(-inf", "inf)"
    for item in _declared(declaration):
        if getattr(item, "ge", None) is not None:
            low = f"[{item.ge:g}"
        if getattr(item, "gt", None) is not None:
            low = f"({item.gt:g}"
        if getattr(item, "le", None) is not None:
            high = f"{item.le:g}]"
        if getattr(item, "lt", None) is not None:
            high = f"{item.lt:g})"
    if low == "(-inf" and high == "inf)":
        return str(context)
    return f"{low}, {high}"


def _lengths(declaration: Any) -> tuple[int | None, int | None]:
    least = most = None
    for item in _declared(declaration):
        least = getattr(item, "min_length", None) if getattr(item, "min_length", None) is not None else least
        most = getattr(item, "max_length", None) if getattr(item, "max_length", None) is not None else most
    return least, most

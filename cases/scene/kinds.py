"""What kind of scene a file holds, said by it or told by its tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError

SPECIMEN = "specimen"
TELLING = {
    "field": ("mesh", "stage", "materials", "random_state", "closed_form", "solver"),
    "dem": ("packing", "rates", "measure"),
    SPECIMEN: (SPECIMEN,),
}
"""Tables that only one kind of scene has."""

LEGS = {"dem": ("loading",), "point": ("control", "target", "rotation_degrees")}
"""Keys of a leg of a path that tell the kind; the first kind whose keys are there counts."""

MATERIAL_TABLES = {"material", "closure", "measured"}


def told(table: dict[str, Any]) -> dict[str, str]:
    """Kinds of which a scene has a table, each with one that tells it."""
    # at the points of a scene with a law of its own, a packing may stand too
    there = table.keys() - ({"packing"} if "law" in table else set())
    if SPECIMEN in table:  # it has a packing, rates and legs too
        there -= {"packing", "rates"}
    found = {kind: f"[{name}]" for kind, names in TELLING.items() for name in reversed(names) if name in there}
    legs = table.get("path")
    parts = [leg for leg in (legs if isinstance(legs, list) else [legs]) if isinstance(leg, dict)]
    for kind, names in LEGS.items():
        hit = next((name for name in names for leg in parts if name in leg), None)
        if hit is not None and not (kind == "dem" and SPECIMEN in table):
            found.setdefault(kind, f"[[path]] with {hit}")
            break
    return found


def kind_of(table: dict[str, Any]) -> str | None:
    """The kind that the tables of a scene tell; None if they tell none, or more than one."""
    found = told(table)
    return next(iter(found)) if len(found) == 1 else None


def require_kind(table: dict[str, Any], file: Path) -> None:
    """See that a scene says its kind, once what its tables tell has been filled in.

    Raises
    ------
    InputError
    """
    if "kind" in table:
        if table["kind"] == "dem" and SPECIMEN in table:
            raise InputError(
                f"{file}: a scene with [specimen] is of the kind 'specimen', not 'dem', whose disks have no bounds; "
                "leave out kind, or [specimen]"
            )
        return
    found = told(table)
    missing = f"{file}: 'kind' is missing (legal: point, field, dem, specimen)"
    if found:
        parts = " and ".join(f"{text} belongs to {kind!r}" for kind, text in found.items())
        raise InputError(f"{missing}, and the tables do not agree on it: {parts}")
    if table and table.keys() - {"title"} and table.keys() - {"title"} <= MATERIAL_TABLES:
        raise InputError(
            f"{missing}; this looks like a material file, which a scene names by material_file = {file.name!r}"
        )
    raise InputError(
        f"{missing}; it need not be given with [mesh] and [[stage]] (field), [[path]] (point), [packing] (dem) or "
        "[specimen] (specimen), but none of these is there"
    )

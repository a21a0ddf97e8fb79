"""Materials of the map: packings that differ from the source's in one respect, and those that a user wants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from pydantic import ValidationError

from granfabric.cases.errors import InputError, several, short, unknown
from granfabric.cases.scene.dem_path import PathError, packing_options
from granfabric.cases.scene.reader import parse_assignment
from granfabric.cases.scene.schema_dem import Measure, Packing
from granfabric.cases.scene.validation_messages import messages
from granfabric.dem_ref.dynamics.packing import PackingOptions
from granfabric.dem_ref.sample.disks import SampleError

from .paths import chosen_names

TABLES = ("material", "packing")
"""What the keys of `--set` begin with; the second as in the scenes of the DEM."""


@dataclass(frozen=True)
class MapMaterial:
    """A row of the map.

    Attributes
    ----------
    name, title : str
    given : dict
        Keys of the table ``[packing]`` of a DEM scene that differ from its defaults.
    options : PackingOptions
    """

    name: str
    title: str
    given: dict[str, Any]
    options: PackingOptions


_ROWS: dict[str, tuple[str, dict[str, Any]]] = {
    "source": ("as in the source", {}),
    "friction_0.2": ("friction 0.2", {"friction": 0.2}),
    "friction_1": ("friction 1.0", {"friction": 1.0}),
    "kt_kn_0.5": ("kt/kn 0.5", {"stiffness_ratio": 0.5}),
    "kt_kn_0.2": ("kt/kn 0.2", {"stiffness_ratio": 0.2}),
    "kn_p_1e3": ("kn/p 1e3", {"stiffness_to_pressure": 1e3}),
    "kn_p_1e5": ("kn/p 1e5", {"stiffness_to_pressure": 1e5}),
    "size_ratio_2": ("size ratio 2", {"diameter_ratio": 2.0}),
    "size_ratio_4": ("size ratio 4", {"diameter_ratio": 4.0}),
    "loose": ("loose, z = 3.57", {"coordination": 3.57}),
}
DEFAULT_MATERIALS = ("source",)
QUICK_MATERIALS = ("source", "friction_0.2", "kt_kn_0.2", "size_ratio_2")


def legal_keys() -> list[str]:
    """Keys that `--set` takes: those of a packing but its number of disks and seed, which have options of their own."""
    return [name for name in Packing.model_fields if name not in ("particles", "seed")]


MATERIALS = {name: row for name, row in _ROWS.items() if set(row[1]) <= set(legal_keys())}
"""Title and keys of the named rows; one whose key packings do not have is none of them."""


def chosen_materials(text: str | None, assignments: Sequence[str] = (), quick: bool = False) -> list[MapMaterial]:
    """Materials of `--materials`, the source's without it; each with what `--set` gives.

    Parameters
    ----------
    text : str or None
        Names of rows, comma separated, or ``all``.
    assignments : sequence of str
        ``material.KEY=VALUE`` with the keys of the table ``[packing]`` of a DEM scene.
    quick : bool
        Without `text`: a few of all kinds.

    Raises
    ------
    InputError
        With a sentence for each error.
    """
    names = list(QUICK_MATERIALS if quick and not assignments else DEFAULT_MATERIALS)
    if text is not None:
        names = chosen_names("--materials", "material", text, dict(MATERIALS))
    own = _own(assignments)
    return [_material(name, own) for name in names]


def _own(assignments: Sequence[str]) -> dict[str, Any]:
    """Keys and values of `--set`."""
    legal, own, wrong = legal_keys(), {}, []
    for text in assignments:
        path, value = parse_assignment(text)
        if len(path) != 2 or path[0] not in TABLES:
            wrong.append(
                f"--set {short('.'.join(path))} is not one of the keys of a packing, material.KEY with KEY of: "
                f"{', '.join(legal)}"
            )
        elif path[1] in ("particles", "seed"):
            wrong.append(f"--set {'.'.join(path)}: packings have the options --particles and --seeds for that")
        elif path[1] not in legal:
            wrong.append(f"--set {unknown('the key', '.'.join(path), legal, spelled=path[1])}")
        else:
            own[path[1]] = value
    if wrong:
        raise several(wrong)
    return own


def _material(name: str, own: dict[str, Any]) -> MapMaterial:
    title, given = MATERIALS[name]
    given = {**given, **own}
    try:
        packing = Packing.model_validate(given)
    except ValidationError as error:
        raise several([f"--set material.{text}" for _, text in messages(error, Packing, given)]) from error
    try:
        options = packing_options(SimpleNamespace(packing=packing, measure=Measure()))
        options.check()
    except (PathError, SampleError) as error:  # of keys that do not go together
        raise InputError(f"material {name!r}: {error}") from error
    added = "".join(f", {key}={value:g}" if isinstance(value, float) else f", {key}={value}" for key, value in
                    own.items())  # fmt: skip
    return MapMaterial(name + added, title + added.replace("_", " "), given, options)


def refuse_twins(materials: Sequence[MapMaterial]) -> None:
    """Refuse rows that `--set` has made the same.

    Raises
    ------
    InputError
    """
    for place, one in enumerate(materials):
        for other in materials[:place]:
            if one.options == other.options:
                raise InputError(
                    f"--set makes the materials {other.name!r} and {one.name!r} the same; leave one of them out"
                )

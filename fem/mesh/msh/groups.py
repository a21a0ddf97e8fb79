"""Which elements belong to which boundary and region: the physical groups of a `.msh` file by dimension and number.

A curve and a surface may have one name, a group no name, and one name several groups. The sign of a number is a matter
of direction and none of membership.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from granfabric.fem.mesh.checks import MeshError

from .elements import Block, IntArray
from .sections import MshFile

_LINE = re.compile(r'\s*(?:(\d)\s+)?([+-]?\d{1,15})\s+"(.*)"\s*')
KINDS = {1: "curve", 2: "surface"}
_OURS = {1: "boundary", 2: "region"}
_NO_NAME = (
    "physical group of {0} without a name, called {1!r} here (of two groups of one name made through Gmsh's API the "
    "second is left without)"
)


@dataclass(frozen=True)
class Groups:
    """Members of groups by name, and what is worth saying about groups.

    Parameters
    ----------
    curves, surfaces : dict of str to ndarray of int
        Elements of the dimension, counted over all blocks in their order.
    remarks : tuple of str
    """

    curves: dict[str, IntArray]
    surfaces: dict[str, IntArray]
    remarks: tuple[str, ...]


def physical_names(file: MshFile) -> dict[tuple[int, int], str]:
    """Names of physical groups by dimension and number without sign; empty names are none.

    Raises
    ------
    MeshError
        If the section is damaged.
    """
    content = file.sections.get("PhysicalNames")
    if content is None:
        return {}
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    first, *lines = [line for line in text.split("\n") if line.strip()] or [""]
    if first.strip() != str(len(lines)):
        raise MeshError("its section $PhysicalNames does not hold the number of names that it says")
    names: dict[tuple[int, int], str] = {}
    for line in lines:
        found = _LINE.fullmatch(line)
        if found is None:
            raise MeshError(f"its section $PhysicalNames holds the line {line[:60]!r}, which names no group")
        dimension, tag, name = found.groups()
        if not name.isprintable():
            raise MeshError(f"its section $PhysicalNames holds the name {name[:60]!r}, which cannot be printed")
        # version 2.0 gives no dimension; of two names of one group Gmsh keeps the first
        for place in (1, 2) if dimension is None else (int(dimension),):
            if name:
                names.setdefault((place, abs(int(tag))), name)
    return names


def groups_of(blocks: list[Block], names: dict[tuple[int, int], str], version: str) -> Groups:
    """Members of each group that has any.

    Parameters
    ----------
    blocks : list of Block
    names : dict of (int, int) to str
        By dimension and number.
    version : str
        Of the file.

    Raises
    ------
    MeshError
        If names are there but no element belongs to a group, or a name that a group without one would get is taken.
    """
    members: dict[tuple[int, int], list[IntArray]] = {}
    offsets = {0: 0, 1: 0, 2: 0}
    for block in blocks:
        dimension = block.kind.dimension
        for index, tag in block.groups:
            members.setdefault((dimension, tag), []).append(offsets[dimension] + index)
        offsets[dimension] += len(block.nodes)
    named = {key: name for key, name in names.items() if key[0] in KINDS}
    if named and not members and version in ("1", "2"):
        raise MeshError(
            f"it names {len(named)} physical groups ({_listed(sorted(set(named.values())))}), but none of its elements "
            "belongs to one: MSH 2.2 with Mesh.SaveAll = 1 loses them; save it with Mesh.SaveAll = 0, or as MSH 4.1 "
            "(gmsh -format msh41)"
        )
    found: dict[int, dict[str, list[IntArray]]] = {1: {}, 2: {}}
    remarks = []
    for (dimension, tag), parts in sorted(members.items()):
        if dimension not in KINDS:
            continue
        name = named.get((dimension, tag))
        if name is None:
            name = f"{KINDS[dimension]} {tag}"
            if name in found[dimension] or (dimension, name) in {(key[0], other) for key, other in named.items()}:
                raise MeshError(
                    f"the physical {KINDS[dimension]} {tag} has no name and another is named {name!r}, as it would be "
                    "called; give it a name"
                )
            if named:
                remarks.append(_NO_NAME.format(f"{KINDS[dimension]}s", name))
        found[dimension].setdefault(name, []).extend(parts)
    for (dimension, _), name in sorted(named.items()):
        if name not in found[dimension]:
            remarks.append(
                f"the file names the {_OURS[dimension]} {name!r}, but no {KINDS[dimension]} of its mesh belongs to it"
            )
    if members and not named:
        key = min(members)
        example = f"{KINDS.get(key[0], 'curve')} {key[1]}"
        remedy = "; MSH 1 stores none, MSH 4.1 does (gmsh -format msh41)" if version == "1" else ""
        remarks.append(f"no physical group of the file has a name: they go by numbers, such as {example!r}{remedy}")
    if not members:
        remarks.append(
            "no element of the file belongs to a physical group; make them in Gmsh (Physical Curve, Physical Surface) "
            "and save the file as MSH 4.1 (gmsh -format msh41)"
        )
    joined = {
        dimension: {name: np.unique(np.concatenate(parts)) for name, parts in by_name.items()}
        for dimension, by_name in found.items()
    }
    return Groups(joined[1], joined[2], tuple(dict.fromkeys(remarks)))


def _listed(names: list[str], shown: int = 4) -> str:
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return ", ".join(repr(name) for name in names[:shown]) + more

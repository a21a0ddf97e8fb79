"""A `.msh` file cut into its sections, and what its first section says about the rest.

Sections may stand in any order; those that say nothing about the mesh (results, periodicity, comments) may be repeated
and are never looked into. A file that is cut short would lose boundaries and still look like a mesh: every section has
to be closed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from granfabric.fem.mesh.checks import MeshError

REMEDY = "save it as MSH 4.1 (gmsh -format msh41)"

_SECTION = re.compile(rb"\$(\w+)[ \t]*\r?\n")
_OF_THE_MESH = (
    "MeshFormat",
    "PhysicalNames",
    "Entities",
    "PartitionedEntities",
    "Nodes",
    "ParametricNodes",
    "Elements",
)
_OLD = ("NOD", "ELM")
_ONE = {b"\x01\x00\x00\x00": "<", b"\x00\x00\x00\x01": ">"}


@dataclass(frozen=True)
class MshFile:
    """Sections of a file and how to read them.

    Parameters
    ----------
    version : {"1", "2", "4.0", "4.1"}
        2 stands for 2.0 to 2.2, which differ in nothing that is read here.
    binary : bool
    order : {"<", ">"}
        Of the bytes of a binary number: little or big end first.
    size : int
        Bytes of a binary count.
    sections : dict of str to bytes
        Content of the sections that say something about the mesh.
    """

    version: str
    binary: bool
    order: str
    size: int
    sections: dict[str, bytes]


def split_sections(data: bytes) -> MshFile:
    """Sections of a file of any version.

    Raises
    ------
    MeshError
        If a section does not end or is there twice with another content, or the file is of a version that is not read.
    """
    found = _sections(data)
    if "NOD" in found or "ELM" in found:
        return _complete(MshFile("1", False, "<", 8, {"Nodes": found.get("NOD"), "Elements": found.get("ELM")}))  # type: ignore[dict-item]
    head = found.get("MeshFormat", b"").split(None, 3)
    if len(head) < 3 or head[1] not in (b"0", b"1"):
        raise MeshError("it does not begin as Gmsh MSH 2.2 or 4.1 do")
    version, binary = _version(head[0]), head[1] == b"1"
    order, size = "<", 8
    if binary:
        rest = found["MeshFormat"].split(b"\n", 1)[1]
        if rest[:4] not in _ONE:
            raise MeshError(f"the order of bytes of its numbers is unknown; {REMEDY}")
        order = _ONE[rest[:4]]
        if version == "4.1":
            size = 4 if head[2] == b"4" else 8
    return _complete(MshFile(version, binary, order, size, found))


def _complete(file: MshFile) -> MshFile:
    for name in ("Nodes", "Elements"):
        if file.sections.get(name) is None and not (name == "Nodes" and "ParametricNodes" in file.sections):
            raise MeshError(f"it has no section ${name}")
    return file


def _version(text: bytes) -> str:
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if 2 <= number < 3:
        return "2"
    if number in (4.0, 4.1):
        return f"{number:.1f}"
    shown = text[:20].decode(errors="replace")
    raise MeshError(f"it does not begin as Gmsh MSH 2.2 or 4.1 do: its version is {shown!r}; {REMEDY}")


def _sections(data: bytes) -> dict[str, bytes]:
    """Content of each section of the mesh by name."""
    found: dict[str, bytes] = {}
    place = len(data) - len(data.lstrip())
    while match := _SECTION.match(data, place):
        name = match[1].decode(errors="replace")
        ending = b"$END" + match[1] if name in _OLD else b"$End" + match[1]
        end = data.find(ending, match.end())
        if end < 0:
            raise MeshError(f"its section ${name} does not end: the file is cut short or damaged")
        content = data[match.end() : end]
        # Gmsh repeats the whole mesh where it appends results to a file.
        if name in found and found[name] != content:
            raise MeshError(f"it holds the section ${name} twice, and the two differ")
        if name in _OF_THE_MESH or name in _OLD:
            found[name] = content
        place = end + len(ending)
        while data[place : place + 1].isspace():
            place += 1
    if place < len(data):
        raise MeshError(f"it holds {data[place : place + 20]!r} where a section should begin")
    return found

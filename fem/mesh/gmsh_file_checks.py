"""What a `.msh` file says about itself, checked before it is read: a reader of meshes believes the counts in the file.

A count that is too large would leave rows of a table unfilled, or fill the memory; one that is too small would drop
what follows; a file cut short would lose boundaries. All of these look like a mesh.
"""

from __future__ import annotations

import io
import re

import numpy as np

from .checks import MeshError

_SECTION = re.compile(rb"\$(\w+)[ \t]*\r?\n")


def check_sections(data: bytes) -> None:
    """See that sections are closed and that there are as many nodes as the file says.

    Raises
    ------
    MeshError
    """
    found = _sections(data)
    head = found.get("MeshFormat", b"").split(None, 3)
    if len(head) < 3 or head[0] not in (b"2.2", b"4.1") or head[1] not in (b"0", b"1"):
        raise MeshError("it does not begin as Gmsh MSH 2.2 or 4.1 do")
    binary, version = head[1] == b"1", head[0].decode()
    for name in ("Nodes", "Elements"):
        if name not in found:
            raise MeshError(f"it has no section ${name}")
    nodes = found["Nodes"]
    if binary:
        filled, wanted = len(nodes), _bytes_of_nodes(nodes, version)
    else:
        filled, wanted = sum(len(line.split()) for line in io.BytesIO(nodes)), _numbers_of_nodes(nodes, version)
    # binary sections end with a line feed, which Gmsh and others do not agree on
    if filled - wanted not in ((0, 1) if binary else (0,)):
        raise MeshError("its section $Nodes does not hold the number of nodes that it says")


def _sections(data: bytes) -> dict[str, bytes]:
    """Content of each section by name."""
    found: dict[str, bytes] = {}
    place = 0
    while match := _SECTION.match(data, place):
        name = match[1].decode(errors="replace")
        ending = b"$End" + match[1]
        end = data.find(ending, match.end())
        if end < 0:
            raise MeshError(f"its section ${name} does not end: the file is cut short or damaged")
        if name in found:
            raise MeshError(f"it holds the section ${name} twice")
        found[name] = data[match.end() : end]
        place = end + len(ending)
        while data[place : place + 1].isspace():
            place += 1
    if place < len(data):
        raise MeshError(f"it holds {data[place : place + 20]!r} where a section should begin")
    return found


def _first_numbers(text: bytes, count: int) -> list[int]:
    try:
        return [int(part) for part in text.split(None, count)[:count]]
    except ValueError:
        raise MeshError("its section $Nodes does not begin with counts") from None


def _numbers_of_nodes(nodes: bytes, version: str) -> int:
    """How many numbers the section has to hold: a node has its number and three coordinates."""
    if version == "2.2":
        return 1 + 4 * (_first_numbers(nodes, 1) or [0])[0]
    blocks, count = (_first_numbers(nodes, 2) + [0, 0])[:2]
    return 4 + 4 * blocks + 4 * count


def _bytes_of_nodes(nodes: bytes, version: str) -> int:
    """The same of a binary section in bytes."""
    if version == "2.2":
        line = nodes.split(b"\n", 1)[0]
        return len(line) + 1 + (4 + 3 * 8) * (_first_numbers(line, 1) or [0])[0]
    if len(nodes) < 16:
        return -1
    blocks, count = (int(number) for number in np.frombuffer(nodes[:16], dtype="<u8"))
    return 4 * 8 + (3 * 4 + 8) * blocks + 4 * 8 * count

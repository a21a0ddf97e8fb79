"""Nodes and elements of `.msh` files of versions 1 and 2: an element names its physical group itself.

An element that is in several groups is written once for each. Numbers of groups may be negative where a curve was named
against its direction.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .elements import Block, IntArray, RawFile, kind_of
from .numbers import Numbers
from .sections import MshFile

_PHYSICAL, _ENTITY, _PARTS = 0, 1, 2
"""Places among the tags of an element: group, curve or surface, number of partitions and these themselves."""


def read_old(file: MshFile) -> RawFile:
    """Nodes and elements of a file of version 1 or 2.

    Raises
    ------
    MeshError
        If it is damaged, or holds elements that are none of a plane mesh.
    """
    if "ParametricNodes" in file.sections:
        tags, points = _parametric_nodes(file, "ParametricNodes")
    else:
        tags, points = _nodes(file)
    numbers = Numbers(file, "Elements")
    count = numbers.counted_line()
    tables = _binary_elements(numbers, count) if file.binary else _text_elements(numbers, count, file.version)
    if numbers.left:
        raise numbers.error("does not hold the number of elements that it says")
    blocks, parts, most = [], np.empty(0, dtype=np.int64), 0
    for (number, tagged), rows in tables.items():
        kind = kind_of(number)
        physical = np.abs(rows[:, _PHYSICAL]) if tagged > _PHYSICAL else np.zeros(len(rows), dtype=np.int64)
        entity = np.abs(rows[:, _ENTITY]) if tagged > _ENTITY else physical
        groups = [(np.flatnonzero(physical == tag), int(tag)) for tag in np.unique(physical) if tag]
        blocks.append(Block(kind, rows[:, tagged:], entity, groups))
        if tagged > _PARTS + 1 and kind.dimension == 2:
            parts = np.union1d(parts, np.abs(rows[:, _PARTS + 1]))
            most = max(most, int(np.abs(rows[:, _PARTS + 1 : tagged]).max()))
    return RawFile(tags, points, blocks, f"{len(parts)} of at least {most}" if 0 < len(parts) < most else "")


def _nodes(file: MshFile) -> tuple[IntArray, NDArray[np.float64]]:
    numbers = Numbers(file, "Nodes")
    count = numbers.counted_line()
    if file.version == "1" and numbers.count_left > 4 * count:  # Gmsh has no other name for the section there
        return _parametric_nodes(file, "Nodes")
    tags, points = numbers.records(count, 1, 3)
    if numbers.left:
        raise numbers.error("does not hold the number of nodes that it says")
    return tags[:, 0], points


def _parametric_nodes(file: MshFile, section: str) -> tuple[IntArray, NDArray[np.float64]]:
    """Nodes with their place on the curve or surface, which is passed over: as many numbers as that has dimensions."""
    numbers = Numbers(file, section)
    count = numbers.counted_line()
    tags, points = [], []
    for _ in range(count):
        tag, point = numbers.records(1, 1, 3)
        dimension = int(numbers.ints(2)[0])
        if not 0 <= dimension <= 3:
            raise numbers.error(f"holds a node of the dimension {dimension}")
        numbers.doubles(dimension)
        tags.append(tag[0, 0])
        points.append(point[0])
    if numbers.left:
        raise numbers.error("does not hold the number of nodes that it says")
    return np.array(tags, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3)


def _text_elements(numbers: Numbers, count: int, version: str) -> dict[tuple[int, int], IntArray]:
    """Tags and nodes of the elements by kind and number of tags.

    A line is number, kind, number of tags, tags, nodes; in version 1 number, kind, group, entity, number of nodes,
    nodes.
    """
    values = numbers.rest()
    starts: dict[tuple[int, int], list[int]] = {}
    place = 0
    for _ in range(count):
        if place + 3 > len(values):
            raise numbers.error("is shorter than its counts say")
        number, tagged = values[place + 1], values[place + 2] if version != "1" else 2
        first = place + (3 if version != "1" else 2)
        if tagged < 0:
            raise numbers.error(f"holds the count {tagged}")
        place = first + tagged + kind_of(number).nodes + (version == "1")
        if place > len(values):
            raise numbers.error("is shorter than its counts say")
        if version == "1" and values[first + 2] != kind_of(number).nodes:
            raise numbers.error(f"gives an element of type {number} {values[first + 2]} nodes")
        starts.setdefault((number, tagged), []).append(first)
    if place != len(values):
        raise numbers.error("does not hold the number of elements that it says")
    all_values = np.array(values, dtype=np.int64)
    tables = {}
    for (number, tagged), firsts in starts.items():
        nodes = kind_of(number).nodes
        after = tagged + (version == "1") + np.arange(nodes)
        tables[number, tagged] = all_values[
            np.array(firsts)[:, None] + np.concatenate([np.arange(tagged), after])[None, :]
        ]
    return tables


def _binary_elements(numbers: Numbers, count: int) -> dict[tuple[int, int], IntArray]:
    """The same from bytes, which come in runs of one kind."""
    rows: dict[tuple[int, int], list[IntArray]] = {}
    while count > 0:
        number, run, tagged = (int(value) for value in numbers.ints(3))
        if not (0 < run <= count and tagged >= 0):
            raise numbers.error("does not hold the number of elements that it says")
        width = 1 + tagged + kind_of(number).nodes
        rows.setdefault((number, tagged), []).append(numbers.ints(run * width).reshape(run, width)[:, 1:])
        count -= run
    return {key: np.concatenate(parts) for key, parts in rows.items()}

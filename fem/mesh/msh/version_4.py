"""Nodes and elements of `.msh` files of versions 4.0 and 4.1: elements belong to curves and surfaces, these to groups.

A curve or surface may be in several physical groups. The number of a group is negative where the curve or surface was
named against its direction, which changes nothing about what is in the group.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .elements import Block, IntArray, RawFile, kind_of
from .numbers import Numbers
from .sections import MshFile

Entities = dict[tuple[int, int], tuple[int, ...]]
"""Physical groups, without sign, of each curve or surface by dimension and number."""


def read_new(file: MshFile) -> RawFile:
    """Nodes and elements of a file of version 4.0 or 4.1.

    Raises
    ------
    MeshError
        If it is damaged, or holds elements that are none of a plane mesh.
    """
    old = file.version == "4.0"
    tags, points = _nodes(Numbers(file, "Nodes"), old)
    entities = _entities(Numbers(file, "Entities"), old) if "Entities" in file.sections else {}
    parts: dict[tuple[int, int], list[int]] = {}
    if "PartitionedEntities" in file.sections:
        numbers = Numbers(file, "PartitionedEntities")
        entities = {**entities, **_partitioned_entities(numbers, old, parts)}
    blocks, filled = _elements(Numbers(file, "Elements"), old, entities)
    surfaces = {key for key in parts if key[0] == 2}
    there = {part for key in surfaces & filled for part in parts[key]}
    every = {part for key in surfaces for part in parts[key]}
    return RawFile(tags, points, blocks, f"{len(there)} of {len(every)}" if there < every else "")


def _nodes(numbers: Numbers, old: bool) -> tuple[IntArray, NDArray[np.float64]]:
    runs, count = numbers.size(), numbers.size()
    if not old:
        numbers.sizes(2)  # the smallest and the largest number
    tags, points = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
    for _ in range(runs):
        head = numbers.ints(3)
        dimension, parametric = int(head[1 if old else 0]), bool(head[2])
        if not 0 <= dimension <= 3:
            raise numbers.error(f"holds nodes of the dimension {dimension}")
        run, width = numbers.size(), 3 + dimension * parametric
        if old:
            whole, other = numbers.records(run, 1, width)
            tags.append(whole[:, 0])
        else:
            tags.append(numbers.sizes(run))
            other = numbers.doubles(run * width).reshape(run, width)
        points.append(other[:, :3])
    found = np.concatenate(tags)
    if numbers.left or len(found) != count:
        raise numbers.error("does not hold the number of nodes that it says")
    return found, np.concatenate(points)


def _groups(numbers: Numbers) -> tuple[int, ...]:
    return tuple(dict.fromkeys(np.abs(numbers.ints(numbers.size())).tolist()))


def _entities(numbers: Numbers, old: bool) -> Entities:
    found: Entities = {}
    for dimension, count in enumerate(numbers.sizes(4).tolist()):
        for _ in range(count):
            tag = int(numbers.ints()[0])
            numbers.doubles(6 if dimension or old else 3)  # where it lies
            found[dimension, abs(tag)] = _groups(numbers)
            if dimension:
                numbers.ints(numbers.size())  # what bounds it
    if numbers.left:
        raise numbers.error("does not hold the number of entities that it says")
    return found


def _partitioned_entities(numbers: Numbers, old: bool, parts: dict[tuple[int, int], list[int]]) -> Entities:
    found: Entities = {}
    numbers.size()  # of partitions
    numbers.ints(2 * numbers.size())  # ghosts
    for dimension, count in enumerate(numbers.sizes(4).tolist()):
        for _ in range(count):
            tag = abs(int(numbers.ints(3)[0]))  # then the entity that it is a part of
            parts[dimension, tag] = numbers.ints(numbers.size()).tolist()
            numbers.doubles(6 if dimension or old else 3)
            found[dimension, tag] = _groups(numbers)
            if dimension:
                numbers.ints(numbers.size())
    if numbers.left:
        raise numbers.error("does not hold the number of entities that it says")
    return found


def _elements(numbers: Numbers, old: bool, entities: Entities) -> tuple[list[Block], set[tuple[int, int]]]:
    runs, count = numbers.size(), numbers.size()
    if not old:
        numbers.sizes(2)
    blocks, filled = [], set()
    for _ in range(runs):
        head = numbers.ints(3)
        dimension, tag, number = (int(head[place]) for place in ((1, 0, 2) if old else (0, 1, 2)))
        run, kind = numbers.size(), kind_of(number)
        rows = (numbers.ints if old else numbers.sizes)(run * (1 + kind.nodes)).reshape(run, 1 + kind.nodes)
        if kind.dimension != dimension:
            raise numbers.error(f"holds {kind.name} in an entity of the dimension {dimension}")
        count -= run
        groups = [(np.arange(run), group) for group in entities.get((dimension, abs(tag)), ()) if group]
        blocks.append(Block(kind, rows[:, 1:], np.full(run, abs(tag), dtype=np.int64), groups))
        if run:
            filled.add((dimension, abs(tag)))
    if numbers.left or count:
        raise numbers.error("does not hold the number of elements that it says")
    return blocks, filled

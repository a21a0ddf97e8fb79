"""Writes one plain model as a `.msh` file in all the ways that Gmsh has: two layers of a rectangle, 2 m by 1 m.

Written from the description of the format, apart from the reader under test; `meshes/` holds files of Gmsh itself.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

NX, NY = 4, 2
"""Squares along the rectangle and up each of its two layers."""
HEIGHT = 0.6
"""Of the lower layer [m]."""

Group = tuple[int, int, str | None, tuple[int, ...]]
"""Dimension, number, name, curves or surfaces (negative: against their direction)."""

GROUPS: tuple[Group, ...] = (
    (1, 1, "bottom", (1,)),
    (1, 2, "right", (2, 5)),
    (1, 3, "top", (6,)),
    (1, 4, "left", (4, 7)),
    (2, 5, "lower", (1,)),
    (2, 6, "upper", (2,)),
)
LENGTHS = {1: 2.0, 2: 0.6, 3: 2.0, 4: 0.6, 5: 0.4, 6: 2.0, 7: 0.4}
"""Of the curves [m]; 3 is the interface."""
AREAS = {1: 1.2, 2: 0.8}
NODES = {15: 1, 1: 2, 8: 3, 2: 3, 9: 6, 3: 4, 16: 8, 10: 9}


def expected(groups: Sequence[Group] = GROUPS) -> tuple[dict[str, float], dict[str, float]]:
    """Length of each boundary and area of each region."""
    sizes: dict[int, dict[str, dict[int, float]]] = {1: {}, 2: {}}
    for dimension, tag, name, entities in groups:
        if dimension in sizes:
            members = sizes[dimension].setdefault(name or f"{('', 'curve', 'surface')[dimension]} {tag}", {})
            members |= {abs(e): (LENGTHS if dimension == 1 else AREAS)[abs(e)] for e in entities}
    return (
        {name: sum(members.values()) for name, members in sizes[1].items()},
        {name: sum(members.values()) for name, members in sizes[2].items()},
    )


@dataclass(frozen=True)
class Model:
    """What is written: nodes by number, elements by (dimension, entity), groups, and how."""

    cell: str = "triangle"
    order: int = 1
    groups: Sequence[Group] = GROUPS
    version: str = "4.1"
    binary: bool = False
    big_end: bool = False
    save_all: bool = False
    parametric: bool = False
    parts: int = 1
    ghosts: bool = False
    extra: Sequence[tuple[str, bytes]] = ()
    sequence: Sequence[int] = ()
    line_end: bytes = b"\n"
    seed: int | None = None
    elements: dict[tuple[int, int], tuple[int, np.ndarray]] = field(default_factory=dict)
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    tags: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))


def _meshed(model: Model) -> Model:
    """The model with nodes and elements; with a seed these have other numbers and another sequence."""
    step = model.order
    x = np.linspace(0, 2, step * NX + 1)
    y = np.concatenate([np.linspace(0, HEIGHT, step * NY + 1), np.linspace(HEIGHT, 1, step * NY + 1)[1:]])
    points = np.stack([*(part.ravel() for part in np.meshgrid(x, y)), np.zeros(len(x) * len(y))], axis=1)
    node = np.arange(len(points)).reshape(len(y), len(x))
    cells: dict[int, list[list[int]]] = {1: [], 2: []}
    for j in range(2 * NY):
        for i in range(NX):
            n = node[step * j : step * j + step + 1, step * i : step * i + step + 1]
            a, b, c, d = n[0, 0], n[0, -1], n[-1, -1], n[-1, 0]
            if step == 1:
                made = [[a, b, c, d]] if model.cell == "quad" else [[a, b, c], [a, c, d]]
            elif model.cell == "quad":
                made = [[a, b, c, d, n[0, 1], n[1, 2], n[2, 1], n[1, 0], n[1, 1]]]
            else:
                made = [[a, b, c, n[0, 1], n[1, 2], n[1, 1]], [a, c, d, n[1, 1], n[2, 1], n[1, 0]]]
            cells[1 if j < NY else 2] += made
    kind = {("triangle", 1): 2, ("triangle", 2): 9, ("quad", 1): 3, ("quad", 2): 10}[model.cell, model.order]
    split = step * NY
    along = {
        1: node[0],
        2: node[: split + 1, -1],
        3: node[split, ::-1],
        4: node[split::-1, 0],
        5: node[split:, -1],
        6: node[-1, ::-1],
        7: node[: split - 1 : -1, 0],
    }
    elements = {(2, tag): (kind, np.array(rows)) for tag, rows in cells.items()}
    for tag, line in along.items():
        ends = [[line[k], line[k + step], *([line[k + 1]] if step == 2 else [])] for k in range(0, len(line) - 1, step)]
        elements[1, tag] = (1 if step == 1 else 8, np.array(ends))
    for tag, corner in enumerate((node[0, 0], node[0, -1]), start=1):
        elements[0, tag] = (15, np.array([[corner]]))
    tags = np.arange(1, len(points) + 1)
    if model.seed is not None:
        rng = np.random.default_rng(model.seed)
        tags = rng.choice(10 * len(points), len(points), replace=False) + 1
        order = rng.permutation(len(points))
        place = np.argsort(order)
        points, tags = points[order], tags[order]
        elements = {key: (kind, place[rng.permutation(rows)]) for key, (kind, rows) in elements.items()}
        keys = list(elements)
        elements = {keys[k]: elements[keys[k]] for k in rng.permutation(len(keys))}
    return replace(model, points=points, tags=tags, elements=elements)


def _put(model: Model, *rows: tuple[str, Sequence[float]]) -> bytes:
    """Numbers of the given types (i: int, n: size, d: double), one line a row as text."""
    if model.binary:
        mark = ">" if model.big_end else "<"
        return b"".join(struct.pack(mark + kinds.replace("n", "Q"), *values) for kinds, values in rows)
    text = (" ".join(repr(int(v) if k != "d" else float(v)) for k, v in zip(kinds, values)) for kinds, values in rows)
    return b"".join(line.encode() + model.line_end for line in text)


def _groups_of(model: Model, dimension: int, tag: int) -> list[int]:
    """Signed numbers of the groups of an entity, one for each time that it is named."""
    return [
        number if entity > 0 else -number
        for group_dimension, number, _, entities in model.groups
        for entity in entities
        if group_dimension == dimension and abs(entity) == tag
    ]


def _written(model: Model) -> dict[tuple[int, int], tuple[int, np.ndarray]]:
    """Elements that Gmsh writes: those of entities in a group, or all."""
    return {key: part for key, part in model.elements.items() if model.save_all or _groups_of(model, *key)}


def _names(model: Model) -> bytes:
    named = [f'{dimension} {tag} "{name}"' for dimension, tag, name, _ in model.groups if name is not None]
    lines = [str(len(named)), *named, ""]
    return model.line_end.join(line.encode() for line in lines)


def _parameters(dimension: int, point: np.ndarray) -> list[float]:
    return [0.25, 0.75, 0.5][:dimension]


def _part_of(model: Model, nodes: np.ndarray) -> np.ndarray:
    """Partition of each element, from 1, by the place of its first node."""
    x = model.points[nodes[:, 0], 0]
    return 1 + np.minimum((x / 2 * model.parts).astype(np.int64), model.parts - 1)


def _old(model: Model) -> dict[str, bytes]:
    """Sections of versions 1 and 2.2."""
    rows: list[tuple[int, list[int], np.ndarray]] = []
    for (dimension, tag), (kind, nodes) in _written(model).items():
        parts = _part_of(model, nodes)
        for row, part in zip(nodes, parts):
            groups = [0] if model.save_all else [abs(number) for number in _groups_of(model, dimension, tag)]
            for group in groups:
                tags = [group, tag]
                if model.parts > 1 and model.version != "1":
                    ghost = model.ghosts and dimension == 2
                    tags += [2 if ghost else 1, int(part)] + ([-(int(part) % model.parts + 1)] if ghost else [])
                rows.append((kind, tags, model.tags[row]))
    count = len(rows)
    place = [(2, 1), *[(1, 1)] * 3] + [(2, 1)] * len(model.points)
    if model.version == "1":
        elements = [
            (f"{'i' * (5 + len(row))}", (k, kind, *tags, len(row), *row)) for k, (kind, tags, row) in enumerate(rows, 1)
        ]
        nodes = [("iddd", (tag, *point)) for tag, point in zip(model.tags, model.points)]
        head = [("i", (len(nodes),))]
        return {"NOD": _put(model, *head, *nodes), "ELM": _put(model, ("i", (count,)), *elements)}
    if model.binary:
        elements = [
            row
            for k, (kind, tags, nodes) in enumerate(rows, 1)
            for row in (("iii", (kind, 1, len(tags))), ("i" * (1 + len(tags) + len(nodes)), (k, *tags, *nodes)))
        ]
    else:
        elements = [
            ("i" * (3 + len(tags) + len(nodes)), (k, kind, len(tags), *tags, *nodes))
            for k, (kind, tags, nodes) in enumerate(rows, 1)
        ]
    nodes = []
    for (dimension, entity), tag, point in zip(place, model.tags, model.points):
        more = [dimension, entity, *_parameters(dimension, point)] if model.parametric else []
        kinds = "iddd" + ("ii" + "d" * dimension if model.parametric else "")
        nodes.append((kinds, (tag, *point, *more)))
    end = b"\n" if model.binary else b""
    return {
        "PhysicalNames": _names(model),
        "ParametricNodes" if model.parametric else "Nodes": b"%d\n" % len(nodes) + _put(model, *nodes) + end,
        "Elements": b"%d\n" % count + _put(model, *elements) + end,
    }


def _new(model: Model) -> dict[str, bytes]:
    """Sections of versions 4.0 and 4.1."""
    old = model.version == "4.0"
    box = [0.0] * 6
    sections = {"PhysicalNames": _names(model)}

    def entity(dimension: int, tag: int, start: Sequence[int], kinds: str) -> tuple[str, list[float]]:
        groups = _groups_of(model, dimension, tag)
        where = box if dimension or old else box[:3]
        bounds = [] if dimension == 0 else [0]
        return (
            kinds + "d" * len(where) + "n" + "i" * len(groups) + "n" * len(bounds),
            [*start, *where, len(groups), *groups, *bounds],
        )

    entities = [entity(dimension, tag, [tag], "i") for dimension, tag in sorted(model.elements)]
    counts = [sum(key[0] == dimension for key in model.elements) for dimension in range(4)]
    sections["Entities"] = _put(model, ("nnnn", counts), *entities)
    blocks = [(key, kind, nodes) for key, (kind, nodes) in _written(model).items()]
    if model.parts > 1:
        split, parents = [], []
        for (dimension, tag), kind, nodes in blocks:
            parts = _part_of(model, nodes)
            for part in np.unique(parts):
                parents.append((dimension, 100 + len(parents), tag, int(part)))
                split.append(((dimension, parents[-1][1]), kind, nodes[parts == part]))
        blocks, parents = split, sorted(parents)
        rows = [entity(d, tag, [own, d, tag, 1, part], "iiini") for d, own, tag, part in parents]
        counts = [sum(parent[0] == dimension for parent in parents) for dimension in range(4)]
        ghosts = [("ii", (900, 1)), ("ii", (901, 2))] if model.ghosts else []
        head = [("n", (model.parts,)), ("n", (len(ghosts),)), *ghosts, ("nnnn", counts)]
        sections["PartitionedEntities"] = _put(model, *head, *rows)
    count = len(model.points)
    runs = [(0, 1, range(0, 1)), (1, 1, range(1, 4)), (2, 1, range(4, count))]
    rows = [("nn" if old else "nnnn", [len(runs), count, *([] if old else [model.tags.min(), model.tags.max()])])]
    for dimension, tag, run in runs:
        flag = int(model.parametric)
        rows.append(("iiin", (*((tag, dimension) if old else (dimension, tag)), flag, len(run))))
        more = [_parameters(dimension, model.points[k]) if flag else [] for k in run]
        if old:
            rows += [("i" + "d" * (3 + len(m)), (model.tags[k], *model.points[k], *m)) for k, m in zip(run, more)]
        else:
            rows += [("n", (model.tags[k],)) for k in run]
            rows += [("d" * (3 + len(m)), (*model.points[k], *m)) for k, m in zip(run, more)]
    sections["Nodes"] = _put(model, *rows)
    total = sum(len(nodes) for _, _, nodes in blocks)
    rows, number = [("nn" if old else "nnnn", [len(blocks), total, *([] if old else [1, total])])], 0
    for (dimension, tag), kind, nodes in blocks:
        rows.append(("iiin", (*((tag, dimension) if old else (dimension, tag)), kind, len(nodes))))
        for row in nodes:
            number += 1
            rows.append((("i" if old else "n") * (1 + len(row)), (number, *model.tags[row])))
    sections["Elements"] = _put(model, *rows)
    if model.binary:
        sections = {name: text if name == "PhysicalNames" else text + b"\n" for name, text in sections.items()}
    return sections


def msh_bytes(model: Model) -> bytes:
    """The file."""
    model = _meshed(model)
    sections = _old(model) if model.version in ("1", "2.2") else _new(model)
    end = model.line_end
    head = b""
    if model.version != "1":
        one = struct.pack(">i" if model.big_end else "<i", 1) + b"\n" if model.binary else b""
        version = {"4.0": b"4"}.get(model.version, model.version.encode())
        head = b"$MeshFormat" + end + version + b" %d 8" % model.binary + end + one + b"$EndMeshFormat" + end
    parts = [*sections.items(), *model.extra]
    if model.sequence:
        parts = [parts[k] for k in np.argsort(np.array([*model.sequence, *range(99)][: len(parts)]), kind="stable")]
    body = b"".join(
        b"$%b" % name.encode() + end + text + (b"$END%b" if name in ("NOD", "ELM") else b"$End%b") % name.encode() + end
        for name, text in parts
    )
    return head + body


def write_msh(path: Path, **options: object) -> Path:
    """Write the model with options of `Model`."""
    path.write_bytes(msh_bytes(Model(**options)))  # type: ignore[arg-type]
    return path

"""Damaged scene files and meshes: refused in one sentence with exit code 2, or still a valid scene; nothing between.

The computation itself is replaced by a marker, so that thousands of files can be tried: what is tested is everything
before it. A scene that comes as far as the computation is valid, and its result folder may be written; a refused one
leaves nothing behind.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import pytest
from mutations import Hang, mutated, one_sentence, within

from granfabric.cases.commands import dem, point, run
from granfabric.cases.errors import RunError
from granfabric.cases.scene import catalogue

SHIPPED = catalogue.HOME
SCENES = {"point": "paths/unload_reload.toml", "run": "biaxial/biaxial.toml", "dem": "disks/dem_loop.toml"}
SECONDS = 20
"""A file of a few kilobytes that takes longer hangs: the scenes here take some hundredths of a second."""

AMOUNTS = [
    pytest.param(1, id="few"),
    pytest.param(8, id="many", marks=pytest.mark.slow),
    pytest.param(200, id="most", marks=pytest.mark.long),
]


@pytest.fixture
def reached(monkeypatch: pytest.MonkeyPatch) -> None:
    """The computation says that it was reached."""

    def computation(*arguments: object, **options: object) -> None:
        raise RunError("computation reached")

    monkeypatch.setattr(point, "drive", computation)
    monkeypatch.setattr(run, "FieldRecorder", computation)
    monkeypatch.setattr(dem, "prepare_packing", computation)
    monkeypatch.setattr("granfabric.cases.terminal.early_kernels.EarlyKernels.start", lambda self, kernels: None)


class Judge:
    """Counts valid scenes, and keeps what ended in any way but the two legal ones."""

    def __init__(self, granfabric: Callable, *arguments: object) -> None:
        self.granfabric, self.arguments = granfabric, arguments
        self.valid = 0
        self.wrong: list[str] = []

    def __call__(self, out: Path, damage: str) -> None:
        try:
            with within(SECONDS):
                code, _, err = self.granfabric(*self.arguments, "-o", out)
        except (Exception, Hang) as error:
            self.wrong.append(f"{damage}: {type(error).__name__}: {error}")
            return
        # a field run adds where what was computed before is
        reached = code == 1 and err.partition(";")[0].strip() == "granfabric: computation reached"
        self.valid += reached
        if not reached and not (code == 2 and one_sentence(err)):
            self.wrong.append(f"{damage}: exit code {code}, {err}")
        elif not reached and out.exists():
            self.wrong.append(f"{damage}: refused, but something was written")
        shutil.rmtree(out, ignore_errors=True)


@pytest.mark.parametrize("amount", AMOUNTS)
@pytest.mark.parametrize("command", SCENES)
def test_damaged_scenes(command: str, amount: int, granfabric: Callable, tmp_path: Path, reached: None) -> None:
    source = SHIPPED / SCENES[command]
    for mesh in source.parent.glob("*.msh"):
        shutil.copy(mesh, tmp_path)
    whole, file = source.read_bytes(), tmp_path / "scene.toml"
    judge = Judge(granfabric, command, file)
    for seed in range(30 * amount):
        file.write_bytes(mutated(whole, np.random.default_rng([seed, amount])))
        judge(tmp_path / f"out{seed}", f"seed {seed}")
    assert not judge.wrong, "\n".join(judge.wrong)
    # damage to comments and titles leaves a scene valid; much damage does not
    assert 0 < judge.valid < 30 * amount * 0.8


POINTS = np.array([[x, y, 0.0] for y in (0.0, 0.05, 0.1) for x in (0.0, 0.025, 0.05)])
QUADS = [[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6], [4, 5, 8, 7]]
TRIANGLES = np.array([[quad[i] for i in corner] for quad in QUADS for corner in ((0, 1, 2), (0, 2, 3))])
SIDES = {"bottom": [[0, 1], [1, 2]], "top": [[7, 6], [8, 7]], "left": [[0, 3], [3, 6]], "right": [[2, 5], [5, 8]]}
GROUPS = {**{name: (1, place + 1) for place, name in enumerate(SIDES)}, "specimen": (2, 5)}


def write_22(path: Path, binary: bool) -> None:
    """The small square, MSH 2.2."""
    cells = [("line", np.array(pairs)) for pairs in SIDES.values()] + [("triangle", TRIANGLES)]
    tags = [np.full(len(data), place + 1) for place, (_, data) in enumerate(cells)]
    mesh = meshio.Mesh(
        POINTS,
        cells,
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={name: np.array([tag, dim]) for name, (dim, tag) in GROUPS.items()},
    )
    meshio.gmsh.write(str(path), mesh, fmt_version="2.2", binary=binary)


def write_41(path: Path, binary: bool) -> None:
    """The small square, MSH 4.1: every side is a curve, all nodes belong to the surface."""

    def put(*rows: tuple[str, tuple]) -> bytes:
        """Numbers of the given types (i: int, n: size, d: double), one line a row as text."""
        if binary:
            return b"".join(struct.pack("<" + kinds.replace("n", "Q"), *values) for kinds, values in rows)
        return b"".join(b" ".join(repr(value).encode() for value in values) + b"\n" for _, values in rows)

    curves = [("idddddd" + "n" + "i" + "n", (tag, *[0.0] * 6, 1, tag, 0)) for tag in range(1, 5)]
    surface = ("idddddd" + "n" + "i" + "n", (1, *[0.0] * 6, 1, 5, 0))
    nodes = [("nnnn", (1, 9, 1, 9)), ("iii", (2, 1, 0)), ("n", (9,))]
    nodes += [("n", (k + 1,)) for k in range(9)] + [("ddd", tuple(map(float, point))) for point in POINTS]
    elements, number = [("nnnn", (5, 16, 1, 16))], 0
    blocks = [(1, tag, 1, SIDES[name]) for name, (dim, tag) in GROUPS.items() if dim == 1]
    for dim, tag, kind, block in [*blocks, (2, 1, 2, TRIANGLES)]:
        elements += [("iii", (dim, tag, kind)), ("n", (len(block),))]
        for corners in block:
            number += 1
            elements.append(("n" * (1 + len(corners)), (number, *(int(corner) + 1 for corner in corners))))
    names = [f'{dim} {tag} "{name}"' for name, (dim, tag) in GROUPS.items()]
    sections = {
        "MeshFormat": f"4.1 {int(binary)} 8\n".encode() + (struct.pack("<i", 1) + b"\n" if binary else b""),
        "PhysicalNames": "\n".join([str(len(names)), *names, ""]).encode(),
        "Entities": put(("nnnn", (0, 4, 1, 0)), *curves, surface) + b"\n" * binary,
        "Nodes": put(*nodes) + b"\n" * binary,
        "Elements": put(*elements) + b"\n" * binary,
    }
    path.write_bytes(b"".join(b"$%b\n%b$End%b\n" % (n.encode(), s, n.encode()) for n, s in sections.items()))


@pytest.mark.parametrize("amount", AMOUNTS)
@pytest.mark.parametrize("kind", ["2.2_text", "2.2_binary", "4.1_text", "4.1_binary", "gmsh"])
def test_damaged_meshes(kind: str, amount: int, granfabric: Callable, tmp_path: Path, reached: None) -> None:
    shutil.copy(SHIPPED / "biaxial/biaxial.toml", tmp_path / "scene.toml")
    if kind == "gmsh":
        whole = (SHIPPED / "biaxial/biaxial.msh").read_bytes()
    else:
        version, form = kind.split("_")
        {"2.2": write_22, "4.1": write_41}[version](tmp_path / "square.msh", form == "binary")
        whole = (tmp_path / "square.msh").read_bytes()
    file = tmp_path / "biaxial.msh"
    file.write_bytes(whole)
    judge = Judge(granfabric, "run", tmp_path / "scene.toml")
    judge(tmp_path / "out", "whole")
    assert judge.valid == 1
    for seed in range((4 if kind == "gmsh" else 25) * amount):
        file.write_bytes(mutated(whole, np.random.default_rng([seed, amount]), text="binary" not in kind))
        judge(tmp_path / f"out{seed}", f"seed {seed}")
    assert not judge.wrong, "\n".join(judge.wrong)

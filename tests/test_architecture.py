"""Who may import whom, between the rooms and inside them. Parsed from the sources, nothing is imported."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from itertools import pairwise
from pathlib import Path

import pytest

HOME = Path(__file__).resolve().parent.parent
ROOMS = ("constitutive", "fem", "dem_ref", "cases")
FRONT = "granfabric"

ALLOWED: dict[str, set[str]] = {
    "constitutive": {"numpy", "numba", "llvmlite"},
    "fem": {
        "numpy",
        "numba",
        "scipy",
        "skfem",
        "meshio",
        "cvxopt",
        "granfabric.constitutive.contract",
        "granfabric.constitutive.compilation",
    },
    "dem_ref": {"numpy", "numba", "scipy.spatial"},
    "cases": {
        *("numpy", "numba", "scipy", "meshio", "matplotlib", "pydantic", "typer", "rich"),
        *("granfabric.constitutive", "granfabric.fem", "granfabric.dem_ref"),
    },
}
"""What a room may import besides itself and the standard library; a dotted name admits only that part."""

FLOORS: dict[str, tuple[str, ...]] = {
    "constitutive": (
        *("compilation", "contract", "threads", "effects", "material_table", "parameters", "lanes", "fabric"),
        *("stiffness", "mixed_control", "network", "sliding", "integration", "state", "law", "path", "plain_laws"),
        "warm_up",
    ),
    "fem": (
        *("accounting", "vectors", "mesh", "linear_solvers", "discretisation", "loads", "equilibrium", "output"),
        "warm_up",
    ),
    "dem_ref": ("compilation", "sample", "dynamics", "measures", "loading", "inputs"),
    "cases": (
        *("errors", "terminal", "scene", "records", "field", "pictures", "effects", "verify", "cost", "commands"),
        "__main__",
    ),
}
"""Folders and files of each room, lowest first: a line imports from its own folder and from those before it."""


def imported(source: str, package: tuple[str, ...]) -> set[str]:
    """Absolute names of all modules that a source text imports, also inside functions and by `import_module`."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            # `from fem import mesh` imports fem.mesh: the longest name decides.
            names.update(f"{module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__") and isinstance(node.args[0].value, str):
                names.add(node.args[0].value)
    return names


def forbidden(names: set[str], room: str) -> set[str]:
    """Those imports that the room may not make."""
    legal = ALLOWED[room] | {f"{FRONT}.{room}"}
    return {
        name
        for name in names
        if name.partition(".")[0] not in sys.stdlib_module_names
        and not any(name == allowed or name.startswith(f"{allowed}.") for allowed in legal)
    }


def sources(room: str) -> list[Path]:
    return sorted((HOME / room).rglob("*.py"))


def package_of(file: Path) -> tuple[str, ...]:
    return (FRONT, *file.relative_to(HOME).with_suffix("").parts[:-1])


def arrows(room: str) -> dict[str, set[str]]:
    """For each folder or file of a room the others of the room from which it imports."""
    found: dict[str, set[str]] = {floor: set() for floor in FLOORS[room]}
    for file in sources(room):
        floor = file.relative_to(HOME / room).parts[0].removesuffix(".py")
        if floor == "__init__":
            continue
        assert floor in found, f"{file.relative_to(HOME)} stands on no floor of {room}"
        for name in imported(file.read_text(encoding="utf-8"), package_of(file)):
            parts = name.split(".")
            if parts[:2] == [FRONT, room] and len(parts) > 2 and parts[2] != floor:
                found[floor].add(parts[2])
    return found


def upward(found: dict[str, set[str]], floors: tuple[str, ...]) -> set[tuple[str, str]]:
    """Arrows to the same or a higher floor."""
    height = {floor: number for number, floor in enumerate(floors)}
    return {(start, end) for start, ends in found.items() for end in ends if height[end] >= height[start]}


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_it_may(room: str) -> None:
    assert sources(room)
    for file in sources(room):
        wrong = forbidden(imported(file.read_text(encoding="utf-8"), package_of(file)), room)
        assert not wrong, f"{file.relative_to(HOME)} imports {', '.join(sorted(wrong))}"


@pytest.mark.parametrize("room", ROOMS)
def test_inside_a_room_arrows_point_down(room: str) -> None:
    found = arrows(room)
    print(f"\n{room}, from the top down")  # pytest -s shows the graph
    for floor in reversed(FLOORS[room]):
        print(f"  {floor:16} {', '.join(sorted(found[floor], key=FLOORS[room].index, reverse=True))}")
    assert not upward(found, FLOORS[room])


@pytest.mark.parametrize("room", ROOMS)
def test_an_arrow_upwards_would_be_found(room: str) -> None:
    floors = FLOORS[room]
    for lower, higher in pairwise(floors):
        assert upward({lower: {higher}}, floors) == {(lower, higher)}
        assert not upward({higher: {lower}}, floors)


def test_a_dot_means_this_folder() -> None:
    """Everything else is imported by its full name, so that a line tells where things are."""
    climbing = re.compile(r"^\s*from \.\.|^\s*from \.\w+\.", re.MULTILINE)
    assert climbing.search("from ..fem import mesh") and climbing.search("from .lanes.rows import copy")
    assert not [file for room in ROOMS for file in sources(room) if climbing.search(file.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(
    ("room", "line"),
    [
        ("constitutive", "import scipy"),
        ("constitutive", "from granfabric.fem.mesh import read_mesh"),
        ("constitutive", "from ..fem import mesh"),
        ("fem", "from granfabric.constitutive.law import ContactLaw"),
        ("fem", "from granfabric.constitutive import law"),
        ("fem", "import granfabric.constitutive"),
        ("fem", "from constitutive.contract import Law"),
        ("fem", "def f():\n    from granfabric.cases import scene"),
        ("dem_ref", "import granfabric.constitutive.contract"),
        ("dem_ref", "import scipy.sparse"),
        ("dem_ref", "import importlib\nimportlib.import_module('granfabric.fem.mesh')"),
        ("cases", "import skfem"),
        ("cases", "import granfabric"),
    ],
)
def test_a_wrong_direction_would_be_found(room: str, line: str) -> None:
    assert forbidden(imported(line, (FRONT, room)), room)


@pytest.mark.parametrize(
    ("room", "line"),
    [
        ("fem", "from granfabric.constitutive.contract import Law\nfrom . import mesh\nimport scipy.sparse.linalg"),
        ("cases", "from granfabric.constitutive.law import ContactLaw\nfrom granfabric.fem import mesh\nimport json"),
        ("dem_ref", "from scipy.spatial import Delaunay"),
    ],
)
def test_right_directions_pass(room: str, line: str) -> None:
    assert not forbidden(imported(line, (FRONT, room)), room)


def test_every_folder_is_installed() -> None:
    """setuptools finds no packages by itself where the folders lie beside each other; the list is checked here."""
    settings = tomllib.loads((HOME / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    folders = {".".join(package_of(file)) for room in ROOMS for file in sources(room)}
    assert set(settings["packages"]) == {FRONT, *folders}
    assert settings["package-dir"] == {FRONT: "api", **{f"{FRONT}.{room}": room for room in ROOMS}}


def test_types_are_checked_as_they_are_imported() -> None:
    """The type checker sees the rooms through links, one for each room and each file of the front."""
    links = {link.name: link.resolve() for link in (HOME / "tests" / "types" / FRONT).iterdir()}
    front = {file.name: file for file in (HOME / "api").iterdir() if file.is_file()}
    assert links == {**{room: HOME / room for room in ROOMS}, **front}


def test_sources_stay_readable() -> None:
    lengths = {
        str(file.relative_to(HOME)): len(file.read_text().splitlines()) for room in ROOMS for file in sources(room)
    }
    assert not {name: length for name, length in lengths.items() if length > 450}

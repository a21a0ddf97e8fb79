"""The directions of import: constitutive <- fem <- cases -> dem_ref. Parsed from the sources, nothing is imported."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest

HOME = Path(__file__).resolve().parent.parent
ROOMS = ("constitutive", "fem", "dem_ref", "cases")

ALLOWED: dict[str, set[str]] = {
    "constitutive": {"numpy", "numba"},
    "fem": {
        "numpy",
        "numba",
        "scipy",
        "skfem",
        "meshio",
        "cvxopt",
        "constitutive.arrays",
        "constitutive.contract",
        "constitutive.compilation",
        "constitutive.threads",
    },
    "dem_ref": {"numpy", "numba", "scipy.spatial"},
    "cases": {
        *("numpy", "numba", "scipy", "meshio", "matplotlib", "pydantic", "typer", "rich"),
        *("constitutive", "fem", "dem_ref"),
    },
}
"""What a room may import besides itself and the standard library; a dotted name admits only that part."""


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
    legal = ALLOWED[room] | {room}
    return {
        name
        for name in names
        if name.partition(".")[0] not in sys.stdlib_module_names
        and not any(name == allowed or name.startswith(f"{allowed}.") for allowed in legal)
    }


def sources(room: str) -> list[Path]:
    return sorted((HOME / room).rglob("*.py"))


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_it_may(room: str) -> None:
    assert sources(room)
    for file in sources(room):
        package = file.relative_to(HOME).with_suffix("").parts[:-1]
        wrong = forbidden(imported(file.read_text(encoding="utf-8"), package), room)
        assert not wrong, f"{file.relative_to(HOME)} imports {', '.join(sorted(wrong))}"


@pytest.mark.parametrize(
    ("room", "line"),
    [
        ("constitutive", "import scipy"),
        ("constitutive", "from fem.mesh import read_mesh"),
        ("constitutive", "from ..fem import mesh"),
        ("fem", "from constitutive.law import ContactLaw"),
        ("fem", "from constitutive import law"),
        ("fem", "import constitutive"),
        ("fem", "def f():\n    from cases import scene"),
        ("dem_ref", "import constitutive.contract"),
        ("dem_ref", "import scipy.sparse"),
        ("dem_ref", "import importlib\nimportlib.import_module('fem.mesh')"),
        ("cases", "import skfem"),
    ],
)
def test_a_wrong_direction_would_be_found(room: str, line: str) -> None:
    assert forbidden(imported(line, (room,)), room)


@pytest.mark.parametrize(
    ("room", "line"),
    [
        ("fem", "from constitutive.contract import Law\nfrom . import mesh\nimport scipy.sparse.linalg"),
        ("cases", "from constitutive.law import ContactLaw\nfrom fem import mesh\nimport json"),
        ("dem_ref", "from scipy.spatial import Delaunay"),
    ],
)
def test_right_directions_pass(room: str, line: str) -> None:
    assert not forbidden(imported(line, (room,)), room)


def test_sources_stay_readable() -> None:
    lengths = {
        str(file.relative_to(HOME)): len(file.read_text().splitlines()) for room in ROOMS for file in sources(room)
    }
    assert not {name: length for name, length in lengths.items() if length > 450}

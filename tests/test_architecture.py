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
        *("dolfinx", "basix", "ufl", "mpi4py", "petsc4py", "dolfinx_solver"),  # of the second host
        *(f"granfabric.constitutive.{part}" for part in ("arrays", "compilation", "contract", "threads")),
        "granfabric.constitutive.effective_stress",
    },
    "dem_ref": {"numpy", "numba", "scipy.spatial"},
    "cases": {
        *("numpy", "numba", "scipy", "meshio", "matplotlib", "pydantic", "typer", "rich", "distributed", "llvmlite"),
        *("granfabric.constitutive", "granfabric.fem", "granfabric.dem_ref"),
    },
}
"""What a room may import besides itself and the standard library; a dotted name admits only that part."""

FLOORS: dict[str, tuple[str, ...]] = {
    "constitutive": (
        *("contract", "arrays", "compilation", "threads", "material_table", "parameters", "effects", "lanes", "fabric"),
        *("initial_checks", "effective_stress", "total_control", "pore_fluid"),
        *("stiffness", "mixed_control", "network", "sliding", "integration", "state", "law", "path", "plain_laws"),
        "warm_up",
    ),
    "fem": (
        *("accounting", "vectors", "mesh", "linear_solvers", "discretisation", "loads", "equilibrium", "output"),
        *("fenicsx", "warm_up"),
    ),
    "dem_ref": (
        *("arrays", "compilation", "sample", "threads", "dynamics", "measures", "loading", "inputs", "exchange"),
        *("preparation", "specimen", "ensemble"),
    ),
    "cases": (
        *("errors", "terminal", "scene", "grains", "records", "engine", "field", "pictures", "effects", "fit"),
        *("verify", "cost", "sweep", "commands", "__main__"),
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


ENTERED = {
    "granfabric.constitutive.law": {"initial_force_fabric", "smallest_step_factor", "update_points"},
    "granfabric.constitutive.pore_fluid": {"_add_fluid", "_effective"},
    "granfabric.constitutive.plain_laws.linear_elastic": {"_update"},
    "granfabric.constitutive.plain_laws.von_mises": {"_update"},
    "granfabric.fem.discretisation.assembly": {
        *("strain_kernel", "element_force_kernel", "gather_force_kernel", "element_tangent_kernel"),
        *("gather_tangent_kernel", "element_action_kernel"),
    },
    "granfabric.dem_ref.sample.neighbours": {"_fill_pairs", "_carry_over"},
    "granfabric.dem_ref.dynamics.relaxation": {"_relax"},
    "granfabric.dem_ref.dynamics.settling": {"_settle", "_settle_two_threads"},
    "granfabric.dem_ref.specimen.specimen": {"refresh_contacts", "bounded_steps", "write_back"},
    "granfabric.dem_ref.dynamics.motion": {"refresh_contacts", "advance", "advance_two_threads", "write_back"},
}
"""Compiled kernels that are called from Python, by the module that calls them and has checked what it hands over."""


def _is_compiled(node: ast.expr) -> bool:
    """Whether this is ``compiled(...)``."""
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "compiled"


def _kernels(tree: ast.Module) -> set[str]:
    """Names of the kernels that a module defines, by decoration or by a call."""
    names = set()
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and any(_is_compiled(entry) for entry in node.decorator_list):
            names.add(node.name)
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and _is_compiled(node.value.func):
            names.update(target.id for target in node.targets if isinstance(target, ast.Name))
    return names


def _compiled_sources(tree: ast.Module) -> set[str]:
    """Functions whose bodies are compiled: kernels, and what is handed to a call of ``compiled``."""
    handed = {
        argument.id
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and _is_compiled(node.value.func)
        for argument in node.value.args
        if isinstance(argument, ast.Name)
    }
    return handed | _kernels(tree)


def entered(modules: dict[str, ast.Module]) -> dict[str, set[str]]:
    """Kernels that each module names outside compiled code."""
    kernels = {name: _kernels(tree) for name, tree in modules.items()}
    found: dict[str, set[str]] = {}
    for name, tree in modules.items():
        known = {kernel: kernel for kernel in kernels[name]}
        aliases = {}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                base = name.split(".")[: -node.level] if node.level else []
                source = ".".join([*base, *([node.module] if node.module else [])])
                for alias in node.names:
                    if alias.name in kernels.get(source, ()):
                        known[alias.asname or alias.name] = alias.name
                    if f"{source}.{alias.name}" in kernels:
                        aliases[alias.asname or alias.name] = f"{source}.{alias.name}"
        left_out = _compiled_sources(tree)
        for statement in tree.body:
            if isinstance(statement, ast.FunctionDef) and statement.name in left_out:
                continue
            for node in ast.walk(statement):
                if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in known:
                    found.setdefault(name, set()).add(known[node.id])
                if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    of = kernels.get(aliases.get(node.value.id, ""), set())
                    found.setdefault(name, set()).update({node.attr} & of)
    return {name: used for name, used in found.items() if used}


def test_kernels_are_entered_only_where_arrays_are_checked() -> None:
    """A new call of a kernel from Python has to be put down here, once what it hands over is checked."""
    modules = {
        ".".join((FRONT, *file.relative_to(HOME).with_suffix("").parts)): ast.parse(file.read_text(encoding="utf-8"))
        for room in ROOMS
        for file in sources(room)
    }
    # formulas of the law are not among them: called from Python they are plain functions
    assert sum(len(_kernels(tree)) for tree in modules.values()) > 20
    assert entered(modules) == ENTERED


def test_a_new_entry_would_be_found() -> None:
    modules = {
        "fem.a": ast.parse("@compiled()\ndef k(x):\n    return k(x)\ntwice = compiled(nogil=True)(raw)"),
        "fem.b": ast.parse("from .a import k as f\nclass C:\n    def g(self):\n        return f(1)"),
        "cases.c": ast.parse("from fem import a\ndef h(call):\n    call(a.twice)"),
        "cases.d": ast.parse("from fem.a import k\n@compiled()\ndef inner(x):\n    return k(x)"),
    }
    assert entered(modules) == {"fem.b": {"k"}, "cases.c": {"twice"}}

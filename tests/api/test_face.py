"""What is typed on the first day: every name, the examples of every docstring, and Python started in awkward places."""

from __future__ import annotations

import doctest
import importlib
import importlib.metadata
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import granfabric as gf

HOME = Path(__file__).resolve().parents[2]
FRONT = ("scenes", "field", "fitting", "results", "packing", "sweeping")


def test_every_name_is_there() -> None:
    assert len(gf.__all__) > 50 and gf.__version__ == importlib.metadata.version("granfabric")
    for name in gf.__all__:
        assert getattr(gf, name) is not None
        assert name in dir(gf)


def test_every_name_of_the_front_has_a_text() -> None:
    texts = {name: (getattr(gf, name).__doc__ or "") for name in gf.__all__ }
    assert not [name for name, text in texts.items() if len(text) < 40]


def test_importing_it_loads_nothing_heavy() -> None:
    heavy = ["numpy", "numba", "scipy", "matplotlib", "skfem", "meshio", "pandas", "pydantic"]
    program = f"import sys, granfabric; print([name for name in {heavy!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("module", FRONT)
def test_examples_of_docstrings(module: str, tmp_path: Path) -> None:
    gf.run_scene("p_constant", {"output.pictures": False}, output=tmp_path / "demo")
    found = doctest.testmod(
        importlib.import_module(f"granfabric.{module}"), extraglobs={"tmp": tmp_path, "demo": tmp_path / "demo"}
    )
    assert found.attempted > 2 and found.failed == 0


def python(folder: Path, program: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder, env=os.environ | variables, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture
def hostile(tmp_path: Path) -> Path:
    """A folder whose files have the names of ours."""
    for name in ("fem.py", "constitutive.py", "dem_ref.py", "cases.py", "api.py"):
        (tmp_path / name).write_text("raise SystemExit('the wrong file was imported')\n")
    for name in ("cases", "fem"):
        (tmp_path / "path" / name).mkdir(parents=True)
        (tmp_path / "path" / name / "__init__.py").write_text("raise SystemExit('the wrong folder was imported')\n")
    return tmp_path


def test_a_users_files_of_the_same_names_are_no_obstacle(hostile: Path) -> None:
    program = (
        "import granfabric as gf\n"
        "from granfabric.fem.mesh import read_mesh\n"
        "from granfabric.cases.__main__ import main\n"
        "assert gf.rectangle(1.0, 1.0, 1, 1).cell == 'triangle' and gf.Segment and read_mesh is gf.read_mesh\n"
        "import sys; sys.argv = ['granfabric', 'scenes']; main()\n"
    )
    done = python(hostile, program, PYTHONPATH=str(hostile / "path"))
    assert done.returncode == 0, done.stderr
    assert "granfabric run NAME" in done.stdout


def test_in_a_clone_the_installed_one_is_imported() -> None:
    """A folder `granfabric` at the root of a clone would be taken instead of the installed package."""
    assert not (HOME / "granfabric").exists()
    done = python(HOME, "import granfabric.fem.mesh, granfabric; print(granfabric.__file__)")
    assert done.returncode == 0 and Path(done.stdout.strip()).resolve() == Path(gf.__file__).resolve()


def test_python_in_a_clone_compiles_nothing_twice(tmp_path: Path) -> None:
    """What one process has compiled, another finds in the cache, wherever it is started."""
    program = (
        "import numpy as np\n"
        "from granfabric.constitutive.integration.points import smallest_step_factor as kernel\n"
        "kernel(np.zeros(2, dtype=np.int8), np.ones((2, 2), dtype=np.int64), 20)\n"
        "print(sum(kernel.stats.cache_hits.values()), sum(kernel.stats.cache_misses.values()))"
    )
    first = python(tmp_path, program, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    second = python(HOME, program, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert (first.stdout.split(), second.stdout.split()) == (["0", "1"], ["1", "0"]), first.stderr + second.stderr


@pytest.mark.slow
def test_the_wheel_holds_one_name(tmp_path: Path) -> None:
    """Nothing of ours beside `granfabric` and its metadata in site-packages; the shipped scenes are inside."""
    build = [sys.executable, "-m", "pip", "wheel", "--no-deps", "-q", "-w", str(tmp_path), str(HOME)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"granfabric"}
    for part in ("py.typed", "__init__.pyi", "constitutive/law.py", "cases/scenes/biaxial/biaxial.msh"):
        assert f"granfabric/{part}" in names
    assert not [name for name in names if "tests" in name or name.endswith(".png")]

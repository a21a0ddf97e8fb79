"""A second process compiles the law's kernels only when the cache is cold; its failure harms nobody."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

from granfabric.cases.terminal import early_kernels
from granfabric.constitutive import compilation, warm_up


@pytest.fixture
def cold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty disk cache."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compilation.cache_directory.cache_clear()
    yield tmp_path
    compilation.cache_directory.cache_clear()


def fill(root: Path) -> None:
    """Index files as a compilation leaves them."""
    folder = compilation.cache_directory("constitutive") / "constitutive_123"
    assert root in folder.parents
    folder.mkdir(parents=True)
    for name in warm_up.ENTRY_KERNELS:
        (folder / f"{name}-1.py311.nbi").touch()


def test_the_cache_is_warm_after_the_kernels_were_used() -> None:
    warm_up.warm_up()
    assert warm_up.kernels_cached()
    with early_kernels.early_kernels() as kernels:
        assert not kernels.running and kernels.wait(lambda: False) < 1.0


def test_the_kernels_compiled_beside_it_are_those_that_the_law_calls() -> None:
    warm_up.warm_up()
    # With other argument types, or under another name, they would not be in the cache.
    for module, name, letters in warm_up.LATE_KERNELS:
        kernel = getattr(import_module(f"granfabric.constitutive.{module}"), name)
        missed = sum(kernel.stats.cache_misses.values())
        kernel.compile(tuple(warm_up._TYPES[letter] for letter in letters))  # raises where these are not its arguments
        assert sum(kernel.stats.cache_misses.values()) == missed, name
    assert warm_up.compile_late(lambda: True) == []
    assert warm_up.compile_late(lambda: False) == []


def test_a_process_is_started_only_when_the_cache_is_cold(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_kernels, "COMMAND", ("-c", "import time; time.sleep(600)"))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with early_kernels.early_kernels() as kernels:
        assert kernels.running
        answers = iter([False, False, True])
        kernels.wait(lambda: next(answers))
        assert kernels.running
    assert not kernels.running  # ended with the block
    fill(cold)
    with early_kernels.early_kernels() as kernels:
        assert not kernels.running


def test_one_core_compiles_by_itself(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with early_kernels.early_kernels() as kernels:
        assert not kernels.running


@pytest.mark.parametrize("failure", ["exit", "interpreter"])
def test_a_failing_process_is_harmless(cold: Path, monkeypatch: pytest.MonkeyPatch, failure: str) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    if failure == "exit":
        monkeypatch.setattr(early_kernels, "COMMAND", ("-c", "raise SystemExit(3)"))
    else:
        monkeypatch.setattr(sys, "executable", str(cold / "none"))
    with early_kernels.early_kernels() as kernels:
        kernels.wait(lambda: False)
        assert not kernels.running


def test_the_command_imports_the_law_from_any_folder(tmp_path: Path) -> None:
    # The cache is warm here, so that this takes no compilation; a folder of the same name is not in its way.
    (tmp_path / "constitutive").mkdir()
    (tmp_path / "constitutive" / "__init__.py").write_text("raise SystemExit(9)")
    done = subprocess.run([sys.executable, *early_kernels.COMMAND], cwd=tmp_path, check=False, capture_output=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_cold_run_finds_the_kernels_that_the_process_compiled(cold: Path) -> None:
    done = subprocess.run([sys.executable, *early_kernels.COMMAND], check=False, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert warm_up.kernels_cached()

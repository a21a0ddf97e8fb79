"""A second process compiles the scene's kernel only when the cache is cold; its failure harms nobody."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.scene import build
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal import early_kernels
from granfabric.constitutive import compilation, warm_up
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.integration.points import update_points
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.network.closures import CLOSURES
from granfabric.constitutive.parameters import Closure, Material

KERNEL = "mean_field"


@pytest.fixture
def cold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty disk cache."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compilation.cache_directory.cache_clear()
    yield tmp_path
    compilation.cache_directory.cache_clear()


def fill(root: Path) -> None:
    """An index as a compilation leaves it, of the kernel for the mean field."""
    folder = compilation.cache_directory("constitutive") / "integration_123"
    assert root in folder.parents
    folder.mkdir(parents=True, exist_ok=True)
    signatures = {("(int64, MeanField(bool, float64))", "machine"): "file"}
    text = pickle.dumps("0.68") + pickle.dumps(("stamp", signatures))
    (folder / "points.update_points-1.py311.nbi").write_bytes(text)


@pytest.mark.parametrize("text", [b"", b"\x80", pickle.dumps("0.68"), pickle.dumps("0.68") + pickle.dumps(3)])
def test_a_damaged_index_is_none(cold: Path, text: bytes) -> None:
    fill(cold)
    assert warm_up.cached("mean_field") and not warm_up.cached("shifted_distribution")
    (index,) = cold.rglob("*.nbi")
    index.write_bytes(text)
    assert not warm_up.cached("mean_field")


def test_the_cache_is_warm_after_the_kernels_were_used() -> None:
    warm_up.warm_up(KERNEL)
    assert warm_up.cached(KERNEL)
    with early_kernels.early_kernels() as kernels:
        kernels.start([KERNEL])
        assert not kernels.running and kernels.wait(lambda: False) < 1.0


@pytest.mark.parametrize("effects", [Effects(), Effects(sliding=True), Effects(contact_loss=False, contact_gain=False)])
@pytest.mark.parametrize("change", ["mean_field", "fluctuating", "shifted_distribution"])
def test_a_kernel_is_named_by_the_closure_it_is_for(change: str, effects: Effects) -> None:
    closure = Closure(force_change=change)  # type: ignore[arg-type]
    law = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)], closure, effects)
    named = ContactLaw(law.materials, Closure(force_change=warm_up.kernel_of(closure, effects)))
    assert type(law._kernel_closure) is type(named._kernel_closure) and type(law._kernel_closure) in CLOSURES


def test_effects_and_control_need_no_further_kernel() -> None:
    """Sliding, mixed control, tangents and effects are numbers to a kernel, not types."""
    warm_up.warm_up(KERNEL)
    number = len(update_points.signatures)
    packing = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)
    for effects in (Effects(sliding=True), Effects(contact_gain=False), Effects(stiffness_feedback=False)):
        for closure in (Closure(), Closure(tangential="self_consistent"), Closure(force_change="fluctuating")):
            law = ContactLaw([packing], closure, effects)
            stress = np.array([[-1e5, -1e5, 0.0]])
            state = law.initial_state(stress)
            end, after, strain = np.zeros_like(stress), np.zeros_like(state), np.zeros_like(stress)
            law.update(np.array([[1e-7, 0.0, 0.0]]), stress, state, end, after)
            law.update_stress_driven(np.array([[10.0, 0.0, 0.0]]), stress, state, end, after, strain)
    assert len(update_points.signatures) == number


def test_a_scene_names_the_kernel_of_its_closure() -> None:
    assert build.kernels(load("biaxial", [])) == ["mean_field", "shifted_distribution"]
    assert build.kernels(load("strip_footing", [])) == ["shifted_distribution", "mean_field"]


def test_a_process_is_started_only_for_what_the_cache_lacks(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_kernels, "COMMAND", ("-c", "import time; time.sleep(600)"))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with early_kernels.early_kernels() as kernels:
        assert not kernels.running  # not before it is told what for
        kernels.start([KERNEL])
        assert kernels.running
        answers = iter([False, False, True])
        kernels.wait(lambda: next(answers))
        assert kernels.running
    assert not kernels.running  # ended with the block
    fill(cold)
    with early_kernels.early_kernels() as kernels:
        kernels.start([KERNEL])
        assert not kernels.running
        kernels.start([KERNEL, "shifted_distribution"])
        assert kernels.running


def test_one_core_compiles_by_itself(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    with early_kernels.early_kernels() as kernels:
        kernels.start([KERNEL])
        assert not kernels.running


@pytest.mark.parametrize("failure", ["exit", "interpreter"])
def test_a_failing_process_is_harmless(cold: Path, monkeypatch: pytest.MonkeyPatch, failure: str) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    if failure == "exit":
        monkeypatch.setattr(early_kernels, "COMMAND", ("-c", "raise SystemExit(3)"))
    else:
        monkeypatch.setattr(sys, "executable", str(cold / "none"))
    with early_kernels.early_kernels() as kernels:
        kernels.start([KERNEL])
        kernels.wait(lambda: False)
        assert not kernels.running


def test_the_command_imports_the_law_from_any_folder(tmp_path: Path) -> None:
    # The cache is warm here, so that this takes no compilation; a folder of the same name is not in its way.
    (tmp_path / "constitutive").mkdir()
    (tmp_path / "constitutive" / "__init__.py").write_text("raise SystemExit(9)")
    command = [sys.executable, *early_kernels.COMMAND, KERNEL]
    done = subprocess.run(command, cwd=tmp_path, check=False, capture_output=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_cold_run_finds_the_kernels_that_the_process_compiled(cold: Path) -> None:
    done = subprocess.run([sys.executable, *early_kernels.COMMAND, KERNEL], check=False, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert warm_up.cached(KERNEL) and not warm_up.cached("shifted_distribution")
    assert list(cold.rglob("points.update_points-*.nbc"))

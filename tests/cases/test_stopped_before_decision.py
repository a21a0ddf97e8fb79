"""A run that was stopped before its effects were decided took no step: gone on with, it decides as one begun anew."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from granfabric.cases.commands import run
from granfabric.cases.effects.resolve import STOPPED_BEFORE
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.interruption import InterruptRequest
from granfabric.cases.terminal.screen import Screen

CHANGES = ["mesh.element=P1", "output.pictures=false", "effects.stiffness_feedback=true"]


def test_it_decides_when_it_goes_on(granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = [word for change in CHANGES for word in ("--set", change)]
    assert granfabric("run", "biaxial", "-o", tmp_path / "whole", *settings).code == 0
    with monkeypatch.context() as patch:
        patch.setattr(InterruptRequest, "__call__", lambda self: True)
        stopped = run.run_field(load("biaxial", CHANGES), tmp_path / "stopped", Screen(quiet=True))
    assert stopped.details["decision"]["note"] == STOPPED_BEFORE and stopped.outcome != "finished"
    other = granfabric("run", "biaxial", "-o", tmp_path / "stopped", "--resume", *settings, "--set", "mesh.element=P2")
    assert other.code == 2 and "mesh.element" in other.err
    assert granfabric("run", "biaxial", "-o", tmp_path / "stopped", "--resume", *settings).code == 0
    first, second = (json.loads((tmp_path / name / "run.json").read_text()) for name in ("whole", "stopped"))
    assert first["effects"] == second["effects"] and not all(first["effects"].values())
    assert (tmp_path / "whole" / "history.csv").read_bytes() == (tmp_path / "stopped" / "history.csv").read_bytes()

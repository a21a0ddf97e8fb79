"""Running the command line inside the test process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from matplotlib.image import imread

from granfabric.cases.commands.cli import main
from granfabric.cases.field.prepare import prepare
from granfabric.cases.scene.reader import load
from granfabric.fem.equilibrium.initial import initial_result
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.problem import Problem


class Result(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


@pytest.fixture
def granfabric(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    """Call ``granfabric(*arguments)``."""

    def call(*arguments: object) -> Result:
        monkeypatch.setattr("sys.argv", ["granfabric", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "200")
        try:
            main()
            code = 0
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else (0 if error.code is None else 1)
        captured = capsys.readouterr()
        return Result(code, captured.out, captured.err)

    return call


@pytest.fixture
def is_drawn() -> Callable[[Path], bool]:
    """Decode a PNG and tell whether it shows something: neither blank nor one colour, large enough, with colours."""

    def look(path: Path) -> bool:
        assert path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
        image = np.asarray(imread(path))[:, :, :3]
        inked = np.abs(image - image[0, 0]).max(axis=2) > 0.1
        coloured = np.ptp(image, axis=2) > 0.2
        return min(image.shape[:2]) > 300 and 0.005 < float(inked.mean()) < 0.9 and bool(coloured.any())

    return look


@pytest.fixture
def solve_scene() -> Callable[..., tuple[Problem, list[StepResult]]]:
    """Solve a shipped field scene with ``key=value`` assignments, without files; the problem and all its steps."""

    def solved(name: str, *assignments: str) -> tuple[Problem, list[StepResult]]:
        prepared = prepare(load(name, assignments))
        steps: list[StepResult] = [initial_result(prepared.problem)]
        summary = solve(prepared.problem, prepared.control, on_step=steps.append)
        assert summary.finished, summary.message
        return prepared.problem, steps

    return solved

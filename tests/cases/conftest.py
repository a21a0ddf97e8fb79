"""Running the command line inside the test process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from granfabric.cases.commands.cli import main
from granfabric.cases.field.prepare import prepare
from granfabric.cases.pictures import style as plot_style
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen
from granfabric.fem.equilibrium.initial import initial_result
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.problem import Problem


class Table(NamedTuple):
    """A printed table."""

    title: str
    names: list[str]
    rows: list[list[str]]

    def column(self, name: str) -> list[str]:
        """Cells of a column by its head."""
        return [row[self.names.index(name)] for row in self.rows]


class Told(NamedTuple):
    """What was printed."""

    tables: list[Table]
    lines: list[str]


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
def pictures(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """Pictures by file name as they are made, instead of files: what `drawn` looks into. Nothing is rendered."""
    kept: dict[str, Figure] = {}

    def keep(path: Path, write: Callable[[Path], object]) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(Figure, "savefig", lambda figure, *arguments, **options: kept.__setitem__(path.name, figure))
            write(path)

    monkeypatch.setattr(plot_style, "write_whole", keep)
    return kept


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch) -> Told:
    """Tables and lines that commands print, as they are given to the screen; they are printed all the same."""
    found = Told([], [])
    table, say = Screen.table, Screen.say

    def keep_table(self: Screen, title: str, names: Any, rows: Any, *words: Any) -> None:
        rows = [list(row) for row in rows]
        found.tables.append(Table(title, list(names), rows))
        table(self, title, names, rows, *words)

    def keep_line(self: Screen, text: str, **options: Any) -> None:
        found.lines.append(text)
        say(self, text, **options)

    monkeypatch.setattr(Screen, "table", keep_table)
    monkeypatch.setattr(Screen, "say", keep_line)
    return found


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

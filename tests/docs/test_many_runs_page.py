"""The page on many runs: its example and its commands are legal as they stand there, values are written as it says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main

from granfabric.cases.commands.cli import app
from granfabric.cases.scene.reader import load
from granfabric.cases.sweep.plan import Request, plan_of
from granfabric.cases.sweep.results import results_of
from granfabric.cases.sweep.values import values_of

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "guide" / "many_runs.md").read_text(encoding="utf-8")
COMMANDS = [line.split("#")[0].strip() for line in PAGE.splitlines() if line.startswith("granfabric sweep")]


def test_the_example_runs(tmp_path: Path) -> None:
    environment = {**os.environ, "COLUMNS": "120"}
    script = DOCS / "examples" / "many_runs.py"
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "finished 6" and float(lines[-1]) == pytest.approx(30e3)
    lost = dict(re.findall(r"'(\w+)': ([\d.]+)", lines[-2]))
    assert float(lost["mean_field"]) > float(lost["shifted_distribution"]) > 0.1


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_of_the_page_are_legal(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(DOCS / "examples" / "many_runs.csv", tmp_path / "runs.csv")
    monkeypatch.chdir(tmp_path)
    words = shlex.split(command)[2:]
    group = typer.main.get_command(app)
    given = group.commands["sweep"].make_context("sweep", words).params  # type: ignore[attr-defined]
    request = Request(given["assignments"] or [], given["table"] and Path(given["table"]), given["latin"] or [],
                      given["samples"], given["seed"])  # fmt: skip
    plan = plan_of(request)
    assert 3 <= len(plan.runs) <= 1000
    for run in plan.runs[:: max(1, len(plan.runs) // 5)]:
        results_of(given["result"] or [], load(given["scene"], run.assignments).scene.kind)


def test_values_are_written_as_the_page_says() -> None:
    rows = re.findall(r"^\| `(.+?)`(?:.*?)\| (\w+) ", PAGE, re.MULTILINE)
    numbers = {"three": 3, "seven": 7, "five": 5, "two": 2}
    assert len(rows) == 6
    for written, number in rows:
        assert len(values_of(f"key={written}")[1]) == numbers[number], written

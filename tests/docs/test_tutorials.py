"""Each tutorial and each example of the site runs as it is written, and shows what its text says."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
SCRIPTS = sorted((DOCS / "tutorials").glob("*.py"))


def output_of(script: Path, folder: Path) -> str:
    environment = {**os.environ, "MPLBACKEND": "Agg", "TMPDIR": str(folder), "COLUMNS": "120"}
    done = subprocess.run([sys.executable, str(script)], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def numbers(text: str, pattern: str) -> list[float]:
    return [float(value) for value in re.findall(pattern, text)]


def test_the_tutorials_are_the_five_that_are_promised() -> None:
    assert [script.stem[:2] for script in SCRIPTS] == ["01", "02", "03", "04", "05"]


def test_first_point(tmp_path: Path) -> None:
    text = output_of(SCRIPTS[0], tmp_path)
    (loaded, unloaded), (shifted, returned) = (
        numbers(line, r": ([\d.]+)") for line in text.splitlines() if "after unloading" in line
    )
    assert loaded == pytest.approx(3.667, abs=1e-3)  # the published figure of the mean field
    assert unloaded < loaded  # which goes on losing contacts
    assert shifted < returned < 4.06


def test_calibration_from_the_dem(tmp_path: Path) -> None:
    text = output_of(SCRIPTS[1], tmp_path)
    differences = numbers(text, r"largest difference in \w+: ([\d.]+)")
    assert len(differences) == 2 and max(differences) < 0.1
    assert numbers(text, r"coordination +([\d.]+)")[0] == pytest.approx(3.9, abs=0.15)


def test_own_mesh_to_paraview(tmp_path: Path) -> None:
    text = output_of(SCRIPTS[2], tmp_path)
    assert "result.pvd" in text and "points.pvd" in text and "mesh_error.vtu" in text
    assert "850 degrees of freedom" in text  # 2 (2 nx + 1) (2 ny + 1)


def test_own_law(tmp_path: Path) -> None:
    text = output_of(SCRIPTS[3], tmp_path)
    assert "obeys the contract: True" in text and "finished: True" in text
    assert numbers(text, r"against differences: (\S+)")[0] < 1e-8
    stresses = numbers(text, r"stress +(-[\d.]+) kPa")
    assert stresses[0] == pytest.approx(-100.0) and stresses == sorted(stresses, reverse=True)


def test_hosting_the_law(tmp_path: Path) -> None:
    text = output_of(SCRIPTS[4], tmp_path)
    assert "100000 points" in text and "failed: 0" in text
    residuals = [line.rsplit("residuals ", 1)[1].split(", ") for line in text.splitlines() if "residuals" in line]
    assert len(residuals) == 5
    for step in residuals:
        first, second, *_, last = (float(value) for value in step)
        assert last < 1e-10 and second < 1e-2 * first and len(step) <= 5  # Newton's method with the exact tangent


def test_the_example_of_the_first_page_prints_what_it_says(tmp_path: Path) -> None:
    script = DOCS / "examples" / "first_point.py"
    promised = re.search(r"# ([\d.]+)$", script.read_text(encoding="utf-8"), re.MULTILINE)
    assert promised is not None
    assert float(output_of(script, tmp_path)) == pytest.approx(float(promised.group(1)), abs=1e-4)


def test_the_example_of_fitting_prints_what_the_page_shows(tmp_path: Path) -> None:
    text = output_of(DOCS / "examples" / "fit_curve.py", tmp_path)
    page = (DOCS / "guide" / "fitting.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"It prints\n\n```text\n(.*?)```", page, re.DOTALL)
    names = re.findall(r"^(\w+) +-?[\d.]+ \+-", text, re.MULTILINE)
    assert names == re.findall(r"^(\w+) +-?[\d.]+ \+-", shown, re.MULTILINE) and len(names) == 5
    for pattern, tolerance in (
        (r"(-?[\d.]+) \+- [\d.]+\n", {"abs": 2e-2}),
        (r"\+- ([\d.]+)\n", {"rel": 0.5}),
        (r"y  +([\d.]+)\n", {"abs": 1e-3}),
    ):  # fmt: skip
        found, promised = numbers(text, pattern), numbers(shown, pattern)
        assert len(found) == len(promised) >= 3 and found == pytest.approx(promised, **tolerance)
    assert "coordination" in (tmp_path / "fitted.toml").read_text()


def test_the_scene_from_nothing_is_legal() -> None:
    from granfabric.cases.scene.reader import load

    assert load(str(DOCS / "examples" / "mine.toml")).scene.kind == "field"


def test_the_python_of_the_readme_runs(tmp_path: Path) -> None:
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    (body,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    script = tmp_path / "readme.py"
    script.write_text(body, encoding="utf-8")
    promised = re.search(r"# ([\d.]+)$", body, re.MULTILINE)
    assert promised is not None
    assert float(output_of(script, tmp_path)) == pytest.approx(float(promised.group(1)), abs=1e-4)


def test_the_python_of_the_start_page_runs(tmp_path: Path) -> None:
    text = (DOCS / "start.md").read_text(encoding="utf-8")
    body = "".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    script = tmp_path / "start.py"
    script.write_text(f"import granfabric as gf\n\n{body}", encoding="utf-8")
    said = output_of(script, tmp_path)
    assert "compression" in said and float(said.splitlines()[-1]) == pytest.approx(-149.7e3, rel=1e-3)

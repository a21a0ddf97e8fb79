"""The page on kernels: its examples run, interpreted and (slow) compiled."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "kernels.md"

CHECK = """
assert report.failed == 0, report.message
assert abs(z - 4.0 * 0.5**0.4) < 1e-7, z
lost = after[0, law.description.columns("coordination_lost")][0]
assert abs(4.0 - lost - z) < 1e-13
# the tangent is the derivative of the update
increment, direction = np.array([[3e-5, 2e-5, 1e-5]]), np.array([[0.3, 0.5, -0.2]]) * 1e-6
tangent, ends = np.zeros((1, 3, 3)), []
law.update(increment, stress, state, end, after, tangent)
for sign in (1, -1):
    other = np.empty_like(end)
    law.update(increment + sign * direction, stress, state, other, after)
    ends.append(other[0])
change = (ends[0] - ends[1]) / 2
assert np.abs(tangent[0] @ direction[0] - change).max() < 1e-5 * np.abs(change).max()
print("done")
"""


def example(name: str) -> str:
    """A marked code block of the page."""
    found = re.search(rf"<!-- example: {name} -->\n```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found[1]


def run(folder: Path, **environment: str) -> None:
    (folder / "opening.py").write_text(example("closure"), encoding="utf-8")
    (folder / "use.py").write_text(example("use") + CHECK, encoding="utf-8")
    made = {**os.environ, **environment}
    command = [sys.executable, "use.py"]
    done = subprocess.run(command, cwd=folder, env=made, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "done", done.stderr[-2000:]


def test_the_closure_of_the_page_interpreted(tmp_path: Path) -> None:
    run(tmp_path, NUMBA_DISABLE_JIT="1")


@pytest.mark.slow
def test_the_closure_of_the_page_compiled(tmp_path: Path) -> None:
    run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path))


def test_a_formula_is_a_function_of_numbers() -> None:
    """The first example, called from Python."""
    source = re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert source is not None
    names: dict = {}
    exec(compile(source[1], str(PAGE), "exec"), names)
    assert names["mobilised"](2.0, 0.3, 0.4) == 0.25 and names["mobilised"](-1.0, 1.0, 0.0) == 0.0


def test_every_file_of_the_page_exists() -> None:
    text = PAGE.read_text(encoding="utf-8")
    root = PAGE.parents[2]
    for name in re.findall(r"`((?:integration|network|lanes|sliding|cases|constitutive|tests)/[\w/]+\.py)`", text):
        assert any((root / part / name).exists() for part in ("", "constitutive")), name

"""The deliberate faults of `tests/mutants` still apply, so that they do not rot; what finds them is told there."""

from __future__ import annotations

import ast
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

HOME = Path(__file__).resolve().parent
TREE = HOME.parent


def _patches() -> ModuleType:
    spec = importlib.util.spec_from_file_location("mutant_patches", HOME / "mutants" / "patches.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


PATCHES = _patches()
FAULTS = PATCHES.all_patches()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_applies_and_stays_python(fault) -> None:
    """Each changes its file, at one place that can only be meant, into something else that can be compiled."""
    before = (TREE / fault.file).read_text(encoding="utf-8")
    after = fault.applied(before)
    assert after != before
    assert ast.dump(ast.parse(after)) != ast.dump(ast.parse(before)), "only words or spaces are changed"
    for test in fault.tests:
        assert (TREE / test.partition("::")[0]).is_file(), test


def test_the_table_of_files_is_that_of_the_patches() -> None:
    assert PATCHES.table() == {fault.name: fault.file for fault in FAULTS}
    assert len(FAULTS) > 200


def test_a_patch_that_is_elsewhere_or_ambiguous() -> None:
    """Lines that have moved are found; lines that are there twice, or not at all, are refused."""
    before, after = "a\nb\nc\nd\ne\nf\n", "a\nb\nc\nX\ne\nf\n"
    text = PATCHES.text_of("n", "some", "d is X", ("t.py", "u.py"), "f.py", before, after)
    fault = PATCHES.parsed("n", text)
    assert (fault.kind, fault.what, fault.tests, fault.file) == ("some", "d is X", ("t.py", "u.py"), "f.py")
    assert fault.applied(before) == after
    assert fault.applied("1\n2\n3\n" + before) == "1\n2\n3\n" + after
    for other in ("a\nb\nc\ne\nf\n", 2 * before[2:]):
        with pytest.raises(PATCHES.PatchError, match="places for it"):
            fault.applied(other)
    with pytest.raises(PATCHES.PatchError, match="nothing is changed"):
        PATCHES.text_of("n", "some", "nothing", (), "f.py", before, before)

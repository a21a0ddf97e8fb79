"""Try deliberate faults: which test finds each? See README.md beside this file.

    python tests/mutants/run.py [NAME ...] [--list] [--take NAME KIND WHAT TEST ...] [--refresh]
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import patches
from patches import TREE, Patch, PatchError

COPIED = ("api", "constitutive", "fem", "dem_ref", "cases", "docs", "tests", "pyproject.toml", "README.md")
FRONT = "tests/types"
"""Folder of the copy that holds the rooms as they are imported, by links: before an installed package."""
LIMIT = 900
"""Seconds after which a test run counts as one that hangs, which is noticed too."""


def try_out(patch: Patch, copy: Path, cache: Path) -> str:
    """The test that finds a fault; empty if it survives.

    Raises
    ------
    PatchError
        If the fault does not apply.
    """
    path = copy / patch.file
    before, times = path.read_text(encoding="utf-8"), path.stat()
    path.write_text(patch.applied(before), encoding="utf-8")
    settings = {"PYTHONPATH": str(copy / FRONT), "NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-rfE", "-p", "no:cacheprovider", "-o", "addopts="]
    command += ["--strict-markers", "-m", "not slow and not long"]
    try:
        for test in patch.tests:
            try:
                done = subprocess.run(
                    [*command, test], cwd=copy, env=os.environ | settings, capture_output=True, text=True, timeout=LIMIT
                )
            except subprocess.TimeoutExpired:
                return f"{test} (it does not end)"
            if done.returncode == 0:
                continue
            found = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", done.stdout, flags=re.MULTILINE)
            if found is None:
                raise PatchError(f"{patch.name}: {test} could not be run: {done.stdout[-300:]}{done.stderr[-300:]}")
            return found[1]
        return ""
    finally:
        path.write_text(before, encoding="utf-8")
        # compiled kernels of an unchanged file are good as long as it is as old as it was
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def see_that_the_copy_is_imported(copy: Path) -> None:
    """Every fault would survive if the tests ran on another tree."""
    program = "import granfabric.cases as cases; print(cases.__file__)"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=copy, env=os.environ | {"PYTHONPATH": str(copy / FRONT)},
        capture_output=True, text=True,
    )  # fmt: skip
    if copy.resolve() not in Path(done.stdout.strip()).resolve().parents:
        raise SystemExit(f"not the copy would be tried but {done.stdout.strip() or done.stderr[-300:]}")


def chosen(names: list[str]) -> list[Patch]:
    """Faults whose name contains one of the names, or whose kind is one; all without names."""
    every = patches.all_patches()
    found = [patch for patch in every if not names or any(n in patch.name or n == patch.kind for n in names)]
    if not found:
        raise SystemExit(f"no fault is called {' or '.join(names)}")
    return found


def run(names: list[str]) -> int:
    """Try the chosen faults; the exit code."""
    survivors, broken = [], []
    with tempfile.TemporaryDirectory(prefix="granfabric-mutants-") as folder:
        copy, cache = Path(folder) / "tree", Path(folder) / "cache"
        copy.mkdir()
        # kernels belong to the place of their source: those of the copy are compiled once, and go with it
        cache.mkdir()
        for name in COPIED:
            source = TREE / name
            if source.is_dir():
                ignored = shutil.ignore_patterns("__pycache__", "*.png")
                shutil.copytree(source, copy / name, symlinks=True, ignore=ignored)
            else:
                shutil.copy(source, copy / name)
        see_that_the_copy_is_imported(copy)
        for patch in chosen(names):
            since = time.perf_counter()
            try:
                finder = try_out(patch, copy, cache)
            except PatchError as error:
                broken.append(patch.name)
                print(f"{patch.name}: NOT TRIED, {error}", flush=True)
                continue
            if not finder:
                survivors.append(patch.name)
            seconds = time.perf_counter() - since
            print(f"{patch.name}: {finder or 'SURVIVES'} ({seconds:.0f} s)", flush=True)
    named = f": {', '.join(survivors)}" if survivors else ""
    print(f"{len(survivors)} survive{named}; {len(broken)} could not be tried")
    return int(bool(survivors or broken))


def listed(names: list[str]) -> int:
    """Print what there is."""
    for patch in chosen(names):
        print(f"{patch.kind:16} {patch.name}: {patch.what} ({patch.file}; {' '.join(patch.tests)})")
    return 0


def take(name: str, kind: str, what: str, *tests: str) -> int:
    """Make a patch of the difference between the working tree and what is committed, of one file."""
    changed = subprocess.run(["git", "diff", "--name-only"], cwd=TREE, capture_output=True, text=True, check=True)
    files = changed.stdout.split()
    if len(files) != 1:
        raise SystemExit(f"a fault is a change of one file, changed are {', '.join(files) or 'none'}")
    old = subprocess.run(["git", "show", f"HEAD:{files[0]}"], cwd=TREE, capture_output=True, text=True, check=True)
    after = (TREE / files[0]).read_text(encoding="utf-8")
    path = patches.HOME / f"{name}.patch"
    path.write_text(patches.text_of(name, kind, what, tests, files[0], old.stdout, after), encoding="utf-8")
    patches.write_table({**patches.table(), name: files[0]})
    print(path)
    return 0


def refresh() -> int:
    """Make every patch anew for the tree as it is, of the file that `files.tsv` names; what does not apply stays."""
    files, broken = patches.table(), 0
    for patch in patches.all_patches():
        file = files.get(patch.name, patch.file)
        try:
            before = (TREE / file).read_text(encoding="utf-8")
            text = patches.text_of(
                patch.name, patch.kind, patch.what, patch.tests, file, before, patch.applied(before)
            )  # fmt: skip
        except (OSError, PatchError) as error:
            broken += 1
            print(f"{patch.name}: {error}")
            continue
        (patches.HOME / f"{patch.name}.patch").write_text(text, encoding="utf-8")
        files[patch.name] = file
    patches.write_table({patch.name: files[patch.name] for patch in patches.all_patches()})
    return int(broken > 0)


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description="Try deliberate faults: which test finds each?")
    parser.add_argument("names", nargs="*", metavar="NAME", help="part of a name, or a kind; all if not given")
    parser.add_argument("--list", action="store_true", help="say what there is")
    parser.add_argument("--refresh", action="store_true", help="make patches anew after files have changed or moved")
    parser.add_argument("--take", nargs="+", metavar="NAME KIND WHAT TEST", help="make a patch of the working tree")
    given = parser.parse_args()
    if given.take:
        return take(*given.take)
    if given.refresh:
        return refresh()
    return listed(given.names) if given.list else run(given.names)


if __name__ == "__main__":
    sys.exit(main())

"""Small unified diffs with a head of their own: read, applied to a text, made anew. No other program is needed."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from pathlib import Path

HOME = Path(__file__).resolve().parent
TREE = HOME.parents[1]
FILES = HOME / "files.tsv"


class PatchError(ValueError):
    """A patch that cannot be read, or does not apply."""


@dataclass(frozen=True)
class Hunk:
    """Lines (without their ends) that are replaced; `start` is the place of the first in the old file, from 0."""

    start: int
    old: tuple[str, ...]
    new: tuple[str, ...]


@dataclass(frozen=True)
class Patch:
    """One fault of one file.

    Attributes
    ----------
    name, kind, what : str
    tests : tuple of str
        Test files, or tests, that should find it; the likeliest first.
    file : str
        Path from the root of the tree.
    hunks : tuple of Hunk
    """

    name: str
    kind: str
    what: str
    tests: tuple[str, ...]
    file: str
    hunks: tuple[Hunk, ...]

    def applied(self, text: str) -> str:
        """The text with the fault in it.

        Raises
        ------
        PatchError
            If the old lines of a hunk are not where they should be, nor at exactly one other place.
        """
        lines = text.split("\n")
        shift = 0
        for hunk in self.hunks:
            size = len(hunk.old)
            at = hunk.start + shift
            if tuple(lines[at : at + size]) != hunk.old:
                places = [place for place in range(len(lines)) if tuple(lines[place : place + size]) == hunk.old]
                if len(places) != 1:
                    raise PatchError(f"{self.name}: {self.file} has {len(places)} places for it")
                (at,) = places
            lines[at : at + size] = hunk.new
            shift = at - hunk.start + len(hunk.new) - size
        return "\n".join(lines)


def parsed(name: str, text: str) -> Patch:
    """A patch from the text of its file.

    Raises
    ------
    PatchError
    """
    head = dict(re.findall(r"^# (\w+): (.*)$", text, flags=re.MULTILINE))
    file = re.search(r"^\+\+\+ b/(.*)$", text, flags=re.MULTILINE)
    if file is None or not {"what", "kind", "tests"} <= set(head):
        raise PatchError(f"{name}: a patch needs # what, # kind and # tests, and names a file")
    hunks = []
    for part in re.split(r"^@@ -(\d+)(?:,\d+)? \+\d+(?:,\d+)? @@.*\n", text, flags=re.MULTILINE)[1:]:
        if part.isdecimal():
            start = int(part) - 1
            continue
        lines = part.removesuffix("\n").split("\n")
        old = tuple(line[1:] for line in lines if line[:1] in (" ", "-", ""))
        new = tuple(line[1:] for line in lines if line[:1] in (" ", "+", ""))
        hunks.append(Hunk(start, old, new))
    return Patch(name, head["kind"], head["what"], tuple(head["tests"].split()), file[1], tuple(hunks))


def all_patches() -> list[Patch]:
    """Every fault, by name."""
    return [parsed(path.stem, path.read_text(encoding="utf-8")) for path in sorted(HOME.glob("*.patch"))]


def text_of(name: str, kind: str, what: str, tests: tuple[str, ...], file: str, before: str, after: str) -> str:
    """Text of a patch file that turns one text of a file into the other."""
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), f"a/{file}", f"b/{file}", lineterm="", n=2)
    diff = "\n".join(lines)
    if not diff:
        raise PatchError(f"{name}: nothing is changed")
    return f"# what: {what}\n# kind: {kind}\n# tests: {' '.join(tests)}\n{diff}\n"


def table() -> dict[str, str]:
    """Patched file by name of the patch, as `files.tsv` says."""
    rows = (line.split("\t") for line in FILES.read_text(encoding="utf-8").splitlines())
    return {patch: file for file, patch in rows}


def write_table(files: dict[str, str]) -> None:
    """Write `files.tsv`: file and patch, sorted by both."""
    rows = sorted(f"{file}\t{patch}" for patch, file in files.items())
    FILES.write_text("\n".join(rows) + "\n", encoding="utf-8")

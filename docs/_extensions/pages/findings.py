"""The table of `findings/`, from the first lines of its scripts."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from .markdown import cell, table

FOLDER = Path(__file__).resolve().parents[3] / "findings"
README = FOLDER / "README.md"
KEYS = ("library", "version", "expected", "seen")
HEAD = ("script", "library", "version", "what one would expect", "what happens")
START, END = "<!-- table: python -m pages.findings, run in docs/_extensions -->", "<!-- end of the table -->"


def header(file: Path) -> dict[str, str]:
    """Entries ``# key: text`` of a script; a line ``#   text`` goes on with the one before.

    Raises
    ------
    ValueError
        If an entry is missing.
    """
    entries: dict[str, str] = {}
    key = ""
    for line in file.read_text(encoding="utf-8").splitlines():
        if found := re.match(r"# (\w+): (.*)$", line):
            key = found.group(1)
            entries.setdefault(key, found.group(2).strip())
        elif key and (more := re.match(r"#\s{2,}(\S.*)$", line)):
            entries[key] += f" {more.group(1).strip()}"
        else:
            key = ""
    if missing := [key for key in KEYS if not entries.get(key)]:
        raise ValueError(f"{file.name}: no line '# {missing[0]}: ...'")
    return {key: entries[key] for key in KEYS}


def listing() -> str:
    """The table as Markdown."""
    scripts = sorted(FOLDER.glob("*.sh"))
    rows = [(f"[`{file.name}`]({file.name})", *(cell(header(file)[key]) for key in KEYS)) for file in scripts]
    return table(HEAD, rows)


def renewed(text: str) -> str:
    """The README with the table of today."""
    before, rest = text.split(START)
    _, after = rest.split(END)
    return f"{before}{START}\n\n{listing()}\n\n{END}{after}"


def pages() -> dict[str, str]:
    """The README as a page of the site, its links to scripts without their targets."""
    text = renewed(README.read_text(encoding="utf-8"))
    text = re.sub(r"\[(`[\w.]+\.sh`)\]\([\w.]+\.sh\)", r"\1", text)
    return {"generated/reference/findings": text.replace(START, "").replace(END, "")}


if __name__ == "__main__":
    README.write_text(renewed(README.read_text(encoding="utf-8")), encoding="utf-8")
    sys.exit(0)

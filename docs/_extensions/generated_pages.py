"""Sphinx extension: writes the pages that come from the program, and lists where an equation stands in the code."""

from __future__ import annotations

import re
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from pages import api, catalogue, commands, equations, files, findings, glossary, scene_keys, state
from pages.docstring import tidy

SOURCES = (api, catalogue, commands, files, findings, glossary, scene_keys, state)


def write_pages(app: Sphinx) -> None:
    """Bring `docs/generated` up to date; pages that have not changed stay, so that they are not read again."""
    home = Path(app.srcdir)
    wanted = {f"{name}.md": text for source in SOURCES for name, text in source.pages().items()}
    for file in (home / "generated").rglob("*.md"):
        if file.relative_to(home).as_posix() not in wanted:
            file.unlink()
    for name, text in wanted.items():
        file = home / name
        if not file.is_file() or file.read_text(encoding="utf-8") != text:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")


def index_entries(place: str, names: list[str]) -> list:
    """A target and entries of the index that lead to it, which the search of the site ranks first."""
    entries = [("single", name, place, "main", None) for name in names]
    return [addnodes.index(entries=entries), nodes.target("", "", ids=[place])]


class EquationEntry(SphinxDirective):
    """Index entries of equations: their numbers, and a name a line."""

    required_arguments = 1
    final_argument_whitespace = True
    has_content = True

    def run(self) -> list:
        """All spellings of the numbers, and the names."""
        numbers = self.arguments[0].split()
        names = [name for number in numbers for name in equations.spellings(number)]
        return index_entries(f"equation-entry-{numbers[0]}", names + list(self.content))


class Entries(SphinxDirective):
    """Index entries of a place that is named by the argument: a name a line."""

    required_arguments = 1
    has_content = True

    def run(self) -> list:
        """The names."""
        return index_entries(self.arguments[0], list(self.content))


class EquationInCode(SphinxDirective):
    """Where an equation of the source stands in the code: its number is the argument."""

    required_arguments = 1

    def run(self) -> list:
        """Parse the list as part of the page."""
        lines = equations.listing(int(self.arguments[0])).splitlines()
        return self.parse_text_to_nodes("\n".join(["In the code:", "", *lines])) if lines else []


def tidy_docstring(app, what, name, obj, options, lines: list[str]) -> None:
    """Prepare a docstring before numpydoc reads it."""
    lines[:] = tidy(lines)


def leave_out_missing(app: Sphinx, name: str, text: list[str]) -> None:
    """A line ``NAME?`` in a table of contents stands for a page that is listed if it exists."""
    home = Path(app.srcdir)

    def chosen(found: re.Match) -> str:
        return f"{found.group(1)}\n" if (home / f"{found.group(1)}.md").is_file() else ""

    text[0] = re.sub(r"^([\w/]+)\?\n", chosen, text[0], flags=re.MULTILINE)


def setup(app: Sphinx) -> dict:
    """Register everything."""
    app.connect("builder-inited", write_pages, priority=100)
    app.connect("source-read", leave_out_missing)
    app.connect("autodoc-process-docstring", tidy_docstring, priority=100)
    app.add_directive("equation-entry", EquationEntry)
    app.add_directive("entries", Entries)
    app.add_directive("equation-in-code", EquationInCode)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

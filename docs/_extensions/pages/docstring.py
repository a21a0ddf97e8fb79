"""Docstrings of the program as reStructuredText: they are written to be read in an editor, not to be typeset."""

from __future__ import annotations

import re

_CODE = re.compile(r"(``.*?``|`[^`]*`)")
_ITEM = re.compile(r"\s*([-*]|\d+[.)]) ")


def _plain(line: str) -> str:
    """Bars are absolute values, stars and trailing underscores are themselves; `name`s may have a plural."""
    parts = _CODE.split(line)
    for place, part in enumerate(parts):
        if part.startswith("`"):
            follows = parts[place + 1] if place + 1 < len(parts) else ""
            parts[place] = part + ("\\ " if follows[:1].isalnum() else "")
        else:
            bullet = _ITEM.match(part).end() if place == 0 and _ITEM.match(part) else 0
            parts[place] = part[:bullet] + re.sub(r"(?<!\\)([|*]|_(?=\W|$))", r"\\\1", part[bullet:])
    return "".join(parts)


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


def tidy(lines: list[str]) -> list[str]:
    """Lines of a docstring with its formulas, which are indented, as literal blocks; other lines without stray markup.

    Sections (an underlined heading such as "Parameters") begin what numpydoc reads; formulas are sought before it.
    """
    out: list[str] = []
    sections = literal = doctest = False
    margin = 0  # of the prose around, or of the item of a list
    for place, line in enumerate(lines):
        following = lines[place + 1] if place + 1 < len(lines) else ""
        if following.strip() and set(following.strip()) == {"-"} and line.strip():
            sections = True
        if not line.strip():
            doctest = False
            out.append(line)
            continue
        if line.lstrip().startswith(">>>"):
            doctest = True
        if literal and _indent(line) <= margin:
            literal = False
        if literal or doctest:
            out.append(line)
            continue
        begins = not sections and out and not out[-1].strip() and _indent(line) > margin and not _ITEM.match(line)
        if begins:
            if not any(entry.rstrip().endswith("::") for entry in out[-2:]):
                out += [" " * margin + "::", ""]
            literal = True
            out.append(line)
            continue
        if set(line.strip()) <= set("=- ") and len(line.strip()) > 3:  # rules of tables and headings
            out.append(line)
            continue
        out.append(line if sections and set(following.strip()) == {"-"} else _plain(line))
        item = _ITEM.match(line)
        margin = item.end() if item else min(_indent(line), margin) if _indent(line) < margin else margin
        if line.rstrip().endswith("::"):
            literal = True
    return out

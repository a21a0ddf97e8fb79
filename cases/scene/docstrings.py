"""Meaning of the fields of a declaration, from the section "Parameters" of its docstring: written once."""

from __future__ import annotations

import re
from inspect import getdoc

_ENTRY = re.compile(r"^(\w+) : .*$")


def parameter_texts(declaration: type) -> dict[str, str]:
    """Text of each entry under "Parameters" in a numpydoc docstring, on one line; empty if there is no docstring."""
    texts: dict[str, list[str]] = {}
    inside, name = False, ""
    lines = (getdoc(declaration) or "").splitlines()
    for line, following in zip(lines, [*lines[1:], ""]):
        if following and set(following) == {"-"}:  # a heading
            inside = line.strip() == "Parameters"
        elif inside and (entry := _ENTRY.match(line)):
            name = entry.group(1)
            texts[name] = []
        elif inside and name and line.startswith("    "):
            texts[name].append(line.strip())
    return {name: " ".join(parts) for name, parts in texts.items()}

"""Errors that the command line turns into exit codes."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class InputError(ValueError):
    """Something the user gave is not legal. The text is a sentence: what, which value, what is legal. Exit code 2.

    A file with several errors gives one sentence a line.
    """


class RunError(RuntimeError):
    """A computation that was legal could not be finished for a reason outside the model, such as a full disk.

    Exit code 1.
    """


MOST_LINES = 40
"""Errors of one file that are told one by one."""
MOST_NAMES = 60
"""Legal names that are listed."""
LONGEST_NAME = 200
"""Beginning of a name that is compared with others."""


def several(texts: Iterable[str]) -> InputError:
    """All errors of an input, one a line."""
    lines = list(dict.fromkeys(texts))
    more = len(lines) - MOST_LINES
    if more > 0:
        lines = [*lines[:MOST_LINES], f"and {more} more {'error' if more == 1 else 'errors'} of this input"]
    return InputError("\n".join(lines))


def short(value: Any) -> str:
    """A value as it is shown in a sentence: never long, and on one line."""
    text = repr(value)
    if isinstance(value, bool):
        text = text.lower()
    return text if len(text) <= 60 else text[:57] + "..."


def nearest(name: str, legal: Iterable[str]) -> str | None:
    """The legal name that is spelled most like the given one; None if there are no legal names."""
    names = list(legal)
    found = get_close_matches(name[:LONGEST_NAME], names, n=1, cutoff=0.0)
    return found[0] if found else None


def unknown(what: str, name: str, legal: Iterable[str], spelled: str | None = None) -> str:
    """Sentence on an unknown name: what it is, what is legal, which legal name is nearest (to `spelled` if given)."""
    names = list(legal)
    shown = short(name)
    if not names:
        return f"{what} {shown} is unknown (there are none)"
    listed = ", ".join(names[:MOST_NAMES]) + (f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else "")
    return f"{what} {shown} is unknown (legal: {listed}); the nearest is {nearest(spelled or name, names)!r}"

"""Errors that the command line turns into exit codes."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(ValueError):
    """Something the user gave is not legal. The text is one sentence: what, which value, what is legal. Exit code 2."""


class RunError(RuntimeError):
    """A computation that was legal could not be finished for a reason outside the model, such as a full disk.

    Exit code 1.
    """


def nearest(name: str, legal: Iterable[str]) -> str | None:
    """The legal name that is spelled most like the given one; None if there are no legal names."""
    names = list(legal)
    found = get_close_matches(name, names, n=1, cutoff=0.0)
    return found[0] if found else None


def unknown(what: str, name: str, legal: Iterable[str], spelled: str | None = None) -> str:
    """Sentence on an unknown name: what it is, what is legal, which legal name is nearest (to `spelled` if given)."""
    names = list(legal)
    if not names:
        return f"{what} {name!r} is unknown (there are none)"
    return f"{what} {name!r} is unknown (legal: {', '.join(names)}); the nearest is {nearest(spelled or name, names)!r}"

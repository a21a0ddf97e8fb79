"""Kinds of files that pictures are written as; no matplotlib is needed to choose them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from granfabric.cases.errors import InputError, unknown

KNOWN: dict[str, dict[str, str | None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None},
    "svg": {"Date": None},
}
"""What is left out of each, so that the same run gives the same bytes."""
DEFAULT = ("png",)

_chosen: ContextVar[tuple[str, ...]] = ContextVar("formats", default=DEFAULT)


def parsed(text: str) -> tuple[str, ...]:
    """Formats from their names with commas between, each once.

    Raises
    ------
    InputError
        If one is not known.
    """
    names = [name.strip().lower() for name in text.split(",")]
    for name in names:
        if name not in KNOWN:
            raise InputError(f"--format {text}: {unknown('the format', name, list(KNOWN))}")
    return tuple(dict.fromkeys(names))


@contextmanager
def written_as(names: Sequence[str]) -> Iterator[None]:
    """Pictures within the block are written in these formats."""
    token = _chosen.set(tuple(names))
    try:
        yield
    finally:
        _chosen.reset(token)


def chosen() -> tuple[str, ...]:
    """The chosen formats, for another process that has to choose them too."""
    return _chosen.get()


def paths(path: Path) -> list[Path]:
    """Files of a picture in the chosen formats."""
    return [path.with_suffix(f".{name}") for name in _chosen.get()]

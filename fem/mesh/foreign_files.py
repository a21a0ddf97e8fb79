"""Files of unknown origin in the hands of a reader that believes them: its warnings, its stumbles, its memory."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from typing import Any

try:
    import resource
except ImportError:  # not on every system; reading then has no limit
    resource = None  # type: ignore[assignment]

MEMORY_PER_BYTE = 200
"""Memory that reading may take for each byte of the file: seven times the ten to thirty that it does take."""
LEAST_MEMORY = 1 << 28
"""And the least limit: libraries that are loaded meanwhile take their share."""

_CUT_SHORT = "string or file could not be read"


class ForeignFileError(ValueError):
    """A file cannot be read; the text says what the reader said."""


@contextmanager
def foreign_reader(size: int) -> Iterator[None]:
    """Read a file of that many bytes with a foreign reader within the block.

    What the reader only warns of, and any way in which it stumbles over damage, becomes one kind of error; memory is
    limited to what a file of this size can need.

    Raises
    ------
    ForeignFileError
    """
    said = io.StringIO()
    try:
        with (
            _limited_memory(max(LEAST_MEMORY, MEMORY_PER_BYTE * size)),
            redirect_stderr(said),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("error", RuntimeWarning)
            warnings.filterwarnings("error", message=_CUT_SHORT)
            yield
    except MemoryError:
        raise ForeignFileError("it names counts that a file of its size cannot hold") from None
    except (Exception, SystemExit) as error:  # whatever a parser does on damaged input, leaving the program included
        reason = str(error).strip().splitlines()
        raise ForeignFileError(reason[0][:200] if reason else type(error).__name__) from None
    if said.getvalue().strip():
        raise ForeignFileError(" ".join(said.getvalue().split())[:200])


@contextmanager
def _limited_memory(more: int) -> Iterator[None]:
    """Let the process take at most that many bytes more of address space within the block."""
    if resource is None or not (taken := _address_space()):
        yield
        return
    before: Any = resource.getrlimit(resource.RLIMIT_AS)
    limit = taken + more
    if before[0] != resource.RLIM_INFINITY:
        limit = min(limit, before[0])
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _address_space() -> int:
    """Bytes of address space of this process; 0 where that is not told."""
    try:
        with open("/proc/self/statm", "rb") as file:
            return int(file.read().split()[0]) * resource.getpagesize()
    except (OSError, ValueError):
        return 0

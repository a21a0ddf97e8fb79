"""How much memory there is, and a sentence where a scene asks for more: better than being killed halfway."""

from __future__ import annotations

from pathlib import Path

from granfabric.cases.errors import InputError

_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def installed() -> int | None:
    """Bytes of memory that this process may use; None where that is not told."""
    found = []
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemTotal:"):
                found.append(int(line.split()[1]) * 1024)
    except (OSError, ValueError, IndexError):
        pass
    for name in _LIMITS:
        try:
            found.append(int(Path(name).read_text()))
        except (OSError, ValueError):
            continue
    return min(found, default=None)


def refuse_beyond(needed: float, what: str) -> None:
    """See that about so many bytes can be had.

    Parameters
    ----------
    needed : float
        A lower estimate [byte].
    what : str
        Begins the sentence, key and value included.

    Raises
    ------
    InputError
    """
    there = installed()
    if there is not None and needed > there:
        raise InputError(
            f"{what} needs at least {needed / 1e9:.3g} GB of memory, this computer has {there / 1e9:.3g} GB"
        )

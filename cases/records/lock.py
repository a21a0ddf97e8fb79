"""One run at a time in a result folder.

A lock file says who is at work. Where the system has `flock`, that is what counts: it ends with its process, however
that ends, so that nobody has to clean up. Elsewhere the file itself counts, and a process that is gone loses it.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError

try:
    import fcntl
except ImportError:  # not on every system
    fcntl = None  # type: ignore[assignment]

NAME = ".granfabric.lock"
"""Lock file of a result folder; there only while a run is at work."""
ATTEMPTS, PAUSE = 5, 0.05
"""Somebody who only looks whether a folder is locked holds it for a moment: try again, after so many seconds."""

_kept: ContextVar[tuple[ExitStack, set[Path]] | None] = ContextVar("kept", default=None)


class HeldError(InputError):
    """Another run holds the folder."""


@contextmanager
def command() -> Iterator[None]:
    """Folders that are held within the block stay so to its end: what a command writes after its run belongs to it."""
    with ExitStack() as stack:
        token = _kept.set((stack, set()))
        try:
            yield
        finally:
            _kept.reset(token)


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold an existing folder within the block, or within the `command` around it.

    Raises
    ------
    InputError
        If another run holds it, or the lock file cannot be written.
    """
    kept = _kept.get()
    if kept is None:
        with command(), held(folder):
            yield
        return
    stack, folders = kept
    place = folder.resolve()
    if place not in folders:
        stack.enter_context(_locked(folder))
        folders.add(place)
    yield


def refuse_held(folder: Path) -> None:
    """Refuse a folder that another run holds; nothing is changed.

    Raises
    ------
    InputError
    """
    kept, path = _kept.get(), folder / NAME
    if (kept is not None and folder.resolve() in kept[1]) or not path.is_file():
        return
    try:
        with path.open("rb") as file:
            if fcntl is None or not _flocked(file.fileno(), shared=True):
                return _refuse_living(folder)
    except BlockingIOError:
        raise _refusal(folder) from None
    except OSError:  # gone meanwhile, or not ours to read: taking it will tell
        return


def _flocked(number: int, shared: bool = False) -> bool:
    """Lock an open file; False where the file system cannot.

    Raises
    ------
    BlockingIOError
        If another process holds it.
    """
    try:
        fcntl.flock(number, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    path = folder / NAME
    try:
        number = _take(folder, path)
    except OSError as error:
        raise InputError(f"the output folder {str(folder)!r} cannot be written: {error.strerror}") from error
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            path.unlink()
        os.close(number)


def _take(folder: Path, path: Path) -> int:
    """Take the lock; the descriptor of the open lock file."""
    for attempt in range(ATTEMPTS):
        if attempt:
            time.sleep(PAUSE)
        number = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if fcntl is None or not _flocked(number):
                os.close(number)
                return _take_by_existence(folder, path)
            # whoever held it may have removed the file between opening and locking
            if _is_at(number, path):
                os.ftruncate(number, 0)
                os.pwrite(number, _note(), 0)
                return number
        except BlockingIOError:
            pass
        os.close(number)
    raise _refusal(folder)


def _is_at(number: int, path: Path) -> bool:
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    here = os.fstat(number)
    return (here.st_dev, here.st_ino) == (there.st_dev, there.st_ino)


def _take_by_existence(folder: Path, path: Path) -> int:
    """Take the lock where files cannot be locked: whose process is named in the file holds it while that lives."""
    _refuse_living(folder)
    with suppress(FileNotFoundError):
        path.unlink()
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        raise _refusal(folder) from None
    os.write(number, _note())
    return number


def _note() -> bytes:
    said = {"process": os.getpid(), "host": socket.gethostname(), "since": datetime.now(UTC).isoformat("T", "seconds")}
    return (json.dumps(said) + "\n").encode()


def _read(folder: Path) -> dict[str, Any]:
    try:
        said = json.loads((folder / NAME).read_bytes())
    except (OSError, ValueError):
        return {}
    return said if isinstance(said, dict) else {}


def _refuse_living(folder: Path) -> None:
    """Refuse if the process named in the lock file lives, or is on another computer, where nobody can tell."""
    said = _read(folder)
    process = said.get("process")
    if not isinstance(process, int) or process <= 0:
        return
    if said.get("host") == socket.gethostname() and not _lives(process):
        return
    raise _refusal(folder, f"; if none is, remove {NAME} there")


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return True


def _refusal(folder: Path, more: str = "") -> HeldError:
    said = _read(folder)
    who = f" (process {said.get('process', '?')} on {said.get('host', '?')}, since {said.get('since', '?')})"
    return HeldError(
        f"another run is at work in the output folder {str(folder)!r}{who if said else ''}; wait for its end or "
        f"choose another folder with -o{more}"
    )

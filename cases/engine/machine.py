"""What a worker is: its machine, its versions, its threads."""

from __future__ import annotations

import hashlib
import os
import platform
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from granfabric.cases.errors import InputError

try:
    import fcntl
except ImportError:  # not on every system
    fcntl = None  # type: ignore[assignment]

ROOMS = ("constitutive", "fem", "dem_ref", "cases")
CHECKED = ("granfabric", "numba", "numpy", "python")
"""What has to be the same on every worker; the rest reads and writes files."""
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""What libraries read when they are loaded. OPENBLAS_NUM_THREADS is not among them: linear algebra takes one thread,
because its last bits depend on how many it has."""


def cores() -> int:
    """Processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def checked_number(option: str, value: int, most: int, why: str = "") -> int:
    """A number of an option within its bounds.

    Raises
    ------
    InputError
    """
    if not 1 <= value <= most:
        raise InputError(f"{option} {value} is outside [1, {most}]{why}")
    return value


def checked_threads(value: int) -> int:
    """The number of threads if the machine has as many cores.

    Raises
    ------
    InputError
    """
    many = "core" if cores() == 1 else "cores"
    return checked_number("--threads", value, cores(), f": this process may use {cores()} {many}")


def limit_threads(number: int) -> None:
    """Let compiled kernels take so many threads; before numba is loaded, its libraries too."""
    import sys

    for name in THREADS:
        os.environ[name] = str(number)
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(min(number, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]


@contextmanager
def threads(number: int) -> Iterator[None]:
    """So many threads for the compiled kernels within the block, as called by this thread."""
    import numba

    before = numba.get_num_threads()
    numba.set_num_threads(min(number, numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]
    try:
        yield
    finally:
        numba.set_num_threads(before)


@contextmanager
def environment(number: int) -> Iterator[None]:
    """Processes that are started within the block load their libraries with so many threads."""
    wanted = {**dict.fromkeys(THREADS, str(number)), "OPENBLAS_NUM_THREADS": "1"}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@cache
def sources() -> str:
    """Ten digits that tell the sources of this program."""
    content = hashlib.sha256()
    home = Path(__file__).resolve().parents[1]
    for room in ROOMS:
        folder = _folder(room, home)
        for file in sorted(folder.rglob("*.py")):
            content.update(f"{room}/{file.relative_to(folder).as_posix()}".encode())
            content.update(file.read_bytes())
    return content.hexdigest()[:10]


def _folder(room: str, cases: Path) -> Path:
    if room == "cases":
        return cases
    from importlib.util import find_spec

    found = find_spec(f"granfabric.{room}")
    assert found is not None and found.submodule_search_locations
    return Path(next(iter(found.submodule_search_locations)))


def versions() -> dict[str, str]:
    """What is in use here, of `CHECKED`, and the processor that kernels are compiled for."""
    from llvmlite.binding import get_host_cpu_name

    found = {"python": platform.python_version()}
    for package in CHECKED[:-1]:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    found["granfabric"] += f" (sources {sources()})"
    return {**{name: found[name] for name in CHECKED}, "processor": get_host_cpu_name()}


def differences(here: dict[str, str], there: dict[str, str]) -> list[str]:
    """Versions of a worker that are not those of this process."""
    return [
        f"{name} {there.get(name, 'unknown')} instead of {here[name]}"
        for name in CHECKED
        if there.get(name) != here[name]
    ]


@contextmanager
def alone_on_machine(name: str, wait: bool = True) -> Iterator[bool]:
    """One process of a user on this machine at a time within the block, where the system can tell.

    Parameters
    ----------
    name : str
        Of what only one may do.
    wait : bool
        For whoever is at it; if not, the block is told False when somebody is.
    """
    if fcntl is None:
        yield True
        return
    user = os.getuid() if hasattr(os, "getuid") else 0
    path = Path(tempfile.gettempdir()) / f"granfabric-{user}-{name}.lock"
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError:  # somebody else's, or a full disk: then everybody compiles
        yield True
        return
    try:
        mine = True
        try:
            fcntl.flock(number, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            mine = False
        except OSError:  # a file system without locks
            pass
        yield mine
    finally:
        os.close(number)

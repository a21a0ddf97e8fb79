"""Compiled kernels of the DEM, kept in a disk cache named by a hash of this package's sources.

Numba looks only at the file that defines a function when it decides whether stored machine code is still good; an
edit in another file that is compiled into it goes unnoticed. A folder per state of the sources cannot go stale.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

MEASURING = "inputs"
"""Room that looks at packings and at small probes of copies, and decides about no motion but theirs."""


@cache
def sources_mark(motion_only: bool = False) -> str:
    """Hash of the present sources of this package, or of those that decide how disks move along a path.

    What was loaded is good as long as the second is the same; what was measured needs the first.
    """
    room = Path(__file__).resolve().parent
    content = hashlib.sha256(f"{numba.__version__} {sys.version_info[:3]}".encode())
    for source in sorted(room.rglob("*.py")):
        if motion_only and source.relative_to(room).parts[0] == MEASURING:
            continue
        content.update(source.name.encode())
        content.update(source.read_bytes())
    return content.hexdigest()[:16]


@cache
def kernel_cache_directory() -> Path:
    """Folder of the machine code that belongs to the present sources of this package."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        root = Path(chosen)
    elif base := os.environ.get("XDG_CACHE_HOME"):
        root = Path(base) / "granfabric"
    else:
        root = Path.home() / ".cache" / "granfabric"
    return root / "dem" / sources_mark()


def compiled(**options: Any) -> Callable[[Callable], Any]:
    """Decorator: `numba.njit` with NumPy's division rules, without the interpreter lock, cached on disk.

    Only the decoration sees the cache folder; other packages of the process keep their own. Kernels for several threads
    have one of their own: stored code is found by the name of the function, not by how it was compiled.
    """
    settings: dict[str, Any] = {"cache": True, "error_model": "numpy", "nogil": True, **options}

    def decorate(function: Callable) -> Any:
        previous = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        folder = kernel_cache_directory() / ("several_threads" if options.get("parallel") else "")
        numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
        try:
            return numba.njit(**settings)(function)
        finally:
            numba.config.CACHE_DIR = previous  # type: ignore[attr-defined]

    return decorate

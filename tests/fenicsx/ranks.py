"""Starting programs on several ranks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

FOLDER = Path(sys.executable).parent


def environment() -> dict[str, str]:
    # Open MPI asks before it lets root run, or more ranks than cores
    allowed = ("OMPI_ALLOW_RUN_AS_ROOT", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "OMPI_MCA_rmaps_base_oversubscribe")
    return {**os.environ, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **dict.fromkeys(allowed, "1")}


def command(ranks: int, *arguments: str) -> list[str]:
    """A command on several ranks; its first argument is a program of the environment or a Python file."""
    first = [str(FOLDER / arguments[0])] if not arguments[0].endswith(".py") else [sys.executable, arguments[0]]
    launcher = FOLDER / "mpiexec"
    return [str(launcher) if launcher.exists() else "mpiexec", "-n", str(ranks), *first, *arguments[1:]]


def on_ranks(ranks: int, *arguments: str, timeout: float = 240.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(ranks, *arguments), capture_output=True, text=True, timeout=timeout, env=environment(), check=False
    )

"""Importing FEniCSx, which is there or is not.

On PyPI its solvers come as `dolfinx-solver-real`, whose module has to be imported first because it tells the loader
where MPI and PETSc are; a distribution's package needs nothing of the kind.
"""

from __future__ import annotations

import importlib
from contextlib import suppress
from types import ModuleType
from typing import Any

OLDEST = (0, 5)
NEW = (0, 9)
"""From here on spaces and expressions are made as today; `dialect` knows both ways."""


class EngineError(ImportError):
    """FEniCSx cannot be used; the text says why and what to install."""


def dolfinx() -> ModuleType:
    """The module `dolfinx`, with what is used here imported.

    Raises
    ------
    EngineError
    """
    with suppress(ImportError):  # from another source than PyPI
        importlib.import_module("dolfinx_solver")
    try:
        module = importlib.import_module("dolfinx")
        for part in ("fem", "mesh", "fem.petsc"):
            importlib.import_module(f"dolfinx.{part}")
    except ImportError as error:
        raise EngineError(
            f"the host 'fenicsx' needs FEniCSx ({error}); with Python 3.12 or later: pip install "
            '"granfabric[fenicsx]"'
        ) from error
    if _version(module) < OLDEST:
        raise EngineError(
            f"the host 'fenicsx' needs dolfinx {OLDEST[0]}.{OLDEST[1]} or later, this is {module.__version__}"
        )
    return module


def _version(module: ModuleType) -> tuple[int, ...]:
    return tuple(int(part) for part in str(getattr(module, "__version__", "0.0")).split(".")[:2])


def is_new() -> bool:
    """Whether this FEniCSx names things as today."""
    return _version(dolfinx()) >= NEW


def world() -> Any:
    """All ranks, `mpi4py.MPI.COMM_WORLD`.

    Raises
    ------
    EngineError
    """
    dolfinx()
    return importlib.import_module("mpi4py.MPI").COMM_WORLD


def versions() -> dict[str, str]:
    """Versions of what computes here."""
    found = {"dolfinx": dolfinx().__version__}
    found["petsc4py"] = importlib.import_module("petsc4py").__version__
    library = importlib.import_module("mpi4py.MPI").Get_library_version()
    found["mpi"] = " ".join(library.split("\n")[0].split())[:60].rstrip("\0 ")
    return found

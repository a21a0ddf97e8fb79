"""Compiled kernels whose disk cache can be trusted.

Numba decides whether a cached machine code is fresh by looking only at the file that defines the function; an
edit in a *helper's* file goes unnoticed. Here the cache folder is named by a hash of every source file of the
package that asks, so that any edit leads to a fresh folder and an unchanged package always starts from the cache.
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
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import PassManager
from numba.core.typed_passes import (
    NativeLowering,
    NoPythonBackend,
    NopythonTypeInference,
    PreLowerStripPhis,
)
from numba.core.untyped_passes import (
    DeadBranchPrune,
    FixupArgs,
    GenericRewrites,
    IRProcessing,
    ReconstructSSA,
    RewriteSemanticConstants,
    TranslateByteCode,
)
from numba.extending import register_jitable


class _WithoutEnvironment:
    """A code generator for what will not be executed by itself."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, environment: Any) -> None:
        """There is no place for one."""


class _FormulaLibrary(JITCodeLibrary):
    """What a formula is compiled to: code to be linked into kernels, optimised and made executable only there."""

    @property
    def codegen(self) -> Any:
        return _WithoutEnvironment(self._codegen)

    def _optimize_functions(self, module: Any) -> None:
        pass

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _FormulaCompiler(CompilerBase):
    """The few steps that plain functions of numbers need, with a library of that kind."""

    def define_pipelines(self) -> Any:
        codegen = self.state.targetctx.codegen()
        self.state.library = _FormulaLibrary(codegen, self.state.func_id.func_qualname)
        steps = PassManager("formula")
        steps.add_pass(TranslateByteCode, "analyse bytecode")
        steps.add_pass(FixupArgs, "arguments")
        steps.add_pass(IRProcessing, "intermediate code")
        steps.add_pass(RewriteSemanticConstants, "constants")
        steps.add_pass(DeadBranchPrune, "branches that are never taken")
        steps.add_pass(GenericRewrites, "entries of tuples")
        steps.add_pass(ReconstructSSA, "a name for each value")
        steps.add_pass(NopythonTypeInference, "types")
        steps.add_pass(PreLowerStripPhis, "values at joints")
        # nothing is deleted on the way: there are numbers only, and a deletion of a tuple would clear its memory
        steps.add_pass(NativeLowering, "machine-independent code")
        steps.add_pass(NoPythonBackend, "result")
        steps.finalize()
        return [steps]


FORMULA_OPTIONS: dict[str, Any] = {
    "pipeline_class": _FormulaCompiler,
    "no_cfunc_wrapper": True,
    "forceinline": True,
    "fastmath": {"contract"},
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    # arrays are not counted as objects each time they are passed on: whoever calls keeps them
    "_nrt": False,
}


def formula(function: Callable) -> Any:
    """Decorator of a plain function of numbers: compiled into the kernels that call it, interpreted elsewhere.

    Its body is that of a scalar function without arrays and exceptions. In a kernel it works on single numbers or on
    eight at a time (`lanes.eight`), for which its source is compiled anew. A product that is added to something may be
    rounded once instead of twice (``contract``), in every lane alike; nothing else of IEEE arithmetic is given up.
    """
    return register_jitable(**FORMULA_OPTIONS)(function)


def _cache_root() -> Path:
    """Folder under which all cache folders lie; an existing `NUMBA_CACHE_DIR` is respected."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"])
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "granfabric"


@cache
def cache_directory(*packages: str) -> Path:
    """Cache folder for kernels that use the sources of the named packages.

    Parameters
    ----------
    packages : str
        Import names of top-level packages, for instance ``"constitutive"``.
    """
    digest = hashlib.sha256(f"{numba.__version__} {sys.version_info[:3]}".encode())
    for package in packages:
        folder = Path(__file__).resolve().parent.parent / package
        for source in sorted(folder.rglob("*.py")):
            digest.update(source.name.encode())
            digest.update(source.read_bytes())
    return _cache_root() / "kernels" / digest.hexdigest()[:16]


def compiled(packages: tuple[str, ...] = ("constitutive",), **options: Any) -> Callable[[Callable], Any]:
    """Decorator: `numba.njit` with NumPy division rules and a disk cache keyed by the packages' sources.

    Only the decoration itself sees the cache folder, so that other packages of the process keep their own.
    """
    settings: dict[str, Any] = {"cache": True, "error_model": "numpy", **options}

    def decorate(function: Callable) -> Any:
        before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = str(cache_directory(*packages))  # type: ignore[attr-defined]
        try:
            return numba.njit(**settings)(function)
        finally:
            numba.config.CACHE_DIR = before  # type: ignore[attr-defined]

    return decorate

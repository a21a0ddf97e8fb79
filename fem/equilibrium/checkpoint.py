"""Checkpoints: everything on which the rest of a run depends, in files that are whole or are not there.

A checkpoint holds the accepted step and what the solvers remember beyond it (last converged tangent, predictor, force
scale, the matrix of the kept factor), so that a run goes on with the same bits. The format is NumPy's `.npz` without
compression and without pickled objects; its checksums and index tell a damaged file from a whole one.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from granfabric.fem.linear_solvers.tangent import FactorMemory
from granfabric.fem.vectors import Array

from .results import StageStart, StepResult
from .stored_arrays import read_stored_arrays

FORMAT = 2
KEPT = 2
"""Checkpoints kept on disk: should the last be damaged, the one before it still serves."""

_NAME = re.compile(r"checkpoint_(\d+)\.npz")
_DAMAGED = (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)
"""What a file of arrays raises that is no checkpoint, or a damaged one."""


class CheckpointError(ValueError):
    """A checkpoint cannot be used; the text names the file and the reason."""


@dataclass(frozen=True)
class SolverMemory:
    """What solvers remember beyond the accepted step.

    Parameters
    ----------
    tangent : ndarray, shape (npt, 3, 3)
        Last converged tangent [Pa]; empty if it is to be asked of the law again.
    last_correction : ndarray, shape (nfree,), optional
        Displacement increment of the step, start of the next predictor [m].
    last_increment : float
        Fraction of the stage that it belongs to.
    force_scale : float
        [N/m].
    factor : FactorMemory
    counters : dict of str to int
    seconds : dict of str to float
        Of the run so far, see `fem.accounting.Accounting`.
    """

    tangent: Array
    last_correction: Array | None
    last_increment: float
    force_scale: float
    factor: FactorMemory
    counters: dict[str, int]
    seconds: dict[str, float]

    @property
    def has_tangent(self) -> bool:
        """Whether the tangent is remembered."""
        return bool(len(self.tangent))


@dataclass(frozen=True)
class Checkpoint:
    """An accepted step and what solvers remember.

    `granfabric.fem.equilibrium.stepping.solve` goes on from it with the same bits.
    """

    result: StepResult
    memory: SolverMemory

    def copied(self) -> Checkpoint:
        """The same with arrays of its own where they are the solver's."""

        def own(values: Any) -> dict[str, Any]:
            arrays = {entry.name: getattr(values, entry.name) for entry in fields(values)}
            return {name: array.copy() for name, array in arrays.items() if isinstance(array, np.ndarray)}

        factor = replace(self.memory.factor, **own(self.memory.factor))
        return Checkpoint(self.result, replace(self.memory, factor=factor, **own(self.memory)))


_PARTS = {"result": StepResult, "stage_start": StageStart, "memory": SolverMemory, "factor": FactorMemory}


_KINDS = {"int": (int,), "float": (float, int), "str": (str,), "bool": (bool,), "Array": (np.ndarray,)}
"""What a plain value may be, by its annotation."""


def _flat(checkpoint: Checkpoint) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and plain values under names like `result.stress`."""
    parts = {
        "result": checkpoint.result,
        "stage_start": checkpoint.result.stage_start,
        "memory": checkpoint.memory,
        "factor": checkpoint.memory.factor,
    }
    arrays, plain = {}, {}
    for part, holder in parts.items():
        for entry in fields(_PARTS[part]):
            value = getattr(holder, entry.name)
            if isinstance(value, np.ndarray):
                arrays[f"{part}.{entry.name}"] = value
            elif not isinstance(value, (StageStart, FactorMemory)):
                plain[f"{part}.{entry.name}"] = value
    return arrays, plain


def _built(arrays: dict[str, np.ndarray], plain: dict[str, Any]) -> Checkpoint:
    both = {**plain, **arrays}

    def values(part: str, *left_out: str) -> dict[str, Any]:
        found = {}
        for entry in fields(_PARTS[part]):
            if entry.name not in left_out:
                found[entry.name] = value = both[f"{part}.{entry.name}"]
                kinds = _KINDS.get(str(entry.type))
                if kinds is not None and type(value) not in kinds:
                    raise TypeError(f"{part}.{entry.name} is {value!r}")
        return found

    result = values("result", "stage_start")
    result["residuals"] = tuple(result["residuals"])
    result["reactions"] = {name: (x, y) for name, (x, y) in result["reactions"].items()}
    result["springs"] = {name: (x, y) for name, (x, y) in result["springs"].items()}
    result["rigid"] = {name: tuple(numbers) for name, numbers in result["rigid"].items()}
    start = StageStart(**values("stage_start"))
    memory = SolverMemory(**values("memory", "factor"), factor=FactorMemory(**values("factor")))
    return Checkpoint(StepResult(**result, stage_start=start), memory)


class CheckpointFolder:
    """The checkpoints of one run, `checkpoint_STEP.npz`.

    Parameters
    ----------
    folder : Path
    identity : str
        Tells the input of the run; a checkpoint of another input is refused.
    """

    def __init__(self, folder: Path, identity: str) -> None:
        self._folder = folder
        self._identity = identity

    def files(self) -> list[Path]:
        """Checkpoints on disk, oldest first."""
        found = {}
        for file in self._folder.glob("checkpoint_*.npz"):
            if match := _NAME.fullmatch(file.name):
                found[int(match[1])] = file
        return [found[step] for step in sorted(found)]

    def save(self, checkpoint: Checkpoint) -> None:
        """Write a checkpoint and remove all but the last two.

        Raises
        ------
        OSError
        """
        arrays, plain = _flat(checkpoint)
        text = json.dumps({"format": FORMAT, "identity": self._identity, "plain": plain})
        file = self._folder / f"checkpoint_{checkpoint.result.step:06d}.npz"
        hidden = self._folder / f".{file.name}"
        with hidden.open("wb") as stream:
            np.savez(stream, text=np.frombuffer(text.encode(), dtype=np.uint8), **arrays)  # type: ignore[arg-type]
            stream.flush()
            # A name that survives a power failure before its content does would look like a whole file.
            os.fsync(stream.fileno())
        os.replace(hidden, file)
        for old in self.files()[:-KEPT]:
            old.unlink()

    def load(self) -> tuple[Checkpoint | None, list[str]]:
        """The last whole checkpoint, None if there is no file at all, and a sentence for each damaged one.

        Raises
        ------
        CheckpointError
            If there are files but none can be used.
        """
        damages: list[str] = []
        for file in reversed(self.files()):
            try:
                return self.read(file), damages
            except CheckpointError as error:
                damages.append(str(error))
        if damages:
            raise CheckpointError("; ".join(damages))
        return None, []

    def read(self, file: Path) -> Checkpoint:
        """One checkpoint, checked.

        Raises
        ------
        CheckpointError
            If it is damaged, of another format, or of another input.
        """
        try:
            arrays = read_stored_arrays(file)
            head = json.loads(arrays.pop("text").tobytes().decode())
            version, identity = head["format"], head["identity"]
            checkpoint = _built(arrays, head["plain"]) if version == FORMAT else None
        except _DAMAGED as error:
            raise CheckpointError(f"{file.name} is damaged ({str(error) or type(error).__name__})") from None
        if checkpoint is None:
            raise CheckpointError(f"{file.name} has the format {version!r}; this version reads {FORMAT}")
        if identity != self._identity:
            raise CheckpointError(f"{file.name} belongs to a run with another input")
        for name, array in arrays.items():
            if array.dtype == np.float64 and not np.isfinite(array).all():
                raise CheckpointError(f"{file.name} is damaged ({name} holds a value that is not finite)")
        return checkpoint

    def remove(self) -> None:
        """Remove all checkpoints: the run is finished."""
        for file in self.files():
            file.unlink()

"""`probe_NAME.csv`: values at places over the steps, a row for each step and place; appended to, never rewritten."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError
from granfabric.constitutive.contract import LawDescription
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult
from granfabric.fem.output.places import Places
from granfabric.fem.output.recovery import Recovery

from . import files

Array = NDArray[np.float64]

LEADING = (("step", "-"), ("stage", "-"), ("fraction", "-"), ("place", "-"), ("distance", "m"), ("x", "m"), ("y", "m"))


def file_name(probe: str) -> str:
    """File of a probe."""
    return f"probe_{probe}.csv"


def headed(name: str, unit: str) -> str:
    """Head of a column: its name with its unit in brackets."""
    return f"{name} [{unit}]"


class ProbeFile:
    """The file of one probe.

    Parameters
    ----------
    folder : Path
    name : str
    places : ndarray, shape (n, 2)
        [m].
    space : Space
    description : LawDescription
    recovery : Recovery
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        places: Array,
        space: Space,
        description: LawDescription,
        recovery: Recovery,
    ) -> None:
        self.path = folder / file_name(name)
        self._places = places
        self._distance = np.linalg.norm(places - places[0], axis=1)
        self._description = description
        self.take_up(space, recovery)
        self._heads = [headed(*column) for column in (*LEADING, *self._values.columns)]

    def take_up(self, space: Space, recovery: Recovery) -> None:
        """Find the places in a space; those outside of it have no values from now on."""
        self._values = Places(space, self._description, recovery, self._places)

    def begin(self) -> None:
        """A file without rows."""
        files.write_text(self.path, files.csv_text(self._heads, []))

    def go_on(self, steps: Sequence[int]) -> None:
        """Keep the rows of these steps, the last of which is that to go on from.

        Raises
        ------
        InputError
            If the file does not hold them.
        """
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"cannot go on: {self.path} cannot be used ({error})") from error
        head, rows = files.csv_text(self._heads, []), lines[1:]
        each = len(self._places)
        wanted = [str(step) for step in steps for _ in range(each)]
        kept = rows[: len(wanted)]
        right = all(row.split(",", 1)[0] == step and row.endswith("\n") for row, step in zip(kept, wanted))
        if lines[:1] != [head] or len(kept) < len(wanted) or not right:
            raise InputError(f"cannot go on: {self.path} does not hold the steps {steps[0]} to {steps[-1]}")
        files.write_text(self.path, "".join([head, *kept]))

    def add(self, step: StepResult) -> None:
        """Rows of a step, all or none.

        Raises
        ------
        OSError
        """
        table = self._values.values(step)
        leading = [step.step, step.stage, float(step.fraction)]
        rows = []
        for place, (values, at, distance) in enumerate(zip(table, self._places, self._distance)):
            numbers = [float(distance), float(at[0]), float(at[1]), *map(float, values)]
            rows.append([*leading, place, *("" if np.isnan(number) else number for number in numbers)])
        text = files.csv_text(self._heads, rows).partition("\n")[2].encode()
        with self.path.open("r+b", buffering=0) as file:
            size = file.seek(0, os.SEEK_END)
            try:
                written = file.write(text)
                while written < len(text):  # an error follows if there is no room for the rest
                    written += file.write(text[written:])
            except OSError:
                file.truncate(size)
                raise

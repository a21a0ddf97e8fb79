"""The numbers of one section of a `.msh` file, one after the other, from text or from bytes."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.mesh.checks import MeshError

from .sections import MshFile

IntArray = NDArray[np.int64]
Array = NDArray[np.float64]

_EXACT = 2.0**53
"""Whole numbers up to here are exact as a double; no file has as many nodes."""


class Numbers:
    """Takes numbers from a section; never more than it holds, whatever the counts in the file say.

    Parameters
    ----------
    file : MshFile
    section : str
        Name of the section.
    """

    def __init__(self, file: MshFile, section: str) -> None:
        self._section, self._binary = section, file.binary
        self._data, self._place = file.sections[section], 0
        self._kinds = {"int": f"{file.order}i4", "size": f"{file.order}u{file.size}", "double": f"{file.order}f8"}
        self._values = np.empty(0) if file.binary else _numbers_of_text(self._data, section)

    @property
    def left(self) -> bool:
        """Whether there is anything left but a line's end."""
        if self._binary:
            return bool(self._data[self._place :].strip())
        return self._place < len(self._values)

    @property
    def count_left(self) -> int:
        """How many numbers of a text are left."""
        return len(self._values) - self._place

    def ints(self, count: int = 1) -> IntArray:
        """The next whole numbers, four bytes each where they are bytes."""
        return self._whole(self._next("int", count))

    def sizes(self, count: int = 1) -> IntArray:
        """The next counts or numbers of nodes and elements."""
        return self._whole(self._next("size", count))

    def size(self) -> int:
        """The next count, not negative."""
        return self._natural(int(self.sizes()[0]))

    def doubles(self, count: int) -> Array:
        """The next numbers."""
        return np.asarray(self._next("double", count), dtype=np.float64)

    def counted_line(self) -> int:
        """The count that files of version 2 write as a line of text before their bytes."""
        if not self._binary:
            return self._natural(int(self.ints()[0]))
        line, _, _ = self._data[self._place :].partition(b"\n")
        self._place += len(line) + 1
        text = line.strip()
        if not text.isdigit() or len(text) > 15:
            raise self.error("does not begin with a count")
        return int(text)

    def records(self, count: int, ints: int, doubles: int) -> tuple[IntArray, Array]:
        """The next rows of a table, shapes (count, ints) and (count, doubles): each some whole numbers, then others."""
        if not self._binary:
            rows = self._next("double", count * (ints + doubles)).reshape(count, ints + doubles)
            return self._whole(rows[:, :ints]), rows[:, ints:]
        kind = np.dtype([("whole", self._kinds["int"], (ints,)), ("other", self._kinds["double"], (doubles,))])
        rows = self._bytes(kind, count)
        return self._whole(rows["whole"]), np.asarray(rows["other"], dtype=np.float64)

    def rest(self) -> list[int]:
        """All numbers that are left in a text, which have to be whole."""
        return self._whole(self._next("double", self.count_left)).tolist()

    def error(self, what: str) -> MeshError:
        """Sentence about this section."""
        return MeshError(f"its section ${self._section} {what}")

    def _next(self, kind: str, count: int) -> NDArray[Any]:
        if self._binary:
            return self._bytes(np.dtype(self._kinds[kind]), count)
        if count > self.count_left:
            raise self.error("is shorter than its counts say")
        self._place += count
        return self._values[self._place - count : self._place]

    def _bytes(self, kind: np.dtype, count: int) -> NDArray[Any]:
        if count * kind.itemsize > len(self._data) - self._place:
            raise self.error("is shorter than its counts say")
        taken = np.frombuffer(self._data, dtype=kind, count=count, offset=self._place)
        self._place += count * kind.itemsize
        return taken

    def _whole(self, values: NDArray) -> IntArray:
        if values.dtype.kind == "f" and not ((values == np.floor(values)) & (np.abs(values) <= _EXACT)).all():
            raise self.error("holds a number that is not whole where it has to be")
        if values.dtype.kind == "u" and values.size and values.max() > _EXACT:
            raise self.error("holds a number beyond all bounds")
        return values.astype(np.int64)

    def _natural(self, count: int) -> int:
        if count < 0:
            raise self.error(f"holds the count {count}")
        return count


def _numbers_of_text(data: bytes, section: str) -> Array:
    if not data.strip():
        return np.empty(0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # NumPy stops at the first word that is no number, and only warns
            return np.fromstring(data.decode("ascii"), sep=" ")
    except (ValueError, DeprecationWarning):
        raise MeshError(f"its section ${section} holds something that is not a number") from None

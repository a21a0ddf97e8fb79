"""Rows of arrays between rank 0, which knows them all, and the ranks that own some of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Exchange:
    """Hands out and collects rows.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    rows : ndarray of int
        Numbers, on rank 0, of the rows that this rank owns, in its own order. Together they are all rows, each once.

    Attributes
    ----------
    total : int
        Rows of all ranks.
    bytes_moved : int
        Sent or received by this rank so far.
    """

    def __init__(self, comm: Any, rows: NDArray[np.int64]) -> None:
        self._comm = comm
        self._own = len(rows)
        self._counts = comm.allgather(len(rows))
        self.total = int(sum(self._counts))
        gathered = comm.gather(np.asarray(rows, dtype=np.int64), root=0)
        self._order = np.concatenate(gathered) if gathered is not None else None
        complete = self._order is None or np.array_equal(np.sort(self._order), np.arange(self.total))
        if not comm.bcast(complete, root=0):
            raise RuntimeError("the parts of the ranks do not make up the whole")
        self.bytes_moved = 0

    def owners(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rank of each row, and its number there; called on rank 0."""
        assert self._order is not None
        rank, number = np.empty(self.total, dtype=np.int64), np.empty(self.total, dtype=np.int64)
        rank[self._order] = np.repeat(np.arange(len(self._counts)), self._counts)
        number[self._order] = np.concatenate([np.arange(count) for count in self._counts])
        return rank, number

    def scatter(self, whole: Array | None, columns: tuple[int, ...] = ()) -> Array:
        """This rank's rows of an array that rank 0 has.

        Parameters
        ----------
        whole : ndarray, shape (total, *columns), on rank 0
        columns : tuple of int
            The same on all ranks.

        Returns
        -------
        ndarray, shape (own rows, *columns)
        """
        own = np.empty((self._own, *columns))
        width = int(np.prod(columns, dtype=np.int64))
        send = None
        if self._order is not None:
            assert whole is not None
            send = np.ascontiguousarray(np.asarray(whole, dtype=np.float64).reshape(self.total, *columns)[self._order])
        self._comm.Scatterv([send, self._widths(width)] if send is not None else None, own, root=0)
        self.bytes_moved += own.nbytes
        return own

    def gather(self, own: NDArray[Any]) -> NDArray[Any] | None:
        """All rows on rank 0, in its order; None on the others.

        Parameters
        ----------
        own : ndarray of float or int8, shape (own rows, ...)
        """
        own = np.ascontiguousarray(own, dtype=np.int8 if own.dtype == np.int8 else np.float64)
        columns = own.shape[1:]
        width = int(np.prod(columns, dtype=np.int64))
        received = np.empty((self.total, *columns), dtype=own.dtype) if self._order is not None else None
        self._comm.Gatherv(own, [received, self._widths(width)] if received is not None else None, root=0)
        self.bytes_moved += own.nbytes
        if received is None:
            return None
        assert self._order is not None
        whole = np.empty_like(received)
        whole[self._order] = received
        return whole

    def _widths(self, width: int) -> list[int]:
        return [count * width for count in self._counts]

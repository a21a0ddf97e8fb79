"""What a worker holds: the packings of its points, as rows of the state, known by tickets.

A ticket is two whole numbers: the home, which is the point for which a packing was made, and a digest of all strain
increments since. The same increment from the same packing has the same ticket, wherever and however often it is asked
for, and a worker keeps the packings that a call began and ended with.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import Array, Status, TangentKind
from granfabric.dem_ref.sample.disks import Sample

from .drive import Pace
from .law import MEASURES, GrainsLaw

Ticket = tuple[int, int]
Tickets = NDArray[np.int64]
"""Home and digest of each, shape (n, 2)."""
DIGEST_BYTES = 6
"""Whole numbers of so many bytes are exact in a column of the state."""


class Answer(NamedTuple):
    """What points answer to a strain increment; nothing of their packings but what is measured on them.

    Attributes
    ----------
    change : ndarray, shape (n, 3)
        Of the stress, zero for a point that failed [Pa].
    measured : ndarray, shape (n, MEASURES)
        The shown columns of the state.
    tangent : ndarray, shape (n, 3, 3); or (0, 3, 3) if not wanted
    status : ndarray of int8, shape (n,)
    steps : ndarray of int64, shape (n,)
        Of the motion, also of points that failed.
    """

    change: Array
    measured: Array
    tangent: Array
    status: NDArray[np.int8]
    steps: NDArray[np.int64]


class Missing(NamedTuple):
    """Packings that the worker does not hold: their places in the question."""

    places: NDArray[np.int64]


def listed(tickets: Tickets) -> list[Ticket]:
    """Tickets as keys."""
    return [(int(home), int(digest)) for home, digest in tickets]


def after(tickets: Tickets, increments: Array, status: NDArray[np.int8]) -> Tickets:
    """Tickets of the packings that points end with: where nothing is strained, or it failed, those that they had."""
    found = tickets.copy()
    for point in np.flatnonzero((status <= Status.LIMITED) & increments.any(axis=1)):
        content = int(tickets[point, 1]).to_bytes(8, "little") + increments[point].tobytes()
        found[point, 1] = int.from_bytes(hashlib.blake2b(content, digest_size=DIGEST_BYTES).digest(), "little")
    return found


class Block:
    """Packings of some points, as a worker holds them.

    Parameters
    ----------
    packings : sequence of Sample
        As which points may begin.
    pace : Pace
    secant : bool
    lost_pressure : float, optional
    threads : int
        Points at work side by side.
    """

    def __init__(
        self, packings: Sequence[Sample], pace: Pace, secant: bool, lost_pressure: float | None, threads: int
    ) -> None:
        self._law = GrainsLaw(packings, pace, secant, threads, lost_pressure)
        self._rows: dict[Ticket, Array] = {}
        self._of_home: dict[int, set[Ticket]] = {}

    def _keep(self, tickets: Tickets, rows: Array) -> None:
        for ticket, row in zip(listed(tickets), rows, strict=True):
            self._rows[ticket] = row
            self._of_home.setdefault(ticket[0], set()).add(ticket)

    def hold(self, tickets: Tickets, rows: Array, report: Callable[[float], None], stop: Callable[[], bool]) -> None:
        """Take packings over, rows of the shape (n, nstate)."""
        self._keep(tickets, np.array(rows))

    def rows(self, tickets: Tickets, report: Callable[[float], None], stop: Callable[[], bool]) -> Array | Missing:
        """Packings, shape (n, nstate)."""
        return self._found(tickets)

    def _found(self, tickets: Tickets) -> Array | Missing:
        keys = listed(tickets)
        missing = [place for place, ticket in enumerate(keys) if ticket not in self._rows]
        if missing:
            return Missing(np.array(missing))
        return np.array([self._rows[ticket] for ticket in keys])

    def advance(
        self,
        tickets: Tickets,
        increments: Array,
        wanted: bool,
        kind: TangentKind,
        report: Callable[[float], None],
        stop: Callable[[], bool],
    ) -> Answer | Missing | None:
        """Strain points; packings that they neither begin nor end with are forgotten.

        Parameters
        ----------
        tickets : ndarray of int64, shape (n, 2)
            Of the packings to begin with.
        increments : ndarray, shape (n, 3)
        wanted : bool
            Whether to give the tangent.
        kind : {"propagated", "continuum", "elastic"}
        report, stop : callable

        Returns
        -------
        Answer, Missing or None
            None if it was left because somebody asked to stop.
        """
        start = self._found(tickets)
        if isinstance(start, Missing):
            return start
        none, change, end = np.zeros((len(start), 3)), np.empty((len(start), 3)), np.empty_like(start)
        tangent = np.empty((len(start), 3, 3)) if wanted else None
        self._law.on_points = lambda done, total: report(done / total)
        self._law.stop = stop
        try:
            status = self._law.update(increments, none, start, change, end, tangent, kind).status
        except KeyboardInterrupt:
            return None
        steps = self._law.steps_of_last
        ends = after(tickets, increments, status)
        self._forget(tickets, ends)
        self._keep(ends, end)
        found = np.empty((0, 3, 3)) if tangent is None else tangent
        return Answer(change, end[:, :MEASURES].copy(), found, status, steps)

    def _forget(self, starts: Tickets, ends: Tickets) -> None:
        used = {*listed(starts), *listed(ends)}
        for home in {ticket[0] for ticket in used}:
            known = self._of_home[home]
            for ticket in known - used:
                del self._rows[ticket]
            known &= used

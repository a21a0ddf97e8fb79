"""Grains at the points of a scene, held by workers: strains go out, stresses and tangents come back.

The packings stay where they are strained. The state that the host sees holds what is measured on a packing and its
ticket (`block`); packings come here once a load step, when the step has been accepted, so that a worker that is lost
costs nothing but time: another one begins with the packings of the last step, and is asked again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import RunError
from granfabric.constitutive.arrays import ArrayError, update_arrays
from granfabric.constitutive.contract import Array, LawDescription, Status, TangentKind, UpdateReport, Variable
from granfabric.dem_ref.sample.disks import Sample

from .block import Answer, Missing, Ticket, Tickets, after, listed
from .failures import GrainsReport
from .law import MEASURED, MEASURES, GrainsLaw, Work

ATTEMPTS = 5
"""Times in a row that workers may be lost over one call before it is given up."""
TICKET = Variable("packing", "which packing, of those that workers hold", components=2, hidden=True)
DESCRIPTION = LawDescription("grains", (*MEASURED, TICKET), ())
BLOCK = "granfabric.cases.grains.block:Block"
"""What makes the part of a worker, from `GrainsLaw.recipe` and a number of threads."""

Questions = Mapping[int, tuple[str, tuple[Any, ...]]]
Fractions = Callable[[Mapping[int, float]], None]


class Crew(Protocol):
    """Workers that hold a `Block` each; see `granfabric.cases.engine.parts.Crew`."""

    workers: int

    def ask(self, questions: Questions, advance: Fractions, stop: Callable[[], bool]) -> dict[int, Any]:
        """Answers of those asked; of those that are lost none."""
        ...

    def renew(self, place: int, stop: Callable[[], bool]) -> None:
        """Have the block of a worker that was lost made anew, without packings."""
        ...


class SpreadGrainsLaw(GrainsLaw):
    """`GrainsLaw` whose points are shared out to workers, point i to worker i modulo their number: the same bits.

    Parameters
    ----------
    law : GrainsLaw
        Of whose recipe the blocks of the crew are.
    crew : Crew

    Raises
    ------
    RunError
        In a call, if workers are lost again and again.
    """

    def __init__(self, law: GrainsLaw, crew: Crew) -> None:
        packings, pace, secant, lost = law.recipe
        super().__init__(packings, pace, secant, 1, lost, law.under)
        self._crew = crew
        self._homes = 0
        self._initial: dict[int, Array] = {}
        self._kept: dict[int, dict[int, Array]] = {}
        self._seen = np.empty((0, 2), dtype=np.int64)
        self._sent: set[int] = set()
        self._last: dict[int, tuple[Tickets, Array, Tickets]] = {}

    @property
    def description(self) -> LawDescription:
        """The law as data: its hidden columns are tickets."""
        return DESCRIPTION

    def initial_state(self, stress: Array, material_index: NDArray[np.int32] | None = None) -> Array:
        """As `GrainsLaw.initial_state`, with tickets."""
        return self.adopted(super().initial_state(stress, material_index))

    def begin(self, rows: Array) -> Array:
        """Take the packings that points begin with over, shape (npt, nstate of `GrainsLaw`).

        Returns
        -------
        ndarray, shape (npt, nstate)
            With tickets, which serve for as long as the law does.
        """
        state = self.adopted(rows)
        homes = [home for home in state[:, MEASURES].astype(int).tolist() if home]
        self._initial.update({home: self._kept.pop(home)[0] for home in homes})
        return state

    def adopted(self, rows: Array) -> Array:
        """Take packings over, shape (npt, nstate of `GrainsLaw`); rows of zeros are points without one.

        Returns
        -------
        ndarray, shape (npt, nstate)
            With tickets, which serve until they are no longer those of any point.
        """
        state = np.zeros((len(rows), DESCRIPTION.nstate))
        state[:, :MEASURES] = rows[:, :MEASURES]
        for point in np.flatnonzero(rows[:, MEASURES + 1] > 0.0):
            self._homes += 1
            state[point, MEASURES] = self._homes
            self._kept[self._homes] = {0: rows[point]}
        return state

    def expanded(self, state: Array) -> Array:
        """The state with all packings, shape (npt, nstate of `GrainsLaw`), as a checkpoint holds it."""
        tickets = _tickets(state)
        there = np.flatnonzero(tickets[:, 0])
        self._secure(tickets[there])
        found = np.zeros((len(state), self._description.nstate))
        for point, ticket in zip(there, listed(tickets[there])):
            row = self._row(ticket)
            assert row is not None
            found[point] = row
        return found

    def packing(self, row: Array) -> Sample:
        """See `GrainsLaw.packing`."""
        return super().packing(self.expanded(row[None, :])[0])

    def lost_pressure(self, row: Array) -> float:
        """See `GrainsLaw.lost_pressure`."""
        return super().lost_pressure(self.expanded(row[None, :])[0])

    def _row(self, ticket: Ticket) -> Array | None:
        """A packing, if it is here."""
        home, digest = ticket
        found = self._kept.get(home, {}).get(digest)
        return self._initial.get(home) if found is None and digest == 0 else found

    def update(
        self,
        strain_increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        tangent: Array | None = None,
        tangent_kind: TangentKind = "propagated",
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """As `GrainsLaw.update`, to the same bits."""
        arrays = update_arrays(
            (DESCRIPTION.nstate, 1), strain_increment, stress_start, state_start, stress_end, state_end, tangent,
            tangent_kind, material_index,
        )  # fmt: skip
        npoints, wanted = len(arrays.increment), tangent is not None
        tickets = _tickets(arrays.state_start)
        self._begin_from(tickets)
        shares = self._shares(tickets)
        sound: NDArray[np.bool_] = np.asarray(np.isfinite(arrays.stress_start).all(axis=1))
        # workers do without the stress, and a point without a sound one is not strained
        increment = arrays.increment if sound.all() else np.where(sound[:, None], arrays.increment, np.nan)
        questions = {
            place: ("advance", (tickets[points], increment[points], wanted, tangent_kind))
            for place, points in shares.items()
        }
        told = self.on_points or (lambda done, total: None)
        if self.stop is not None and self.stop():
            raise KeyboardInterrupt

        def advance(fractions: Mapping[int, float]) -> None:
            told(round(sum(fractions.get(place, 0.0) * len(points) for place, points in shares.items())), npoints)

        answers = self._asked(questions, advance)
        status, steps = np.zeros(npoints, dtype=np.int8), np.zeros(npoints, dtype=np.int64)
        arrays.stress_end[:], arrays.state_end[:] = arrays.stress_start, arrays.state_start
        for place, points in shares.items():
            answer: Answer = answers[place]
            status[points], steps[points] = answer.status, answer.steps
            if wanted:
                arrays.tangent[points] = answer.tangent
            moved = (answer.status <= Status.LIMITED) & increment[points].any(axis=1)
            there = points[moved]
            arrays.stress_end[there] = arrays.stress_start[there] + answer.change[moved]
            arrays.state_end[there, :MEASURES] = answer.measured[moved]
            ends = after(tickets[points], increment[points], answer.status)
            arrays.state_end[there, MEASURES:] = ends[moved]
            self._last[place] = (tickets[points], increment[points], ends)
        self.work = Work(self.work.steps + int(steps.sum()), self.work.calls + 1)
        ones = np.ones(npoints, dtype=np.int32)
        failed = bool((status > Status.LIMITED).any())
        return GrainsReport(status, ones, np.zeros_like(ones), 0.5 if failed else 1.0)

    def _shares(self, tickets: Tickets) -> dict[int, NDArray[np.int64]]:
        """Points of each worker that has any, by its place."""
        if not (tickets[:, 0] > 0).all():
            raise ArrayError("state_start holds points without a packing")
        place = (tickets[:, 0] - 1) % self._crew.workers
        return {int(one): np.flatnonzero(place == one) for one in np.unique(place)}

    def _asked(self, questions: Questions, advance: Fractions | None = None) -> dict[int, Any]:
        """Answers of all blocks that are asked, whose first argument are tickets, whatever becomes of the workers.

        Raises
        ------
        KeyboardInterrupt
            If it was left because somebody asked to stop.
        RunError
        """
        stop = self.stop or (lambda: False)
        answers: dict[int, Any] = {}
        losses = 0
        while len(answers) < len(questions):
            left = {place: question for place, question in questions.items() if place not in answers}
            found = self._crew.ask(left, _beside(dict.fromkeys(answers, 1.0), advance or _nothing), stop)
            if stop() and (len(found) < len(left) or any(answer is None for answer in found.values())):
                raise KeyboardInterrupt
            missing = {
                place: left[place][1][0][answer.places]
                for place, answer in found.items()
                if isinstance(answer, Missing)
            }
            if missing:
                self._provide(missing)
            answers.update({place: answer for place, answer in found.items() if place not in missing})
            lost = left.keys() - found.keys()
            losses += bool(lost)
            if losses >= ATTEMPTS:
                raise RunError(f"workers are lost again and again, {losses} times in one call of the law")
            for place in sorted(lost):
                self._crew.renew(place, stop)
        return answers

    def _provide(self, wanted: Mapping[int, Tickets]) -> None:
        """Give workers packings that they do not hold; those of a step that are not here yet are strained again.

        Raises
        ------
        ArrayError
            If they are those of no step that can be known.
        """
        held: dict[int, tuple[str, tuple[Any, ...]]] = {}
        again: dict[int, tuple[str, tuple[Any, ...]]] = {}
        for place, tickets in wanted.items():
            rows = [self._row(ticket) for ticket in listed(tickets)]
            here = np.array([row is not None for row in rows])
            if here.any():
                held[place] = ("hold", (tickets[here], np.array([row for row in rows if row is not None])))
            if not here.all():
                before, increments, ends = self._last[place]
                if not set(listed(tickets[~here])) <= set(listed(ends)):
                    raise ArrayError("state_start holds packings that were given up, not those of the last call")
                again[place] = ("advance", (before, increments, False, "propagated"))
        if held:
            self._crew.ask(held, _nothing, lambda: False)
        if again:
            self._asked(again)

    def _begin_from(self, tickets: Tickets) -> None:
        """Have the packings here that points begin with, so that no worker is needed for them; those before may go."""
        if np.array_equal(tickets, self._seen):
            return
        self._secure(tickets)
        for home, digest in listed(tickets):
            known = self._kept.get(home, {})
            if len(known) > 1:
                self._kept[home] = {digest: known[digest]} if digest in known else {}
        new = np.array([home not in self._sent for home in tickets[:, 0].tolist()])
        if new.any():
            self._sent.update(tickets[new, 0].tolist())
            self._provide({place: tickets[new][points] for place, points in self._shares(tickets[new]).items()})
        self._seen = tickets

    def _secure(self, tickets: Tickets) -> None:
        """Bring those packings here that are not."""
        new = [place for place, ticket in enumerate(listed(tickets)) if self._row(ticket) is None]
        if not new:
            return
        wanted = tickets[new]
        shares = self._shares(wanted)
        rows = self._asked({place: ("rows", (wanted[points],)) for place, points in shares.items()})
        for place, points in shares.items():
            for (home, digest), row in zip(listed(wanted[points]), rows[place], strict=True):
                self._kept.setdefault(home, {})[digest] = row


def _beside(done: Mapping[int, float], advance: Fractions) -> Fractions:
    """Tell of those that are asked together with those that have answered."""
    return lambda now: advance({**done, **now})


def _nothing(fractions: Mapping[int, float]) -> None:
    """Nobody is told."""


def _tickets(state: Array) -> Tickets:
    return state[:, MEASURES:].astype(np.int64)

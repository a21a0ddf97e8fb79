"""Parts that are held by workers of Dask, as its actors: what they are asked does not pass the scheduler."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from granfabric.cases.errors import InputError, RunError
from granfabric.cases.terminal.screen import Screen

from . import cluster_worker as remote
from .cluster import Cluster, connected
from .jobs import Ended, Stop
from .parts import Fractions, Part, Question

POLL_SECONDS = 0.1
LOOK_SECONDS = 1.0
"""Between two looks at which workers there are."""
PATIENCE = 60.0
"""Seconds to wait for a worker that holds nothing yet, before one gets a second part."""
MAKE_SECONDS = 600.0
"""In which a part has to be there: kernels may have to be compiled."""


@contextmanager
def crew(address: str, screen: Screen, stop: Stop, part: Part, most: int, threads: int = 1) -> Iterator[ClusterCrew]:
    """Parts held by the workers of a scheduler, one each, but not more than `most`.

    Raises
    ------
    InputError
        As `cluster.connected`.
    RunError
        If nobody comes, or a worker is lost while its part is made.
    """
    with connected(address, None, screen, stop, threads) as cluster:
        made = ClusterCrew(cluster, part, most)
        try:
            made.begin(stop)
            yield made
        finally:
            made.end()


class ClusterCrew:
    """See `crew`."""

    def __init__(self, cluster: Cluster, part: Part, most: int) -> None:
        self._cluster, self._client, self._part = cluster, cluster.client, part
        self._client.direct_to_workers = True
        self._terms = cluster.terms
        self._names = sorted(self._client.nthreads())[:most]
        self.workers = len(self._names)
        many = "worker" if self.workers == 1 else "workers"
        self.text = f"{self.workers} {many} at {cluster.address}"
        self._parts: dict[int, tuple[str, Any, Any]] = {}
        self._fractions: dict[int, float] = {}
        self._topic = f"granfabric-{self._terms.session}"
        self._made = 0
        self._asked = False

    def begin(self, stop: Stop) -> None:
        """Have all parts made."""
        if not self.workers:
            raise RunError(f"there are no workers at {self._cluster.address}")
        self._client.subscribe_topic(self._topic, self._note)
        self._make(dict(enumerate(self._names)), stop)

    def end(self) -> None:
        """Let the workers forget their parts."""
        with suppress(Exception):
            self._client.unsubscribe_topic(self._topic)
        with suppress(Exception):
            self._client.cancel([future for _, future, _ in self._parts.values()], force=True)

    def _note(self, event: tuple[float, Any]) -> None:
        place, fraction = event[1]
        self._fractions[place] = fraction

    def _make(self, where: Mapping[int, str], stop: Stop) -> None:
        """Make parts at workers.

        Raises
        ------
        RunError
            If a worker does not fit, or is lost meanwhile.
        """
        futures = {}
        for place, worker in where.items():
            self._made += 1
            futures[place] = self._client.submit(
                remote.HeldPart, place, self._terms, actor=True, workers=[worker],
                allow_other_workers=False, key=f"granfabric-{self._terms.session}-part-{self._made}",
            )  # fmt: skip
        since = time.monotonic()
        for place, future in futures.items():
            while True:
                with self._client.as_current():
                    try:
                        self._parts[place] = (where[place], future, future.result(timeout=POLL_SECONDS))
                        break
                    except TimeoutError:
                        pass
                    except Exception as error:
                        raise RunError(f"worker {where[place]} cannot take part: {error}") from error
                if stop():
                    raise KeyboardInterrupt
                gone = where[place] not in self._there()
                if gone or time.monotonic() - since > MAKE_SECONDS:
                    raise RunError(f"worker {where[place]} was lost while it was begun")
        with self._client.as_current():
            made = self._answers({place: self._parts[place][2].make(self._part) for place in where}, stop)
        for place in where.keys() - made.keys():
            raise RunError(f"worker {where[place]} was lost while its part was made")

    def ask(self, questions: Mapping[int, Question], advance: Fractions, stop: Stop) -> dict[int, Any]:
        """See `Crew`."""
        self._fractions = dict.fromkeys(questions, 0.0)
        waiting = {}
        for place, (method, arguments) in questions.items():
            with self._client.as_current(), suppress(RuntimeError, OSError):  # a worker that is lost already
                waiting[place] = self._parts[place][2].ask(method, arguments)
        return self._answers(waiting, stop, advance)

    def _answers(
        self, waiting: dict[int, Any], stop: Stop, advance: Fractions = lambda fractions: None
    ) -> dict[int, Any]:
        """What comes of calls of parts, by their place; of those whose worker is lost nothing."""
        found, looked = dict[int, Any](), time.monotonic()
        while waiting:
            if stop() and not self._asked:
                self._asked = True
                with suppress(Exception):
                    self._client.run(remote.stopping(self._terms), on_error="ignore")
            if time.monotonic() - looked > LOOK_SECONDS:
                looked = time.monotonic()
                there = self._there()
                waiting = {place: answer for place, answer in waiting.items() if self._parts[place][0] in there}
            for number, (place, answer) in enumerate(list(waiting.items())):
                if number and not answer.done():  # the first one is waited for
                    continue
                try:
                    ended: Ended = answer.result(timeout=POLL_SECONDS)
                except TimeoutError:
                    continue
                except (OSError, RuntimeError, KeyError):  # its worker is gone, or another one at the same address
                    del waiting[place]
                    continue
                del waiting[place]
                if ended.error is not None:
                    raise ended.error
                found[place], self._fractions[place] = ended.value, 1.0
            advance(dict(self._fractions))
        return found

    def _there(self) -> set[str]:
        """Addresses of the workers.

        Raises
        ------
        RunError
            If the scheduler is gone.
        """
        try:
            if self._client.status not in ("running", "connecting"):
                raise OSError("the connection is closed")
            return set(self._client.nthreads())
        except Exception as error:
            raise RunError(f"the scheduler at {self._cluster.address} is gone ({error}); --resume goes on") from error

    def renew(self, place: int, stop: Stop) -> None:
        """See `Crew`. A worker that holds nothing is preferred, and waited for; dead workers are often begun anew."""
        lost, future, _ = self._parts.pop(place)
        with suppress(Exception):
            self._client.cancel([future], force=True)
        since = time.monotonic()
        while True:
            if stop():
                raise KeyboardInterrupt
            there = self._there() - {lost}
            busy = [worker for worker, *_ in self._parts.values()]
            free = sorted(there - set(busy))
            late = time.monotonic() - since > PATIENCE
            chosen = free[:1] or (sorted(there, key=busy.count)[:1] if late else [])
            if chosen:
                break
            time.sleep(POLL_SECONDS)
        try:
            self._cluster.check()
        except InputError as error:
            raise RunError(f"a worker that came later is not fit: {error}; --resume goes on") from error
        self._make({place: chosen[0]}, stop)

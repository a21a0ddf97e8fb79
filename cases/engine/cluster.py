"""Jobs on a cluster that somebody runs: the scheduler and the workers of Dask, reached by an address."""

from __future__ import annotations

import logging
import queue
import time
import uuid
import warnings
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from granfabric.cases.errors import InputError, RunError, short
from granfabric.cases.terminal.screen import Screen

from . import cluster_worker as remote
from . import machine
from .jobs import Advance, Ended, Follow, Job, Stop, WorkerLost

CONNECT_SECONDS = 15
POLL_SECONDS = 0.1
LOOK_SECONDS = 10.0
"""Between two looks at whether there are workers and a scheduler."""
GATHER_SECONDS = 10.0
"""To bring what a job returned, which is small."""
REPORTS_A_SECOND = 100
"""Progress that all workers together tell, a tenth of what the scheduler can pass on."""
GROUP = "granfabric"
"""All keys begin with it, and go on with a word that begins with a digit. The scheduler then knows jobs for a group and
keeps them until a worker is free; of keys without anything in common it gives all to workers at once, and what waits
at a worker goes down with it."""
SHOWN = 4
"""Workers that are named in a sentence."""


@contextmanager
def connected(address: str, folder: Path | None, screen: Screen, stop: Stop, threads: int = 1) -> Iterator[Cluster]:
    """A cluster whose workers are fit for jobs that keep their results in a folder.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://host:8786``.
    folder : Path or None
        Existing; every worker has to see it at the same path. None if they need none.
    screen : Screen
    stop : callable
        Asked while there are no workers yet.
    threads : int
        For the compiled kernels of a job.

    Raises
    ------
    InputError
        If Dask is not installed, no scheduler answers, or a worker is not fit.
    """
    session = f"0{uuid.uuid4().hex[:12]}"
    token = None if folder is None else folder.resolve() / f".granfabric-{session}"
    with _client(address) as client:
        try:
            if token is not None:
                token.write_text(session)
            seen = "" if token is None else str(token)
            cluster = Cluster(client, address, remote.Terms(session, seen, machine.versions(), threads), screen)
            cluster.wait_for_workers(stop)
            cluster.check()
            yield cluster
        finally:
            if token is not None:
                with suppress(OSError):
                    token.unlink()


def examine(address: str) -> None:
    """See that a scheduler answers and that the workers of the moment are fit, before anything is written.

    Raises
    ------
    InputError
        As `connected`; whether workers see the folder is looked at later.
    """
    with _client(address) as client:
        Cluster(client, address, remote.Terms("0", "", machine.versions(), 1), Screen(quiet=True)).check()


@contextmanager
def _client(address: str) -> Iterator[Any]:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "--scheduler needs the packages dask and distributed: pip install 'granfabric[scale]'"
        ) from None
    for name in [*logging.root.manager.loggerDict, "distributed"]:  # what matters of it is told in sentences
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of versions, which are compared below
        try:
            client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"--scheduler {short(address)}: no scheduler of Dask answers there ({_first_line(error)}); an address "
                "is of the form tcp://HOST:8786"
            ) from error
    try:
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=5)


def _first_line(error: BaseException) -> str:
    return str(error).strip().split("\n")[0][:200] or type(error).__name__


class Cluster:
    """Workers of Dask; see `connected`.

    The scheduler gives what a lost worker had to another one, and after several losses gives it up: all that was
    waiting at that worker, not only what was at work. A job that was given up is therefore done once more, alone, at
    the end.
    """

    def __init__(self, client: Any, address: str, terms: remote.Terms, screen: Screen) -> None:
        self.client, self.address, self.terms, self._screen = client, address, terms, screen
        self.workers = 0
        self.text = ""

    def wait_for_workers(self, stop: Stop) -> None:
        """Wait for the first worker; more may come at any time."""
        said = False
        while not self.client.nthreads() and not stop():
            if not said:
                self._screen.say(f"waiting for workers at {self.address} (Ctrl-C stops)")
                said = True
            time.sleep(0.5)
        self.workers = len(self.client.nthreads())
        many = "worker" if self.workers == 1 else "workers"
        self.text = f"{self.workers} {many} at {self.address}"
        self.terms = replace(self.terms, report_seconds=max(1.0, self.workers / REPORTS_A_SECOND))

    def check(self) -> None:
        """See that all workers are fit: one job at a time, the same versions, the folder in sight.

        Raises
        ------
        InputError
            What is wrong, and with whom.
        """
        found = self.client.run(remote.examination(self.terms), on_error="return")
        wrong: dict[str, list[str]] = {}
        processors: dict[str, int] = {}
        for worker, said in found.items():
            text = said["refusal"] if isinstance(said, dict) else f"it does not answer: {_first_line(said)}"
            if text:
                wrong.setdefault(text, []).append(worker)
            elif isinstance(said, dict):
                processors[said["processor"]] = processors.get(said["processor"], 0) + 1
        if wrong:
            raise InputError("\n".join(f"--scheduler: {_named(workers)}: {text}" for text, workers in wrong.items()))
        if len(processors) > 1:
            kinds = ", ".join(f"{count} of {name}" for name, count in sorted(processors.items()))
            self._screen.say(f"warning: workers have different processors ({kinds}): last digits may differ with them")

    def carry_out(self, first: Iterable[Job], follow: Follow, advance: Advance, stop: Stop) -> None:
        """See `Engine`."""
        client, ended = self.client, queue.SimpleQueue[Any]()
        pending: dict[str, tuple[Job, Any]] = {}
        working: dict[str, float] = {}
        suspects, tried = deque[Job](), set[str]()
        rank = 0

        def submit(jobs: Iterable[Job]) -> None:
            for job in jobs:
                key = f"{GROUP}-{self.terms.session}-{job.key}{'-alone' if job.key in tried else ''}"
                future = client.submit(remote.perform, job, key, self.terms, key=key, pure=False, priority=rank)
                pending[key] = (job, future)
                future.add_done_callback(lambda done, key=key: ended.put(key))

        def note(event: tuple[float, Any]) -> None:
            key, fraction = event[1]
            if key in pending:
                working[key] = fraction

        topic = f"granfabric-{self.terms.session}"
        client.subscribe_topic(topic, note)
        asked, looked = False, time.monotonic()
        try:
            submit(first)
            while pending or (suspects and not asked):
                if stop() and not asked:
                    asked = True
                    self._ask_to_stop(pending)
                if not pending and suspects and not asked:
                    tried.add(suspects[0].key)
                    submit([suspects.popleft()])
                with suppress(queue.Empty):
                    key = ended.get(timeout=POLL_SECONDS)
                    working.pop(key, None)
                    job, future = pending.get(key, (None, None))
                    if job is not None and future is not None:
                        if future.cancelled():
                            self._look()
                            del pending[key]
                            continue
                        came = self._came(job, future)
                        if came is None:  # gone with its worker: the scheduler has it done again
                            future.add_done_callback(lambda done, key=key: ended.put(key))
                        else:
                            del pending[key]
                            if isinstance(came.error, WorkerLost) and job.key not in tried:
                                suspects.append(job)  # or only waited beside the one that ends workers
                                continue
                            more = list(follow(job, came))
                            rank += 1  # before what was handed over earlier
                            if not asked:
                                submit(more)
                    continue
                advance({pending[key][0].text: value for key, value in list(working.items()) if key in pending})
                if time.monotonic() - looked > LOOK_SECONDS:
                    looked = time.monotonic()
                    self._look()
        finally:
            with suppress(Exception):
                client.unsubscribe_topic(topic)
            if pending:
                with suppress(Exception):
                    client.cancel([future for _, future in pending.values()], force=True)

    def _came(self, job: Job, future: Any) -> Ended | None:
        """What came of a job; None if that is not known after all."""
        from distributed.scheduler import KilledWorker

        if future.status == "finished":
            try:
                return future.result(timeout=GATHER_SECONDS)
            except TimeoutError:
                return None
            except Exception as caught:
                error: Any = caught
        elif future.status == "error":
            error = future.exception()
        else:
            return None
        if isinstance(error, KilledWorker):
            return Ended(error=WorkerLost(f"{job.text}: every worker that was at work on it ended by itself"))
        if isinstance(error, remote.UnfitError | ImportError):
            raise RunError(f"a worker that came later is not fit: {error}; what has finished is kept")
        return Ended(error=error if isinstance(error, Exception) else RuntimeError(repr(error)))

    def _ask_to_stop(self, pending: dict[str, tuple[Job, Any]]) -> None:
        """Take back what has not begun, ask what is at work."""
        with suppress(Exception):
            begun = {str(key) for keys in self.client.processing().values() for key in keys}
            waiting = [key for key in pending if key not in begun]
            self.client.cancel([pending[key][1] for key in waiting])
            for key in waiting:
                del pending[key]
            self.client.run(remote.stopping(self.terms), on_error="ignore")

    def _look(self) -> None:
        """Say that there is nobody left to work; give up if the scheduler is gone.

        Raises
        ------
        RunError
        """
        try:
            if self.client.status not in ("running", "connecting"):
                raise OSError("the connection is closed")
            workers = len(self.client.nthreads())
        except Exception as error:
            raise RunError(
                f"the scheduler at {self.address} is gone ({_first_line(error)}); what has finished is kept"
            ) from error
        if workers == 0 and self.workers:
            self._screen.say(f"warning: no workers are left at {self.address}; waiting for others (Ctrl-C stops)")
        self.workers = workers


def _named(workers: list[str]) -> str:
    more = f" and {len(workers) - SHOWN} more" if len(workers) > SHOWN else ""
    return f"{'worker' if len(workers) == 1 else 'workers'} {', '.join(workers[:SHOWN])}{more}"

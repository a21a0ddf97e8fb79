"""Where the time of a run goes, and how often what is done."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields

PHASES = ("setup", "law", "assembly", "state", "boundary", "factorise", "solve", "output")


@dataclass
class Accounting:
    """Counters and wall-clock seconds by phase.

    Parameters
    ----------
    clock : callable, optional
        Seconds; one that stands still while kernels are compiled gives times that do not depend on their cache.

    Attributes
    ----------
    seconds : dict of str to float
        Phases: ``setup`` (patterns, first tangent), ``law``, ``assembly`` (internal forces, tangent matrix), ``state``
        (strains, commits, copies), ``boundary`` (loads, prescribed values), ``factorise``, ``solve`` (Krylov iterations
        with their triangular solves and tangent actions), ``output`` (callbacks).
    steps, cuts : int
        Accepted load steps and abandoned attempts.
    newton_iterations : int
        Corrections by a linear solve, predictors included.
    law_calls, matrix_assemblies, factorisations, lu_fallbacks, linear_solves, krylov_iterations, line_searches : int
    """

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(PHASES, 0.0))
    steps: int = 0
    cuts: int = 0
    newton_iterations: int = 0
    law_calls: int = 0
    matrix_assemblies: int = 0
    factorisations: int = 0
    lu_fallbacks: int = 0
    linear_solves: int = 0
    krylov_iterations: int = 0
    line_searches: int = 0
    clock: Callable[[], float] = time.perf_counter

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Add the time spent inside to the named phase. Phases must not be nested."""
        start = self.clock()
        try:
            yield
        finally:
            self.seconds[name] += self.clock() - start

    def counters(self) -> dict[str, int]:
        """All counts by name."""
        names = [entry.name for entry in fields(self) if entry.name not in ("seconds", "clock")]
        return {name: getattr(self, name) for name in names}

    def continue_from(self, counters: dict[str, int], seconds: dict[str, float]) -> None:
        """Go on counting from an earlier part of the run; time already spent in this part is added."""
        for name in self.counters():
            setattr(self, name, counters[name])
        for name in self.seconds:
            self.seconds[name] += seconds[name]

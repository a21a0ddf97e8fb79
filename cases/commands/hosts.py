"""Which host computes: `granfabric run --host`."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from granfabric.cases.errors import InputError

if TYPE_CHECKING:
    from granfabric.cases.records.field_recorder import FieldRecorder
    from granfabric.cases.scene.schema import FieldOutput
    from granfabric.fem.equilibrium.results import RunSummary
    from granfabric.fem.fenicsx.team import Team

HostName = Literal["own", "fenicsx"]
HostOption = Annotated[
    HostName,
    typer.Option(
        "--host", metavar="NAME", help="Who computes: own, or fenicsx, on many ranks by mpiexec -n N granfabric run ..."
    ),
]

RANKS = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "PMIX_SIZE")
"""What a launcher of MPI tells its processes; by a scheduler too, which does so for a single process as well."""


def _team() -> Team:
    from granfabric.fem.fenicsx.engine import EngineError
    from granfabric.fem.fenicsx.team import Team

    try:
        return Team()
    except EngineError as error:
        raise InputError(str(error)) from error


def assists(host: HostName) -> bool:
    """Whether this process is a rank that assists; then it has done so when the call returns.

    Raises
    ------
    InputError
        If the host is not installed, or one that computes in one process was started as several.
    """
    if host == "own":
        ranks = max(int(value) if (value := os.environ.get(name, "")).isdigit() else 1 for name in RANKS)
        if ranks > 1:
            raise InputError(f"--host: the own host computes in one process, not on {ranks} ranks; try --host fenicsx")
        return False
    team = _team()
    if team.leads:
        return False
    # launchers hand Ctrl-C to every rank; rank 0 answers it for all
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    team.assist()
    return True


@contextmanager
def leading(host: HostName) -> Iterator[Team | None]:
    """The ranks that compute, led by this process; None if the own host does."""
    if host == "own":
        yield None
        return
    with _team() as team:
        yield team


def check(team: Team | None, loaded: Any, problem: Any) -> None:
    """Refuse what the chosen host cannot do, before anything is computed or written.

    Raises
    ------
    InputError
    """
    if team is None:
        return
    from granfabric.cases.scene.schema_law_kind import is_grains

    if is_grains(loaded.scene):
        raise loaded.error(["law", "kind"], "law.kind = 'grains' runs on the own host only; leave out --host")
    from granfabric.fem.fenicsx.distribution import DistributionError, check_space

    solver = loaded.scene.solver.linear_solver
    if solver != "auto":
        raise loaded.error(
            ["solver", "linear_solver"],
            f"solver.linear_solver = {solver!r}: the host 'fenicsx' uses the direct solver of its PETSc; leave it at "
            "'auto', or run with --host own",
        )
    try:
        check_space(problem.space)
    except DistributionError as error:
        raise loaded.error(["mesh"], f"mesh: {error}; run with --host own") from error


def in_pieces(team: Team | None) -> bool:
    """Whether each rank writes the fields of its own cells."""
    return team is not None and team.comm.size > 1


def solving(team: Team | None, recorder: FieldRecorder, output: FieldOutput) -> Callable[..., RunSummary]:
    """What runs all stages, with arguments of `granfabric.fem.equilibrium.stepping.solve`."""
    if team is None:
        from granfabric.fem.equilibrium.stepping import solve

        return solve
    if not in_pieces(team):
        return team.solve
    from granfabric.fem.fenicsx.pieces import PieceOutput

    return partial(
        team.solve, pieces=PieceOutput(recorder.series, output.every, output.compression, recorder.written)
    )


def as_data(team: Team | None) -> dict[str, Any]:
    """What `run.json` holds of the host."""
    if team is None:
        return {"name": "own"}
    from granfabric.fem.fenicsx.engine import versions

    return {"name": "fenicsx", "ranks": team.comm.size, "versions": versions()}

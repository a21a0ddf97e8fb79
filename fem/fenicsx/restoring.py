"""Going on from a checkpoint, of this host or of the own one, on any number of ranks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.fem.equilibrium.checkpoint import SolverMemory
from granfabric.fem.equilibrium.control import ControlError
from granfabric.fem.equilibrium.results import StageStart, StepResult
from granfabric.fem.linear_solvers.tangent import FactorMemory
from granfabric.fem.loads.kinds import Stage

from .dividing import of_nodes
from .local_problem import LocalProblem

Array = NDArray[np.float64]

_NONE = np.empty(0)


def divide_checkpoint(
    problem: LocalProblem, resume: StepResult | None, memory: SolverMemory | None
) -> tuple[StepResult | None, SolverMemory | None]:
    """This rank's part of the step to go on from, which rank 0 has. Tangents are asked anew of the law.

    Raises
    ------
    ControlError
        On all ranks, if it does not belong to the problem.
    """
    space = problem.space
    head: Any = None
    if resume is not None:
        start = resume.stage_start
        plain = replace(resume, displacement=_NONE, stress=_NONE, strain=_NONE, state=_NONE,
                        status=np.empty(0, dtype=np.int8),
                        stage_start=StageStart(_NONE, _NONE, _NONE, load_factors=start.load_factors), reactions={},
                        rigid={}, springs={}, active=None, support=None)  # fmt: skip
        rest = None
        if memory is not None:
            rest = replace(memory, tangent=_NONE, last_correction=None, factor=FactorMemory())
        started = len(start.spring_offsets), start.held is not None
        head = (plain, rest, started, len(resume.displacement), resume.state.shape)
    head = space.comm.bcast(head, root=0)
    if head is None:
        return None, None
    plain, rest, started, ndofs, shape = head
    width = problem.initial_state.shape[1]
    names = [stage.name for stage in problem.stages]
    if plain.stage not in names:
        raise ControlError(f"the step to go on from belongs to stage {plain.stage!r}, not one of {names}")
    if ndofs != 2 * space.nodes.total or tuple(shape) != (space.points.total, width):
        raise ControlError(
            f"the step to go on from has {ndofs} degrees of freedom and a state of shape {tuple(shape)}, this problem "
            f"{2 * space.nodes.total} and {(space.points.total, width)}"
        )
    body = problem.program.terms[_number(problem.stages, plain.stage)].body
    made = replace(
        plain,
        displacement=of_nodes(space, None if resume is None else resume.displacement),
        stress=space.points.scatter(None if resume is None else resume.stress, (3,)),
        strain=space.points.scatter(None if resume is None else resume.strain, (3,)),
        state=space.points.scatter(None if resume is None else resume.state, (width,)),
        status=space.points.scatter(None if resume is None else resume.status.astype(np.float64)).astype(np.int8),
        active=None if body is None else body.active,
        stage_start=_start(problem, None if resume is None else resume.stage_start, plain.stage_start, *started),
    )
    if rest is None:
        return made, None
    return made, replace(rest, tangent=np.empty((0, 3, 3)), last_correction=None)


def _start(
    problem: LocalProblem, whole: StageStart | None, plain: StageStart, springs: int, holds: bool
) -> StageStart:
    """This rank's part of the start of a stage."""

    def part(vector: Array | None) -> Array:
        return of_nodes(problem.space, vector)

    vectors = (None,) * 3 if whole is None else (whole.displacement, whole.fading, whole.reference)
    displacement, fading, reference = (part(vector) for vector in vectors)
    offsets = [part(None if whole is None else whole.spring_offsets[row]) for row in range(springs)]
    held = part(None if whole is None else whole.held) if holds else None
    empty = np.empty((0, 0))
    return StageStart(
        displacement, fading, reference, np.array(offsets) if offsets else empty, plain.load_factors, held
    )


def _number(stages: Sequence[Stage], name: str) -> int:
    return [stage.name for stage in stages].index(name)

"""Which parameters the curves can tell: expected standard errors, and what acts alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError, several

from .deviations import Deviations
from .parameters import Free, told_by

Array = NDArray[np.float64]

INDEPENDENT = 30
"""Rows of a column that count as independent where no standard errors are given: curves are smooth, and more rows of
the same curve tell no more."""
CHOSEN = 0.25
"""Expected standard error, over the size of the parameter, up to which it is free if nobody names the free ones."""
TOLD = 1.0
"""The same up to which a parameter that was named is accepted."""
BLIND = 1e-7
"""Change of the curves, in their scales, for a change of the parameter by its size: below, they do not know of it."""
PARTNER = 0.3
"""Part of the largest entry of a combination that no curve sees, from which a parameter belongs to it."""


def weighted(deviations: Deviations, jacobian: Array) -> Array:
    """Rows of a Jacobian with the weight that they have as evidence."""
    weights = [np.ones(0)]
    for entry in deviations.entries:
        known = entry.column in deviations.side.curves[entry.curve].known_errors
        count = entry.rows.size
        weights.append(np.full(count, 1.0 if known else np.sqrt(min(count, INDEPENDENT) / count)))
    return np.asarray(jacobian * np.concatenate(weights)[:, None])


def expected_errors(jacobian: Array) -> Array:
    """Standard errors of the sought numbers, all free together; infinite where nothing tells them."""
    if jacobian.shape[1] == 0:
        return np.zeros(0)
    sizes = np.linalg.norm(jacobian, axis=0)
    if not (sizes > 0.0).all() or not np.isfinite(sizes).all():
        return np.where(sizes > 0.0, 0.0, np.inf)
    _, singular, right = np.linalg.svd(jacobian / sizes, full_matrices=False)
    if len(singular) < jacobian.shape[1] or singular[-1] < 1e-12 * singular[0]:
        return np.full(jacobian.shape[1], np.inf)
    return np.asarray(np.sqrt(((right.T / singular) ** 2).sum(axis=1)) / sizes)


def condition(jacobian: Array) -> float:
    """Condition number of a Jacobian whose columns are made equally long."""
    sizes = np.linalg.norm(jacobian, axis=0)
    if jacobian.shape[0] < jacobian.shape[1] or not (sizes > 0.0).all():
        return np.inf
    singular = np.linalg.svd(jacobian / sizes, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0.0 else np.inf


def choose(free: Sequence[Free], jacobian: Array) -> list[int]:
    """Numbers of those parameters that the curves tell together, taken one after the other."""
    chosen: list[int] = []
    for place in range(len(free)):
        trial = [*chosen, place]
        if (expected_errors(jacobian[:, trial]) <= CHOSEN).all():
            chosen = trial
    return chosen


def refusal(free: Sequence[Free], jacobian: Array) -> InputError | None:
    """Why parameters that were named cannot all be free, by their names; None if they can."""
    sizes = np.linalg.norm(jacobian, axis=0)
    texts = []
    seen = []
    for place, entry in enumerate(free):
        if sizes[place] < BLIND:
            texts.append(
                f"--free: {entry.name} cannot be identified: these curves do not change with it at all; "
                f"it is told by {told_by(entry.name)}"
            )
        elif 1.0 / sizes[place] > TOLD:
            texts.append(
                f"--free: {entry.name} cannot be identified: its standard error would be {1.0 / sizes[place]:.2g} "
                f"times its size ({entry.size:.3g}) at the scales of these curves; it is told by "
                f"{told_by(entry.name)}, or by smaller errors (columns NAME_error, --set scale.NAME=...)"
            )
        else:
            seen.append(place)
    if texts:
        return several(texts)
    expected = expected_errors(jacobian)
    if (expected <= TOLD).all():
        return None
    alike = _alike(jacobian)
    if len(alike) < 2:  # the one that is told least, and the one that takes most of what tells it
        correlation = np.linalg.pinv(jacobian.T @ jacobian)[alike[0]] * np.linalg.norm(jacobian, axis=0)
        correlation[alike[0]] = 0.0
        alike = sorted([alike[0], int(np.argmax(np.abs(correlation)))])
    names = [free[place].name for place in alike]
    known = [f"{name} is told by {told_by(name)}" for name in names]
    return InputError(
        f"--free: {', '.join(names)} cannot be identified together: their effects on these curves cancel "
        f"(condition number {condition(jacobian):.1e} of the Jacobian); hold one of them, or give what tells them "
        f"apart: {'; '.join(known)}"
    )


def _alike(jacobian: Array) -> list[int]:
    """Parameters of the combination that the curves see least."""
    _, _, right = np.linalg.svd(jacobian, full_matrices=True)
    weights = np.abs(right[-1])
    return [int(place) for place in np.flatnonzero(weights >= PARTNER * weights.max())]

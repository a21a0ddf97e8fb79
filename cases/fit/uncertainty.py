"""Standard errors and correlations of fitted parameters, and which columns they come from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .deviations import Deviations

Array = NDArray[np.float64]

SHORTEST = 8
"""Deviations of a column along one curve from which their connection is assessed."""
CONNECTED = 2.0
"""Correlation of neighbouring deviations, times the root of their number, from which it is no chance."""
MOST_CONNECTED = 0.98


@dataclass(frozen=True)
class Uncertainty:
    """What the deviations at the end say about the parameters.

    Attributes
    ----------
    errors : ndarray, shape (nfree,)
        Standard errors of the sought numbers.
    correlation : ndarray, shape (nfree, nfree)
    shares : dict of str to ndarray, shape (nfree,)
        Part of the information on each parameter, beyond what the others explain, by column.
    scatter : dict of str to float
        Standard deviation of the deviations of a column, in its scales.
    connected : dict of str to float
        Factor by which standard errors from a column are widened because its deviations follow each other; only those
        beyond one.
    """

    errors: Array
    correlation: Array
    shares: dict[str, Array]
    scatter: dict[str, float]
    connected: dict[str, float]


@dataclass(frozen=True)
class FromRows:
    """A parameter that is held at what the first rows of the curves say.

    Attributes
    ----------
    column : str
        From which it was taken.
    derivative : ndarray, shape (ndeviations,)
        Of the deviations by it.
    scale : float
        Its deviation for one scale in each of these rows.
    """

    column: str
    derivative: Array
    scale: float


def uncertainty(
    deviations: Deviations, here: Array, jacobian: Array, held: Sequence[FromRows] = ()
) -> Uncertainty:
    """Covariance from the Jacobian, with a variance of each column from its own deviations.

    With ``P = (J^T J)^-1 J^T`` and V the variances, the covariance is ``P V P^T``. A column's variance is the sum of
    squares of its deviations over their number less what the parameters take of it; where the file gives standard
    errors it is not below one. Where neighbouring deviations are correlated (r), because the law departs from the curve
    rather than scatters about it, it is times (1 + r)/(1 - r), as for a mean of such a series. What is `held` at the
    first rows adds ``(P j) (P j)^T`` times its own variance, with j the derivative by it.
    """
    columns = np.concatenate([np.full(entry.rows.size, entry.column, dtype=object) for entry in deviations.entries])
    known = {name for curve in deviations.side.curves for name in curve.known_errors}
    inverse = np.linalg.pinv(jacobian)
    taken = np.einsum("ij,ji->i", jacobian, inverse)
    variance, scatter, connected = np.ones(here.size), {}, {}
    for name in dict.fromkeys(columns):
        part = columns == name
        left = max(float(part.sum() - taken[part].sum()), 0.5)
        square = float(here[part] @ here[part]) / left
        scatter[name] = float(np.sqrt(square))
        factor = _connection(deviations, here, name)
        if factor > 1.0:
            connected[name] = float(np.sqrt(factor))
        variance[part] = factor * (max(square, 1.0) if name in known else square)
    covariance = (inverse * variance) @ inverse.T
    for entry in held:
        shift = inverse @ entry.derivative
        size = max(scatter.get(entry.column, 1.0), 1.0 if entry.column in known else 0.0) * entry.scale
        covariance += np.outer(shift, shift) * size**2
    errors = np.sqrt(np.diag(covariance))
    with np.errstate(all="ignore"):
        correlation = covariance / np.outer(errors, errors)
    correlation[~np.isfinite(correlation)] = 0.0
    np.fill_diagonal(correlation, 1.0)
    return Uncertainty(errors, correlation, _shares(columns, jacobian), scatter, connected)


def _connection(deviations: Deviations, here: Array, name: str) -> float:
    """(1 + r)/(1 - r) of neighbouring deviations of a column; 1 if r may be chance."""
    product = square = count = 0.0
    begin = 0
    for entry in deviations.entries:
        part = here[begin : begin + entry.rows.size]
        begin += entry.rows.size
        if entry.column == name and part.size >= SHORTEST:
            product += float(part[1:] @ part[:-1])
            square += float(part @ part)
            count += part.size
    if not square > 0.0 or product / square * np.sqrt(count) <= CONNECTED:
        return 1.0
    r = min(product / square, MOST_CONNECTED)
    return (1.0 + r) / (1.0 - r)


def _shares(columns: NDArray[np.object_], jacobian: Array) -> dict[str, Array]:
    """Squares of what is left of each parameter's column beside the others, by column of the curves, adding up to 1."""
    rest = np.empty_like(jacobian)
    for place in range(jacobian.shape[1]):
        others = np.delete(jacobian, place, axis=1)
        own = jacobian[:, place]
        rest[:, place] = own - others @ np.linalg.lstsq(others, own, rcond=None)[0] if others.size else own
    squares = rest**2
    total = np.where(squares.sum(axis=0) > 0.0, squares.sum(axis=0), 1.0)
    return {str(name): squares[columns == name].sum(axis=0) / total for name in dict.fromkeys(columns)}

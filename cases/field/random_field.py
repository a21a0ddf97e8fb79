"""A random function of place: Gaussian, homogeneous, correlated over a length, the same on every mesh."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MODES = 2000
"""Waves that are superposed; the distribution of values at a place is normal up to terms of order 1/MODES."""
_CHUNK = 500


def random_field(
    points: Array, seed: int, lengths: tuple[float, float], correlation: Literal["gaussian", "exponential"]
) -> Array:
    """Values of mean 0 and variance 1 at given places.

    Waves of random direction, length and phase [Shinozuka 1971, J. Acoust. Soc. Am. 49, 357]: wave vectors are drawn
    from the spectrum of the wanted correlation, which is thereby met exactly on the mean over seeds,

        gaussian      rho = exp(-d^2),   wave vectors normal with variance 2
        exponential   rho = exp(-d),     wave vectors Cauchy-distributed in the plane

    with ``d^2 = (dx/l_x)^2 + (dy/l_y)^2`` between two places. Because a value depends on the place alone, a finer mesh
    sees the same specimen.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        [m].
    seed : int
        The same seed gives the same function.
    lengths : (float, float)
        Correlation lengths along x and y [m].
    correlation : {"gaussian", "exponential"}

    Returns
    -------
    ndarray, shape (n,)
    """
    generator = np.random.default_rng(seed)
    waves = generator.standard_normal((MODES, 2))
    phases = generator.uniform(0.0, 2 * np.pi, MODES)
    if correlation == "gaussian":
        waves *= np.sqrt(2.0)
    else:  # multivariate Student distribution of one degree of freedom
        waves /= np.abs(generator.standard_normal((MODES, 1)))
    scaled = points / np.asarray(lengths)
    values = np.zeros(len(points))
    for start in range(0, MODES, _CHUNK):
        part = slice(start, start + _CHUNK)
        values += np.cos(scaled @ waves[part].T + phases[part]).sum(axis=1)
    return np.asarray(np.sqrt(2.0 / MODES) * values)

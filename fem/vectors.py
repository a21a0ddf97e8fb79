"""Inner products that always take one thread.

The threads of a linear algebra library do not help vectors of this size, wait for each other on a busy machine, and let
the last bits depend on their number.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def dot(first: Array, second: Array) -> float:
    """Inner product of two vectors."""
    return float(np.einsum("i,i->", first, second))


def norm(vector: Array) -> float:
    """Euclidean norm; nan or inf where the vector holds such values."""
    return math.sqrt(dot(vector, vector))

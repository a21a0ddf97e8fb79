"""Both sides of the comparison at the same stress ratios."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .dem_side import SeedResult
from .paths import PathRow
from .table import Comparison

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PathStudy:
    """Both sides at the same fractions of the segments of a path.

    Attributes
    ----------
    segment, stress_ratio, angle : ndarray, shape (nplaces,)
        See `PathRow`; means over the packings.
    dem : list of dict of ndarray, shape (nplaces,)
        One a packing, by quantity.
    model : dict of list of dict of ndarray
        By closure.
    """

    segment: Array
    stress_ratio: Array
    angle: Array
    dem: list[dict[str, Array]]
    model: dict[str, list[dict[str, Array]]]


@dataclass(frozen=True)
class Study:
    """Both sides at the same stress ratios.

    Attributes
    ----------
    levels : ndarray, shape (nlevels,)
        Stress ratios q/p.
    dem : dict of dict of ndarray, shape (nseeds, nlevels)
        By loading and column of the DEM's history; NaN beyond what a run reached.
    model : dict of dict of dict of ndarray, shape (nseeds, nlevels)
        By loading, closure and quantity.
    results : list of SeedResult
    rows : list of Comparison
    seconds : dict of str to float
        Time of the DEM by phase and of the ``model``, over all seeds, without compilation.
    paths : dict of str to PathStudy
        Cycles and rotation.
    path_rows : list of PathRow
    probes : dict of dict of ndarray, shape (nseeds, 2)
        By probe and side ("DEM" or closure): changes of z and a_c.
    cost : dict of str to float
        Microseconds of an update with its tangent, by closure.
    messages : list of str
        Where a closure could not go on.
    """

    levels: Array
    dem: dict[str, dict[str, Array]]
    model: dict[str, dict[str, dict[str, Array]]]
    results: list[SeedResult]
    rows: list[Comparison]
    seconds: dict[str, float]
    paths: dict[str, PathStudy]
    path_rows: list[PathRow]
    probes: dict[str, dict[str, Array]]
    cost: dict[str, float]
    messages: list[str]

    @property
    def closures(self) -> list[str]:
        """Names of the closures compared."""
        return list(next(iter(self.model.values())))

    @property
    def shortfalls(self) -> list[str]:
        """Loadings that a packing did not carry to the last stress ratio that is compared."""
        found = []
        for loading, columns in self.dem.items():
            for result, reached in zip(self.results, np.isfinite(columns["coordination"])):
                if not reached[-1]:
                    most = self.levels[np.flatnonzero(reached)[-1]]
                    found.append(
                        f"packing of seed {result.seed}, {loading.replace('_', ' ')}: q/p = {most:.3f} was the most "
                        f"that it carried, of {self.levels[-1]:g} that are compared"
                    )
        return found

"""Arrays of a block of lanes, by name; the last index is the lane."""

import numpy as np

from granfabric.constitutive.lanes.eight import LANES_OF_KERNELS
from granfabric.constitutive.material_table import MICRO
from granfabric.constitutive.network.point import INPUTS
from granfabric.constitutive.sliding.slide import MOST_STAGES

from .stage import ADVANCED, RATES

SPARE = MOST_STAGES - 1
"""A stage that no scheme has: for rates that may not be kept."""

_WIDTH = len(LANES_OF_KERNELS)
_ROWS = {
    # what the lanes were given (see `network.point`); micro-state and stress at the end
    **{"inputs": INPUTS, "ends": MICRO + 3},
    # unknowns and their derivatives at the start of the substep, and at a stage or the end
    **{"y": ADVANCED, "trial": ADVANCED},
    # rates of all stages; of the last pass over an implicit stage
    **{"k": MOST_STAGES * RATES, "before": 2 * ADVANCED},
    # z, a_c gained, lost, and strain, so far
    "sums": 9,
    # length of the substep and pseudo-time at which it starts
    **{"step": 1, "time": 1},
    # 1 where the first stage of the substep has to be evaluated, where the substep is accepted, where the state at the
    # end of the increment has been found
    **{"fresh": 1, "accepted": 1, "solved": 1},
    # of the substep: gravest status of its stages, error in units of the tolerance, evaluations of the rates
    **{"worst": 1, "measure": 1, "evaluations": 1},
}

BLOCK = np.dtype(
    [
        *((name, "f8", (rows, _WIDTH)) for name, rows in _ROWS.items()),
        # point in each lane, material whose numbers a lane holds, -1 if none; 1 if the substep is the last one
        *(("point_of", "i8", _WIDTH), ("material", "i8", _WIDTH), ("last", "i8", _WIDTH)),
    ]
)

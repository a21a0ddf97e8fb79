"""What points that may slide carry through an increment, by name; the last index is the lane."""

import numpy as np

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import LANES_OF_KERNELS, read

MOST_STAGES = 8

_ROWS = {
    # numbers of the material; see `cone`
    **dict.fromkeys(("first", "peak", "reference", "exponent", "dilatancy", "constant", "cohesion"), 1),
    # the hardening strain and its derivatives by the strain increment, at the start of the substep and at a stage
    **{"kappa": 1, "kappa_by": 3, "trial_kappa": 1, "trial_kappa_by": 3},
    # plastic volumetric strain and dissipation since the start of the increment
    **{"volume": 1, "work": 1},
    # rates of each stage: of kappa, of its derivatives, of plastic volumetric strain and of dissipation
    **{"kappa_rate": MOST_STAGES, "kappa_slope": 3 * MOST_STAGES, "volume_rate": MOST_STAGES, "work_rate": MOST_STAGES},
    # of the stage under way: stress rates without plastic strain, direction of the flow, whether it starts from q = 0
    **{"elastic": 3, "flow": 2, "at_rest": 1},
    # 1 or 0: the substep starts on the cone; has plastic strain; the multiplier has changed sign in it; it ended at the
    # cone
    **dict.fromkeys(("on_cone", "slides", "turned_back", "crossed"), 1),
    # bracket of the pseudo-time at which the cone is reached
    **dict.fromkeys(("low", "low_f", "high", "high_f", "side", "whole_step", "tries"), 1),
    # length of the substep before it was shortened
    "planned_step": 1,
    # derivatives by the strain increment of the pseudo-time at which the substep starts, and of its length
    **{"time_change": 3, "step_change": 3},
    # a change of the step by which Y' is found, and the column of derivatives that it stands in for
    **{"seed": 1, "kept": 6},
    # strain xx, yy, xy that the return to the cone adds
    "correction": 3,
}

SLIDE = np.dtype([(name, "f8", (rows, len(LANES_OF_KERNELS))) for name, rows in _ROWS.items()])


@formula
def cone_of(slide, lanes):
    """Numbers of the material: first, peak, reference, exponent, dilatancy, constant-volume ratio, cohesion."""
    return (
        read(slide["first"], 0, lanes),
        read(slide["peak"], 0, lanes),
        read(slide["reference"], 0, lanes),
        read(slide["exponent"], 0, lanes),
        read(slide["dilatancy"], 0, lanes),
        read(slide["constant"], 0, lanes),
        read(slide["cohesion"], 0, lanes),
    )

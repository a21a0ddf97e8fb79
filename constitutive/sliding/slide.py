"""What a point that may slide carries through an increment, by name."""

import numpy as np

MOST_STAGES = 8

SLIDE = np.dtype(
    [
        # numbers of the material; see `cone`
        *((name, "f8") for name in ("first", "peak", "reference", "exponent", "dilatancy", "constant", "cohesion")),
        # the hardening strain and its derivatives by the strain increment, at the start of the substep and at a stage
        *(("kappa", "f8"), ("kappa_by", "f8", 3), ("trial_kappa", "f8"), ("trial_kappa_by", "f8", 3)),
        # plastic volumetric strain and dissipation since the start of the increment
        *(("volume", "f8"), ("work", "f8")),
        # rates of each stage: of kappa, of its derivatives, of plastic volumetric strain and of dissipation
        ("kappa_rate", "f8", MOST_STAGES),
        ("kappa_slope", "f8", (MOST_STAGES, 3)),
        *(("volume_rate", "f8", MOST_STAGES), ("work_rate", "f8", MOST_STAGES)),
        # of the stage under way: stress rates without plastic strain, direction of the flow, whether it starts from q = 0
        *(("elastic", "f8", 3), ("flow", "f8", 2), ("at_rest", "b1")),
        # the substep starts on the cone; has plastic strain; its first stage is being computed; the multiplier has
        # changed sign in it; it ended at the cone
        *((name, "b1") for name in ("on_cone", "slides", "decides", "turned_back", "crossed")),
        # bracket of the pseudo-time at which the cone is reached
        *((name, "f8") for name in ("low", "low_f", "high", "high_f", "side", "whole_step", "tries")),
        # length of the substep before it was shortened
        ("planned_step", "f8"),
        # derivatives by the strain increment of the pseudo-time at which the substep starts, and of its length
        *(("time_change", "f8", 3), ("step_change", "f8", 3)),
        # a change of the step by which Y' is found, and the column of derivatives that it stands in for
        *(("seed", "f8"), ("kept", "f8", 6)),
        # strain xx, yy, xy that the return to the cone adds
        ("correction", "f8", 3),
    ]
)

"""Why a loading ended before its end, and the words for it."""

from __future__ import annotations

from enum import IntEnum


class Ending(IntEnum):
    """How a leg ended; the numbers are stored in checkpoints."""

    ON_ITS_WAY = 0
    """Or at its end as asked."""
    TOO_STRONG = 1
    LOST_PRESSURE = 2
    STOOD_STILL = 3


def ending_text(ending: Ending, pressure: float, reference: float, unbalanced_force: float) -> str:
    """One sentence without a full stop on why a leg ended early; empty if it did not.

    Parameters
    ----------
    ending : Ending
    pressure, reference : float
        Mean pressure at the end and that of the start, Pa.
    unbalanced_force : float
        Largest at the end, over the mean contact force.
    """
    if ending == Ending.TOO_STRONG:
        return "it asks for a stress that the sample cannot carry, and was given up at a large strain"
    if ending == Ending.LOST_PRESSURE:
        left = max(pressure, 0.0) + 0.0  # without contacts it is -0.0
        return (
            f"the sample has lost its pressure: p = {left:.3g} Pa of {reference:.4g} Pa at the start is "
            "left, its disks hardly press on each other any more"
        )
    if ending == Ending.STOOD_STILL:
        return (
            f"the loading stands still: it neither advances nor comes to rest at p = {max(pressure, 0.0):.4g} Pa "
            f"(unbalanced force {unbalanced_force:.2g}, see [rates])"
        )
    return ""

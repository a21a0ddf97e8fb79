"""Stresses that pull: beyond q = p one principal stress is tension, which grains without cohesion do not carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

CARRIED = 1.0 + 1e-6
"""Largest q/p that counts as carried; the stress is computed within the tolerance of the law."""


def pulling_stress(scene: Mapping[str, Any], steps: Sequence[int], ratios: Sequence[float], points: str = "") -> str:
    """A warning for a run whose stress pulls; empty if it does not, or a material has a cohesion to pull against.

    Parameters
    ----------
    scene : mapping
        As resolved.
    steps : sequence of int
    ratios : sequence of float
        Largest q/p of each step.
    points : str
        Where, as the end of a phrase: " at some points".
    """
    materials = [scene.get("material") or {}, *(scene.get("materials") or {}).values()]
    if any((material.get("apparent_cohesion") or 0.0) > 0.0 for material in materials):
        return ""
    found = np.asarray(ratios, dtype=float)
    beyond = np.flatnonzero(found > CARRIED)
    if not beyond.size:
        return ""
    return (
        f"warning: from step {steps[int(beyond[0])]} on q exceeds p{points} (q/p up to {found.max():.3g}): one "
        "principal stress pulls, which grains without cohesion cannot; take nothing from there on for an answer"
    )

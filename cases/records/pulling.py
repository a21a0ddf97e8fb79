"""Tensile stresses: beyond q = p one principal stress is tensile, which grains without cohesion do not carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

CARRIED = 1.0 + 1e-6
"""Largest q/p that counts as carried; the stress is computed within the tolerance of the law."""


def pulling_stress(scene: Mapping[str, Any], steps: Sequence[int], ratios: Sequence[float], points: str = "") -> str:
    """A warning for a run with a tensile principal stress; empty without one, or if a material has a cohesion.

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
        "principal stress is tensile, which grains without cohesion cannot carry; results from there on are not valid"
    )

"""Compile a law's kernels ahead of their first use: ``python -m granfabric.constitutive.warm_up KERNEL ...``.

A kernel is named by the closure it is for: ``mean_field`` (which does for "fluctuating" and for a network at rest as
well) or ``shifted_distribution``. A host that prepares its own part meanwhile finds them in the disk cache.
"""

from __future__ import annotations

import gc
import sys

import numpy as np

from .compilation import cache_directory
from .effects import Effects
from .law import ContactLaw
from .parameters import Closure, ForceChange, Material

KERNELS: tuple[ForceChange, ...] = ("mean_field", "shifted_distribution")


def kernel_of(closure: Closure, effects: Effects) -> ForceChange:
    """Name of the kernel that a law with this closure and these effects calls."""
    return KERNELS[closure.force_change == "shifted_distribution" and effects.network_changes]


def _marker(kernel: str) -> str:
    return f"{kernel}.compiled"


def cached(kernel: str) -> bool:
    """Whether the disk cache holds the kernel, as far as `warm_up` has put it there."""
    return (cache_directory("constitutive") / _marker(kernel)).exists()


def warm_up(kernel: str) -> None:
    """Update one point by a strain increment with its tangent."""
    closure = Closure(force_change=kernel)  # type: ignore[arg-type]
    law = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)], closure)
    stress = np.array([[-1e5, -1e5, 0.0]])
    state = law.initial_state(stress)
    increment = np.array([[1e-7, -1e-7, 0.0]])
    law.update(increment, stress, state, np.zeros_like(stress), np.zeros_like(state), np.zeros((1, 3, 3)))
    folder = cache_directory("constitutive")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _marker(kernel)).touch()


if __name__ == "__main__":
    gc.disable()  # a process that ends soon, and a twentieth of whose time it would take
    for name in sys.argv[1:]:
        warm_up(name)

"""Compile a law's kernels ahead of their first use: ``python -m granfabric.constitutive.warm_up KERNEL ...``.

A kernel is named by the closure it is for: ``mean_field`` (which does for "fluctuating" and for a network at rest as
well) or ``shifted_distribution``. A host that prepares its own part meanwhile finds them in the disk cache.
"""

from __future__ import annotations

import gc
import pickle
import sys

import numpy as np

from granfabric.constitutive.network.rates import MeanField
from granfabric.constitutive.network.weak_force_state import ShiftedDistribution

from .compilation import cache_directory
from .effects import Effects
from .law import ContactLaw
from .parameters import Closure, ForceChange, Material

KERNELS: tuple[ForceChange, ...] = ("mean_field", "shifted_distribution")


def kernel_of(closure: Closure, effects: Effects) -> ForceChange:
    """Name of the kernel that a law with this closure and these effects calls."""
    return KERNELS[closure.force_change == "shifted_distribution" and effects.network_changes]


_CLOSURES = {"mean_field": MeanField.__name__, "shifted_distribution": ShiftedDistribution.__name__}


def cached(kernel: ForceChange) -> bool:
    """Whether the disk cache holds the kernel."""
    for index in cache_directory("constitutive").rglob("points.update_points-*.nbi"):
        # the version that wrote it, then a stamp of the source and a file for each signature
        try:
            with index.open("rb") as stream:
                pickle.load(stream)
                _, signatures = pickle.loads(stream.read())
            if any(f"{_CLOSURES[kernel]}(" in str(key[0]) for key in signatures):
                return True
        except Exception:  # whatever is in the file: then it will be compiled
            continue
    return False


def warm_up(kernel: ForceChange) -> None:
    """Update one point by a strain increment with its tangent."""
    law = ContactLaw(
        [Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)], Closure(force_change=kernel)
    )
    stress = np.array([[-1e5, -1e5, 0.0]])
    state = law.initial_state(stress)
    increment = np.array([[1e-7, -1e-7, 0.0]])
    law.update(increment, stress, state, np.zeros_like(stress), np.zeros_like(state), np.zeros((1, 3, 3)))


if __name__ == "__main__":
    gc.disable()  # a process that ends soon, and a twentieth of whose time it would take
    for name in sys.argv[1:]:
        warm_up(name)  # type: ignore[arg-type]

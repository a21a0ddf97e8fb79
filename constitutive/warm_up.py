"""Compile a law's kernels ahead of their first use: ``python -m granfabric.constitutive.warm_up KERNEL ...``.

A kernel is named by the closure it is for, with ``+sliding`` if points may slide: ``shifted_distribution+sliding``,
``mean_field``, ``at_rest``. A host that prepares its own part meanwhile finds them in the disk cache.
"""

from __future__ import annotations

import sys

import numpy as np

from .compilation import cache_directory
from .effects import Effects
from .law import ContactLaw
from .parameters import Closure, Material

SLIDING = "+sliding"
AT_REST = "at_rest"
FAMILIES = {"mean_field": "mean_field", "fluctuating": "mean_field", "shifted_distribution": "shifted_distribution"}
"""Force changes, and the one for which their kernel is named."""


def kernel_of(closure: Closure, effects: Effects) -> str:
    """Name of the kernel that a law with this closure and these effects calls."""
    family = FAMILIES[closure.force_change] if effects.network_changes else AT_REST
    return family + (SLIDING if effects.sliding else "")


def _law(kernel: str) -> ContactLaw:
    family, sliding = kernel.removesuffix(SLIDING), kernel.endswith(SLIDING)
    moving = family != AT_REST
    closure = Closure(force_change=family) if moving else Closure()  # type: ignore[arg-type]
    effects = Effects(contact_loss=moving, contact_gain=moving, sliding=sliding)
    return ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)], closure, effects)


def _marker(kernel: str) -> str:
    return f"{kernel.replace('+', '-')}.compiled"


def cached(kernel: str) -> bool:
    """Whether the disk cache holds the kernel, as far as `warm_up` has put it there."""
    return (cache_directory("constitutive") / _marker(kernel)).exists()


def warm_up(kernel: str) -> None:
    """Update one point by a strain increment with its tangent."""
    law = _law(kernel)
    stress = np.array([[-1e5, -1e5, 0.0]])
    state = law.initial_state(stress)
    increment = np.array([[1e-7, -1e-7, 0.0]])
    law.update(increment, stress, state, np.zeros_like(stress), np.zeros_like(state), np.zeros((1, 3, 3)))
    folder = cache_directory("constitutive")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _marker(kernel)).touch()


if __name__ == "__main__":
    for name in sys.argv[1:]:
        warm_up(name)

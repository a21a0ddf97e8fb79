"""Compile the law's kernels ahead of their first use: ``python -m constitutive.warm_up``.

A host that prepares its own part meanwhile finds them in the disk cache.
"""

from __future__ import annotations

import numpy as np

from .compilation import cache_directory

ENTRY_KERNELS = ("integrate.update_points", "integrate.smallest_step_factor")
"""Kernels that the law calls; whatever they call in turn is compiled before them."""


def kernels_cached() -> bool:
    """Whether the disk cache holds an index of every kernel that the law calls."""
    folder = cache_directory("constitutive")
    return all(any(folder.rglob(f"{name}-*.nbi")) for name in ENTRY_KERNELS)


def warm_up() -> None:
    """Update one point by a strain increment with its tangent, and once under mixed control."""
    from .law import ContactLaw
    from .parameters import Material

    law = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
    stress = np.array([[-1e5, -1e5, 0.0]])
    state = law.initial_state(stress)
    stress_end, state_end, strain = np.zeros_like(stress), np.zeros_like(state), np.zeros((1, 3))
    increment = np.array([[1e-7, -1e-7, 0.0]])
    law.update(increment, stress, state, stress_end, state_end, np.zeros((1, 3, 3)))
    control = np.array([[1, 0, 0]], dtype=np.uint8)
    law.update_mixed(control, np.array([[0.0, -1e-7, 0.0]]), stress, state, stress_end, state_end, strain)


if __name__ == "__main__":
    warm_up()

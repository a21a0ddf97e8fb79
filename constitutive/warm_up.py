"""Compile the law's kernels ahead of their first use: ``python -m granfabric.constitutive.warm_up``.

A host that prepares its own part meanwhile finds them in the disk cache, and can lend a hand with `compile_late`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

import numba
import numpy as np
from numba.core.errors import NumbaError

from .compilation import cache_directory

ENTRY_KERNELS = ("points.update_points", "points.smallest_step_factor")
"""Kernels that the law calls; whatever they call in turn is compiled before them."""


LATE_KERNELS = (
    *(("integration.substep", "accept_substep", "wwb"), ("integration.substep", "estimate_error", "wwfbbb")),
    ("integration.stage", "_differentiate", "wob"),
    *(("network.rates", "_close", "wo"), ("network.rates", "_differentiate", "wo"), ("network.rates", "_split", "wo")),
    *(("network.rates", "_improve", "wo"), ("network.quadrature_change", "quadrature_change", "wiibbbww")),
    *(("network.contact_change", "_gain", "wb"), ("network.contact_change", "_loss_by_force_anisotropy", "w")),
    *(("network.contact_change", "_loss", "wb"), ("network.arcs", "_from_series", "wb"), ("network.arcs", "_second_moments", "w")),
)
"""Module, name and argument types of kernels that `update_points` calls, those that it needs last before the others."""

_TYPES = {
    "w": numba.float64[::1],
    "o": numba.int64[::1],
    "b": numba.boolean,
    "f": numba.float64,
    "i": numba.int64,
}


def compile_late(go_on: Callable[[], bool]) -> list[str]:
    """Compile kernels from the end of the list while another process works on it from its beginning.

    What that one has finished is found in the cache. A kernel that does not exist (any more) with these arguments is
    passed over: it is compiled where it is called.

    Parameters
    ----------
    go_on : callable
        Asked before each kernel.

    Returns
    -------
    list of str
        Kernels that were compiled here, neither found in the cache nor passed over.
    """
    done = []
    for module, name, letters in LATE_KERNELS:
        if not go_on():
            break
        kernel = getattr(import_module(f"{__package__}.{module}"), name, None)
        if kernel is None:
            continue
        missed = sum(kernel.stats.cache_misses.values())
        try:
            kernel.compile(tuple(_TYPES[letter] for letter in letters))
        except (NumbaError, TypeError):  # the latter for another number of arguments
            continue
        if sum(kernel.stats.cache_misses.values()) > missed:
            done.append(f"{module}.{name}")
    return done


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

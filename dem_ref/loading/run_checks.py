"""Whether the arrays of a checkpoint can be those of a run, beside its sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .endings import Ending
from .leg_state import LEG_NUMBERS

_NUMBER_ARRAYS: dict[str, tuple[int, ...]] = {
    "run_numbers": (22,), "leg_state": (LEG_NUMBERS,), "motion_stress": (3,), "motion_measures": (8,),
    "motion_tally": (3,),
}  # fmt: skip


def damage(arrays: dict[str, NDArray], count: int, segments: int, columns: int) -> str:
    """Why these arrays are not those of a run of so many disks and segments; empty if they are."""
    contacts = len(arrays.get("contact_first", ()))
    shapes: dict[str, tuple[str, tuple[int, ...]]] = {
        "rows": ("f8", (len(arrays["rows"]), columns)),
        **{name: ("f8", shape) for name, shape in _NUMBER_ARRAYS.items()},
        **{f"contact_{name}": ("i8", (contacts,)) for name in ("first", "second")},
        **{f"contact_{name}": ("f8", (contacts,)) for name in ("length", "normal_force", "tangential_force")},
        "contact_normal": ("f8", (contacts, 2)),
        "contact_image": ("i1", (contacts, 2)),
    }
    if len(arrays.get("leg_state", ())) == 0:
        shapes["leg_state"] = ("f8", (0,))
    for name, (kind, shape) in shapes.items():
        array = arrays.get(name)
        if array is None or array.dtype != np.dtype(kind) or array.shape != shape or not np.isfinite(array).all():
            return f"array '{name}' is missing or damaged"
    if not len(arrays["rows"]):
        return "array 'rows' is empty"
    if not (0 <= arrays["run_numbers"][0] <= segments and abs(arrays["run_numbers"][6]) < 2**53):
        return "it names a segment that the run does not have"
    if arrays["run_numbers"][21] not in list(Ending):
        return "it ended in a way that there is not"
    first, second = arrays["contact_first"], arrays["contact_second"]
    if contacts and not (first.min() >= 0 and (first < second).all() and second.max() < count):
        return "its contacts are not between its disks"
    return ""

"""Which state variables of a law files show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import LawDescription


def shown_part(description: LawDescription) -> tuple[LawDescription, NDArray[np.int64] | None]:
    """The law without the variables that writers pass over, and the columns of those that stay; None if all do."""
    shown = tuple(variable for variable in description.state if not variable.hidden)
    if len(shown) == len(description.state):
        return description, None
    every = np.arange(description.nstate)
    columns = [every[description.columns(variable.name)] for variable in shown]
    return replace(description, state=shown), np.concatenate(columns)

"""What a file of another code tells, before it is checked as a packing; in the units of the file."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEYS = ("normal_stiffness", "stiffness_ratio", "friction", "length_unit", "force_unit")
"""Numbers that a file may tell besides the disks."""


@dataclass
class RawDisks:
    """Disks as a file gives them.

    Attributes
    ----------
    origin : str
        The file.
    identity : (n,) int64
        Numbers of the disks, by which contacts name them.
    numbered : bool
        Whether the file gave those numbers; if not they count the rows.
    line : (n,) int64
        Line of each disk, from 1.
    position : (n, 2)
    radius : (n,)
    cell : (2, 2), optional
    keys : dict of str to float
        Of `KEYS`.
    seed : int
    digits : int
        Most significant digits of any coordinate: what positions are known to.
    remarks : list of str
        What a user should know.
    """

    origin: str
    identity: NDArray[np.int64]
    numbered: bool
    line: NDArray[np.int64]
    position: Array
    radius: Array
    cell: Array | None = None
    keys: dict[str, float] = field(default_factory=dict)
    seed: int = -1
    digits: int = 17
    remarks: list[str] = field(default_factory=list)


@dataclass
class RawContacts:
    """Contacts as a file gives them; forces act on the second disk.

    Attributes
    ----------
    origin : str
    line : (m,) int64
    first, second : (m,) int64
        Numbers of disks.
    columns : dict of str to (m,)
        Of `FORCE_COLUMNS`.
    cell : (2, 2), optional
        The cell that the list tells of, in the axes in which its forces are.
    """

    origin: str
    line: NDArray[np.int64]
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    columns: dict[str, Array]
    cell: Array | None = None


FORCE_COLUMNS = {
    "fn": "normal force, compression positive",
    "fn_x": "normal force on disk id2, x",
    "fn_y": "normal force on disk id2, y",
    "ft": "tangential force on disk id2, along the normal from id1 to id2 turned by +90 degrees",
    "ft_x": "tangential force on disk id2, x",
    "ft_y": "tangential force on disk id2, y",
    "ft1_x": "tangential force on disk id1, x",
    "ft1_y": "tangential force on disk id1, y",
    "tangential_elongation": "elongation of the tangential spring",
}
"""Columns of a list of contacts besides ``id1`` and ``id2``."""

ALIASES = {
    "patom1": "id1", "patom2": "id2", "first": "id1", "second": "id2", "i": "id1", "j": "id2",
    "normal_force": "fn", "tangential_force": "ft",
}  # fmt: skip
"""Other names of columns of contacts."""

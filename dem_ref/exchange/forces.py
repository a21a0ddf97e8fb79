"""Forces that a list of contacts gives, put beside the contacts that the disks have, and compared with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError
from granfabric.dem_ref.measures.contacts import contacts_of, unbalanced_force
from granfabric.dem_ref.sample.disks import Sample

from .raw import RawContacts, RawDisks

AGREEMENT = 0.02
"""Largest difference between forces that are given and those that follow from overlaps, over their mean."""
WEAK = 1e-3
"""Force over its mean below which a contact may be missing in a list."""
OVER_LIMIT = 0.01
"""Fraction of the tangential forces beyond Coulomb's limit that damping and rounding explain; it is cut off."""
SAME_CELL = 1e-6
"""Largest difference between the cells of disks and of their contacts, over their size."""
TURNED = 0.3
"""An unbalanced force that falls to this fraction when all tangential forces change sign says that they are on the
other disk."""
SPOILT = 0.05
"""Unbalanced force, over the mean contact force, of a packing that coarse coordinates have spoilt."""


def names_of(disks: RawDisks, first: int, second: int) -> str:
    """Two disks by the identities and lines of their file, for a message."""
    return (
        f"{disks.identity[first]} (line {disks.line[first]}) and {disks.identity[second]} (line {disks.line[second]})"
    )


@dataclass
class Matched:
    """Rows of a list of contacts put beside the contacts that the disks have."""

    contacts: RawContacts
    row: NDArray[np.int64]
    """Row of each contact of the sample, -1 for those that the list lacks."""
    overlap: NDArray[np.float64]
    same: NDArray[np.bool_]
    """Whether the row's first disk is the contact's."""
    normal: NDArray[np.float64] | None
    """Normal force of each contact, in the file's unit; NaN where the list lacks it."""


def matched_contacts(disks: RawDisks, contacts: RawContacts, sample: Sample) -> Matched:
    """Put the rows of a list beside the contacts that the disks have.

    Raises
    ------
    SampleError
        If the list cannot belong to the disks: another cell, unknown disks, a contact with itself or twice.
    """
    origin = contacts.origin
    if not disks.numbered:
        raise SampleError(
            f"{disks.origin}: has no column id, by which the contacts in {origin} could name the disks"
        )
    _compare_cells(disks, contacts)
    first, second = _places(disks, contacts, contacts.first), _places(disks, contacts, contacts.second)
    itself = np.flatnonzero(first == second)
    if len(itself):
        raise SampleError(
            f"{origin}, line {contacts.line[itself[0]]}: id1 = id2 = {contacts.first[itself[0]]}, a contact of a disk "
            "with itself"
        )
    key = np.minimum(first, second) * sample.count + np.maximum(first, second)
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if len(twice):
        a, b = order[twice[0]], order[twice[0] + 1]
        raise SampleError(
            f"{origin}, line {contacts.line[b]}: the contact of {contacts.first[b]} and {contacts.second[b]} stands in "
            f"line {contacts.line[a]} already; each contact is wanted once"
        )
    real = contacts_of(sample)
    place = np.minimum(np.searchsorted(key[order], real.key), max(len(order) - 1, 0))
    known = key[order][place] == real.key if len(order) else np.zeros(real.count, bool)
    row = np.where(known, order[place] if len(order) else -1, -1)
    overlap = real.normal_force / sample.normal_stiffness
    lost = (row < 0) & (overlap > WEAK * overlap.mean()) if real.count else np.zeros(0, bool)
    if lost.any():
        at = int(np.flatnonzero(lost)[0])
        raise SampleError(
            f"{origin}: {int(lost.sum())} of the {real.count} contacts that the disks have are not in it, for instance "
            f"that of {names_of(disks, int(real.first[at]), int(real.second[at]))}; does it belong to another state?"
        )
    same = first[row] == real.first
    column = contacts.columns
    force: NDArray[np.float64] | None = None
    every: NDArray[np.float64] | None = None
    if "fn" in column:
        every = column["fn"]
    elif "fn_x" in column:
        every = np.hypot(column["fn_x"], column["fn_y"])
    if every is not None:
        force = np.where(row >= 0, every[row], np.nan)
        touching = np.isin(key, real.key)
        apart = ~touching & (every > AGREEMENT * np.nanmean(force)) if real.count else every > 0.0
        if apart.any():
            at = int(np.flatnonzero(apart)[0])
            raise SampleError(
                f"{origin}, line {contacts.line[at]}: a force of {every[at]:.4g} between {contacts.first[at]} and "
                f"{contacts.second[at]}, which do not touch in {disks.origin} ({int(apart.sum())} of these); do both "
                "files belong to the same state?"
            )
    return Matched(contacts, row, overlap, same, force)


def _compare_cells(disks: RawDisks, contacts: RawContacts) -> None:
    if contacts.cell is None or disks.cell is None:
        return
    off = float(np.abs(contacts.cell - disks.cell).max()) / float(np.abs(disks.cell).max())
    if off > SAME_CELL:
        raise SampleError(
            f"{contacts.origin}: its cell {contacts.cell.tolist()} is not the cell {disks.cell.tolist()} of "
            f"{disks.origin}: another time step, or other axes (a dump with triclinic/general beside one without)"
        )


def _places(disks: RawDisks, contacts: RawContacts, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    place = np.minimum(np.searchsorted(disks.identity, numbers), len(disks.identity) - 1)
    unknown = np.flatnonzero(disks.identity[place] != numbers)
    if len(unknown):
        raise SampleError(
            f"{contacts.origin}, line {contacts.line[unknown[0]]}: there is no disk with id = {numbers[unknown[0]]} in "
            f"{disks.origin}"
        )
    return place.astype(np.int64)


def stiffness_from_forces(matched: Matched, unit: float, remarks: list[str]) -> float:
    """Slope of the normal forces over the overlaps, if they lie on a line through zero."""
    assert matched.normal is not None
    known = np.isfinite(matched.normal)
    force, overlap = unit * matched.normal[known], matched.overlap[known]
    if not len(force) or not overlap @ force > 0.0:
        raise SampleError(f"{matched.contacts.origin}: no forces from which normal_stiffness could follow; give it")
    stiffness = float(overlap @ force / (overlap @ overlap))
    off = float(np.sqrt(np.mean((force - stiffness * overlap) ** 2)) / force.mean())
    if off > AGREEMENT:
        raise SampleError(
            f"{matched.contacts.origin}: normal forces are not proportional to overlaps (they are off by "
            f"{100 * off:.3g} % of their mean about the best line); a linear normal law is wanted: is it a Hertz law, "
            "or have coordinates too few digits?"
        )
    remarks.append(
        f"normal_stiffness = {stiffness:.6g} Pa follows from forces and overlaps (within {100 * off:.2g} % of the mean)"
    )
    return stiffness


def take_forces(matched: Matched, sample: Sample, unit: float, remarks: list[str]) -> bool:
    """Compare normal forces, take over tangential ones; whether there were any."""
    origin, column = matched.contacts.origin, matched.contacts.columns
    real = contacts_of(sample)
    if matched.normal is not None:
        known = np.isfinite(matched.normal)
        force = unit * matched.normal[known]
        mean = float(real.normal_force.mean()) if real.count else 1.0
        off = float(np.sqrt(np.mean((force - real.normal_force[known]) ** 2)) / mean) if known.any() else 0.0
        if off > AGREEMENT:
            overlap = matched.overlap[known]
            fit = float(overlap @ force / (overlap @ overlap))
            raise SampleError(
                f"{origin}: normal forces differ from kn x overlap by {100 * off:.3g} % of their mean with kn = "
                f"{sample.normal_stiffness:g} Pa; kn = {fit:.6g} Pa would fit best (normal_stiffness, force_unit and "
                "length_unit have to go together, and the law has to be linear)"
            )
    stiffness = sample.normal_stiffness * sample.stiffness_ratio
    has = matched.row >= 0
    if "tangential_elongation" in column and unit == 1.0:
        elongation = np.where(has, column["tangential_elongation"][matched.row], 0.0)
    else:
        tangential = _tangential(matched, real.normal)
        if tangential is None:
            return False
        elongation = -unit * tangential / stiffness
    limit = sample.friction * real.normal_force
    force = np.abs(stiffness * elongation)
    over = np.maximum(force - limit, 0.0)
    if over.sum() > OVER_LIMIT * force.sum():
        at = int(np.argmax(over))
        line = matched.contacts.line[matched.row[at]]
        raise SampleError(
            f"{origin}, line {line}: the tangential force is {force[at] / real.normal_force[at]:.4g} times the normal "
            f"one, above friction = {sample.friction:g}, as in {np.count_nonzero(over > OVER_LIMIT * limit)} contacts; "
            "is the friction larger, or the unit of force another?"
        )
    cap = limit / stiffness  # a kernel would take the excess off in the first step
    key = sample.pairs.first.astype(np.int64) * sample.count + sample.pairs.second
    place = np.searchsorted(key, real.key)
    sample.pairs.tangential[place] = np.where(np.abs(elongation) > cap, np.sign(elongation) * cap, elongation)
    balance = unbalanced_force(sample)
    if balance > SPOILT:
        other = sample.copy()
        other.pairs.tangential *= -1.0
        if unbalanced_force(other) < TURNED * balance:
            raise SampleError(
                f"{origin}: with the opposite sign the tangential forces would balance the disks (unbalanced force "
                f"{unbalanced_force(other):.2g} instead of {balance:.2g}); do they act on the other disk? Columns "
                "ft_x, ft_y are those on id2, ft1_x, ft1_y those on id1"
            )
    absent = int((~has).sum())
    if absent:
        remarks.append(f"{origin}: {absent} contacts of hardly any force are not in it; they get no tangential force")
    return True


def _tangential(matched: Matched, normal: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Tangential force on the second disk of each contact along its normal turned by +90 degrees, file's unit."""
    column, row, has = matched.contacts.columns, matched.row, matched.row >= 0
    if "ft" in column:  # the same whichever disk is called the second
        return np.where(has, column["ft"][row], 0.0)
    for name, sign in (("ft", 1.0), ("ft1", -1.0)):
        if f"{name}_x" in column:
            along = column[f"{name}_y"][row] * normal[:, 0] - column[f"{name}_x"][row] * normal[:, 1]
            return np.where(has, np.where(matched.same, sign, -sign) * along, 0.0)
    return None

"""From what a file tells to a sample: units, what is missing, whether it can be a packing, forces at contacts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, is_within
from granfabric.dem_ref.measures.contacts import contacts_of, love_weber_stress, unbalanced_force
from granfabric.dem_ref.sample.checks import misfit
from granfabric.dem_ref.sample.disks import LARGEST, SMALLEST, Sample, new_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

from .raw import KEYS, RawContacts, RawDisks

LAW = {
    "normal_stiffness": "contact stiffness kn [Pa: N per m of overlap and per m of thickness]",
    "stiffness_ratio": "kt/kn [-]",
    "friction": "coefficient of friction between disks [-]",
}
"""Numbers of the contact law that a packing needs."""
UNITS = ("length_unit", "force_unit")

DEEPEST = 0.2
"""Largest overlap over the smaller diameter."""
FARTHEST_PERIODS = 60.0
"""Most periods between a disk and the cell."""
COARSE = 0.02
"""Step of the coordinates over the mean overlap beyond which it can spoil the balance of forces."""
SPOILT = 0.05
"""Unbalanced force, over the mean contact force, of a packing that coarse coordinates have spoilt."""
AGREEMENT = 0.02
"""Largest difference between forces that are given and those that follow from overlaps, over their mean."""
WEAK = 1e-3
"""Force over its mean below which a contact may be missing in a list."""
OVER_LIMIT = 0.01
"""Share of the tangential forces beyond Coulomb's limit that damping and rounding explain; it is cut off."""
SAME_CELL = 1e-6
"""Largest difference between the cells of disks and of their contacts, over their size."""
TURNED = 0.3
"""An unbalanced force that falls to this share when all tangential forces change sign says that they are on the other
disk."""


@dataclass
class Imported:
    """A packing from a file of another code.

    Attributes
    ----------
    sample : Sample
    format : str
    remarks : list of str
        What was assumed or found, each a sentence.
    forces_given : bool
        Whether tangential forces came from the file; without them they are zero.
    """

    sample: Sample
    format: str = ""
    remarks: list[str] = field(default_factory=list)
    forces_given: bool = False


def assemble(disks: RawDisks, contacts: RawContacts | None, given: Mapping[str, float | None]) -> Imported:
    """A checked sample.

    Parameters
    ----------
    disks : RawDisks
    contacts : RawContacts, optional
    given : mapping
        Numbers of the contact law and units that win over those of the file.

    Raises
    ------
    SampleError
    """
    origin = disks.origin
    remarks = [f"{origin}: {text}" for text in disks.remarks]
    numbers = _numbers(disks, given, remarks)
    length, force = numbers.get("length_unit", 1.0), numbers.get("force_unit", 1.0)
    position, radius, cell = _geometry(disks, length)
    found: Sample
    try:
        # numbers of the law come later: forces may tell the stiffness
        found = new_sample(position, radius, cell, normal_stiffness=1.0)
    except (SampleError, CellTooSmallError) as error:
        raise SampleError(f"{origin}: {error}") from None
    _check_overlaps(disks, found)
    matched = None if contacts is None else _matched(disks, contacts, found)
    if matched is not None and "normal_stiffness" not in numbers and matched.normal is not None:
        numbers["normal_stiffness"] = _stiffness_from_forces(matched, force, remarks)
    sample = _with_law(disks, contacts, numbers, found)
    forces_given = False
    if matched is not None:
        forces_given = _take_forces(matched, sample, force, remarks)
    _check_digits(disks, sample, length)
    if not forces_given:
        remarks.append(
            f"{origin}: tangential forces are unknown and taken as zero; normal forces follow from the overlaps by "
            f"fn = kn x overlap with kn = {sample.normal_stiffness:g} Pa"
        )
    return Imported(sample, "", remarks, forces_given)


def _numbers(disks: RawDisks, given: Mapping[str, float | None], remarks: list[str]) -> dict[str, float]:
    numbers = dict(disks.keys)
    for name, value in given.items():
        if value is None:
            continue
        if name in numbers and numbers[name] != value:
            remarks.append(f"{name} = {value:g} as given, not {numbers[name]:g} as {disks.origin} says")
        numbers[name] = value
    for name in UNITS:
        if name in numbers and not is_within(numbers[name], SMALLEST, LARGEST):
            raise SampleError(f"{disks.origin}: {name} = {numbers[name]}, legal are finite values > 0")
    return numbers


def _geometry(
    disks: RawDisks, length: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    origin = disks.origin
    if disks.cell is None:
        raise SampleError(
            f"{origin}: the periodic cell is not told; give it as a line '# cell = WIDTH HEIGHT' (or both lattice "
            "vectors, '# cell = a_x a_y b_x b_y'), or as the option cell"
        )
    if not np.linalg.det(disks.cell) > 0.0:
        a, b = disks.cell.tolist()
        raise SampleError(
            f"{origin}: cell = {a}, {b} has the area {np.linalg.det(disks.cell):g}; legal are two vectors of which the "
            "second lies to the left of the first"
        )
    reduced = disks.position @ np.linalg.inv(disks.cell)
    away = np.abs(reduced - 0.5).max(axis=1)
    worst = int(np.argmax(away))
    if away[worst] > FARTHEST_PERIODS:
        x, y = disks.position[worst]
        raise SampleError(
            f"{origin}, line {disks.line[worst]}: the disk at x = {x:g}, y = {y:g} lies {away[worst]:.0f} periods away "
            f"from the cell {disks.cell.tolist()}; are both in the same unit?"
        )
    position, radius, cell = disks.position * length, disks.radius * length, disks.cell * length
    if reason := misfit(position, radius, cell):
        raise SampleError(f"{origin}: {reason} (are radii given where diameters are meant, or in another unit?)")
    return position, radius, cell


def _names(disks: RawDisks, first: int, second: int) -> str:
    return (
        f"{disks.identity[first]} (line {disks.line[first]}) and {disks.identity[second]} (line {disks.line[second]})"
    )


def _check_overlaps(disks: RawDisks, sample: Sample) -> None:
    contacts = contacts_of(sample)
    if not contacts.count:
        return
    overlap = contacts.normal_force / sample.normal_stiffness
    depth = overlap / (2.0 * np.minimum(sample.radius[contacts.first], sample.radius[contacts.second]))
    worst = int(np.argmax(depth))
    if depth[worst] > DEEPEST or not np.isfinite(depth).all():
        raise SampleError(
            f"{disks.origin}: the disks {_names(disks, int(contacts.first[worst]), int(contacts.second[worst]))} "
            f"overlap by {100 * depth[worst]:.3g} % of a diameter, legal is up to {100 * DEEPEST:g} %; are sizes radii "
            "where diameters are meant, or is the cell too small?"
        )


def _with_law(
    disks: RawDisks, contacts: RawContacts | None, numbers: Mapping[str, float], found: Sample
) -> Sample:
    missing = [name for name in LAW if name not in numbers]
    if missing:
        where = disks.origin if contacts is None else f"{disks.origin} and {contacts.origin}"
        wanted = "; ".join(f"{name}: {LAW[name]}" for name in missing)
        raise SampleError(
            f"{where}: nothing tells {_listed(missing)}, which cannot be read off disks; give {wanted} (as options, or "
            "in a table as lines '# KEY = VALUE')"
        )
    try:
        sample = new_sample(
            found.position, found.radius, found.cell, seed=disks.seed,
            **{name: float(numbers[name]) for name in LAW},
        )  # fmt: skip
    except SampleError as error:
        raise SampleError(f"{disks.origin}: {error}") from None
    return sample


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


@dataclass
class _Matched:
    """Rows of a list of contacts put beside the contacts that the disks have."""

    contacts: RawContacts
    row: NDArray[np.int64]
    """Row of each contact of the sample, -1 for those that the list lacks."""
    overlap: NDArray[np.float64]
    same: NDArray[np.bool_]
    """Whether the row's first disk is the contact's."""
    normal: NDArray[np.float64] | None
    """Normal force of each contact, in the file's unit; NaN where the list lacks it."""


def _matched(disks: RawDisks, contacts: RawContacts, sample: Sample) -> _Matched:
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
            f"that of {_names(disks, int(real.first[at]), int(real.second[at]))}; does it belong to another state?"
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
    return _Matched(contacts, row, overlap, same, force)


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


def _stiffness_from_forces(matched: _Matched, unit: float, remarks: list[str]) -> float:
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
            f"{100 * off:.3g} % of their mean about the best line); a linear normal law is wanted: is it a Hertz law, or "
            "have coordinates too few digits? normal_stiffness as an option is compared in the same way"
        )
    remarks.append(
        f"normal_stiffness = {stiffness:.6g} Pa follows from forces and overlaps (within {100 * off:.2g} % of the mean)"
    )
    return stiffness


def _take_forces(matched: _Matched, sample: Sample, unit: float, remarks: list[str]) -> bool:
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
                f"{unbalanced_force(other):.2g} instead of {balance:.2g}); do they act on the other disk? Columns ft_x, "
                "ft_y are those on id2, ft1_x, ft1_y those on id1"
            )
    absent = int((~has).sum())
    if absent:
        remarks.append(f"{origin}: {absent} contacts of hardly any force are not in it; they get no tangential force")
    return True


def _tangential(matched: _Matched, normal: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Tangential force on the second disk of each contact along its normal turned by +90 degrees, file's unit."""
    column, row, has = matched.contacts.columns, matched.row, matched.row >= 0
    if "ft" in column:  # the same whichever disk is called the second
        return np.where(has, column["ft"][row], 0.0)
    for name, sign in (("ft", 1.0), ("ft1", -1.0)):
        if f"{name}_x" in column:
            along = column[f"{name}_y"][row] * normal[:, 0] - column[f"{name}_x"][row] * normal[:, 1]
            return np.where(has, np.where(matched.same, sign, -sign) * along, 0.0)
    return None


def _check_digits(disks: RawDisks, sample: Sample, length: float) -> None:
    """Refuse a packing of which the file has not enough digits to tell its overlaps."""
    contacts = contacts_of(sample)
    farthest = float(np.abs(disks.position).max()) * length
    if not contacts.count or not farthest > 0.0:
        return
    step = 10.0 ** (floor(log10(farthest)) + 1 - disks.digits)
    overlap = float(contacts.normal_force.mean()) / sample.normal_stiffness
    balance = unbalanced_force(sample)
    if step > COARSE * overlap and balance > SPOILT:
        raise SampleError(
            f"{disks.origin}: coordinates of {disks.digits} digits are in steps of {step:.1g} m, the mean overlap is "
            f"{overlap:.2g} m, so that contact forces are lost in rounding (unbalanced force {balance:.2g}); write all "
            "digits, in LAMMPS by `dump_modify ID format float %.17g`"
        )


def summary(sample: Sample) -> str:
    """One line on an imported packing."""
    stress = love_weber_stress(sample)
    contacts = contacts_of(sample)
    p = -0.5 * float(stress[0] + stress[1])
    deviator = float(np.hypot(0.5 * (stress[0] - stress[1]), stress[2]))
    ratio = f"{deviator / p:.3g}" if p > 0.0 else "-"
    return (
        f"{sample.count} disks, {contacts.count} contacts, solid fraction {sample.solid_fraction:.4f}, "
        f"p = {p + 0.0:.4g} Pa, q/p = {ratio}, unbalanced force {unbalanced_force(sample, contacts):.2g}"
    )

"""From what a file tells to a sample: units, what is missing, whether it can be a packing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError, is_within
from granfabric.dem_ref.measures.contacts import contacts_of, love_weber_stress, unbalanced_force
from granfabric.dem_ref.sample.checks import LARGEST_LENGTH, misfit
from granfabric.dem_ref.sample.disks import LARGEST, SMALLEST, Sample, new_sample
from granfabric.dem_ref.sample.neighbours import CellTooSmallError

from .forces import SPOILT, matched_contacts, names_of, stiffness_from_forces, take_forces
from .raw import RawContacts, RawDisks

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
FEWEST_DIGITS = 4
"""Coordinates with fewer were not rounded but made up: a lattice, an example."""
COARSE = 0.02
"""Step of the coordinates over the mean overlap beyond which it can spoil the balance of forces."""


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
    matched = None if contacts is None else matched_contacts(disks, contacts, found)
    if matched is not None and "normal_stiffness" not in numbers and matched.normal is not None:
        numbers["normal_stiffness"] = stiffness_from_forces(matched, force, remarks)
    sample = _with_law(disks, contacts, numbers, found)
    forces_given = False
    if matched is not None:
        forces_given = take_forces(matched, sample, force, remarks)
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
    if not np.abs(disks.cell).max() < LARGEST_LENGTH:
        raise SampleError(f"{origin}: cell = {disks.cell.tolist()} is too large for its area to be a number")
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


def _check_overlaps(disks: RawDisks, sample: Sample) -> None:
    contacts = contacts_of(sample)
    if not contacts.count:
        return
    overlap = contacts.normal_force / sample.normal_stiffness
    depth = overlap / (2.0 * np.minimum(sample.radius[contacts.first], sample.radius[contacts.second]))
    worst = int(np.argmax(depth))
    if depth[worst] > DEEPEST or not np.isfinite(depth).all():
        raise SampleError(
            f"{disks.origin}: the disks {names_of(disks, int(contacts.first[worst]), int(contacts.second[worst]))} "
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


def _check_digits(disks: RawDisks, sample: Sample, length: float) -> None:
    """Refuse a packing of which the file has not enough digits to tell its overlaps."""
    contacts = contacts_of(sample)
    farthest = float(np.abs(disks.position).max()) * length
    if not contacts.count or not farthest > 0.0 or disks.digits < FEWEST_DIGITS:
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

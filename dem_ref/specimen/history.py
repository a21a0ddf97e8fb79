"""What is recorded of a specimen: strains, forces of its platens, contacts, energies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from granfabric.dem_ref.dynamics.stepping import CARRYING
from granfabric.dem_ref.measures.contacts import (
    Contacts,
    component_along,
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    sliding_fraction,
)

from .bounded_steps import DRAG_HEAT, FOLLOWING_WORK, FRICTION_HEAT, GIVEN_WORK, PLATEN_WORK

if TYPE_CHECKING:
    from .specimen import Specimen

COLUMNS = (
    "axial_strain", "volumetric_strain", "height", "width", "upper_force", "lower_force", "upper_shear", "lower_shear",
    "axial_stress", "stress_ratio", "coordination", "fabric_anisotropy", "sliding_fraction", "unbalanced_force",
    "elastic_energy", "kinetic_energy", "platen_work", "given_work", "following_work", "friction_heat", "drag_heat",
    "energy_error", "dem_steps",
)  # fmt: skip

UPWARDS = 0.5 * np.pi
"""Direction of the compression, along which the anisotropy is signed."""


def energies(specimen: Specimen, contacts: Contacts | None = None) -> tuple[float, float, float]:
    """Elastic energy of contacts, that of the platens' contacts, and kinetic energy; J per metre."""
    sample = specimen.sample
    kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
    found = contacts_of(sample) if contacts is None else contacts
    inner = 0.5 * float(np.sum(found.normal_force**2) / kn + np.sum(found.tangential_force**2) / kt)
    outer = specimen.platen_contacts()
    stored = 0.5 * float(np.sum(outer.normal_force**2) / kn + np.sum(outer.shear_force**2) / kt)
    return inner, stored, 0.5 * kn / specimen.step**2 * float(np.sum(specimen.velocity[:, :3] ** 2))


def lateral_strain(specimen: Specimen, contacts: Contacts) -> float:
    """Widening since the consolidation: of the line that fits the displacements along x best, of disks that carry."""
    start = specimen.start
    assert start is not None
    number = np.bincount(np.concatenate([contacts.first, contacts.second]), minlength=specimen.sample.count)
    carry = number >= CARRYING
    x, moved = start.position[carry, 0], specimen.sample.position[carry, 0] - start.position[carry, 0]
    if len(x) < CARRYING:
        return 0.0
    apart = x - x.mean()
    return float(apart @ (moved - moved.mean()) / (apart @ apart))


def row(specimen: Specimen) -> list[float]:
    """Values of `COLUMNS`, now."""
    start = specimen.start
    assert start is not None
    contacts = contacts_of(specimen.sample)
    tally, forces = specimen.tally, specimen.reactions
    width = specimen.area / specimen.height
    inner, outer, kinetic = energies(specimen, contacts)
    elastic = inner + outer - start.elastic_energy
    balance = (
        tally[PLATEN_WORK] + tally[GIVEN_WORK] - tally[FRICTION_HEAT] - tally[DRAG_HEAT] + tally[FOLLOWING_WORK]
        - elastic - kinetic
    )  # fmt: skip
    axial = float(0.5 * forces[:, 0].sum() / width)
    ratio = (axial - specimen.pressure) / (axial + specimen.pressure)
    strain, wider = specimen.axial_strain, lateral_strain(specimen, contacts)
    return [
        strain, strain - wider, specimen.height, width, forces[1, 0], forces[0, 0], forces[1, 1], forces[0, 1], axial,
        ratio, coordination_number(specimen.sample, contacts).all_particles,
        component_along(fabric_anisotropy(contacts), UPWARDS), sliding_fraction(specimen.sample, contacts),
        specimen.unbalanced_force, elastic, kinetic, tally[PLATEN_WORK], tally[GIVEN_WORK], tally[FOLLOWING_WORK],
        tally[FRICTION_HEAT], tally[DRAG_HEAT], balance, float(specimen.steps_done),
    ]  # fmt: skip

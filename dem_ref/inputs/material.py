"""The material table of the point law, measured on a packing.

Everything comes from the packing itself, from probes that go no further than q/p = 0.05, and from an isotropic
unloading:

===============================================  ===============================================================
the packing at rest                              coordination, solid_fraction, force_density_at_zero,
                                                 force_density_slope, gap_density_at_zero, neighbours
elastic probes of 0.2 % of p                     bulk_reduction, shear_reduction, weak_contact_ratio,
                                                 weak_contact_gradient, elastic_scatter,
                                                 elastic_scatter_isotropic, fluctuation, tangential_force_ratio,
                                                 slip_delay (with the friction coefficient)
an isotropic unloading by 60 %                   weak_contact_ratio_isotropic, tangential_force_loss
one by 80 %                                      isostatic_coordination
loops to q/p = 0.05                              force_anisotropy_ratio, slip, irreversible_scatter
===============================================  ===============================================================

Each value comes with the standard error of one packing against the mean of many made alike (`uncertainty`).
"""

from __future__ import annotations

import numpy as np

from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import (
    Contacts,
    bearing_particles,
    contacts_of,
    coordination_number,
    fabric_anisotropy,
    force_harmonics,
    love_weber_stress,
    rattler_minimum,
)
from granfabric.dem_ref.measures.distribution import FORCE_WINDOW, edge_errors, force_distribution
from granfabric.dem_ref.measures.tessellation import (
    closing_gap_density,
    gap_distribution,
    radical_neighbours,
    solid_fraction_error,
)
from granfabric.dem_ref.measures.uncertainty import Measured, blocks_of, blocks_of_contacts, jackknife
from granfabric.dem_ref.sample.disks import Sample, SampleError

from .probes import at_rest, elastic_moduli, elastic_probes, moduli_errors
from .unloading import measure_unloading
from .weak_contacts import LOOP_STRESS_RATIO, measure_slip_with_errors, measure_weak_contacts, weak_contact_errors

RATTLERS = ("included", "excluded")
MATERIAL_KEYS = (
    "coordination", "solid_fraction", "normal_stiffness", "stiffness_ratio", "force_density_at_zero",
    "force_density_slope", "gap_density_at_zero", "neighbours", "force_anisotropy_ratio", "bulk_reduction",
    "shear_reduction", "isostatic_coordination",
)  # fmt: skip
CLOSURE_KEYS = (
    "weak_contact_ratio", "weak_contact_ratio_isotropic", "weak_contact_gradient", "elastic_scatter",
    "elastic_scatter_isotropic", "irreversible_scatter", "tangential_force_ratio", "tangential_force_loss", "slip",
    "slip_delay", "fluctuation",
)  # fmt: skip

CLOSING_FORCE = 0.2
"""Gaps are counted up to the displacement that changes a contact force by this fraction of the mean force: the density
of gaps diverges weakly at zero, and loading closes those that lie within such displacements."""
ISOTROPIC = 0.01
"""Largest q/p of a packing that counts as isotropic; what a packing is left with after it was made is below 1e-6."""


def measure_material(
    sample: Sample, rattlers: str = "included", loop_stress_ratio: float = LOOP_STRESS_RATIO
) -> dict[str, float]:
    """The values of `measure_material_with_errors`."""
    measured = measure_material_with_errors(sample, rattlers, loop_stress_ratio)
    return {name: entry.value for name, entry in measured.items()}


def measure_material_with_errors(
    sample: Sample, rattlers: str = "included", loop_stress_ratio: float = LOOP_STRESS_RATIO
) -> dict[str, Measured]:
    """All inputs of the point law but those of sliding, measured on an isotropic packing and on small probes of it.

    Parameters
    ----------
    sample : Sample
        Under isotropic stress, friction on; not changed. If it is not at rest, a copy held at its stress is measured.
    rattlers : str
        ``"included"``: coordination over all particles, to which the uniform-strain moduli and the mean force refer;
        ``"excluded"``: without rattlers. The isostatic coordination follows the same counting.
    loop_stress_ratio : float
        q/p of the loops at constant p.

    Returns
    -------
    dict of str to Measured
        Keys `MATERIAL_KEYS` (the scene's table ``[material]``) and `CLOSURE_KEYS` (its table ``[closure]``); values
        that the packing does not give are NaN.

    Raises
    ------
    SampleError
        If the sample has no pressure, or is not isotropic.
    ProbeError
        If it does not come to rest, or does not carry a probe.
    """
    if rattlers not in RATTLERS:
        raise SampleError(f"rattlers is '{rattlers}', legal are 'included' and 'excluded'")
    sample = at_rest(sample)
    contacts = contacts_of(sample)
    p, q, _ = stress_invariants(love_weber_stress(sample, contacts))
    if q > ISOTROPIC * p:
        raise SampleError(f"the sample carries q/p = {q / p:.3g}, the inputs are measured on an isotropic packing")
    neighbours = radical_neighbours(sample)
    window = CLOSING_FORCE * mean_overlap(sample) / sample.mean_diameter
    gaps = gap_distribution(sample, neighbours, window)
    isotropic, shear = elastic_probes(sample)
    moduli = elastic_moduli(sample, isotropic, shear)
    bulk_error, shear_error = moduli_errors(isotropic, shear)
    weak = measure_weak_contacts(sample, isotropic, shear)
    weak_error = weak_contact_errors(sample, isotropic, shear)
    loop, loop_error = measure_slip_with_errors(sample, loop_stress_ratio)
    block = blocks_of_contacts(sample, contacts)
    line = force_distribution(contacts).at_zero
    line_errors = edge_errors(contacts.normal_force, block, FORCE_WINDOW)
    density, slope = Measured(line.value, line_errors[0]), Measured(line.slope, line_errors[1])
    tangential = Measured(weak.tangential_ratio, weak_error.tangential_ratio)
    modulus = Measured(moduli.shear, shear_error * moduli.shear)
    unloading = measure_unloading(sample, density, slope, tangential, modulus, rattlers)
    bearing = bearing_particles(sample.count, contacts, rattler_minimum(sample))
    return {
        "coordination": _coordination(sample, contacts, rattlers),
        "solid_fraction": Measured(sample.solid_fraction, solid_fraction_error(sample)),
        "normal_stiffness": Measured(sample.normal_stiffness, 0.0),
        "stiffness_ratio": Measured(sample.stiffness_ratio, 0.0),
        "force_density_at_zero": density,
        "force_density_slope": slope,
        "gap_density_at_zero": closing_gap_density(sample, neighbours, window, bearing),
        "neighbours": Measured(gaps.neighbours, 0.0),
        "force_anisotropy_ratio": Measured(loop.force_anisotropy_ratio, loop_error.force_anisotropy_ratio),
        "bulk_reduction": Measured(moduli.bulk_reduction, bulk_error * moduli.bulk_reduction),
        "shear_reduction": Measured(moduli.shear_reduction, shear_error * moduli.shear_reduction),
        "isostatic_coordination": unloading.isostatic,
        "weak_contact_ratio": Measured(weak.ratio, weak_error.ratio),
        "weak_contact_ratio_isotropic": unloading.ratio,
        "weak_contact_gradient": Measured(weak.gradient, weak_error.gradient),
        "elastic_scatter": Measured(weak.scatter, weak_error.scatter),
        "elastic_scatter_isotropic": Measured(weak.scatter_isotropic, weak_error.scatter_isotropic),
        "irreversible_scatter": Measured(loop.irreversible_scatter, loop_error.irreversible_scatter),
        "tangential_force_ratio": tangential,
        "tangential_force_loss": unloading.tangential_loss,
        "slip": Measured(loop.slip, loop_error.slip),
        "slip_delay": _slip_delay(sample.friction, weak.tangential_response, weak_error.tangential_response),
        "fluctuation": Measured(weak.fluctuation, weak_error.fluctuation),
    }


def measure_fabric(sample: Sample) -> tuple[Measured, Measured]:
    """Fabric anisotropy of a packing, components along cos 2 theta and sin 2 theta; near zero, isotropic on average."""
    contacts = contacts_of(sample)
    block = blocks_of_contacts(sample, contacts)
    value = fabric_anisotropy(contacts)
    error = jackknife(lambda without: fabric_anisotropy(contacts.subset(block != without)))
    return Measured(float(value[0]), float(error[0])), Measured(float(value[1]), float(error[1]))


def _coordination(sample: Sample, contacts: Contacts, rattlers: str) -> Measured:
    z = coordination_number(sample, contacts)
    held = np.ones(sample.count, bool)
    if rattlers == "excluded":
        held = bearing_particles(sample.count, contacts, rattler_minimum(sample))
    kept = held[contacts.first] & held[contacts.second]
    ends = np.concatenate([contacts.first[kept], contacts.second[kept]])
    number = np.bincount(ends, minlength=sample.count)
    block = blocks_of(sample.position, sample.cell)
    error = float(jackknife(lambda without: number[held & (block != without)].mean()))
    return Measured(z.all_particles if rattlers == "included" else z.without_rattlers, error)


def _slip_delay(friction: float, response: float, response_error: float) -> Measured:
    """Friction over the tangential forces that a probe calls up at weak contacts; NaN where it calls up none.

    Without friction there are none at all.
    """
    if not response > 0.0:
        return Measured(float("nan"), float("nan"))
    delay = friction / response
    return Measured(delay, delay * response_error / response)


def mean_overlap(sample: Sample) -> float:
    """Mean normal force over kn [m]."""
    return force_harmonics(contacts_of(sample)).mean / sample.normal_stiffness

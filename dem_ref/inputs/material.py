"""The material table of the point law, measured on a packing.

Everything comes from the packing itself or from probes that go no further than 5 % in p and q/p = 0.05:

===============================================  ===============================================================
the packing at rest                              coordination, solid_fraction, force_density_at_zero,
                                                 gap_density_at_zero, neighbours
elastic probes of 0.2 % of p                     bulk_reduction, shear_reduction, weak_contact_ratio,
                                                 weak_contact_ratio_isotropic, elastic_scatter,
                                                 elastic_scatter_isotropic, fluctuation, tangential_force_ratio,
                                                 slip_delay (with the friction coefficient)
an isotropic unloading by 5 %                    isostatic_coordination
loops to q/p = 0.05                              force_anisotropy_ratio, slip, irreversible_scatter
===============================================  ===============================================================
"""

from __future__ import annotations

from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, force_harmonics, love_weber_stress
from granfabric.dem_ref.measures.distribution import force_distribution
from granfabric.dem_ref.measures.tessellation import gap_distribution
from granfabric.dem_ref.sample.disks import Sample, SampleError

from .probes import ELASTIC_LIMITS, elastic_moduli, elastic_probes, shear_modulus, stress_probe
from .weak_contacts import LOOP_STRESS_RATIO, measure_slip, measure_weak_contacts

RATTLERS = ("included", "excluded")
MATERIAL_KEYS = (
    "coordination", "solid_fraction", "normal_stiffness", "stiffness_ratio", "force_density_at_zero",
    "gap_density_at_zero", "neighbours", "force_anisotropy_ratio", "bulk_reduction", "shear_reduction",
    "isostatic_coordination",
)  # fmt: skip
CLOSURE_KEYS = (
    "weak_contact_ratio", "weak_contact_ratio_isotropic", "elastic_scatter", "elastic_scatter_isotropic",
    "irreversible_scatter", "tangential_force_ratio", "slip", "slip_delay", "fluctuation",
)  # fmt: skip

CLOSING_FORCE = 0.2
"""Gaps are counted up to the displacement that changes a contact force by this share of the mean force: the density of
gaps diverges weakly at zero, and loading closes those that lie within such displacements."""
UNLOADING = 0.05
"""Share of p taken off to see how the shear modulus falls with the coordination number."""


def measure_material(
    sample: Sample, rattlers: str = "included", loop_stress_ratio: float = LOOP_STRESS_RATIO
) -> dict[str, float]:
    """All inputs of the point law but those of sliding, measured on an isotropic packing and on small probes of it.

    Parameters
    ----------
    sample : Sample
        At rest under isotropic stress, friction on; not changed.
    rattlers : str
        ``"included"``: coordination over all particles, to which the uniform-strain moduli and the mean force refer;
        ``"excluded"``: without rattlers. The isostatic coordination follows the same counting: it is where the straight
        line through the elastic shear moduli before and after an isotropic unloading, over z, reaches zero.
    loop_stress_ratio : float
        q/p of the loops at constant p.

    Returns
    -------
    dict
        Keys `MATERIAL_KEYS` (the scene's table ``[material]``) and `CLOSURE_KEYS` (its table ``[closure]``).
    """
    if rattlers not in RATTLERS:
        raise SampleError(f"rattlers is '{rattlers}', legal are 'included' and 'excluded'")
    contacts = contacts_of(sample)
    z = coordination_number(sample, contacts)
    gaps = gap_distribution(sample, window=CLOSING_FORCE * mean_overlap(sample) / sample.mean_diameter)
    isotropic, shear = elastic_probes(sample)
    moduli = elastic_moduli(sample, isotropic, shear)
    weak = measure_weak_contacts(sample, isotropic, shear)
    loop = measure_slip(sample, loop_stress_ratio)
    return {
        "coordination": z.all_particles if rattlers == "included" else z.without_rattlers,
        "solid_fraction": sample.solid_fraction,
        "normal_stiffness": sample.normal_stiffness,
        "stiffness_ratio": sample.stiffness_ratio,
        "force_density_at_zero": force_distribution(contacts).at_zero.value,
        "gap_density_at_zero": gaps.mean_density,
        "neighbours": gaps.neighbours,
        "force_anisotropy_ratio": loop.force_anisotropy_ratio,
        "bulk_reduction": moduli.bulk_reduction,
        "shear_reduction": moduli.shear_reduction,
        "isostatic_coordination": isostatic_coordination(sample, moduli.shear, rattlers),
        "weak_contact_ratio": weak.ratio,
        "weak_contact_ratio_isotropic": weak.ratio_isotropic,
        "elastic_scatter": weak.scatter,
        "elastic_scatter_isotropic": weak.scatter_isotropic,
        "irreversible_scatter": loop.irreversible_scatter,
        "tangential_force_ratio": weak.tangential_ratio,
        "slip": loop.slip,
        "slip_delay": sample.friction / weak.tangential_response,
        "fluctuation": weak.fluctuation,
    }


def mean_overlap(sample: Sample) -> float:
    """Mean normal force over kn [m]."""
    return force_harmonics(contacts_of(sample)).mean / sample.normal_stiffness


def isostatic_coordination(sample: Sample, modulus: float, rattlers: str) -> float:
    """Coordination number where a straight line through G(z) reaches zero; G [Pa] of the packing itself is given."""
    p = stress_invariants(love_weber_stress(sample))[0]
    unloaded = stress_probe(sample, -UNLOADING * p, 0.0, limits=ELASTIC_LIMITS).sample
    before, after = coordination_number(sample), coordination_number(unloaded)
    counted = "all_particles" if rattlers == "included" else "without_rattlers"
    z0, z1 = getattr(before, counted), getattr(after, counted)
    softening = 1.0 - shear_modulus(unloaded) / modulus
    return z0 - (z0 - z1) / softening if softening > 0.0 else float("nan")

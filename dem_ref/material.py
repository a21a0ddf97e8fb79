"""The material table of the point law, measured on a packing."""

from __future__ import annotations

from dem_ref.distribution import force_distribution
from dem_ref.measure import contacts_of, coordination_number
from dem_ref.probes import loading_loop, measure_elasticity, settled, shear_modulus
from dem_ref.sample import Sample, SampleError
from dem_ref.tessellation import gap_distribution

RATTLERS = ("included", "excluded")
MATERIAL_KEYS = (
    "coordination", "solid_fraction", "normal_stiffness", "stiffness_ratio", "force_density_at_zero",
    "gap_density_at_zero", "neighbours", "force_anisotropy_ratio", "bulk_reduction", "shear_reduction",
    "isostatic_coordination",
)  # fmt: skip
CLOSURE_KEYS = ("weak_contact_ratio", "weak_contact_ratio_isotropic", "elastic_scatter", "fluctuation")


def measure_material(sample: Sample, rattlers: str = "included", loop_stress_ratio: float = 0.2) -> dict[str, float]:
    """All inputs of the point law, measured on an isotropic packing and on small probes of it.

    Parameters
    ----------
    sample : Sample
        At rest under isotropic stress, friction on; not changed.
    rattlers : str
        ``"included"``: coordination over all particles, to which the uniform-strain moduli and the mean force refer;
        ``"excluded"``: without rattlers. The isostatic coordination follows the same counting: it is where the straight
        line through the elastic shear moduli at the start and at the top of the loop, over z, reaches zero.
    loop_stress_ratio : float
        q/p of the loop at constant p from which the force anisotropy ratio and the fluctuation come.

    Returns
    -------
    dict
        Keys `MATERIAL_KEYS` (the scene's table ``[material]``) and `CLOSURE_KEYS` (its table ``[closure]``).
    """
    if rattlers not in RATTLERS:
        raise SampleError(f"rattlers is '{rattlers}', legal are 'included' and 'excluded'")
    contacts = contacts_of(sample)
    z = coordination_number(sample, contacts)
    forces = force_distribution(contacts)
    gaps = gap_distribution(sample)
    moduli, weak = measure_elasticity(sample)
    loop = loading_loop(sample, loop_stress_ratio)
    top = settled(loop.loaded)
    z_top = coordination_number(top)
    z0, z1 = (
        (z.all_particles, z_top.all_particles)
        if rattlers == "included"
        else (z.without_rattlers, z_top.without_rattlers)
    )
    softening = 1.0 - shear_modulus(top) / shear_modulus(sample)
    isostatic = z0 - (z0 - z1) / softening
    return {
        "coordination": z0,
        "solid_fraction": sample.solid_fraction,
        "normal_stiffness": sample.normal_stiffness,
        "stiffness_ratio": sample.stiffness_ratio,
        "force_density_at_zero": forces.at_zero.value,
        "gap_density_at_zero": gaps.at_zero.value,
        "neighbours": gaps.neighbours,
        "force_anisotropy_ratio": loop.force_anisotropy_ratio,
        "bulk_reduction": moduli.bulk_reduction,
        "shear_reduction": moduli.shear_reduction,
        "isostatic_coordination": isostatic,
        "weak_contact_ratio": weak.ratio,
        "weak_contact_ratio_isotropic": weak.ratio_isotropic,
        "elastic_scatter": weak.scatter,
        "fluctuation": loop.fluctuation,
    }

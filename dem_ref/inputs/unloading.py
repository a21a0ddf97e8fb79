"""What an isotropic unloading takes from the network: inputs for paths on which the pressure falls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, love_weber_stress
from granfabric.dem_ref.measures.events import network_change
from granfabric.dem_ref.measures.uncertainty import Measured
from granfabric.dem_ref.sample.disks import Sample

from .probes import ProbeError, elastic_moduli, elastic_probes, moduli_errors, stress_probe
from .weak_contacts import measure_weak_contacts, weak_contact_errors

UNLOADED = 0.4
"""Pressure at which lost contacts are counted, over the initial one: far enough that their number is known to some 3 %,
and in the middle of the range for which it is wanted, because loss slows down as the pressure falls."""
SOFTENED = 0.2
"""Pressure at which the shear modulus is measured again: what is left of it, a sixth, tells where it vanishes."""

NOTHING = Measured(float("nan"), float("nan"))


@dataclass(frozen=True)
class Unloading:
    """What is measured.

    Attributes
    ----------
    ratio : Measured
        chi_p: shift of weak forces over the change of pressure, from the number of contacts that it loses.
    tangential_loss : Measured
        kappa: c_t falls as ``exp(-kappa (Lambda + Lambda^2/2))`` with what is lost, ``Lambda = P0 chi_p (1 - p/p_0)``.
        NaN where nothing is lost, or no tangential forces are called up.
    isostatic : Measured
        z_iso: coordination number at which the shear modulus vanishes; see `isostatic_coordination`.
    """

    ratio: Measured
    tangential_loss: Measured
    isostatic: Measured


def shift_that_loses(fraction: float, p0: float, slope: float) -> float:
    """Shift D below zero at which a line of forces P0 + P0' F has lost this fraction of all contacts.

    ``fraction = 1 - exp(-Lambda - Lambda^2/2)``, ``Lambda = P0 D + P0' D^2/2``; NaN if the line does not hold as many.
    """
    if not (p0 > 0.0 and 0.0 <= fraction < 1.0):
        return float("nan")
    lost = float(np.sqrt(1.0 - 2.0 * np.log1p(-fraction)) - 1.0)
    square = p0 * p0 + 2.0 * slope * lost
    return 2.0 * lost / (p0 + float(np.sqrt(square))) if square > 0.0 else float("nan")


def isostatic_coordination(z: tuple[float, float], counted: float, shear: tuple[Measured, Measured]) -> Measured:
    """Coordination number at which the shear modulus vanishes, from its values before and after an unloading.

    The modulus over its uniform-strain estimate, G/z up to a constant, falls on a straight line in z. Disks with
    friction 0.5 and kt = kn stay within 0.03 of it between the initial pressure and a tenth of it, and the line ends at
    z = 3.0 to 3.1 counted without rattlers, where theory has 3; counted with them that is 2.4 to 2.5.

    Parameters
    ----------
    z : tuple of 2 floats
        Before and after.
    counted : float
        Standard error of the second.
    shear : tuple of 2 Measured
        Shear moduli before and after [Pa].

    Returns
    -------
    Measured
        NaN if the modulus over its estimate does not fall.
    """
    (z0, z1), (before, after) = z, shear
    left = after.value / before.value * z0 / z1
    softening = 1.0 - left
    if not softening > 0.0:
        return NOTHING
    of_moduli = left * float(np.hypot(before.error / before.value, after.error / after.value))
    # by z1: directly, and because the estimate goes with it
    of_count = counted * (1.0 / softening + (z0 - z1) / softening**2 * left / z1)
    return Measured(z0 - (z0 - z1) / softening, float(np.hypot(of_count, (z0 - z1) / softening**2 * of_moduli)))


def _isostatic(sample: Sample, unloaded: Sample, p: float, before: Measured, rattlers: str) -> Measured:
    """z_iso from a further unloading; `p` [Pa] is the pressure of the sample. NaN if it does not carry that."""
    contacts = contacts_of(sample)
    try:
        softened = stress_probe(unloaded, (SOFTENED - UNLOADED) * p, 0.0).sample
    except ProbeError:  # a few disks may fall apart; they do not tell
        return NOTHING
    isotropic, shear = elastic_probes(softened)
    modulus = elastic_moduli(softened, isotropic, shear).shear
    after = Measured(modulus, moduli_errors(isotropic, shear)[1] * modulus)
    counting = "all_particles" if rattlers == "included" else "without_rattlers"
    z0, z1 = (getattr(coordination_number(each), counting) for each in (sample, softened))
    lost = network_change(contacts, contacts_of(softened), sample.count).lost
    return isostatic_coordination((z0, z1), z0 * float(np.sqrt(lost)) / contacts.count, (before, after))


def measure_unloading(
    sample: Sample,
    density: Measured,
    slope: Measured,
    tangential_ratio: Measured,
    shear_modulus: Measured,
    rattlers: str = "included",
) -> Unloading:
    """Unload an isotropic packing to `UNLOADED` and on to `SOFTENED` of its pressure; it is not changed.

    Parameters
    ----------
    sample : Sample
        At rest.
    density, slope : Measured
        P0 and P0'.
    tangential_ratio, shear_modulus : Measured
        c_t and G [Pa] before the unloading.
    rattlers : str
        ``"included"`` or ``"excluded"``: what z_iso counts.

    Raises
    ------
    ProbeError
        If it does not come to rest at the lower pressure.
    """
    p = stress_invariants(love_weber_stress(sample))[0]
    probe = stress_probe(sample, (UNLOADED - 1.0) * p, 0.0)
    lost, number = probe.change.lost, probe.before.count
    fall = 1.0 - UNLOADED
    ratio = shift_that_loses(lost / number, density.value, slope.value) / fall
    counted = 1.0 / np.sqrt(max(lost, 1))
    error = ratio * float(np.hypot(counted, density.error / density.value if density.value > 0.0 else np.nan))
    isotropic, shear = elastic_probes(probe.sample)
    after = measure_weak_contacts(probe.sample, isotropic, shear)
    after_error = weak_contact_errors(probe.sample, isotropic, shear)
    left = density.value * ratio * fall
    exponent = left + 0.5 * left * left
    isostatic = _isostatic(sample, probe.sample, p, shear_modulus, rattlers)
    before, present = tangential_ratio.value, after.tangential_ratio
    if not (before > 0.0 and present > 0.0 and exponent > 0.0):
        return Unloading(Measured(ratio, error), NOTHING, isostatic)
    kappa = float(np.log(before / present)) / exponent
    of_ratios = float(np.hypot(tangential_ratio.error / before, after_error.tangential_ratio / present))
    kappa_error = float(np.hypot(of_ratios / exponent, kappa * counted))
    # a packing whose c_t grows by the scatter of so few contacts has no negative loss
    return Unloading(Measured(ratio, error), Measured(max(kappa, 0.0), kappa_error), isostatic)

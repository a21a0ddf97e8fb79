"""Small stress probes on a sample, and what contacts with small forces do in them."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from dem_ref.distribution import force_distribution
from dem_ref.events import NetworkChange, match_contacts, network_change
from dem_ref.legs import Leg, axial_stress_ratio, biaxial_leg, stress_invariants, stress_leg
from dem_ref.measure import Contacts, contacts_of, force_harmonics, love_weber_stress
from dem_ref.motion import Motion
from dem_ref.sample import Sample
from dem_ref.servo import Loading, RateLimits

ELASTIC_PROBE = 2.0e-3
PROBE_LIMITS = RateLimits(inertial_number=3.0e-6, unbalanced_force=1.0e-4)
ELASTIC_LIMITS = RateLimits(inertial_number=1.0e-6, unbalanced_force=1.0e-5, lag=1.0e-3)
WEAK_FORCE = 0.15  # of the mean normal force


class ProbeError(RuntimeError):
    """A probe did not settle at its target stress."""


@dataclass(frozen=True)
class Probe:
    """A stress probe.

    Attributes
    ----------
    sample : Sample
        After the probe.
    stress_change, strain_change : (3,)
        xx, yy, xy; tension positive, tensor shear strain.
    before, after : Contacts
    change : NetworkChange
    """

    sample: Sample
    stress_change: NDArray[np.float64]
    strain_change: NDArray[np.float64]
    before: Contacts
    after: Contacts
    change: NetworkChange


def stress_probe(
    sample: Sample,
    dp: float,
    dq: float,
    angle: float = np.pi / 2,
    limits: RateLimits | None = None,
    steps: int = 2_000_000,
) -> Probe:
    """Add a stress increment and let the sample settle; the sample itself is not changed.

    Parameters
    ----------
    dp, dq : float
        Pa; change of p, and of the deviator (negative allowed) with its major compression along `angle` (radians from
        the x axis).
    """
    after = sample.copy()
    motion = Motion(after)
    stress = love_weber_stress(sample)
    motion.stress[:] = stress
    increment = -np.array([dp + dq * cos(2 * angle), dp - dq * cos(2 * angle), dq * sin(2 * angle)])
    if not Loading(motion, stress_leg(stress + increment), limits or PROBE_LIMITS).run(steps):
        raise ProbeError(f"the probe dp = {dp:.4g}, dq = {dq:.4g} did not settle within {steps} steps")
    c0, c1 = contacts_of(sample), contacts_of(after)
    return Probe(
        after,
        love_weber_stress(after) - stress,
        after.strain - sample.strain,
        c0,
        c1,
        network_change(c0, c1, sample.count),
    )


@dataclass(frozen=True)
class ElasticModuli:
    """Elastic moduli of the packing against uniform strain.

    Attributes
    ----------
    bulk, shear : float
        ``dp/d(eps_v)`` and ``dq/d(eps_1 - eps_2)``, Pa.
    bulk_uniform, shear_uniform : float
        ``z phi kn/(2 pi)`` and ``z phi (kn + kt)/(4 pi)`` with z over all particles.
    bulk_reduction, shear_reduction : float
        Measured over uniform-strain estimate.
    """

    bulk: float
    shear: float
    bulk_uniform: float
    shear_uniform: float

    @property
    def bulk_reduction(self) -> float:
        """Measured bulk modulus over the uniform-strain estimate."""
        return self.bulk / self.bulk_uniform

    @property
    def shear_reduction(self) -> float:
        """Measured shear modulus over the uniform-strain estimate."""
        return self.shear / self.shear_uniform


@dataclass(frozen=True)
class WeakContacts:
    """What contacts with small forces feel of the mean change of force in their direction (elastic probes).

    Attributes
    ----------
    ratio : float
        chi: their change over the mean change of their direction, in the limit of zero force; shear probes.
    ratio_isotropic : float
        chi_p: the same for isotropic probes.
    scatter : float
        c_e: standard deviation about that over the amplitude ``chi |w|`` of the shifted harmonic.
    """

    ratio: float
    ratio_isotropic: float
    scatter: float


def uniform_strain_moduli(sample: Sample, contacts: Contacts | None = None) -> tuple[float, float]:
    """``K = z phi kn/(2 pi)`` and ``G = z phi (kn + kt)/(4 pi)``, z over all particles."""
    c = contacts or contacts_of(sample)
    z = 2.0 * c.count / sample.count
    kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
    return z * sample.solid_fraction * kn / (2 * np.pi), z * sample.solid_fraction * (kn + kt) / (4 * np.pi)


def _elastic_probes(sample: Sample, size: float) -> tuple[list[Probe], list[Probe]]:
    p = stress_invariants(love_weber_stress(sample))[0]
    isotropic = [stress_probe(sample, sign * size * p, 0.0, limits=ELASTIC_LIMITS) for sign in (1.0, -1.0)]
    shear = [stress_probe(sample, 0.0, size * p, angle, limits=ELASTIC_LIMITS) for angle in (0.5 * np.pi, 0.25 * np.pi)]
    return isotropic, shear


def _bulk(probe: Probe) -> float:
    return float((probe.stress_change[0] + probe.stress_change[1]) / (2.0 * probe.strain_change[:2].sum()))


def _shear(probe: Probe) -> float:
    ds, de = probe.stress_change, probe.strain_change
    stress = np.array([0.5 * (ds[0] - ds[1]), ds[2]])
    strain = np.array([de[0] - de[1], 2.0 * de[2]])
    return float(stress @ strain / (strain @ strain))


def settled(sample: Sample, limits: RateLimits | None = None) -> Sample:
    """A copy held at its stress until it has come to rest."""
    return stress_probe(sample, 0.0, 0.0, limits=limits or ELASTIC_LIMITS).sample


def shear_modulus(sample: Sample, size: float = ELASTIC_PROBE) -> float:
    """Elastic shear modulus ``dq/d(eps_1 - eps_2)``, Pa: from a small unloading of the deviator, at q = 0 a loading.

    The sample is held at its stress first, so that no creep of an unfinished loading enters.
    """
    rest = settled(sample)
    p, q, angle = stress_invariants(love_weber_stress(rest))
    dq = -size * p if q > 2.0 * size * p else size * p
    return _shear(stress_probe(rest, 0.0, dq, angle, limits=ELASTIC_LIMITS))


def measure_elasticity(sample: Sample, size: float = ELASTIC_PROBE) -> tuple[ElasticModuli, WeakContacts]:
    """Moduli and the response of weak contacts from probes of ``size * p`` (isotropic up and down, shear twice).

    The change of normal force of each persisting contact is divided by the mean normal force f. Its mean over direction
    is fitted by harmonics ``m0 + m . e`` over all contacts. The ratio of a contact's change to that mean grows with its
    force; a straight line in the force over the contacts below `WEAK_FORCE` gives its limit at zero force.
    """
    isotropic, shear = _elastic_probes(sample, size)
    contacts = contacts_of(sample)
    moduli = ElasticModuli(
        float(np.mean([_bulk(b) for b in isotropic])),
        float(np.mean([_shear(b) for b in shear])),
        *uniform_strain_moduli(sample, contacts),
    )
    ratios, scatters, ratios_isotropic = [], [], []
    for probe in isotropic:
        change, force, _ = _force_change(probe)
        ratios_isotropic.append(_ratio_at_zero(change, np.full(len(change), change.mean()), force)[0])
    for probe in shear:
        change, force, e = _force_change(probe)
        basis = np.column_stack([np.ones(len(change)), e])
        mean = basis @ np.linalg.lstsq(basis, change, rcond=None)[0]
        ratio, scatter = _ratio_at_zero(change, mean, force)
        ratios.append(ratio)
        scatters.append(scatter)
    return moduli, WeakContacts(float(np.mean(ratios)), float(np.mean(ratios_isotropic)), float(np.mean(scatters)))


def _ratio_at_zero(
    change: NDArray[np.float64], mean: NDArray[np.float64], force: NDArray[np.float64]
) -> tuple[float, float]:
    """Ratio change/mean in the limit of zero force, and the scatter over the amplitude of ratio x mean."""
    weak = force < WEAK_FORCE
    m = mean[weak]
    basis = np.column_stack([m, m * force[weak]])
    coefficients = np.linalg.lstsq(basis, change[weak], rcond=None)[0]
    amplitude = abs(coefficients[0]) * np.sqrt(2.0 * np.mean(m**2))
    return float(coefficients[0]), float(np.std(change[weak] - basis @ coefficients) / amplitude)


def _force_change(probe: Probe) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Change of normal force, normal force before (both over f), and e, of the persisting contacts."""
    match = match_contacts(probe.before, probe.after)
    scale = force_harmonics(probe.before).mean
    old, new = match.persisting_before, match.persisting_after
    force = probe.before.normal_force[old] / scale
    return probe.after.normal_force[new] / scale - force, force, probe.before.double_angle[old]


@dataclass(frozen=True)
class LoopResult:
    """A loading at constant p to a stress ratio and back.

    Attributes
    ----------
    loaded, unloaded : Sample
    force_anisotropy_ratio : float
        c_n: a_n over q/p, at the end of the loading.
    fluctuation : float
        c_w: irreversible scatter S of the forces of weak contacts, over ``|dgamma| kn r/f`` of the loading. Taken from
        the contacts that are open after the loop: a normal scatter of standard deviation S (in units of f) of a flat
        distribution with density P0 moves a fraction ``P0 S/sqrt(2 pi)`` of all contacts below zero force.
    force_scatter : float
        The same from the quartiles of the force changes of contacts with initial forces of 0.1 to 0.5 f.
    shear_strain : float
        eps_1 - eps_2 at the end of the loading.
    """

    loaded: Sample
    unloaded: Sample
    force_anisotropy_ratio: float
    fluctuation: float
    force_scatter: float
    shear_strain: float


def loading_loop(sample: Sample, stress_ratio: float = 0.2, limits: RateLimits | None = None) -> LoopResult:
    """Load an isotropic sample at constant p to `stress_ratio`, unload to q = 0; measure c_n and c_w.

    In the quartiles (a normal distribution has 1.349 standard deviations between them) lost contacts count as lowest,
    so that the loss of the weakest does not narrow the scatter.
    """
    current = sample.copy()
    motion = Motion(current)
    motion.stress[:] = love_weber_stress(current)
    angle = 0.5 * np.pi
    start = current.strain.copy()
    _follow(motion, biaxial_leg("constant_pressure", 0.02, stress_ratio, angle), limits)
    loaded = current.copy()
    shear_strain = float((current.strain - start)[0] - (current.strain - start)[1])
    reached = axial_stress_ratio(motion.stress, angle)
    harmonics = force_harmonics(contacts_of(loaded))
    ratio = -float(harmonics.normal[0]) / reached
    _follow(motion, biaxial_leg("constant_pressure", -0.02, 0.0, angle), limits)
    before, after = contacts_of(sample), contacts_of(current)
    scale = force_harmonics(before).mean
    match = match_contacts(before, after)
    change = np.full(before.count, -np.inf)
    old = match.persisting_before
    change[old] = (after.normal_force[match.persisting_after] - before.normal_force[old]) / scale
    force = before.normal_force / scale
    weak = (force > 0.1) & (force < 0.5)
    low, high = np.quantile(change[weak], [0.25, 0.75], method="higher")
    scatter = float(high - low) / 1.349
    unit = shear_strain * sample.normal_stiffness * 0.5 * sample.mean_diameter / scale
    density = force_distribution(before).at_zero.value
    opened = float(np.mean(match.lost)) * np.sqrt(2.0 * np.pi) / density
    return LoopResult(loaded, current, ratio, opened / unit, scatter / unit, shear_strain)


def _follow(motion: Motion, leg: Leg, limits: RateLimits | None) -> None:
    if not Loading(motion, leg, limits).run(5_000_000):
        raise ProbeError("the loading did not reach the stress ratio asked for")

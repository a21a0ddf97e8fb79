"""Small stress probes on a sample, and its elastic moduli."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.dynamics.motion import Motion
from granfabric.dem_ref.loading.legs import stress_invariants, stress_leg
from granfabric.dem_ref.loading.servo import Loading, RateLimits
from granfabric.dem_ref.measures.contacts import Contacts, contacts_of, love_weber_stress
from granfabric.dem_ref.measures.events import NetworkChange, network_change
from granfabric.dem_ref.sample.disks import Sample

ELASTIC_PROBE = 2.0e-3
PROBE_LIMITS = RateLimits(inertial_number=3.0e-6, unbalanced_force=1.0e-4)
ELASTIC_LIMITS = RateLimits(inertial_number=1.0e-6, unbalanced_force=1.0e-5, lag=1.0e-3)


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


def uniform_strain_moduli(sample: Sample, contacts: Contacts | None = None) -> tuple[float, float]:
    """``K = z phi kn/(2 pi)`` and ``G = z phi (kn + kt)/(4 pi)``, z over all particles."""
    c = contacts or contacts_of(sample)
    z = 2.0 * c.count / sample.count
    kn, kt = sample.normal_stiffness, sample.normal_stiffness * sample.stiffness_ratio
    return z * sample.solid_fraction * kn / (2 * np.pi), z * sample.solid_fraction * (kn + kt) / (4 * np.pi)


def elastic_probes(sample: Sample, size: float = ELASTIC_PROBE) -> tuple[list[Probe], list[Probe]]:
    """Probes of ``size * p``: isotropic up and down; shear with major compression along y and at 45 degrees to it."""
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


def elastic_moduli(sample: Sample, isotropic: list[Probe], shear: list[Probe]) -> ElasticModuli:
    """Moduli from elastic probes of the sample."""
    return ElasticModuli(
        float(np.mean([_bulk(probe) for probe in isotropic])),
        float(np.mean([_shear(probe) for probe in shear])),
        *uniform_strain_moduli(sample),
    )

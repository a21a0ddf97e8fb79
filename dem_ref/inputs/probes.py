"""Small stress probes on a sample, and its elastic moduli."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.dynamics.motion import Motion
from granfabric.dem_ref.loading.endings import ending_text
from granfabric.dem_ref.loading.legs import stress_invariants, stress_leg
from granfabric.dem_ref.loading.servo import Loading, RateLimits, mean_pressure
from granfabric.dem_ref.measures.contacts import Contacts, contacts_of, love_weber_stress, unbalanced_force
from granfabric.dem_ref.measures.events import NetworkChange, network_change
from granfabric.dem_ref.sample.disks import Sample, SampleError

ELASTIC_PROBE = 2.0e-3
PROBE_LIMITS = RateLimits(inertial_number=3.0e-6, unbalanced_force=1.0e-4)
ELASTIC_LIMITS = RateLimits(inertial_number=1.0e-6, unbalanced_force=1.0e-5, lag=1.0e-3)
AT_REST = 5.0e-5
"""Largest unbalanced force, over the mean contact force, of a sample at rest: a fortieth of what an elastic probe
changes. Packings are made with 2e-5, probes end below that."""


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

    A sample that is not at rest is held at its stress first, so that only the increment acts.

    Parameters
    ----------
    dp, dq : float
        Pa; change of p, and of the deviator (negative allowed) with its major compression along `angle` (radians from
        the x axis).

    Raises
    ------
    ProbeError
        If the sample does not settle at its target: it flows, or has lost its pressure.
    SampleError
        If it has no pressure to begin with.
    """
    return _probe(at_rest(sample), dp, dq, angle, limits, steps)


def _probe(
    sample: Sample, dp: float, dq: float, angle: float, limits: RateLimits | None, steps: int = 2_000_000
) -> Probe:
    after = sample.copy()
    motion = Motion(after)
    stress = love_weber_stress(sample)
    motion.stress[:] = stress
    increment = -np.array([dp + dq * cos(2 * angle), dp - dq * cos(2 * angle), dq * sin(2 * angle)])
    loading = Loading(motion, stress_leg(stress + increment), limits or PROBE_LIMITS)
    if not loading.run(steps):
        reason = ending_text(
            loading.ending, mean_pressure(motion.stress), loading.reference_pressure, motion.unbalanced_force
        )
        raise ProbeError(
            f"the probe dp = {dp:.4g} Pa, dq = {dq:.4g} Pa did not settle: "
            f"{reason or f'it moves still after {steps} steps'}"
        )
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
    sample = at_rest(sample)
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
    return _probe(sample, 0.0, 0.0, 0.5 * np.pi, limits or ELASTIC_LIMITS).sample


def is_at_rest(sample: Sample) -> bool:
    """Whether a sample has a pressure (disks that do not touch are in balance too) and hardly any unbalanced force."""
    return mean_pressure(love_weber_stress(sample)) > 0.0 and unbalanced_force(sample) <= AT_REST


def at_rest(sample: Sample) -> Sample:
    """The sample itself if it is at rest, else a copy held at its stress until it is.

    Raises
    ------
    SampleError
        If the sample has no pressure: disks that do not touch are in balance, but they are no packing.
    ProbeError
        If it does not come to rest.
    """
    p = mean_pressure(love_weber_stress(sample))
    if not p > 0.0:
        raise SampleError(f"the sample has no pressure (p = {max(p, 0.0) + 0.0:.3g} Pa): nothing can be measured on it")
    if is_at_rest(sample):
        return sample
    unbalanced = unbalanced_force(sample)
    try:
        return settled(sample)
    except ProbeError as error:
        raise ProbeError(
            f"the sample is not at rest (unbalanced force {unbalanced:.2g}) and does not come to rest when it is held "
            f"at its stress: {error}"
        ) from error


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
        *uniform_strain_moduli(sample, isotropic[0].before),
    )


def moduli_errors(isotropic: list[Probe], shear: list[Probe]) -> tuple[float, float]:
    """Relative standard errors of the bulk and the shear modulus, from how much directions differ.

    An endless packing has one shear modulus and takes no shear strain under pressure. A small one answers two shears at
    45 degrees by a symmetric matrix ``[[G + D, H], [H, G - D]]``, of which D and H vary as a single direction does
    about the mean, ``sqrt(D^2 + H^2)``; the mean of two directions has 1/sqrt(2) of that. In the same way the shear
    strain that pressure causes, over the change of area, is what single directions of the bulk modulus differ by.
    """
    strain = np.array([_shear_strain(probe) for probe in shear])
    stress = np.array([_shear_stress(probe) for probe in shear])
    moduli = np.linalg.solve(strain, stress)  # strain @ moduli = stress, both as rows
    mean = 0.5 * (moduli[0, 0] + moduli[1, 1])
    apart = np.hypot(0.5 * (moduli[0, 0] - moduli[1, 1]), 0.5 * (moduli[0, 1] + moduli[1, 0]))
    coupling = [np.hypot(*_shear_strain(probe)) / abs(probe.strain_change[:2].sum()) for probe in isotropic]
    return float(np.mean(coupling) / np.sqrt(2.0)), float(apart / mean / np.sqrt(2.0))


def _shear_strain(probe: Probe) -> NDArray[np.float64]:
    de = probe.strain_change
    return np.array([de[0] - de[1], 2.0 * de[2]])


def _shear_stress(probe: Probe) -> NDArray[np.float64]:
    ds = probe.stress_change
    return np.array([0.5 * (ds[0] - ds[1]), ds[2]])

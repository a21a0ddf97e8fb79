"""Batches of points that follow straight strain paths, and how far two results are apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Material
from granfabric.constitutive.path import Leg, drive

Array = NDArray[np.float64]

PRESSURE = 100e3
"""Initial mean pressure [Pa]."""
PATH_STRAIN = 1e-4
"""Size of each path, norm of the strain tensor. At kn/p = 1e4 a biaxial test reaches q/p = 0.3 with it."""
MATERIAL = Material(
    coordination=4.06,
    solid_fraction=0.846,
    normal_stiffness=1e4 * PRESSURE,
    force_density_at_zero=0.5,
    gap_density_at_zero=3.0,
    force_anisotropy_ratio=1.0,
    bulk_reduction=0.88,
    shear_reduction=0.69,
)
SEED = 20170


@dataclass(frozen=True)
class Batch:
    """Points with their start and the strain they go through.

    Parameters
    ----------
    stress : ndarray, shape (npt, 3)
        xx, yy, xy, tension positive [Pa].
    coordination : ndarray, shape (npt,)
    fabric : ndarray, shape (npt, 2)
    strain : ndarray, shape (npt, 3)
        Whole strain of the path, xx, yy, engineering xy.
    biaxial : ndarray of bool, shape (npt,)
        Points of the biaxial path; the others go in random directions.
    """

    stress: Array
    coordination: Array
    fabric: Array
    strain: Array
    biaxial: NDArray[np.bool_]


@dataclass(frozen=True)
class End:
    """Where a batch arrived, and the substeps it took (summed over points and increments).

    Parameters
    ----------
    stress, coordination, fabric : ndarray
        As in `Batch`.
    accepted, rejected : int
    failed : int
        Points that the law refused.
    evaluations : int
        Evaluations of the rates over all points, those of rejected substeps included.
    """

    stress: Array
    coordination: Array
    fabric: Array
    accepted: int
    rejected: int
    failed: int
    evaluations: int = 0


def law_of(integration: Integration, closure: Closure | None = None) -> ContactLaw:
    """The contact law of all point studies with the given numerics."""
    return ContactLaw([MATERIAL], closure=closure, integration=integration)


def make_batch(points: int) -> Batch:
    """A quarter of the points on the biaxial path under turned axes, the others in random directions.

    Random points start under q/p up to 0.2 and are compressed and sheared in an arbitrary direction to their own axes,
    so that loading, unloading and rotating axes are among them; pure extension, where grains lose contact, is not.
    """
    rng = np.random.default_rng(SEED)
    biaxial = np.arange(points) < max(1, points // 4)
    coordination = rng.uniform(3.7, 4.3, points)
    ratio, angle = np.where(biaxial, 0.0, rng.uniform(0.0, 0.2, points)), rng.uniform(0.0, 2 * np.pi, points)
    s = ratio[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    stress = -PRESSURE * np.stack([1.0 + s[:, 0], 1.0 - s[:, 0], s[:, 1]], axis=1)
    volume, shear = rng.uniform(0.1, 0.5, points), rng.uniform(0.2, 0.6, points)
    direction = rng.uniform(0.0, 2 * np.pi, points)
    lateral = _biaxial_lateral_strain() / PATH_STRAIN
    volume[biaxial], shear[biaxial] = (1.0 - lateral) / 2, (1.0 + lateral) / 2
    strain = np.stack(
        [-volume - shear * np.cos(direction), -volume + shear * np.cos(direction), -2 * shear * np.sin(direction)],
        axis=1,
    )
    size = np.sqrt(strain[:, 0] ** 2 + strain[:, 1] ** 2 + strain[:, 2] ** 2 / 2)
    return Batch(stress, coordination, 0.5 * s, strain * (PATH_STRAIN / size)[:, None], biaxial)


def _biaxial_lateral_strain() -> float:
    """Lateral strain of biaxial compression by `PATH_STRAIN` under constant lateral stress."""
    law = law_of(Integration(integrator="dormand_prince", tolerance=1e-10))
    leg = Leg(control=("stress", "strain", "stress"), target=(-PRESSURE, -PATH_STRAIN, 0.0), increments=20)
    return float(drive(law, (-PRESSURE, -PRESSURE, 0.0), [leg]).columns["strain_xx"][-1])


def initial_state(law: ContactLaw, batch: Batch) -> Array:
    """State of the points at the start of their paths."""
    return law.initial_state(batch.stress, coordination=batch.coordination, fabric_anisotropy=batch.fabric)


def follow(law: ContactLaw, batch: Batch, start: Array, increments: int) -> End:
    """Take all points along their paths in equal strain increments; each increment is one call of the law.

    Parameters
    ----------
    law : ContactLaw
    batch : Batch
    start : ndarray, shape (npt, nstate)
        As `initial_state` gives it; not changed.
    increments : int
    """
    stress, state = batch.stress.copy(), start.copy()
    stress_end, state_end = np.empty_like(stress), np.empty_like(state)
    increment = np.ascontiguousarray(batch.strain / increments)
    accepted = rejected = evaluations = 0
    failed = np.zeros(len(stress), dtype=bool)
    for _ in range(increments):
        report = law.update(increment, stress, state, stress_end, state_end)
        accepted += int(report.substeps.sum())
        rejected += int(report.rejected.sum())
        evaluations += 0 if report.evaluations is None else int(report.evaluations.sum())
        failed |= report.status > 1
        stress, stress_end = stress_end, stress
        state, state_end = state_end, state
    columns = law.description.columns
    return End(
        stress,
        state[:, columns("coordination")][:, 0],
        state[:, columns("fabric_anisotropy")],
        accepted,
        rejected,
        int(failed.sum()),
        evaluations,
    )


def distance(end: End, reference: End) -> Array:
    """Error of each point: largest of stress relative to p, z relative to itself, and a_c; shape (npt,)."""
    p = -0.5 * (reference.stress[:, 0] + reference.stress[:, 1])
    return np.max(
        [
            np.abs(end.stress - reference.stress).max(axis=1) / p,
            np.abs(end.coordination / reference.coordination - 1.0),
            np.abs(end.fabric - reference.fabric).max(axis=1),
        ],
        axis=0,
    )

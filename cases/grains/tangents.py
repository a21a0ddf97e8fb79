"""Other tangents of packings, as FEM x DEM codes use them, to compare with: they cost iterations, or calls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import Array, TangentKind, UpdateReport
from granfabric.dem_ref.sample.disks import Sample

from .law import GrainsLaw
from .network_stiffness import network_stiffness

PERTURBATION = 1e-7
"""Strain by which increments are perturbed: small against them, large against the noise of packings at rest."""


class IsotropicTangent(GrainsLaw):
    """Grains with the mean isotropic elastic stiffness of their packings before loading for a tangent, everywhere."""

    def __init__(self, packings: Sequence[Sample]) -> None:
        super().__init__(packings, secant=False, threads=1)
        mean = np.mean([network_stiffness(sample) for sample in packings], axis=0)
        bulk = 0.25 * (mean[0, 0] + mean[1, 1] + 2.0 * mean[0, 1])
        shear = 0.5 * (0.25 * (mean[0, 0] + mean[1, 1] - 2.0 * mean[0, 1]) + mean[2, 2])
        self._isotropic = np.array(
            [[bulk + shear, bulk - shear, 0.0], [bulk - shear, bulk + shear, 0.0], [0.0, 0.0, shear]]
        )

    def update(
        self,
        strain_increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        tangent: Array | None = None,
        tangent_kind: TangentKind = "propagated",
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """As `GrainsLaw.update`, with the one tangent."""
        report = super().update(
            strain_increment, stress_start, state_start, stress_end, state_end, None, tangent_kind, material_index
        )
        if tangent is not None:
            tangent[:] = self._isotropic
        return report


class PerturbedTangent(GrainsLaw):
    """Grains with a tangent from three perturbed strain increments, symmetrised: four drives a point and call."""

    def __init__(self, packings: Sequence[Sample]) -> None:
        super().__init__(packings, secant=False, threads=1)

    def update(
        self,
        strain_increment: Array,
        stress_start: Array,
        state_start: Array,
        stress_end: Array,
        state_end: Array,
        tangent: Array | None = None,
        tangent_kind: TangentKind = "propagated",
        material_index: NDArray[np.int32] | None = None,
    ) -> UpdateReport:
        """As `GrainsLaw.update`, with the perturbed tangent."""
        report = super().update(
            strain_increment, stress_start, state_start, stress_end, state_end, tangent, tangent_kind, material_index
        )
        if tangent is None or report.failed:
            return report
        found, stress, state = np.empty_like(tangent), np.empty_like(stress_end), np.empty_like(state_end)
        for component in range(3):
            increment = np.array(strain_increment, dtype=np.float64)
            increment[:, component] += PERTURBATION
            if super().update(increment, stress_start, state_start, stress, state).failed:
                return report
            found[:, :, component] = (stress - stress_end) / PERTURBATION
        tangent[:] = 0.5 * (found + found.transpose(0, 2, 1))
        return report

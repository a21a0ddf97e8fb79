"""What sliding asks of its parameters and of an initial stress."""

from __future__ import annotations

import numpy as np

from granfabric.constitutive.contract import Array
from granfabric.constitutive.material_table import PAR_COHESION, PAR_EXPONENT, PAR_GAMMA_R, PAR_M_FIRST, PAR_M_PEAK
from granfabric.constitutive.parameters import Material, ParameterError


def check_sliding(material: Material) -> None:
    """Refuse parameters whose cone does not harden, or whose plastic strain could give back work.

    Raises
    ------
    ParameterError
        See `sliding` for the condition on the dilatancy.
    """
    first, peak = material.first_yield_stress_ratio, material.peak_stress_ratio
    if first >= peak:
        raise ParameterError(
            f"material.first_yield_stress_ratio = {first:g} is not below material.peak_stress_ratio = {peak:g}"
        )
    slope, constant = material.dilatancy, material.constant_volume_stress_ratio
    if (slope - 1.0) * peak > slope * constant:
        most = peak / (peak - constant)
        raise ParameterError(
            f"material.dilatancy = {slope:g} lets sliding at the peak give back work: with peak_stress_ratio = "
            f"{peak:g} and constant_volume_stress_ratio = {constant:g} it may be {most:g} at most"
        )


def initial_hardening(table: Array, stress: Array) -> tuple[Array, Array]:
    """Hardening and plastic shear strain that put an initial stress on the cone; 0 where it lies below the first yield.

    Parameters
    ----------
    table : ndarray, shape (npt, nparameters)
        Parameters of each point.
    stress : ndarray, shape (npt, 3)
        Tension positive [Pa].

    Raises
    ------
    ParameterError
        If a stress ratio is not below the peak.
    """
    first, peak, reference = table[:, PAR_M_FIRST], table[:, PAR_M_PEAK], table[:, PAR_GAMMA_R]
    p = -0.5 * (stress[:, 0] + stress[:, 1])
    q = np.hypot(0.5 * (stress[:, 0] - stress[:, 1]), stress[:, 2])
    carried = p > 0.0
    ratio = np.where(carried, q / np.where(carried, p + table[:, PAR_COHESION], 1.0), 0.0)
    beyond = np.flatnonzero(ratio >= peak)
    if beyond.size:
        point = int(beyond[0])
        raise ParameterError(
            f"the initial stress has q/(p + c) = {ratio[point]:.6g} at point {point}, but sliding admits less than "
            f"material.peak_stress_ratio = {peak[point]:g}"
        )
    excess = np.maximum(ratio - first, 0.0)
    kappa: Array = reference * excess / (peak - ratio)
    return kappa, kappa * (kappa / (reference + kappa)) ** (table[:, PAR_EXPONENT] - 1.0)

"""Loss of ellipticity against its closed form."""

from __future__ import annotations

import numpy as np
import pytest

from granfabric.fem.equilibrium.bands import band_fraction

BULK, SHEAR = 2.0, 1.0


def tangent(friction: float, dilatancy: float, hardening: float) -> np.ndarray:
    """Plane cone q = M p with flow D, deviator along xx - yy: D = C - (C:P)(Q:C)/(H + Q:C:P).

    Stress and strain in plane (p, q) with moduli K, G: yield normal (-M, 1), flow direction (-D, 1).
    """
    stiffness = np.array([[BULK + SHEAR, BULK - SHEAR, 0.0], [BULK - SHEAR, BULK + SHEAR, 0.0], [0.0, 0.0, SHEAR]])
    # q = (s_yy - s_xx)/2 with pressure p = -(s_xx + s_yy)/2: gradients of q - M p
    normal = np.array([-0.5 + friction / 2, 0.5 + friction / 2, 0.0])
    flow = np.array([-0.5 + dilatancy / 2, 0.5 + dilatancy / 2, 0.0])
    down = normal @ stiffness @ flow + hardening
    return stiffness - np.outer(stiffness @ flow, normal @ stiffness) / down


def critical_hardening(friction: float, dilatancy: float) -> float:
    """Largest hardening at which some band is possible, by bisection on the determinant over fine directions."""
    angles = np.linspace(0.0, np.pi, 20001)
    x, y = np.cos(angles), np.sin(angles)
    normals = np.zeros((len(angles), 2, 3))
    normals[:, 0, 0] = normals[:, 1, 2] = x
    normals[:, 0, 2] = normals[:, 1, 1] = y

    def lost(hardening: float) -> bool:
        acoustic = np.einsum("aik,kl,ajl->aij", normals, tangent(friction, dilatancy, hardening), normals)
        return bool((np.linalg.det(acoustic) < 0.0).any())

    low, high = -1.0, 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if lost(middle) else (low, middle)
    return low


@pytest.mark.parametrize(("friction", "dilatancy"), [(0.5, 0.0), (0.3, 0.0), (0.5, 0.3)])
def test_bands_form_while_it_still_hardens_if_flow_is_not_associated(friction, dilatancy):
    """Critical hardening of plane strain cones, H = K G (M - D)^2 / (4 (K + G)) here: positive if M and D differ."""
    critical = critical_hardening(friction, dilatancy)
    assert critical == pytest.approx(BULK * SHEAR / (BULK + SHEAR) * (friction - dilatancy) ** 2 / 4, rel=1e-3)
    points = np.array([tangent(friction, dilatancy, factor * critical) for factor in (0.5, 2.0, 0.5, 1.5)])
    assert band_fraction(points, np.array([1.0, 2.0, 3.0, 4.0])) == pytest.approx(0.4)


def test_associated_flow_that_hardens_and_elasticity_have_none():
    points = np.array([tangent(0.4, 0.4, 1e-3), tangent(0.0, 0.0, 10.0)])
    assert band_fraction(points, np.ones(2)) == 0.0

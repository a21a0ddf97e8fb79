"""Closed forms: equilibrium, boundary values, and displacements that belong to the stresses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from granfabric.cases.field import closed_forms
from granfabric.cases.scene.schema_closed_form import ClosedForm, HoleInPlate, StripLoad, ThickCylinder

K, G = 220e6, 170e6

RING = ClosedForm(
    thick_cylinder=ThickCylinder(inner_radius=0.5, outer_radius=1.5, inner_pressure=30e3, outer_pressure=12e3)
)
HOLE = ClosedForm(hole_in_plate=HoleInPlate(radius=0.5, centre=[0.1, -0.2], stress=[-20e3, 7e3, 5e3], pressure=11e3))
STRIP = ClosedForm(strip_load=StripLoad(half_width=0.5, centre=[0.2, 2.0], pressure=40e3))


def places() -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(5)
    radius, angle = generator.uniform(0.9, 1.4, 40), generator.uniform(0, 2 * np.pi, 40)
    return radius * np.cos(angle), radius * np.sin(angle)


def gradient(function: Callable, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences of second order."""
    step = 1e-4
    along_x = (function(x + step, y) - function(x - step, y)) / (2 * step)
    return along_x, (function(x, y + step) - function(x, y - step)) / (2 * step)


@pytest.mark.parametrize("form", [RING, HOLE, STRIP], ids=lambda form: form.name)
def test_equilibrium(form: ClosedForm) -> None:
    """d s_xx/dx + d s_xy/dy = 0 and its fellow, up to the h^2 of the differences."""
    by_x, by_y = gradient(lambda x, y: closed_forms.stress(form, x, y), *places())
    size = np.abs(by_x).max()
    assert size > 1e3  # the stress does vary, so that the balance says something
    assert np.abs(by_x[:, 0] + by_y[:, 2]).max() < 1e-5 * size
    assert np.abs(by_x[:, 2] + by_y[:, 1]).max() < 1e-5 * size


@pytest.mark.parametrize("form", [RING, HOLE], ids=lambda form: form.name)
def test_displacement_belongs_to_the_stress(form: ClosedForm) -> None:
    """Strains from differences, stress from plane elasticity: mean K eps_v, deviator G."""
    x, y = places()
    by_x, by_y = gradient(lambda a, b: closed_forms.displacement(form, a, b, K, G), x, y)
    xx, yy, xy = by_x[:, 0], by_y[:, 1], by_x[:, 1] + by_y[:, 0]
    stress = np.stack([K * (xx + yy) + G * (xx - yy), K * (xx + yy) - G * (xx - yy), G * xy], axis=1)
    np.testing.assert_allclose(stress, closed_forms.stress(form, x, y), atol=1e-5 * 30e3)


def test_the_strip_load_is_compatible_too() -> None:
    """Without body force the sum of the normal stresses is harmonic in an elastic body."""
    x, y = places()
    step = 1e-3

    def total(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return closed_forms.stress(STRIP, a, b)[:, :2].sum(axis=1)

    around = total(x + step, y) + total(x - step, y) + total(x, y + step) + total(x, y - step)
    assert np.abs(around - 4 * total(x, y)).max() / step**2 < 1e-3 * 40e3


def test_boundary_values() -> None:
    angle = np.linspace(0.0, 2 * np.pi, 13)
    nx, ny = np.cos(angle), np.sin(angle)

    def pressed(form: ClosedForm, radius: float, outward: float, centre: tuple[float, float], pressure: float) -> None:
        of_surface = closed_forms.traction(form, 2.0)
        force = of_surface(centre[0] + radius * nx, centre[1] + radius * ny, outward * nx, outward * ny)
        np.testing.assert_allclose(force, -2 * pressure * outward * np.stack([nx, ny], axis=1), atol=1e-6)

    pressed(RING, 0.5, -1.0, (0.0, 0.0), 30e3)
    pressed(RING, 1.5, 1.0, (0.0, 0.0), 12e3)
    pressed(HOLE, 0.5, -1.0, (0.1, -0.2), 11e3)
    far = closed_forms.stress(HOLE, np.array([1e6]), np.array([-2e6]))
    np.testing.assert_allclose(far, [[-20e3, 7e3, 5e3]], rtol=1e-9)
    x = np.array([-0.2, 0.2, 0.6, 0.8, -0.4])
    surface = closed_forms.stress(STRIP, x, np.full(5, 2.0))
    np.testing.assert_allclose(surface[:, 1], [-40e3, -40e3, -40e3, 0, 0], atol=1e-9)
    np.testing.assert_allclose(surface[:, 2], 0.0, atol=1e-9)


def test_known_values() -> None:
    """Three times the stress beside a hole; p/pi (alpha + sin alpha) under the middle of a strip, s_xx with a minus."""
    hole = ClosedForm(hole_in_plate=HoleInPlate(radius=1.0, stress=[0.0, -1.0, 0.0]))
    beside, above = closed_forms.stress(hole, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    np.testing.assert_allclose(beside, [0.0, -3.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(above, [1.0, 0.0, 0.0], atol=1e-14)
    depth = 0.7
    alpha = 2 * np.arctan(0.5 / depth)
    under = closed_forms.stress(STRIP, np.array([0.2]), np.array([2.0 - depth]))[0]
    unit = 40e3 / np.pi
    np.testing.assert_allclose(under, [-unit * (alpha - np.sin(alpha)), -unit * (alpha + np.sin(alpha)), 0], atol=1e-9)
    # Saint-Venant: the strip's force on any deep level, p times its width.
    x = np.linspace(-4000, 4000, 400_001)
    level = closed_forms.stress(STRIP, x, np.full_like(x, -8.0))[:, 1]
    assert np.trapezoid(level, x) == pytest.approx(-40e3 * 1.0, rel=1e-6)

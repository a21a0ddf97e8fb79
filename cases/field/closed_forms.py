"""Plane elasticity in closed form: stress and displacement of the forms that a scene may name.

In the plane a material has a bulk modulus K (mean stress over the sum of the two strains) and a shear modulus G; plane
strain is K = lambda + G. Stress here is the change since the initial state, tension positive, order xx, yy, xy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.scene.schema_closed_form import ClosedForm, HoleInPlate, StripLoad, ThickCylinder

Array = NDArray[np.float64]

TITLES = {
    "thick_cylinder": "Lame's thick cylinder",
    "hole_in_plate": "Kirsch's hole in a plate",
    "strip_load": "Flamant's strip load",
}


def _cartesian(radial: Array, hoop: Array, shear: Array, nx: Array, ny: Array) -> Array:
    """Polar stress components (rr, tt, rt) to xx, yy, xy, shape (n, 3); (nx, ny) points along the radius."""
    xx = radial * nx**2 + hoop * ny**2 - 2 * shear * nx * ny
    yy = radial * ny**2 + hoop * nx**2 + 2 * shear * nx * ny
    xy = (radial - hoop) * nx * ny + shear * (nx**2 - ny**2)
    return np.stack([xx, yy, xy], axis=1)


def _lame_constants(form: ThickCylinder) -> tuple[float, float]:
    """A [Pa] and B [Pa m^2] of ``s_rr = A - B/r^2, s_tt = A + B/r^2``."""
    inner, outer = form.inner_radius**2, form.outer_radius**2
    uniform = (form.inner_pressure * inner - form.outer_pressure * outer) / (outer - inner)
    return uniform, (form.inner_pressure - form.outer_pressure) * inner * outer / (outer - inner)


def thick_cylinder_stress(form: ThickCylinder, x: Array, y: Array) -> Array:
    """Lame's stress, shape (n, 3) [Pa] [Timoshenko & Goodier, Theory of Elasticity, 3rd ed. 1970, section 28]."""
    radius = np.hypot(x, y)
    uniform, decaying = _lame_constants(form)
    fraction = decaying / radius**2
    return _cartesian(uniform - fraction, uniform + fraction, np.zeros_like(x), x / radius, y / radius)


def thick_cylinder_displacement(form: ThickCylinder, x: Array, y: Array, bulk: float, shear: float) -> Array:
    """Lame's displacement, shape (n, 2) [m]: u_r/r = A/(2K) + B/(2 G r^2), from the hoop strain."""
    uniform, decaying = _lame_constants(form)
    stretch = uniform / (2 * bulk) + decaying / (2 * shear * (x**2 + y**2))
    return np.stack([stretch * x, stretch * y], axis=1)


def _kirsch_terms(form: HoleInPlate, x: Array, y: Array) -> tuple[Array, ...]:
    """Direction (nx, ny), radius, (a/r)^2, mean stress and deviator along and across in polar components."""
    dx, dy = x - form.centre[0], y - form.centre[1]
    radius = np.hypot(dx, dy)
    nx, ny = dx / radius, dy / radius
    xx, yy, xy = form.stress
    cosine, sine = nx**2 - ny**2, 2 * nx * ny
    along = (xx - yy) / 2 * cosine + xy * sine
    across = -(xx - yy) / 2 * sine + xy * cosine
    return nx, ny, radius, (form.radius / radius) ** 2, np.full_like(radius, (xx + yy) / 2), along, across


def hole_in_plate_stress(form: HoleInPlate, x: Array, y: Array) -> Array:
    """Kirsch's stress, shape (n, 3) [Pa] [Kirsch 1898; Timoshenko & Goodier, section 35], with pressure in the hole."""
    nx, ny, _, ratio, mean, along, across = _kirsch_terms(form, x, y)
    radial = mean * (1 - ratio) - form.pressure * ratio + along * (1 - 4 * ratio + 3 * ratio**2)
    hoop = mean * (1 + ratio) + form.pressure * ratio - along * (1 + 3 * ratio**2)
    return _cartesian(radial, hoop, across * (1 + 2 * ratio - 3 * ratio**2), nx, ny)


def hole_in_plate_displacement(form: HoleInPlate, x: Array, y: Array, bulk: float, shear: float) -> Array:
    """Kirsch's displacement, shape (n, 2) [m], with Kolosov's constant kappa = 1 + 2 G/K; the centre stays."""
    nx, ny, radius, ratio, mean, along, across = _kirsch_terms(form, x, y)
    kappa = 1 + 2 * shear / bulk
    radial = mean * ((kappa - 1) / 2 + ratio) + form.pressure * ratio + along * (1 + (1 + kappa) * ratio - ratio**2)
    hoop = across * (1 + (kappa - 1) * ratio + ratio**2)
    radial, hoop = (radius / (2 * shear) * part for part in (radial, hoop))
    return np.stack([radial * nx - hoop * ny, radial * ny + hoop * nx], axis=1)


def strip_load_stress(form: StripLoad, x: Array, y: Array) -> Array:
    """Stress under a strip load, shape (n, 3) [Pa] [Flamant 1892 integrated; Timoshenko & Goodier, section 37].

    With alpha the angle under which a point sees the strip and phi twice the direction of its middle from the vertical,
    s_yy = -p/pi (alpha + sin alpha cos phi), s_xx = -p/pi (alpha - sin alpha cos phi), s_xy = p/pi sin alpha sin phi.
    """
    depth, aside = form.centre[1] - y, x - form.centre[0]
    left, right = np.arctan2(aside + form.half_width, depth), np.arctan2(aside - form.half_width, depth)
    alpha, phi = left - right, left + right
    unit = form.pressure / np.pi
    cosine, sine = unit * np.sin(alpha) * np.cos(phi), unit * np.sin(alpha) * np.sin(phi)
    return np.stack([-unit * alpha + cosine, -unit * alpha - cosine, sine], axis=1)


STRESS: dict[str, Callable[[Any, Array, Array], Array]] = {
    "thick_cylinder": thick_cylinder_stress,
    "hole_in_plate": hole_in_plate_stress,
    "strip_load": strip_load_stress,
}
DISPLACEMENT: dict[str, Callable[[Any, Array, Array, float, float], Array]] = {
    "thick_cylinder": thick_cylinder_displacement,
    "hole_in_plate": hole_in_plate_displacement,
}
"""A strip load on a half-plane has no displacement that stays finite far away."""


def stress(form: ClosedForm, x: Array, y: Array) -> Array:
    """Stress change of a scene's closed form, shape (n, 3) [Pa], tension positive."""
    return STRESS[form.name](getattr(form, form.name), x, y)


def traction(form: ClosedForm, factor: float) -> Callable[[Array, Array, Array, Array], Array]:
    """The closed form's traction on any surface as a function of x, y and the outward normal, shape (n, 2) [Pa]."""

    def of_surface(x: Array, y: Array, nx: Array, ny: Array) -> Array:
        xx, yy, xy = factor * stress(form, x, y).T
        return np.stack([xx * nx + xy * ny, xy * nx + yy * ny], axis=1)

    return of_surface


def displacement(form: ClosedForm, x: Array, y: Array, bulk: float, shear: float) -> Array | None:
    """Displacement of a scene's closed form, shape (n, 2) [m]; None if it has none."""
    formula = DISPLACEMENT.get(form.name)
    return None if formula is None else formula(getattr(form, form.name), x, y, bulk, shear)

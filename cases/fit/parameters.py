"""Parameters that a fit may free: bounds, scale, the order in which they are chosen, and what tells them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError, several, unknown
from granfabric.cases.scene.measured import bounds
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Closure, Material

from .settings import NUMBERS, Base

Array = NDArray[np.float64]

WIDE = 1e9
"""Ratio of the bounds of a parameter above zero from which its logarithm is sought."""
UNBOUNDED = 1e100
"""Bounds beyond this are none."""

ORDER = (
    "coordination", "initial_fabric_xx", "initial_fabric_xy", "force_density_at_zero", "force_anisotropy_ratio",
    "normal_stiffness", "shear_reduction", "bulk_reduction", "tangential_force_ratio", "peak_stress_ratio",
    "reference_plastic_strain", "slip", "irreversible_scatter", "gap_density_at_zero", "dilatancy",
    "constant_volume_stress_ratio", "weak_contact_ratio_isotropic", "elastic_scatter", "weak_contact_ratio",
    "slip_delay", "elastic_scatter_isotropic", "isostatic_coordination", "hardening_exponent", "force_density_slope",
    "weak_contact_gradient", "tangential_force_loss",
)  # fmt: skip
"""In which they are tried where nobody names them; others follow."""
CONTACTS = ("coordination", "fabric_anisotropy")
FORCES = ("normal_force_anisotropy", "tangential_force_anisotropy")
DEFORMATION = ("strain", "stress", "p", "q")
SEEN_IN = {
    "coordination": ("coordination",),
    "initial_fabric_xx": ("fabric_anisotropy",),
    "initial_fabric_xy": ("fabric_anisotropy",),
    "force_density_at_zero": CONTACTS,
    "force_density_slope": CONTACTS,
    "gap_density_at_zero": CONTACTS,
    "irreversible_scatter": CONTACTS,
    "elastic_scatter": CONTACTS,
    "elastic_scatter_isotropic": CONTACTS,
    "weak_contact_ratio": CONTACTS,
    "weak_contact_ratio_isotropic": CONTACTS,
    "weak_contact_gradient": CONTACTS,
    "fluctuation": CONTACTS,
    "force_anisotropy_ratio": ("normal_force_anisotropy",),
    "tangential_force_ratio": FORCES,
    "tangential_force_loss": FORCES,
    "slip": FORCES,
    "slip_delay": FORCES,
    "normal_stiffness": DEFORMATION,
    "bulk_reduction": DEFORMATION,
    "shear_reduction": DEFORMATION,
    "isostatic_coordination": DEFORMATION,
}  # fmt: skip
"""Beginnings of the names of columns of which one has to be there for a parameter to be free unless named: what it is
for, however far its effects reach. Of others any column will do."""
ON_REQUEST = ("solid_fraction", "neighbours", "stiffness_ratio", "first_yield_stress_ratio", "apparent_cohesion")
"""Never free unless named: they act like another one, or only at the very start."""

TOLD_BY = {
    "coordination": "z (column coordination) of any path",
    "solid_fraction": "nothing that normal_stiffness does not tell as well: it is measured on the packing",
    "normal_stiffness": "strains under prescribed stress",
    "stiffness_ratio": "strains under a change of pressure and of q, with bulk_reduction and shear_reduction held",
    "force_density_at_zero": "z and a_c while q/p grows",
    "force_density_slope": "z and a_c where a tenth of the contacts and more are lost, beside those at small q/p",
    "gap_density_at_zero": "z and a_c while the pressure grows many times, at a stiffness kn/p that is not large",
    "neighbours": "nothing that gap_density_at_zero does not tell as well: 6 in the plane",
    "force_anisotropy_ratio": "a_n while q/p changes",
    "bulk_reduction": "volumetric strain under a change of pressure, with normal_stiffness held",
    "shear_reduction": "shear strain under a change of q, with normal_stiffness held",
    "isostatic_coordination": 'shear strain where z has changed much, with closure.shear_stiffness = "isostatic"',
    "initial_fabric_xx": "a_c from the start",
    "initial_fabric_xy": "both components of a_c (fabric_anisotropy_1 and _2)",
    "peak_stress_ratio": "shear strain under strain control (control = strain) up to the peak of q/p",
    "first_yield_stress_ratio": "shear strain at small q/p",
    "reference_plastic_strain": "shear strain with q/p in closely spaced rows",
    "hardening_exponent": "shear strain with q/p from the start to the peak",
    "dilatancy": "volumetric with shear strain beyond q/p of about 0.2",
    "constant_volume_stress_ratio": "volumetric with shear strain on both sides of the turn from contraction",
    "apparent_cohesion": "peaks of q/p at several pressures",
    "weak_contact_ratio": "z and a_c while q/p grows, with force_density_at_zero known",
    "weak_contact_ratio_isotropic": "z while the pressure falls at constant q/p",
    "weak_contact_gradient": "a_c while q/p grows at a pressure that is not the initial one, beside a_c at that one",
    "elastic_scatter": "z on unloading of q/p against z on loading",
    "elastic_scatter_isotropic": "z while the pressure changes and comes back",
    "irreversible_scatter": "z that does not come back after a cycle of q/p",
    "tangential_force_ratio": "a_t while q/p is small",
    "tangential_force_loss": "a_t while q/p grows at a pressure that has fallen, beside a_t at the initial one",
    "slip": "a_t while q/p grows to 0.3",
    "slip_delay": "a_t at constant lateral stress beside a_t at constant p",
    "fluctuation": 'z and a_c while q/p grows, with closure.force_change = "fluctuating"',
}
"""Curves that tell a parameter, for sentences."""
ANY = "curves that change when it does"

SYMBOLS = {
    "z": "coordination", "z0": "coordination", "phi": "solid_fraction", "kn": "normal_stiffness",
    "kt/kn": "stiffness_ratio", "P0": "force_density_at_zero", "P0'": "force_density_slope",
    "P_xi0": "gap_density_at_zero", "kappa": "tangential_force_loss",
    "c_n": "force_anisotropy_ratio", "z_iso": "isostatic_coordination", "chi": "weak_contact_ratio",
    "chi_p": "weak_contact_ratio_isotropic", "c_e": "elastic_scatter", "c_p": "elastic_scatter_isotropic",
    "c_i": "irreversible_scatter", "c_t": "tangential_force_ratio", "M_peak": "peak_stress_ratio",
}  # fmt: skip
"""Symbols that are taken for names."""

DEFAULTS = {
    **{variable.name: variable.default for variable in Material.variables() if variable.default is not None},
    **{name: float(getattr(Closure(), name)) for name in CLOSURE_NUMBERS},
}

ABOUT_ZERO = {
    "initial_fabric_xx": 0.1, "initial_fabric_xy": 0.1, "first_yield_stress_ratio": 0.1, "force_density_slope": 0.2,
}  # fmt: skip
"""A change that matters, of parameters that may be zero."""


@dataclass(frozen=True)
class Free:
    """A free parameter.

    Attributes
    ----------
    name : str
    first : float
        Where the fit begins.
    lower, upper : float
        Bounds of the law.
    size : float
        A change that matters.
    logarithmic : bool
        Whether its logarithm is sought.
    """

    name: str
    first: float
    lower: float
    upper: float
    size: float
    logarithmic: bool

    def inside(self, value: float) -> float:
        """From the value to the number that is sought."""
        return math.log(value / self.size) if self.logarithmic else value / self.size

    def outside(self, sought: float) -> float:
        """Inverse of `inside`, within the bounds."""
        value = self.size * math.exp(min(sought, 600.0)) if self.logarithmic else self.size * sought
        return min(max(value, self.lower), self.upper)

    @property
    def limits(self) -> tuple[float, float]:
        """Bounds of the number that is sought."""
        low = self.inside(self.lower) if self.lower > (1.0 / UNBOUNDED if self.logarithmic else -UNBOUNDED) else -np.inf
        return low, self.inside(self.upper) if self.upper < UNBOUNDED else np.inf

    def error(self, value: float, sought: float) -> float:
        """Standard error of the value for that of the sought number."""
        return sought * (value if self.logarithmic else self.size)

    def bound(self, value: float) -> str:
        """At which bound the value is: "lower", "upper" or none."""
        near = 1e-5 * self.size
        if not self.logarithmic and value - self.lower <= near:
            return "lower"
        return "upper" if not self.logarithmic and self.upper - value <= near else ""


def free_parameter(name: str, value: float, pressure: float) -> Free:
    """A parameter of the law with its bounds and a scale that follows from its value and its default."""
    low, high = bounds()[name]
    logarithmic = low > 0.0 and high / low >= WIDE and value > 0.0
    size = abs(value) if logarithmic else max(abs(value), abs(DEFAULTS.get(name, 0.0)))
    if name in ABOUT_ZERO:
        size = max(size, ABOUT_ZERO[name])
    elif size == 0.0:
        size = 0.1 * (high - low) if high < UNBOUNDED else pressure
    return Free(name, value, low, high, size, logarithmic)


def named(texts: Sequence[str]) -> list[str]:
    """Names of parameters from `--free`: separated by commas, with or without their table.

    Raises
    ------
    InputError
    """
    found: list[str] = []
    wrong = []
    for text in (part.strip() for entry in texts for part in entry.split(",")):
        section, _, key = text.rpartition(".")
        key = SYMBOLS.get(key, key)
        if key not in NUMBERS or section not in ("", "material", "closure"):
            wrong.append(f"--free: {unknown('the parameter', text, NUMBERS, spelled=key)}")
        elif key not in found:
            found.append(key)
    if wrong:
        raise several(wrong)
    if not found:
        raise InputError("--free names no parameter")
    return found


def candidates(base: Base, rows: bool, columns: Iterable[str]) -> list[str]:
    """Parameters that may be free if nobody names them and these columns are compared, in the order of trying.

    What `--set` gives is held; a stiffness from a material file as well, because the reductions scale what it does.
    With `rows` each curve starts from its own first row, which leaves nothing to fit of the start.
    """
    held = {name for name, origin in base.origins.items() if origin == "set"}
    if base.origins["normal_stiffness"] == "file":
        held.add("normal_stiffness")
    if rows:
        held |= {"coordination", "initial_fabric_xx", "initial_fabric_xy"}
    names = [*ORDER, *(name for name in NUMBERS if name not in ORDER)]
    there = tuple(columns)

    def seen(name: str) -> bool:
        return name not in SEEN_IN or any((column.endswith(("strain", "stress")) and "strain" in SEEN_IN[name])
                                          or column.startswith(SEEN_IN[name]) for column in there)

    return [name for name in names if name in NUMBERS and name not in held | {*ON_REQUEST} and seen(name)]


def told_by(name: str) -> str:
    """Which curves tell a parameter."""
    return TOLD_BY.get(name, ANY)


def values_of(free: Sequence[Free], sought: Array, held: Mapping[str, float]) -> dict[str, float]:
    """All parameters for given numbers that are sought."""
    return {**held, **{entry.name: entry.outside(float(number)) for entry, number in zip(free, sought)}}

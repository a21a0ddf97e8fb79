"""Parameters of the contact law: the material, the choice of closure, and the numerics of its integration.

Names are those of the scene files. Each parameter is declared once, with meaning, unit and physical bounds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Any, Literal, TypeVar, get_args

import numpy as np

from .contract import Array, Variable

ForceChange = Literal["mean_field", "fluctuating", "shifted_distribution"]
ShearStiffness = Literal["uniform_strain", "isostatic"]
Tangential = Literal["neglected", "self_consistent", "frictional"]
Distribution = Literal["harmonic", "maximum_entropy"]
ArcIntegration = Literal["closed_form", "gauss"]
Integrator = Literal["forward_euler", "modified_euler", "bogacki_shampine", "dormand_prince", "kennedy_carpenter"]


class ParameterError(ValueError):
    """A parameter has an illegal value; the text names it, the value and what is legal."""


def is_number(value: object) -> bool:
    """Whether this is a real number and no truth value."""
    return isinstance(value, (int, float, np.floating, np.integer)) and not isinstance(value, bool)


def is_within(value: object, low: float, high: float) -> bool:
    """Whether this is a real number within bounds; NaN is not."""
    # as Python's own number: a bound would be rounded to the precision of a float32
    number: Any = value.item() if isinstance(value, np.generic) else value
    return is_number(value) and bool(low <= number <= high)


def is_integer(value: object) -> bool:
    """Whether this is an integer and no truth value."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


Kind = TypeVar("Kind")


def rows_of(owner: str, materials: object, kind: type[Kind]) -> tuple[Kind, ...]:
    """One material or a sequence of them as a tuple.

    Raises
    ------
    ParameterError
        If there is none, or something else among them.
    """
    rows: tuple[Any, ...] = (materials,)
    if not isinstance(materials, kind):
        rows = tuple(materials) if isinstance(materials, Iterable) else (materials,)
    for row in rows:
        if not isinstance(row, kind):
            raise ParameterError(f"{owner} needs a {kind.__name__} or a sequence of them, not {row!r}")
    if not rows:
        raise ParameterError(f"{owner} needs at least one material")
    return rows


def instance_of(name: str, value: object, kind: type[Kind]) -> Kind:
    """The value, or the defaults of its kind if it is None.

    Raises
    ------
    ParameterError
    """
    if value is None:
        return kind()
    if not isinstance(value, kind):
        raise ParameterError(f"{name} = {value!r} is not of the class {kind.__name__}")
    return value


def _declare(variable: Variable) -> Any:
    if variable.default is None:
        return field(metadata={"variable": variable})
    return field(default=variable.default, metadata={"variable": variable})


@dataclass(frozen=True, kw_only=True)
class Material:
    """One granular material: what a packing is before loading. Shear and stiffness in Pa (disks of unit thickness).

    See `Material.variables` for meaning, unit and bounds of each entry.
    """

    coordination: float = _declare(
        Variable("coordination", "coordination number z of the initial packing", lower=1e-3, upper=6.0)
    )
    solid_fraction: float = _declare(Variable("solid_fraction", "solid fraction phi", lower=1e-3, upper=1.0))
    normal_stiffness: float = _declare(
        Variable("normal_stiffness", "normal contact stiffness kn", "Pa", lower=1e-300, upper=1e300)
    )
    stiffness_ratio: float = _declare(
        Variable("stiffness_ratio", "tangential over normal contact stiffness kt/kn", lower=0.0, upper=1.0, default=1.0)
    )
    force_density_at_zero: float = _declare(
        Variable(
            "force_density_at_zero",
            "density P0 of normal forces (divided by their mean) at zero force",
            lower=0.0,
            upper=10.0,
            default=0.5,
        )
    )
    force_density_slope: float = _declare(
        Variable(
            "force_density_slope",
            "slope P0' of the density of normal forces (divided by their mean) near zero force",
            lower=-10.0,
            upper=10.0,
            default=0.0,
        )
    )
    gap_density_at_zero: float = _declare(
        Variable(
            "gap_density_at_zero",
            "density P_xi0 of gaps (divided by the mean diameter) of neighbours at zero gap",
            lower=0.0,
            upper=1e6,
            default=3.0,
        )
    )
    neighbours: float = _declare(
        Variable("neighbours", "mean number of Dirichlet neighbours z_nb", lower=1.0, upper=20.0, default=6.0)
    )
    force_anisotropy_ratio: float = _declare(
        Variable("force_anisotropy_ratio", "normal-force anisotropy c_n = a_n/(q/p)", lower=0.0, upper=2.0, default=1.0)
    )
    bulk_reduction: float = _declare(
        Variable("bulk_reduction", "bulk modulus over its uniform-strain estimate", lower=1e-3, upper=2.0, default=1.0)
    )
    shear_reduction: float = _declare(
        Variable(
            "shear_reduction", "shear modulus over its uniform-strain estimate", lower=1e-3, upper=2.0, default=1.0
        )
    )
    isostatic_coordination: float = _declare(
        Variable(
            "isostatic_coordination",
            "coordination number z_iso at which the shear stiffness vanishes, counted as z is",
            lower=0.0,
            upper=5.0,
            default=3.0,
        )
    )
    initial_fabric_xx: float = _declare(
        Variable("initial_fabric_xx", "a_c(0), component along cos 2 theta", lower=-2.0, upper=2.0, default=0.0)
    )
    initial_fabric_xy: float = _declare(
        Variable("initial_fabric_xy", "a_c(0), component along sin 2 theta", lower=-2.0, upper=2.0, default=0.0)
    )
    peak_stress_ratio: float = _declare(
        Variable("peak_stress_ratio", "sliding: largest stress ratio M_peak", lower=1e-3, upper=1.0, default=0.41)
    )
    first_yield_stress_ratio: float = _declare(
        Variable(
            "first_yield_stress_ratio", "sliding: stress ratio M_first below which nothing slides at first",
            lower=0.0, upper=1.0, default=0.0,
        )
    )  # fmt: skip
    reference_plastic_strain: float = _declare(
        Variable(
            "reference_plastic_strain",
            "sliding: hardening strain gamma_r at which M is half way from M_first to M_peak",
            lower=1e-12,
            upper=1.0,
            default=5.5e-5,
        )
    )
    hardening_exponent: float = _declare(
        Variable(
            "hardening_exponent",
            "sliding: exponent m of the growth of plastic strain with the stress ratio; 1 is a hyperbola",
            lower=1.0,
            upper=4.0,
            default=2.0,
        )
    )
    dilatancy: float = _declare(
        Variable(
            "dilatancy",
            "sliding: slope D of plastic volumetric over shear strain with the stress ratio",
            lower=0.0,
            upper=10.0,
            default=1.05,
        )
    )
    constant_volume_stress_ratio: float = _declare(
        Variable(
            "constant_volume_stress_ratio",
            "sliding: stress ratio M_cv above which the packing dilates",
            lower=0.0,
            upper=1.0,
            default=0.17,
        )
    )
    apparent_cohesion: float = _declare(
        Variable(
            "apparent_cohesion",
            "sliding: cohesion c, the distance of the cone's apex from zero pressure",
            "Pa",
            lower=0.0,
            upper=1e300,
            default=0.0,
        )
    )
    fluid_bulk_stiffness: float = _declare(
        Variable("fluid_bulk_stiffness", "pore fluid: bulk modulus K_f; 0 is no fluid", "Pa",
                 lower=0.0, upper=1e300, default=0.0)
    )  # fmt: skip
    fluid_porosity: float = _declare(
        Variable("fluid_porosity", "pore fluid: porosity n; 0 takes 1 - phi of the disks",
                 lower=0.0, upper=1.0, default=0.0)
    )  # fmt: skip

    def __post_init__(self) -> None:
        for variable in self.variables():
            value = getattr(self, variable.name)
            if not is_number(value):
                raise ParameterError(f"material.{variable.name} = {value!r} is not a number")
            if not is_within(value, variable.lower, variable.upper):
                raise ParameterError(
                    f"material.{variable.name} = {value!r} is outside its physical bounds "
                    f"[{variable.lower:g}, {variable.upper:g}] ({variable.meaning}, unit {variable.unit})"
                )

    @classmethod
    def variables(cls) -> tuple[Variable, ...]:
        """Declaration of every parameter, in table order."""
        return tuple(entry.metadata["variable"] for entry in fields(cls))


def _check_choice(owner: str, name: str, value: object, legal: tuple[str, ...]) -> None:
    if not isinstance(value, str) or value not in legal:
        near = get_close_matches(str(value), legal, n=1, cutoff=0.0)
        raise ParameterError(f"{owner}.{name} = {value!r} is not one of {', '.join(legal)}; the nearest is {near[0]!r}")


CLOSURE_NUMBERS: dict[str, tuple[float, float]] = {
    "weak_contact_ratio": (0.0, 5.0),
    "weak_contact_ratio_isotropic": (0.01, 5.0),
    "weak_contact_gradient": (0.0, 2.0),
    "elastic_scatter": (0.0, 5.0),
    "elastic_scatter_isotropic": (0.0, 5.0),
    "irreversible_scatter": (0.0, 50.0),
    "tangential_force_ratio": (0.0, 2.0),
    "tangential_force_loss": (0.0, 20.0),
    "slip": (0.0, 50.0),
    "slip_delay": (0.0, 50.0),
    "fluctuation": (0.0, 5.0),
}
"""Numbers of a closure, each with the smallest and the largest that is legal."""


@dataclass(frozen=True, kw_only=True)
class Closure:
    """How the change of contact forces is closed.

    Parameters
    ----------
    force_change : {"mean_field", "fluctuating", "shifted_distribution"}
        Force change of weak contacts: every contact of a direction feels the mean change (the source), or that change
        with a scatter proportional to the strain, or the distribution of weak forces is followed as it is shifted and
        spread.
    tangential : {"neglected", "self_consistent", "frictional"}
        ``b = 2 ds`` (the source, a_t constant), ``b = c_n ds + da_c``, or a_t limited by friction, ``b = 2 ds - da_t``.
        The last goes with "shifted_distribution" only, which takes it unless "self_consistent" is asked for.
    distribution : {"harmonic", "maximum_entropy"}
        Directional density of contacts for a given a_c; not used by "shifted_distribution", which has its own.
    shear_stiffness : {"uniform_strain", "isostatic"}
        G in proportion to z, or to z (z - z_iso).
    weak_contact_ratio : float
        chi: mean change of force of weak contacts over that of all contacts of their direction.
    weak_contact_ratio_isotropic : float
        chi_p: the same for a change of pressure.
    weak_contact_gradient : float
        a: how much more of a change of pressure stronger contacts feel, per mean force; a pressure p stretches the
        distribution of weak forces by (p/p_0)^a.
    elastic_scatter : float
        c_e: scatter of the change of weak forces over the amplitude of their mean change; reversible.
    elastic_scatter_isotropic : float
        c_p: the same for a change of pressure.
    irreversible_scatter : float
        c_i: irreversible scatter of the weak forces, over their mean, per square of the largest q/p so far.
    tangential_force_ratio : float
        c_t: |a_t|/(q/p) of contacts that do not slip.
    tangential_force_loss : float
        kappa: exponent with which c_t falls with the fraction of contacts that a falling pressure has left.
    slip : float
        k: decrease of |a_t|/(q/p) by contacts that slip, per q/p.
    slip_delay : float
        lambda: the shift X_0 of weak forces delays slip by this times X_0 in q/p.
    fluctuation : float
        c_w: scatter of the change of weak forces, per shear strain kn r/f; of "fluctuating".
    """

    force_change: ForceChange = "mean_field"
    tangential: Tangential = "neglected"
    distribution: Distribution = "harmonic"
    shear_stiffness: ShearStiffness = "uniform_strain"
    weak_contact_ratio: float = 0.75
    weak_contact_ratio_isotropic: float = 0.6
    weak_contact_gradient: float = 0.5
    elastic_scatter: float = 0.45
    elastic_scatter_isotropic: float = 0.35
    irreversible_scatter: float = 2.3
    tangential_force_ratio: float = 0.78
    tangential_force_loss: float = 1.5
    slip: float = 1.0
    slip_delay: float = 0.6
    fluctuation: float = 0.3

    def __post_init__(self) -> None:
        _check_choice("closure", "force_change", self.force_change, get_args(ForceChange))
        _check_choice("closure", "tangential", self.tangential, get_args(Tangential))
        _check_choice("closure", "distribution", self.distribution, get_args(Distribution))
        _check_choice("closure", "shear_stiffness", self.shear_stiffness, get_args(ShearStiffness))
        for name, (least, most) in CLOSURE_NUMBERS.items():
            value = getattr(self, name)
            if not is_within(value, least, most):
                raise ParameterError(f"closure.{name} = {value!r} is not a number in [{least:g}, {most:g}]")
        if self.tangential == "frictional" and self.force_change != "shifted_distribution":
            raise ParameterError(
                f"closure.tangential = 'frictional' goes with force_change = 'shifted_distribution', not with "
                f"{self.force_change!r}"
            )

    @property
    def tangential_rule(self) -> Tangential:
        """What is done about a_t: `tangential`, or "frictional" where shifted weak forces leave it open."""
        if self.force_change == "shifted_distribution" and self.tangential == "neglected":
            return "frictional"
        return self.tangential

    @property
    def slips(self) -> bool:
        """Whether contacts carry tangential forces up to a limit that some of them come to."""
        return self.tangential_rule == "frictional" and self.tangential_force_ratio > 0.0 and self.slip > 0.0


INTEGRATION_NUMBERS: dict[str, tuple[float, float]] = {
    "tolerance": (1e-14, 1.0),
    "substeps": (0, 10_000_000),
    "maximum_substeps": (1, 100_000_000),
    "directions": (4, 512),
}
"""Numbers of the integration, each with the smallest and the largest that is legal."""


@dataclass(frozen=True, kw_only=True)
class Integration:
    """Numerics of the update at a point.

    Parameters
    ----------
    integrator : {"forward_euler", "modified_euler", "bogacki_shampine", "dormand_prince", "kennedy_carpenter"}
        Runge-Kutta scheme, the last one implicit; all but the first control their error by an embedded lower order:
        2(1), 3(2), 5(4), 3(2).
    tolerance : float
        Local error allowed per substep, relative to the state.
    substeps : int
        Fixed number of equal substeps; 0 for error control. `forward_euler` has no error estimate and needs a number.
    maximum_substeps : int
        A point that needs more fails with a status.
    arc_integration : {"closed_form", "gauss"}
        Integrals over the arcs of loss and gain. The maximum-entropy distribution has no closed form and always uses
        the quadrature.
    directions : int
        Gauss points on each arc. The closure "shifted_distribution", whose integrands are smooth over the whole circle,
        takes half as many, equally spaced.
    """

    integrator: Integrator = "bogacki_shampine"
    tolerance: float = 1e-6
    substeps: int = 0
    maximum_substeps: int = 100_000
    arc_integration: ArcIntegration = "closed_form"
    directions: int = 32

    def __post_init__(self) -> None:
        _check_choice("integration", "integrator", self.integrator, get_args(Integrator))
        _check_choice("integration", "arc_integration", self.arc_integration, get_args(ArcIntegration))
        least, most = INTEGRATION_NUMBERS["tolerance"]
        if not is_within(self.tolerance, least, most):
            raise ParameterError(f"integration.tolerance = {self.tolerance!r} is not a number in [{least:g}, {most:g}]")
        for name in ("substeps", "maximum_substeps", "directions"):
            least, most = INTEGRATION_NUMBERS[name]
            value = getattr(self, name)
            if not is_integer(value) or not least <= value <= most:
                raise ParameterError(f"integration.{name} = {value!r} is not an integer in [{least}, {most}]")
        if self.integrator == "forward_euler" and self.substeps == 0:
            raise ParameterError(
                "integration.substeps = 0 asks for error control, but forward_euler has no error estimate; "
                "give a fixed number of substeps or another integrator"
            )


def parameter_table(materials: Sequence[Material]) -> Array:
    """Rows of parameters for the kernels, one a material, columns in the order of `Material.variables`.

    Returns
    -------
    ndarray, shape (nmaterials, nparameters)
    """
    names = [variable.name for variable in Material.variables()]
    return np.array([[float(getattr(material, name)) for name in names] for material in materials])

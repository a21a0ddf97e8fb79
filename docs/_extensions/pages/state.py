"""State variables and parameters of the laws, from their descriptions."""

from __future__ import annotations

from dataclasses import replace

from .glossary import all_state_variables, everything_on
from .markdown import bound, code, number, page, table
from .project import (
    ElasticMaterial,
    LawDescription,
    LinearElasticLaw,
    Material,
    Variable,
    VonMisesLaw,
    VonMisesMaterial,
    state_variables,
)

HEAD = ("name", "components", "unit", "bounds", "meaning")


def _bounds(variable: Variable) -> str:
    parts = (bound("≥", variable.lower), bound("≤", variable.upper))
    return ", ".join(part for part in parts if part)


def carried_for(name: str) -> str:
    """Which choices a law needs to carry a state variable."""
    on = everything_on()
    needs = []
    for effect in on.names():
        reduced = replace(on, **{effect: False})
        remembering = reduced.tangential_memory and reduced.network_changes
        if name not in {variable.name for variable in state_variables(reduced, True, remembering)}:
            needs.append(code(f"effects.{effect}"))
    if name not in {variable.name for variable in state_variables(on, shifted=False)}:
        shifted = '`closure.force_change = "shifted_distribution"`'
        frozen = replace(on, stiffness_feedback=False)
        also = name in {variable.name for variable in state_variables(frozen, shifted=False)}
        needs.append(f"{shifted}, or `effects.stiffness_feedback` off" if also else shifted)
    return ", ".join(needs) or "always"


def _parameters(variables: tuple[Variable, ...]) -> str:
    rows = [
        (
            code(entry.name),
            entry.unit,
            _bounds(entry),
            "required" if entry.default is None else code(number(entry.default)),
            entry.meaning,
        )
        for entry in variables
    ]
    return table(("name", "unit", "bounds", "default", "meaning"), rows)


def plain_laws() -> dict[str, LawDescription]:
    """The laws beside the contact law."""
    return {
        "Linear elasticity": LinearElasticLaw(ElasticMaterial(1e9, 0.3)).description,
        "Von Mises plasticity": VonMisesLaw(VonMisesMaterial(1e9, 0.3, 1e5)).description,
    }


def pages() -> dict[str, str]:
    """One page."""
    rows = [
        (
            code(variable.name),
            str(variable.components),
            variable.unit,
            _bounds(variable),
            variable.meaning,
            carried_for(variable.name),
        )
        for variable in all_state_variables()
    ]
    parts = [
        "# State variables and parameters",
        "A law declares its state and its parameters as data "
        "({py:class}`granfabric.constitutive.contract.LawDescription`); drivers, files and this page read them. In "
        "`points_*.vtu` each state variable is an array of its name. Two components are those of a vector in the "
        "double-angle plane, along cos 2θ and sin 2θ; without the effect `principal_rotation` only the first is "
        "carried.",
        "## Contact law: state",
        table((*HEAD, "carried with"), rows),
        "## Contact law: parameters of a material",
        _parameters(Material.variables()),
        "Choices and numbers of `[closure]`, `[effects]` and `[integration]`: {doc}`scene_law`.",
    ]
    for title, description in plain_laws().items():
        state = [
            (code(entry.name), str(entry.components), entry.unit, _bounds(entry), entry.meaning)
            for entry in description.state
        ]
        parts += [f"## {title}", table(HEAD, state) if state else "No state.", _parameters(description.parameters)]
    return {"generated/reference/state": page(*parts)}

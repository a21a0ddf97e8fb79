"""Which law stands at the points of a scene: the contact law, or grains."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import Field

from .schema_base import Positive, Section

TOLERANCE = 1e-4
"""Of the residual, with grains at the points, if nothing is said."""
FINEST_TOLERANCE = 1e-6
"""Packings answer with jumps of about this much of their pressure; Newton's method gets no further."""

UNUSED = ("material", "materials", "accuracy", "closure", "effects", "integration", "random_state", "closed_form")
"""Tables and keys of the contact law, which grains do not need."""


class LawSection(Section):
    """What stands at the points: the contact law, or a packing of disks at each of them (with [packing])."""

    kind: Literal["contact", "grains"] = Field(
        default="contact", description="the contact law with [material], or grains with [packing]"
    )
    packings: Annotated[int, Field(ge=1, le=10_000)] = Field(
        default=8,
        description="number of different packings, seeds from packing.seed on; points take them in turn",
    )
    strain_step: Annotated[float, Field(ge=1e-10, le=1e-5)] = Field(
        default=2e-8, description="largest strain of one step of the grains' motion [-]"
    )
    rest: Annotated[float, Field(ge=1e-9, le=1e-2)] = Field(
        default=1e-5, description="unbalanced over mean contact force below which a packing is at rest [-]"
    )
    longest_rest: Annotated[int, Field(ge=100, le=100_000_000)] = Field(
        default=200_000, description="steps in which a packing has to come to rest after a strain increment"
    )
    tangent: Literal["secant", "network"] = Field(
        default="secant",
        description="stiffness of the network of contacts, corrected to give the last stress increment or as it stands",
    )
    packing_file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="packing.npz of `granfabric dem`, or failed_point.npz, relative to this file, as it stands at the "
        "points instead of packings made by [packing]",
    )
    lost_pressure: Positive | None = Field(
        default=None,
        description="mean pressure below which a packing carries nothing [Pa]; a hundredth of its initial one if not "
        "given",
    )


def is_grains(scene: Any) -> bool:
    """Whether grains stand at the points of a scene, checked or as resolved."""
    law = scene.get("law") if isinstance(scene, dict) else getattr(scene, "law", None)
    if law is None:
        return False
    return bool((law.get("kind") if isinstance(law, dict) else law.kind) == "grains")


def fill(table: dict[str, Any]) -> None:
    """Put into a scene with grains, as a table, what is left open and has another default than with the contact law."""
    if isinstance(table.get("law"), dict) and is_grains(table) and ("mesh" in table or "stage" in table):
        solver = table.setdefault("solver", {})
        if isinstance(solver, dict):
            solver.setdefault("tolerance", TOLERANCE)


def remarks(scene: Any) -> Iterator[str]:
    """What is asked of grains that they hardly give, a sentence each."""
    solver = getattr(scene, "solver", None)
    if solver is not None and solver.tolerance < FINEST_TOLERANCE:
        yield (
            f"warning: solver.tolerance = {solver.tolerance:g}: packings answer with jumps of about 2e-6 of their "
            f"pressure, so that steps may find no equilibrium below {FINEST_TOLERANCE:g}; {TOLERANCE:g} is what is "
            "taken if nothing is said"
        )


def check_law(scene: Any) -> None:
    """See that a scene has what its law needs, and nothing that it cannot use.

    Raises
    ------
    ValueError
        Naming the key.
    """
    if not is_grains(scene):
        _check_contact(scene)
        return
    given = scene.model_fields_set
    for name in UNUSED:
        if name in given and getattr(scene, name):
            raise ValueError(f"{name} does not go with law.kind = 'grains': the disks of [packing] are the material")
    packing, law = scene.packing, scene.law
    if law.packing_file is not None:
        if packing is not None:
            raise ValueError("packing does not go with law.packing_file, which holds the disks")
        if "packings" in law.model_fields_set and law.packings != 1:
            raise ValueError("law.packings does not go with law.packing_file, which holds one packing")
    if packing is not None and "stiffness_to_pressure" in packing.model_fields_set:
        raise ValueError(
            "packing.stiffness_to_pressure does not go with law.kind = 'grains': kn over p follows from "
            "packing.normal_stiffness and the initial stress"
        )
    if packing is not None and "particles" in packing.model_fields_set and packing.particles > 20_000:
        raise ValueError(f"packing.particles = {packing.particles} is outside its bounds [50, 20000] at points")
    initial = scene.initial
    for name in ("state", "pore_pressure", "pore_pressure_gradient", "water_level"):
        if name in initial.model_fields_set and getattr(initial, name) not in (None, 0.0, [0.0, 0.0]):
            what = "begin as packings (law.packing_file)" if name == "state" else "are dry"
            raise ValueError(f"initial.{name} does not go with law.kind = 'grains': grains {what}")


def _check_contact(scene: Any) -> None:
    if scene.packing is not None:
        raise ValueError("packing goes with a DEM scene or with law.kind = 'grains'")
    if scene.law is not None and (more := scene.law.model_fields_set - {"kind"}):
        raise ValueError(f"law.{sorted(more)[0]} goes with law.kind = 'grains'")
    if scene.kind == "point" and scene.material is None:
        raise ValueError("'material' is missing (the granular material)")

"""Mesh and element of a boundary-value problem."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema_base import Pair, Positive, Section

Cells = Annotated[int, Field(ge=1, le=5000)]
Cell = Annotated[Literal["triangle", "quad"], Field(description="shape of the cells; triangles halve a square")]


class Rectangle(Section):
    """A rectangular specimen, meshed regularly; boundaries bottom, right, top, left, region all."""

    width: Positive = Field(description="[m]")
    height: Positive = Field(description="[m]")
    nx: Cells = Field(description="cells along x")
    ny: Cells = Field(description="cells along y")
    cell: Cell = "triangle"


class Ring(Section):
    """Quarter of a ring around the origin; boundaries inner, outer, bottom (y = 0), left (x = 0), region all."""

    inner_radius: Positive = Field(description="[m]")
    outer_radius: Positive = Field(description="[m]")
    n_radial: Cells = Field(description="cells along the radius")
    n_around: Cells = Field(description="cells around the quarter")
    cell: Cell = "triangle"

    @model_validator(mode="after")
    def _not_empty(self) -> Ring:
        if not self.inner_radius < self.outer_radius:
            raise ValueError(f"outer_radius = {self.outer_radius:g} is not above inner_radius = {self.inner_radius:g}")
        return self


class PlateWithHole(Section):
    """Quarter of a plate with a hole around the origin; boundaries hole, right, top, bottom, left, region all."""

    radius: Positive = Field(description="of the hole [m]")
    width: Positive = Field(description="of the quarter, from the centre of the hole [m]")
    height: Positive = Field(description="of the quarter, from the centre of the hole [m]")
    n_radial: Cells = Field(description="cells from the hole outwards")
    n_around: Annotated[int, Field(ge=2, le=5000, multiple_of=2)] = Field(description="cells around the quarter, even")
    cell: Cell = "triangle"

    @model_validator(mode="after")
    def _fits(self) -> PlateWithHole:
        if not self.radius < min(self.width, self.height):
            raise ValueError(
                f"radius = {self.radius:g} is not below width = {self.width:g} and height = {self.height:g}"
            )
        return self


class BoundaryPart(Section):
    """Part of a boundary under a name of its own: the sides of elements between two places."""

    name: Annotated[str, Field(min_length=1, max_length=80)] = Field(description="new name")
    boundary: str = Field(description="boundary that it is a part of")
    x: Pair | None = Field(default=None, description="from, to [m]")
    y: Pair | None = Field(default=None, description="from, to [m]")
    snap: bool = Field(default=False, description="move the ends to the nearest nodes, and say by how much")


SHAPES = ("rectangle", "ring", "plate_with_hole")


class Mesh(Section):
    """Mesh and finite element: a Gmsh file or one of the parametric shapes."""

    file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="Gmsh file, relative to the scene file"
    )
    rectangle: Rectangle | None = Field(default=None, description="rectangle, meshed regularly")
    ring: Ring | None = Field(default=None, description="quarter of a ring")
    plate_with_hole: PlateWithHole | None = Field(default=None, description="quarter of a plate with a circular hole")
    refine: Annotated[int, Field(ge=1, le=64)] = Field(
        default=1, description="multiplies the numbers of cells of a parametric shape"
    )
    parts: Literal["joined", "separate"] = Field(
        default="joined",
        description='of a mesh file: "joined": it has to be one body; "separate": bodies held one by one, bodies that '
        "touch, cracks with doubled nodes",
    )
    part: list[BoundaryPart] = Field(default=[], description="parts of boundaries with names of their own")
    element: Literal["P1", "P2", "Q1", "Q2"] = Field(
        default="P2", description="Lagrange element: triangles P, quadrilaterals Q, of first or second order"
    )
    quadrature_degree: Annotated[int, Field(ge=1, le=20)] | None = Field(
        default=None, description="polynomial degree integrated exactly; 1, 2, 2, 4 for P1, P2, Q1, Q2 if not given"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Mesh:
        sources = [name for name in ("file", *SHAPES) if getattr(self, name) is not None]
        if len(sources) != 1:
            raise ValueError(
                f"the mesh needs either file or one of {', '.join(SHAPES)}"
                + (f", not {' and '.join(sources)}" if sources else "")
            )
        if self.file is not None:
            if self.refine != 1:
                raise ValueError("refine multiplies the cells of a parametric shape; a mesh file is as fine as it is")
            return self
        cell = getattr(self, sources[0]).cell
        letter = {"triangle": "P", "quad": "Q"}[cell]
        if self.element[0] != letter:
            raise ValueError(f"element {self.element} does not fit {cell} cells; use {letter}{self.element[1]}")
        return self

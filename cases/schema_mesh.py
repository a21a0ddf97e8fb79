"""Mesh and element of a boundary-value problem."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from .schema_base import Positive, Section


class Rectangle(Section):
    """A rectangular specimen, meshed regularly; boundaries bottom, right, top, left, region all."""

    width: Positive
    height: Positive
    nx: Annotated[int, Field(ge=1, le=5000)]
    ny: Annotated[int, Field(ge=1, le=5000)]
    cell: Literal["triangle", "quad"] = "triangle"


class Mesh(Section):
    """Mesh and finite element."""

    file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="Gmsh file, relative to the scene file"
    )
    rectangle: Rectangle | None = None
    element: Literal["P1", "P2", "Q1", "Q2"] = "P2"
    quadrature_degree: Annotated[int, Field(ge=1, le=20)] | None = None

    @model_validator(mode="after")
    def _one_source(self) -> Mesh:
        if (self.file is None) == (self.rectangle is None):
            raise ValueError("the mesh needs either file or rectangle, not both")
        if self.rectangle is not None:
            letter = {"triangle": "P", "quad": "Q"}[self.rectangle.cell]
            if self.element[0] != letter:
                raise ValueError(
                    f"element {self.element} does not fit {self.rectangle.cell} cells; use {letter}{self.element[1]}"
                )
        return self

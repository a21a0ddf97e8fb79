"""From a checked scene of a specimen to the options and the legs of its run."""

from __future__ import annotations

from typing import Any

from granfabric.dem_ref.specimen.cut import SpecimenOptions
from granfabric.dem_ref.specimen.run import SpecimenLeg

RECORDS = 40
"""Of a compression to the largest axial strain."""


def specimen_options(scene: Any) -> SpecimenOptions:
    """Boundaries, pace and what counts as rest."""
    rates = scene.rates
    return SpecimenOptions(
        **scene.specimen.model_dump(),
        inertial_number=rates.inertial_number,
        at_rest=rates.unbalanced_force,
        longest_rest=rates.longest_rest,
    )


def specimen_legs(scene: Any) -> tuple[SpecimenLeg, ...]:
    """Legs of the path."""
    return tuple(
        SpecimenLeg(leg.loading, leg.axial_strain or 0.0, leg.stress_ratio, leg.axial_stress or 0.0)
        for leg in scene.path
    )


def strain_step(scene: Any) -> float:
    """Axial strain between two records of a compression."""
    if scene.output.strain_step is not None:
        return float(scene.output.strain_step)
    largest = max(abs(leg.axial_strain or 0.0) for leg in scene.path)
    return largest / RECORDS if largest else 1e-3

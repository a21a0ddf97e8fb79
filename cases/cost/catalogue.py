"""All studies, in the order in which they are computed."""

from __future__ import annotations

from granfabric.cases.errors import InputError, unknown

from . import (
    arcs,
    closures,
    decisions,
    dem,
    distributions,
    effects,
    footing,
    grains_at_points,
    integrators,
    load_steps,
    mesh,
    output,
    tangents,
)
from .study import Study

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        integrators.STUDY,
        arcs.STUDY,
        distributions.STUDY,
        tangents.STUDY,
        mesh.STUDY,
        footing.STUDY,
        load_steps.STUDY,
        output.STUDY,
        dem.STUDY,
        closures.STUDY,
        effects.STUDY,
        decisions.STUDY,
        grains_at_points.STUDY,
    )
}


def chosen(name: str | None) -> list[Study]:
    """The named study, or all.

    Raises
    ------
    InputError
        If there is no study of that name.
    """
    if name is None:
        return list(STUDIES.values())
    if name not in STUDIES:
        raise InputError(unknown("the study", name, STUDIES))
    return [STUDIES[name]]

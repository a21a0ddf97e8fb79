"""`granfabric verify` is three things: the source's figures, a map of materials by paths, or the law against curves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import InputError
from granfabric.cases.records.record import Record
from granfabric.cases.terminal.screen import Screen


def verify_as_asked(
    folder: Path,
    particles: int | None,
    seeds: int | None,
    paths: str | None,
    materials: str | None,
    assignments: Sequence[str],
    data: Sequence[str],
    quick: bool,
    choice: Choice,
    screen: Screen,
    overwrite: bool,
) -> Record:
    """Do what the options ask for; see their help texts.

    Raises
    ------
    InputError
        If they do not go together, or one is not legal.
    RunError
        If the run broke off.
    """
    if data:
        given: dict[str, object] = {"--paths": paths, "--materials": materials, "--quick": quick or None}
        given |= {"--particles": particles, "--seeds": seeds, "--workers": choice.workers}
        given |= {"--scheduler": choice.scheduler}
        for name, value in given.items():
            if value is not None:
                raise InputError(f"{name} is of comparisons with the DEM; --data compares with curves")
        from .fit import curves_of, run_comparison

        return run_comparison(curves_of(list(data)), folder, screen, list(assignments), overwrite)[0]
    from .verify import PARTICLES, SEEDS, run_verify
    from .verify_map import MapRequest, run_map

    request = MapRequest(paths, materials, assignments, quick, particles, seeds, choice)
    if request.is_map:
        return run_map(request, folder, screen, overwrite)
    numbers = (PARTICLES if particles is None else particles, SEEDS if seeds is None else seeds)
    return run_verify(folder, *numbers, screen, overwrite, choice)

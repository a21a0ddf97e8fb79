"""`granfabric verify` is several things: the source's figures, a map, the law against curves, or a field scene."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from granfabric.cases.engine import machine
from granfabric.cases.engine.choice import Choice
from granfabric.cases.errors import InputError
from granfabric.cases.records.record import Record
from granfabric.cases.terminal.screen import Screen


def verify_as_asked(
    scene: str | None,
    output: Path | None,
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
    judges: tuple[int | None, int | None, bool] = (None, None, False),
) -> Record:
    """Do what the options ask for; see their help texts.

    Raises
    ------
    InputError
        If they do not go together, or one is not legal.
    RunError
        If the run broke off.
    """
    folder = output or Path("results") / ("verify" if scene is None else f"verify_{Path(scene).stem}")
    for option, asked in zip(("--specimens", "--specimen-particles", "--measured"), judges):
        if scene is None and asked:
            raise InputError(f"{option} goes with a scene: granfabric verify SCENE {option}")
    if scene is not None:
        unused: dict[str, object] = {"--paths": paths, "--materials": materials, "--quick": quick or None}
        unused |= {"--data": list(data) or None}
        for name, value in unused.items():
            if value is not None:
                raise InputError(f"{name} does not go with a scene, which is computed by the law and by grains")
        from .verify_scene import Judges, run_verify_scene

        choice.check()
        with machine.threads(choice.threads) if choice.threads else nullcontext():
            return run_verify_scene(
                scene, folder, particles, seeds, list(assignments), screen, overwrite, Judges(*judges), choice
            )
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

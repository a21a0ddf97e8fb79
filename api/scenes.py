"""Scenes from Python: the same computations, files and sentences as the commands."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from granfabric.cases.scene import catalogue, reader
from granfabric.cases.scene.material_file import read_material as material_tables
from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.toml_text import value_text
from granfabric.cases.terminal.screen import Screen
from granfabric.constitutive.parameters import Closure, Material

from .results import Results, read_results

__all__ = ["load_scene", "read_material", "run_scene", "scene_names"]


class _Silent(Screen):
    """Says nothing; progress goes to a callback."""

    def __init__(self, progress: Callable[[float, str], None] | None) -> None:
        super().__init__(Console(file=io.StringIO()))
        self._progress = progress

    @contextmanager
    def progress(self, what: str, total: float) -> Iterator[Callable[[float, str], None]]:
        def tell(completed: float, text: str) -> None:
            if self._progress is not None:
                self._progress(completed / total if total else 1.0, f"{what}: {text}" if text else what)

        yield tell


def scene_names() -> list[str]:
    """Names of the shipped scenes.

    Examples
    --------
    >>> import granfabric as gf
    >>> "biaxial" in gf.scene_names()
    True
    """
    return list(catalogue.shipped())


def load_scene(scene: str | Path, changes: Mapping[str, Any] | None = None) -> LoadedScene:
    """A scene, checked: what `run_scene` computes.

    Parameters
    ----------
    scene : str or Path
        Shipped name, scene file or folder with one.
    changes : mapping of str to value, optional
        Keys as `--set` takes them, with Python values: ``{"material.coordination": 3.9}``.

    Raises
    ------
    InputError
        With the sentence that the command prints.

    Examples
    --------
    >>> import granfabric as gf
    >>> gf.load_scene("p_constant", {"material.coordination": 3.9}).scene.material.coordination
    3.9
    """
    assignments = [f"{key}={value_text(value)}" for key, value in (changes or {}).items()]
    return reader.load(str(scene), assignments)


def run_scene(
    scene: str | Path,
    changes: Mapping[str, Any] | None = None,
    output: str | Path | None = None,
    progress: Callable[[float, str], None] | None = None,
    overwrite: bool = False,
    resume: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Results:
    """Compute a scene of any kind, as `granfabric run`, `point` or `dem` do, and read its results back.

    Parameters
    ----------
    scene, changes :
        As in `load_scene`.
    output : str or Path, optional
        Result folder; ``results/NAME`` in the working folder if not given.
    progress : callable, optional
        ``progress(fraction, text)``, called as the run goes on.
    overwrite : bool
        Replace results of another scene.
    resume : bool
        Go on with a run that was stopped.
    workers : int, optional
        Processes of this machine that the points of a field scene with grains are shared out to.
    scheduler : str, optional
        Address of a scheduler of Dask, whose workers are taken instead.

    Returns
    -------
    Results
        Look at its `outcome`: a computation that could not finish has one too, with what it reached.

    Raises
    ------
    InputError
        If the scene or the folder cannot be used; then nothing was written.
    RunError
        If the run broke off within a step.

    Examples
    --------
    >>> import granfabric as gf
    >>> results = gf.run_scene("p_constant", {"output.pictures": False}, output=tmp / "p_constant")
    >>> results.outcome, round(float(results.history["coordination"].iloc[-1]), 4)
    ('finished', 3.6674)
    """
    from granfabric.cases.commands.dem import run_disks
    from granfabric.cases.commands.point import run_point
    from granfabric.cases.commands.run import run_field
    from granfabric.cases.engine.choice import asked_for
    from granfabric.cases.field import grains_run

    loaded = load_scene(scene, changes)
    folder = Path("results", loaded.name) if output is None else Path(output)
    screen, choice = _Silent(progress), asked_for(workers, scheduler, None)
    if loaded.scene.kind != "field":
        grains_run.check(loaded, choice)
    if loaded.scene.kind == "point":
        run_point(loaded, folder, screen, overwrite)
    elif loaded.scene.kind in ("dem", "specimen"):
        run_disks(loaded, folder, screen, resume, overwrite)
    else:
        run_field(loaded, folder, screen, resume, overwrite=overwrite, choice=choice)
    return read_results(folder)


def read_material(name: str | Path) -> tuple[Material, Closure]:
    """Material and closure of a material file, as `granfabric dem` writes them.

    Parameters
    ----------
    name : str or Path
        Shipped name such as "dense_disks", or a file.

    Raises
    ------
    InputError

    Examples
    --------
    >>> import granfabric as gf
    >>> material, closure = gf.read_material("dense_disks")
    >>> closure.force_change
    'shifted_distribution'
    """
    tables = material_tables(catalogue.material(str(name), Path()))
    return Material(**tables["material"]), Closure(**tables.get("closure", {}))

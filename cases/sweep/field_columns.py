"""Columns of the history of a field that its scene names: by boundary, by region, of bodies, springs and controls."""

from __future__ import annotations

from collections.abc import Sequence

from granfabric.cases.errors import InputError, unknown
from granfabric.cases.field.groups import named_boundaries
from granfabric.cases.field.prepare import read_or_make_mesh
from granfabric.cases.records.body_columns import OF_A_BODY
from granfabric.cases.records.reaction_columns import TOTAL
from granfabric.cases.records.region_columns import BODY, NETWORK
from granfabric.cases.scene.reader import LoadedScene

from .results import FIELD_FAMILIES, LOAD_FACTOR, Result

REGION = "region_"


def field_columns(loaded: LoadedScene, of_regions: bool = True) -> list[str]:
    """Columns by the names in a scene, as far as it tells them; those by region need its mesh.

    Parameters
    ----------
    loaded : LoadedScene
        Of kind "field".
    of_regions : bool
        Whether to read, or make, the mesh for the names of its regions.
    """
    stages = loaded.scene.stage
    boundaries, supported = named_boundaries(loaded.scene)
    rigid = dict.fromkeys(load.boundary for stage in stages for load in stage.rigid)
    springs = dict.fromkeys(load.boundary for stage in stages for load in stage.spring)
    found = [
        *(f"displacement_{name}_{axis}" for name in boundaries for axis in "xy"),
        *(f"reaction_{name}_{what}" for name in supported for what in ("x", "y", "moment")),
        *(TOTAL if supported else ()),
        *(f"rigid_{name}_{what}" for name in rigid for what in OF_A_BODY),
        *(f"spring_{name}_{axis}" for name in springs for axis in "xy"),
        *((LOAD_FACTOR,) if any(stage.control is not None for stage in stages) else ()),
    ]
    if of_regions:
        mesh = read_or_make_mesh(loaded)
        regions = [name for name, cells in mesh.regions.items() if 0 < len(cells) < mesh.mesh.t.shape[1]]
        found += [f"{REGION}{name}_{what}" for name in regions for what in (*BODY, *NETWORK)]
    return found


def refuse_missing(results: Sequence[Result], loaded: LoadedScene) -> None:
    """See that columns by the names in a scene are among those that a run of it writes.

    Raises
    ------
    InputError
    """
    asked = [(result, name) for result in results for name in (result.column, result.other)]
    asked = [(result, name) for result, name in asked if name == LOAD_FACTOR or name.startswith(FIELD_FAMILIES)]
    if not asked:
        return
    columns = field_columns(loaded, any(name.startswith(REGION) for _, name in asked))
    for result, name in asked:
        if name == LOAD_FACTOR and name not in columns:
            raise InputError(f"--result {result.text}: no stage of the scene has a control, which gives {LOAD_FACTOR}")
        if name not in columns:
            raise InputError(f"--result {result.text}: {unknown('the column of history.csv', name, columns)}")

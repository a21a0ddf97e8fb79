"""Places of `[[output.probe]]`, checked against the mesh before anything is computed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.scene.reader import LoadedScene
from granfabric.cases.scene.schema_probe import COUNT
from granfabric.fem.discretisation.location import Locator
from granfabric.fem.discretisation.nearest import nearest_on_boundary
from granfabric.fem.discretisation.parts import parts
from granfabric.fem.discretisation.space import Space
from granfabric.fem.output.cells import whole_cells
from granfabric.fem.output.places import ON_THE_EDGE

Array = NDArray[np.float64]


def probe_places(loaded: LoadedScene, space: Space) -> dict[str, Array]:
    """Places of each probe by its name, shape (n, 2) [m].

    Raises
    ------
    InputError
        If a place lies outside of the mesh; with the nearest place that does not.
    """
    probes = loaded.scene.output.probe
    if not probes:
        return {}
    found: dict[str, Array] = {}
    for probe in probes:
        start, end = getattr(probe, "from"), probe.to
        if probe.point is not None:
            found[probe.name] = np.array([probe.point])
        else:
            fraction = np.linspace(0.0, 1.0, probe.count or COUNT)[:, None]
            found[probe.name] = np.array(start) * (1.0 - fraction) + np.array(end) * fraction
    wrong = outside(space, found)
    if wrong:
        places = enumerate(probe.name for probe in probes)
        raise loaded.errors([(["output", "probe", number], wrong[name]) for number, name in places if name in wrong])
    return found


def outside(space: Space, probes: Mapping[str, Array]) -> dict[str, str]:
    """What is wrong with each probe that has places, shape (n, 2) [m], outside of the mesh."""
    locator = Locator(space.nodes, *whole_cells(space, parts(space)))
    wrong = {}
    for name, places in probes.items():
        beyond = np.flatnonzero(locator.find(places, ON_THE_EDGE)[0][:, 0] < 0)
        if len(beyond):
            x, y = places[beyond[0]]
            near = nearest_on_boundary(space.host_mesh, places[beyond[0]], space.order == 2)
            which = "point" if len(places) == 1 else f"{len(beyond)} of {len(places)} places of the line, first"
            wrong[name] = (
                f"probe {name!r}: {which} ({x:.6g}, {y:.6g}) m lies outside of the mesh; the nearest place of the mesh "
                f"is ({near[0]:.9g}, {near[1]:.9g}) m"
            )
    return wrong

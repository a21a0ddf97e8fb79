"""Places of `[[output.probe]]`, checked against the mesh before anything is computed."""

from __future__ import annotations

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
    nodes = parts(space)
    locator = Locator(space.nodes, *whole_cells(space, nodes))
    found, wrong = {}, []
    for number, probe in enumerate(probes):
        start, end = getattr(probe, "from"), probe.to
        if probe.point is not None:
            places, count = np.array([probe.point]), 1
        else:
            count = probe.count or COUNT
            fraction = np.linspace(0.0, 1.0, count)[:, None]
            places = np.array(start) * (1.0 - fraction) + np.array(end) * fraction
        outside = np.flatnonzero(locator.find(places, ON_THE_EDGE)[0][:, 0] < 0)
        if len(outside):
            x, y = places[outside[0]]
            near = nearest_on_boundary(space.host_mesh, places[outside[0]], space.order == 2)
            which = "point" if count == 1 else f"{len(outside)} of {count} places of the line, first"
            wrong.append(
                (
                    ["output", "probe", number],
                    f"probe {probe.name!r}: {which} ({x:.6g}, {y:.6g}) m lies outside of the mesh; the nearest place "
                    f"of the mesh is ({near[0]:.9g}, {near[1]:.9g}) m",
                )
            )
        found[probe.name] = places
    if wrong:
        raise loaded.errors(wrong)
    return found

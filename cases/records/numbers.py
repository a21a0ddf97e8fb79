"""Names that stand behind the numbers in the files for ParaView: of regions and of materials."""

from __future__ import annotations

from collections.abc import Iterable

from granfabric.fem.mesh.host_mesh import HostMesh


def names_of_numbers(host: HostMesh, materials: Iterable[str] = ()) -> dict[str, dict[str, str]]:
    """For `run.json`: names by number of the fields ``region`` and ``material``; what has no names is left out.

    Parameters
    ----------
    host : HostMesh
        Its regions count from 1 in its order.
    materials : iterable of str
        Of the scene, which count from 1 as well.
    """
    named = {"region": host.regions, "material": materials}
    found = {field: {str(place): name for place, name in enumerate(names, start=1)} for field, names in named.items()}
    return {field: names for field, names in found.items() if names}


def region_at(host: HostMesh, cell: int) -> str:
    """Name of the region of a cell, of the first where several overlap; empty in none."""
    return next((name for name, cells in host.regions.items() if cell in cells), "")

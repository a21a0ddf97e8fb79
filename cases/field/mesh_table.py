"""What a mesh consists of, said before anything is computed: one line a group."""

from __future__ import annotations

from typing import Any

from granfabric.cases.terminal.screen import Screen
from granfabric.fem.mesh.host_mesh import HostMesh
from granfabric.fem.mesh.summary import Group, groups, remarks

NONE = {"boundary": "(rest of the outline)", "region": "(cells in no region)"}
"""What is in no group is called in the table."""
_MEASURE = {"boundary": ("side", "m"), "region": ("cell", "m^2")}


def row(group: Group) -> list[str]:
    """A group's name, kind, number of sides or cells, length or area."""
    what, unit = _MEASURE[group.kind]
    count = len(group.index)
    number = f"{count} {what}{'' if count == 1 else 's'}"
    return [group.name or NONE[group.kind], group.kind if group.name else "-", number, f"{group.size:.6g} {unit}"]


def show(host: HostMesh, screen: Screen, curved: bool = True) -> list[Group]:
    """Print a line for each boundary and region, and what is worth a look.

    Parameters
    ----------
    host : HostMesh
    screen : Screen
    curved : bool
        Whether the element follows curved sides, those of second order do.
    """
    found = groups(host, curved)
    cells, nodes = host.mesh.t.shape[1], host.mesh.p.shape[1]
    (x, y), (right, top) = host.mesh.p.min(axis=1), host.mesh.p.max(axis=1)
    shape = {"triangle": "triangles", "quad": "quadrilaterals"}[host.cell]
    title = f"mesh: {cells} {shape}, {nodes} corners, x from {x:.6g} to {right:.6g} m, y from {y:.6g} to {top:.6g} m"
    names = ["group", "kind", "number", "size"]
    screen.table(title, names, [row(group) for group in found], words=("group", "kind"))
    for text in remarks(host):
        screen.say(f"note: {text}")
    return found


def as_data(host: HostMesh, curved: bool = True) -> list[dict[str, Any]]:
    """The same for `run.json`."""
    return [
        {"name": group.name, "kind": group.kind, "count": len(group.index), "size": group.size}
        for group in groups(host, curved)
    ]

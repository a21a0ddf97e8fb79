"""Results to files that ParaView opens: a series of fields on the mesh and one of integration points."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import LawDescription
from granfabric.constitutive.effective_stress import effective_stress
from granfabric.fem.discretisation.projection import Projection
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult

from .vtu import GridWriter

Array = NDArray[np.float64]

FIELDS = "result"
POINTS = "points"
_CELL_TYPES = {"P1": "triangle", "P2": "triangle6", "Q1": "quad", "Q2": "quad9"}


_Series = list[tuple[float, str]]


class OutputError(ValueError):
    """Results cannot be written; the text names the folder and the reason."""


def padded_vector(values: Array) -> Array:
    """Two components to three, (n, 2) -> (n, 3), so that ParaView draws arrows."""
    return np.column_stack([values, np.zeros(len(values))])


def padded_tensor(values: Array, shear_factor: float = 1.0, zz: Array | None = None) -> Array:
    """xx, yy, xy to a full symmetric tensor by rows, (n, 3) -> (n, 9).

    Parameters
    ----------
    values : ndarray, shape (n, 3)
    shear_factor : float
        0.5 turns an engineering shear strain into the tensor component.
    zz : ndarray, shape (n,), optional
        Component out of the plane; zero if not given.
    """
    full = np.zeros((len(values), 9))
    full[:, 0], full[:, 4] = values[:, 0], values[:, 1]
    full[:, 1] = full[:, 3] = shear_factor * values[:, 2]
    if zz is not None:
        full[:, 8] = zz
    return full


def point_fields(result: StepResult, description: LawDescription) -> dict[str, Array]:
    """Stress, strain and every state variable by name at the integration points, padded for files."""
    zz = result.state[:, description.columns("stress_zz")].ravel() if description.has_state("stress_zz") else None
    fields = {
        "stress": padded_tensor(result.stress, zz=zz),
        "strain": padded_tensor(result.strain, shear_factor=0.5),
    }
    if description.has_state("pore_pressure"):
        carried = effective_stress(result.stress, result.state, description)
        pressure = result.state[:, description.columns("pore_pressure")].ravel()
        fields["effective_stress"] = padded_tensor(carried, zz=None if zz is None else zz + 0.0 * pressure)
    for variable in description.state:
        columns = result.state[:, description.columns(variable.name)]
        if variable.components == 1:
            fields[variable.name] = columns.ravel()
        elif variable.components == 2:
            fields[variable.name] = padded_vector(columns)
        else:
            fields[variable.name] = padded_tensor(columns)
    return fields


def shown_part(description: LawDescription) -> tuple[LawDescription, NDArray[np.int64] | None]:
    """The law without the variables that writers pass over, and the columns of those that stay; None if all do."""
    shown = tuple(variable for variable in description.state if not variable.hidden)
    if len(shown) == len(description.state):
        return description, None
    every = np.arange(description.nstate)
    columns = [every[description.columns(variable.name)] for variable in shown]
    return replace(description, state=shown), np.concatenate(columns)


class FieldWriter:
    """Write one `.vtu` of fields and one of integration points a step, and keep `result.pvd`, `points.pvd` up to date.

    A `.pvd` is replaced in one move after its `.vtu` is complete, so that what it names can always be read.

    Parameters
    ----------
    folder : str or Path
        Created if missing.
    space : Space
    description : LawDescription
    keep : callable, optional
        Going on with a run: told a step's number, whether its files and its entry in the series are kept. Without it
        the series begin anew.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """

    def __init__(
        self,
        folder: str | Path,
        space: Space,
        description: LawDescription,
        keep: Callable[[int], bool] | None = None,
    ) -> None:
        self.folder = Path(folder)
        self._space = space
        self._description, self._shown = shown_part(description)
        self._projection = Projection(space)
        self._grids = {
            FIELDS: GridWriter(padded_vector(space.nodes), _CELL_TYPES[space.element], _counter_clockwise(space)),
            POINTS: GridWriter(padded_vector(space.points), "vertex", np.arange(space.npoints).reshape(-1, 1)),
        }
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe = self.folder / ".writable"
            probe.write_text("")
            probe.unlink()
        except OSError as error:
            raise OutputError(f"output folder {self.folder} cannot be written: {error.strerror or error}") from None
        # both are read before either is changed
        existing = {name: self._existing(name, keep) for name in (FIELDS, POINTS)}
        for name, (series, kept) in existing.items():
            if kept != series:
                self._write_series(name, kept)
                for _, file in set(series) - set(kept):
                    (self.folder / file).unlink(missing_ok=True)
        self._series = {name: kept for name, (_, kept) in existing.items()}

    def _existing(self, name: str, keep: Callable[[int], bool] | None) -> tuple[_Series, _Series]:
        """Entries of a series on disk, and those of them to keep."""
        path = self.folder / f"{name}.pvd"
        if keep is None or not path.is_file():
            return [], []
        try:
            entries = ElementTree.parse(path).getroot().iter("DataSet")
            series = [(float(entry.attrib["timestep"]), entry.attrib["file"]) for entry in entries]
            for _, file in series:
                if not re.fullmatch(rf"{name}_\d{{1,9}}\.vtu", file):  # never a file elsewhere
                    raise ValueError(f"{file!r} is no file of this series")
            kept = [(time, file) for time, file in series if keep(int(file.removesuffix(".vtu").rpartition("_")[2]))]
        except (ElementTree.ParseError, KeyError, ValueError):
            raise OutputError(f"{path} is damaged; remove it or choose another output folder") from None
        for _, file in kept:
            if not (self.folder / file).is_file():
                raise OutputError(f"{path} names {file}, which is gone; choose another output folder")
        return series, kept

    def write(
        self,
        result: StepResult,
        time: float,
        extra_fields: dict[str, Array] | None = None,
    ) -> None:
        """Write one step.

        Parameters
        ----------
        result : StepResult
        time : float
            Time stamp in the series, ascending.
        extra_fields : dict of str to ndarray, shape (npt,), (npt, 3) or (npt, 9), optional
            Further fields at the integration points; they are projected as well.

        Raises
        ------
        OutputError
        """
        extra = extra_fields or {}
        if self._shown is not None:
            result = replace(result, state=result.state[:, self._shown])
        at_points = {**point_fields(result, self._description), **extra}
        # Projected before it is padded: less than half of the columns.
        recover = self._projection
        nodal = replace(
            result, stress=recover(result.stress), strain=recover(result.strain), state=recover(result.state)
        )
        at_nodes = point_fields(nodal, self._description)
        at_nodes |= {name: recover(values) for name, values in extra.items()}
        at_nodes["displacement"] = padded_vector(result.displacement.reshape(-1, 2))
        at_points["status"] = result.status.astype(np.int32)
        at_points["displacement"] = padded_vector(self._space.interpolate(result.displacement.reshape(-1, 2)))
        try:
            self._write(FIELDS, time, result.step, at_nodes)
            self._write(POINTS, time, result.step, at_points)
        except OSError as error:
            raise OutputError(f"output folder {self.folder} cannot be written: {error.strerror or error}") from None

    def _write(self, name: str, time: float, step: int, fields: dict[str, Array]) -> None:
        file = f"{name}_{step:04d}.vtu"
        self._grids[name].write(self.folder / file, fields)
        series = [entry for entry in self._series[name] if entry[1] != file]
        series.append((time, file))
        self._series[name] = series
        self._write_series(name, series)

    def _write_series(self, name: str, series: _Series) -> None:
        lines = [f'    <DataSet timestep="{stamp!r}" part="0" file={quoteattr(entry)}/>' for stamp, entry in series]
        text = "\n".join(
            ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>", *lines]
            + ["  </Collection>", "</VTKFile>", ""]
        )
        hidden = self.folder / f".{name}.pvd"
        hidden.write_text(text)
        os.replace(hidden, self.folder / f"{name}.pvd")


def _counter_clockwise(space: Space) -> NDArray[np.int64]:
    """Element nodes in VTK's order; scikit-fem sorts the corners of triangles, which turns some of them."""
    nodes = space.element_nodes.astype(np.int64)
    if space.host_mesh.cell == "quad":
        return nodes
    corner = space.nodes[nodes[:, :3]]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    turned = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0
    order = [0, 2, 1] if space.order == 1 else [0, 2, 1, 5, 4, 3]
    result = nodes.copy()
    result[turned] = nodes[turned][:, order]
    return result

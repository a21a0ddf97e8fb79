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
from granfabric.fem.discretisation.restricted import RestrictedSpace, restricted_space
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult

from .cells import vtk_cells
from .compression import Compression
from .derived import derived, invariants
from .recovery import Recovery, region_of_cells
from .shown import shown_part
from .vtu import GridWriter

Array = NDArray[np.float64]

FIELDS = "result"
POINTS = "points"


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


def restricted_result(result: StepResult, part: RestrictedSpace) -> StepResult:
    """A step with the values of a part of the body alone, in the order of the part's nodes and points."""
    return replace(
        result,
        displacement=result.displacement.reshape(-1, 2)[part.nodes].ravel(),
        stress=result.stress[part.points],
        strain=result.strain[part.points],
        state=result.state[part.points],
        status=result.status[part.points],
    )


class FieldWriter:
    """Write one `.vtu` of fields and one of integration points a step, and keep `result.pvd`, `points.pvd` up to date.

    A `.pvd` is replaced in one move after its `.vtu` is complete, so that what it names can always be read. Fields are
    recovered for each material by itself; where materials meet, nodes are there once for each of them. Where stages
    change the body, each file holds what is there at its step, and nothing of the rest.

    Parameters
    ----------
    folder : str or Path
        Created if missing.
    space : Space
    description : LawDescription
    keep : callable, optional
        Going on with a run: told a step's number, whether its files and its entry in the series are kept. Without it
        the series begin anew.
    material_index : ndarray of int, shape (npt,), optional
        Number of the material at each integration point, from 0; one material if not given.
    compression : {"none", "fast", "small"}

    Attributes
    ----------
    recovery : Recovery
        From integration points to the nodes of the files.

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
        material_index: NDArray[np.integer] | None = None,
        compression: Compression = "none",
    ) -> None:
        self.folder = Path(folder)
        self._description, self._shown = shown_part(description)
        self._compression: Compression = compression
        self._whole, self._material_index = space, material_index
        self.part: RestrictedSpace | None = None
        self._take_up()
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

    def _take_up(self) -> None:
        """Write what is on the space, or on the part of it that is there, from now on."""
        part = self.part
        space = self._whole if part is None else part.space
        index = self._material_index
        if index is not None and part is not None:
            index = index[part.points]
        self.space = space
        self.recovery = Recovery(space, index)
        nodes = self.recovery.nodes
        self._cells = vtk_cells(space, nodes)
        number = np.arange(space.nelements) if part is None else part.cells
        of_cells = {
            "element": number.astype(np.int32),
            "region": region_of_cells(space),
            "material": self.recovery.material,
        }
        self._grids = {
            FIELDS: GridWriter(
                padded_vector(space.nodes[nodes.node]),
                self._cells.blocks,
                self._compression,
                lasting_of_cells={name: values[self._cells.element] for name, values in of_cells.items()},
            ),
            POINTS: GridWriter(
                padded_vector(space.points),
                [("vertex", np.arange(space.npoints).reshape(-1, 1))],
                self._compression,
                lasting={name: values[space.point_cell] for name, values in of_cells.items()},
            ),
        }

    def follow_body(self, active: NDArray[np.bool_] | None) -> bool:
        """Take up the elements that are there at a step, with their nodes and points alone; whether they are others."""
        if active is None or active.all():
            changed, self.part = self.part is not None, None
        elif self.part is not None and np.array_equal(self.part.cells, np.flatnonzero(active)):
            return False
        else:
            changed, self.part = True, restricted_space(self._whole, active)
        if changed:
            self._take_up()
        return changed

    def of_part(self, result: StepResult) -> StepResult:
        """A step with the values of what is there alone."""
        return result if self.part is None else restricted_result(result, self.part)

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
        self.follow_body(result.active)
        extra = extra_fields or {}
        if self._shown is not None:
            result = replace(result, state=result.state[:, self._shown])
        if self.part is not None:
            extra = {name: values[self.part.points] for name, values in extra.items()}
        result = self.of_part(result)
        carried = effective_stress(result.stress, result.state, self._description)
        displacement = result.displacement.reshape(-1, 2)
        at_points = {**point_fields(result, self._description), **derived(result.stress, carried), **extra}
        # Projected before it is padded: less than half of the columns.
        nodal = self.recovery.result(result)
        at_nodes = {
            **point_fields(nodal, self._description),
            **derived(nodal.stress, effective_stress(nodal.stress, nodal.state, self._description)),
        }
        at_nodes |= {name: self.recovery.field(values) for name, values in extra.items()}
        at_nodes["displacement"] = padded_vector(displacement[self.recovery.nodes.node])
        at_points["status"] = result.status.astype(np.int32)
        at_points["displacement"] = padded_vector(self.space.interpolate(displacement))
        means = self.recovery.cell_means
        of_cells = invariants(means(result.stress), means(carried))
        of_cells = {name: values[self._cells.element] for name, values in of_cells.items()}
        try:
            self._write(FIELDS, time, result.step, at_nodes, of_cells)
            self._write(POINTS, time, result.step, at_points)
        except OSError as error:
            raise OutputError(f"output folder {self.folder} cannot be written: {error.strerror or error}") from None

    def _write(
        self, name: str, time: float, step: int, fields: dict[str, Array], of_cells: dict[str, Array] | None = None
    ) -> None:
        file = f"{name}_{step:04d}.vtu"
        self._grids[name].write(self.folder / file, fields, of_cells)
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

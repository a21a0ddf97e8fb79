"""Results to files that ParaView opens: a series of fields on the mesh and one of integration points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.contract import LawDescription
from granfabric.constitutive.effective_stress import effective_stress
from granfabric.fem.discretisation.restricted import RestrictedSpace, restricted_space
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.results import StepResult

from .cells import VtkCells, vtk_cells
from .compression import Compression
from .derived import derived, invariants
from .recovery import Recovery, region_of_cells
from .series_files import FIELDS, POINTS, OutputError, SeriesFiles, file_name
from .shown import shown_part
from .vtu import Described, GridWriter

Array = NDArray[np.float64]

__all__ = ["FIELDS", "POINTS", "FieldWriter", "Grids", "OutputError", "padded_tensor", "padded_vector", "point_fields"]


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


class Grids:
    """What both files of a step hold: fields at the nodes of the mesh, and at the integration points.

    Fields are recovered for each material by itself; where materials meet, nodes are there once for each of them. Where
    stages change the body, a step has what is there, and nothing of the rest.

    Parameters
    ----------
    space : Space
    description : LawDescription
    material_index : ndarray of int, shape (npt,), optional
        Number of the material at each integration point, from 0; one material if not given.
    compression : {"none", "fast", "small"}
    piece : Piece, optional
        What of the space is written, and the numbers in the whole; all of it if not given.

    Attributes
    ----------
    space : Space
        What is there of the one that was given.
    recovery : Recovery
        From integration points to the nodes of the files.
    part : RestrictedSpace or None
    """

    def __init__(
        self,
        space: Space,
        description: LawDescription,
        material_index: NDArray[np.integer] | None = None,
        compression: Compression = "none",
        piece: Piece | None = None,
    ) -> None:
        self._description, self._shown = shown_part(description)
        self._compression: Compression = compression
        self._whole, self._material_index, self._piece = space, material_index, piece
        self.part: RestrictedSpace | None = None
        self._take_up()

    def _take_up(self) -> None:
        """Write what is on the space, or on the part of it that is there, from now on."""
        part, piece = self.part, self._piece
        space = self._whole if part is None else part.space
        index = self._material_index
        if index is not None and part is not None:
            index = index[part.points]
        self.space = space
        self.recovery = Recovery(space, index)
        nodes = self.recovery.nodes
        number = np.arange(space.nelements) if part is None else part.cells
        of_whole, own = number, np.ones(space.nelements, dtype=bool)
        if piece is not None:
            of_whole, own = piece.elements[number], piece.own[number]
        cells = vtk_cells(space, nodes)
        of_cells = {
            "element": of_whole.astype(np.int32),
            "region": region_of_cells(space),
            "material": self.recovery.material,
        }
        self._cell_element = cells.element
        self._nodes = self._points = None  # all
        lasting = {}
        if piece is not None:
            cells, self._nodes = _of_elements(cells, own)
            self._points = own[space.point_cell]
            self._cell_element = cells.element
            of_space = nodes.node[self._nodes]
            lasting["node"] = piece.nodes[of_space if part is None else part.nodes[of_space]].astype(np.int32)
        self._grids = {
            FIELDS: GridWriter(
                self._chosen(padded_vector(space.nodes[nodes.node]), self._nodes),
                cells.blocks,
                self._compression,
                lasting,
                {name: values[self._cell_element] for name, values in of_cells.items()},
            ),
            POINTS: GridWriter(
                self._chosen(padded_vector(space.points), self._points),
                [("vertex", np.arange(int(own[space.point_cell].sum())).reshape(-1, 1))],
                self._compression,
                lasting={name: self._chosen(of[space.point_cell], self._points) for name, of in of_cells.items()},
            ),
        }

    @staticmethod
    def _chosen(values: NDArray, rows: NDArray | None) -> NDArray:
        return values if rows is None else values[rows]

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

    def write_files(
        self, folder: Path, names: dict[str, str], result: StepResult, extra: dict[str, Array] | None = None
    ) -> dict[str, Described]:
        """Write both files of a step.

        Parameters
        ----------
        folder : Path
        names : dict of str to str
            File of each series.
        result : StepResult
            Of all nodes and points of the space that was given.
        extra : dict of str to ndarray, shape (npt,), (npt, 3) or (npt, 9), optional
            Further fields at the integration points; they are projected as well.

        Returns
        -------
        dict of str to Described
            What the file of each series holds.

        Raises
        ------
        OSError
        """
        self.follow_body(result.active)
        extra = extra or {}
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
        of_cells = {name: values[self._cell_element] for name, values in of_cells.items()}
        at_nodes = {name: self._chosen(values, self._nodes) for name, values in at_nodes.items()}
        at_points = {name: self._chosen(values, self._points) for name, values in at_points.items()}
        return {
            FIELDS: self._grids[FIELDS].write(folder / names[FIELDS], at_nodes, of_cells),
            POINTS: self._grids[POINTS].write(folder / names[POINTS], at_points),
        }


@dataclass(frozen=True)
class Piece:
    """What of a space is one piece of a whole; the rest of it surrounds the piece, for recovery alone.

    Parameters
    ----------
    own : ndarray of bool, shape (nelem,)
        Elements of the piece.
    elements, nodes : ndarray of int, shapes (nelem,), (nnodes,)
        Numbers in the whole.
    """

    own: NDArray[np.bool_]
    elements: NDArray[np.int64]
    nodes: NDArray[np.int64]


def _of_elements(cells: VtkCells, own: NDArray[np.bool_]) -> tuple[VtkCells, NDArray[np.int64]]:
    """Cells of some elements, and the nodes that they have, to which they are renumbered."""
    chosen = own[cells.element]
    blocks, begin = [], 0
    for name, block in cells.blocks:
        blocks.append((name, block[chosen[begin : begin + len(block)]]))
        begin += len(block)
    blocks = [(name, block) for name, block in blocks if len(block)]
    nodes = np.unique(np.concatenate([block.ravel() for _, block in blocks]))
    blocks = [(name, np.searchsorted(nodes, block)) for name, block in blocks]
    return VtkCells(blocks, cells.element[chosen]), nodes


class FieldWriter(Grids):
    """Write one `.vtu` of fields and one of integration points a step, and keep `result.pvd`, `points.pvd` up to date.

    A `.pvd` is replaced in one move after its `.vtu` is complete, so that what it names can always be read. For what
    files hold see `Grids`.

    Parameters
    ----------
    folder : str or Path
        Created if missing.
    space : Space
    description : LawDescription
    keep : callable, optional
        See `SeriesFiles`.
    material_index : ndarray of int, shape (npt,), optional
    compression : {"none", "fast", "small"}

    Attributes
    ----------
    series : SeriesFiles

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
        super().__init__(space, description, material_index, compression)
        self.folder = Path(folder)
        self.series = SeriesFiles(folder, keep)

    def write(self, result: StepResult, time: float, extra_fields: dict[str, Array] | None = None) -> None:
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
        names = {series: file_name(series, result.step) for series in (FIELDS, POINTS)}
        try:
            self.write_files(self.folder, names, result, extra_fields)
            for series, file in names.items():
                self.series.add(series, time, file)
        except OSError as error:
            raise OutputError(f"output folder {self.folder} cannot be written: {error.strerror or error}") from None

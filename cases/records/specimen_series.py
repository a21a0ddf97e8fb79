"""History of a specimen of disks as text; its disks, contacts and fields as time series for ParaView."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.measures.coarse_graining import GAUSSIAN_REACH
from granfabric.dem_ref.specimen.fields import SpecimenFields, places_in, specimen_fields
from granfabric.dem_ref.specimen.run import SpecimenRun
from granfabric.dem_ref.specimen.specimen import Specimen

from . import files
from .dem_series import CONTACTS, FIELDS, PARTICLES, DemSeries, FieldGrid, contact_mesh, grid_mesh, particle_mesh

Array = NDArray[np.float64]


def history_text(run: SpecimenRun) -> str:
    """The records so far as comma-separated text."""
    history = run.history()
    return files.csv_text(list(history), list(zip(*(column.tolist() for column in history.values()))))


def cells_of(specimen: Specimen, cells: int) -> tuple[int, int]:
    """Cells of a grid across and along a specimen, about squares."""
    width = specimen.area / specimen.height
    return cells, max(1, round(cells * specimen.height / width))


def scale_for(specimen: Specimen, grid: FieldGrid) -> float:
    """Scale of the kernel [mean diameters]."""
    if grid.scale is not None:
        return grid.scale
    reach = max(4.0, 1.5 * specimen.area / specimen.height / grid.cells / specimen.sample.mean_diameter)
    return reach / (GAUSSIAN_REACH if grid.kernel == "gaussian" else 1.0)


def fields_on_grid(specimen: Specimen, start: Array | None, grid: FieldGrid) -> tuple[SpecimenFields, Array]:
    """Averages at the middles of the cells, and the corners of the grid, shape (a + 1, b + 1, 2)."""
    cells = cells_of(specimen, grid.cells)

    def at(x: Array, y: Array) -> Array:
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)

    middles = at(*((np.arange(number) + 0.5) / number for number in cells))
    corners = at(*(np.linspace(0.0, 1.0, number + 1) for number in cells))
    found = specimen_fields(specimen, middles, scale_for(specimen, grid), grid.kernel, start)
    return found, places_in(specimen, corners).reshape(cells[0] + 1, cells[1] + 1, 2)


class SpecimenSeries:
    """Write disks, contacts and fields at every so many records; see `DemSeries`.

    Parameters
    ----------
    folder : Path
    run : SpecimenRun
    every : int
        0 for no files.
    reached : int
        Going on with a run: number of its last record.
    grid : FieldGrid, optional
    """

    def __init__(self, folder: Path, run: SpecimenRun, every: int, reached: int, grid: FieldGrid | None) -> None:
        self._series = DemSeries(folder, run.specimen.sample, every, reached, grid)
        self._grid = grid

    def add(self, run: SpecimenRun) -> None:
        """Write the last record if it is due, or the last of the run."""
        record = len(run.specimen.rows) - 1
        if record < 0 or not self._series.is_due(record, run.finished):
            return
        sample = run.specimen.sample
        meshes: dict[str, meshio.Mesh] = {
            PARTICLES: particle_mesh(sample, run.start_position, wrapped=False),
            CONTACTS: contact_mesh(sample, wrapped=False),
        }
        if self._grid is not None:
            found, corners = fields_on_grid(run.specimen, run.start_position, self._grid)
            meshes[FIELDS] = grid_mesh(found, found.strain, corners)
        self._series.write(record, meshes)

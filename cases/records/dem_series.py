"""History of a DEM run as text; its particles and contacts as time series for ParaView."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.loading.run import DemRun
from granfabric.dem_ref.measures.coarse_graining import GAUSSIAN_REACH, CoarseFields, coarse_grained
from granfabric.dem_ref.measures.fields import contact_fields, particle_fields
from granfabric.dem_ref.sample.disks import Sample
from granfabric.dem_ref.sample.neighbours import cell_heights
from granfabric.dem_ref.specimen.fields import SpecimenFields

from . import files

PARTICLES = "particles"
CONTACTS = "contacts"
FIELDS = "fields"


def history_text(run: DemRun) -> str:
    """The records so far as comma-separated text."""
    history = run.history()
    return files.csv_text(list(history), list(zip(*(column.tolist() for column in history.values()))))


def _padded(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([values, np.zeros(len(values))])


def particle_mesh(sample: Sample, start: NDArray[np.float64], wrapped: bool = True) -> meshio.Mesh:
    """Disks as points; their radius is a field, to be drawn by ParaView's glyphs or point gaussians.

    Parameters
    ----------
    sample : Sample
    start : ndarray, shape (n, 2)
        Positions from which displacements count.
    wrapped : bool
        Into the periodic cell.
    """
    fields = particle_fields(sample)
    if not wrapped:
        fields["position"] = sample.position
    data = {name: values for name, values in fields.items() if name != "position"}
    data["displacement"] = _padded(sample.position - start)
    points = _padded(fields["position"])
    return meshio.Mesh(points, [("vertex", np.arange(len(points)).reshape(-1, 1))], point_data=data)


def contact_mesh(sample: Sample, wrapped: bool = True) -> meshio.Mesh:
    """Contacts as lines between centres; fields for the cells, and for the points so that tubes can vary in width."""
    fields = contact_fields(sample, wrapped)
    count = len(fields["start"])
    points = np.empty((2 * count, 3))
    points[0::2], points[1::2] = _padded(fields["start"]), _padded(fields["end"])
    data = {name: fields[name] for name in ("normal_force", "tangential_force", "mobilisation")}
    return meshio.Mesh(
        points,
        [("line", np.arange(2 * count).reshape(-1, 2))],
        point_data={name: np.repeat(values, 2) for name, values in data.items()},
        cell_data={name: [values] for name, values in data.items()},
    )


@dataclass(frozen=True)
class FieldGrid:
    """A grid on which fields are averaged.

    Parameters
    ----------
    cells : int
        Along each side.
    kernel : str
    scale : float, optional
        Of the kernel, mean diameters; 1.5 cells of the grid, at least four diameters, reach if not given.
    """

    cells: int
    kernel: str = "lucy"
    scale: float | None = None

    def scale_for(self, sample: Sample) -> float:
        """Scale of the kernel for a sample [mean diameters]."""
        if self.scale is not None:
            return self.scale
        longest = float(np.linalg.norm(sample.cell, axis=1).max()) / sample.mean_diameter
        half = 0.49 * min(cell_heights(sample.cell)) / sample.mean_diameter
        reach = min(max(4.0, 1.5 * longest / self.cells), half)
        return reach / (GAUSSIAN_REACH if self.kernel == "gaussian" else 1.0)


def field_mesh(
    sample: Sample, start: tuple[NDArray[np.float64], NDArray[np.float64]], grid: FieldGrid
) -> meshio.Mesh:
    """Averages on a grid as quadrilaterals with cell data; strains count from positions and cell at the start.

    Stress and strain hold xx, yy, xy, tension positive (shear strain gamma_xy); fabric is the vector of a_c in the
    double-angle plane.
    """
    cells = (grid.cells, grid.cells)
    found = coarse_grained(sample, cells, grid.scale_for(sample), grid.kernel, start)
    assert found.strain is not None
    return grid_mesh(found, found.strain, found.corner)


def grid_mesh(
    found: CoarseFields | SpecimenFields, strain: NDArray[np.float64], corner: NDArray[np.float64]
) -> meshio.Mesh:
    """Fields of the cells of a grid, whose corners have the shape (a + 1, b + 1, 2), as quadrilaterals."""
    place = np.arange(corner.shape[0] * corner.shape[1]).reshape(corner.shape[:2])
    corners = [place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]]
    data = {
        "disks": found.disks, "coordination": found.coordination, "fabric": _padded(found.fabric),
        "fabric_anisotropy": np.hypot(*found.fabric.T), "solid_fraction": found.solid_fraction,
        "stress": found.stress, "strain": strain, "p": -0.5 * (found.stress[:, 0] + found.stress[:, 1]),
        "q": np.hypot(0.5 * (found.stress[:, 0] - found.stress[:, 1]), found.stress[:, 2]),
    }  # fmt: skip
    return meshio.Mesh(
        _padded(corner.reshape(-1, 2)),
        [("quad", np.stack([corner.ravel() for corner in corners], axis=-1))],
        cell_data={name: [values] for name, values in data.items()},
    )


class DemSeries:
    """Write particles and contacts at every so many records, and keep both `.pvd` files up to date.

    Whether a record is written depends on its number alone, so that a resumed run leaves the same files.

    Parameters
    ----------
    folder : Path
    start : Sample
        The packing; displacements and strains count from it.
    every : int
        0 for no files.
    reached : int
        Going on with a run: number of its last record; earlier files stay in the series.
    grid : FieldGrid, optional
        Averages on a grid as well, a third series.
    """

    def __init__(
        self, folder: Path, start: Sample, every: int, reached: int = -1, grid: FieldGrid | None = None
    ) -> None:
        self._folder = folder
        self._start = start.position.copy(), start.cell.copy()
        self._grid = grid
        self._every = every
        self._records: list[int] = []
        names = (PARTICLES, CONTACTS) if grid is None else (PARTICLES, CONTACTS, FIELDS)
        if every:
            for record in range(0, reached + 1, every):
                if all((folder / _name(series, record)).is_file() for series in names):
                    self._records.append(record)

    def is_due(self, record: int, last: bool = False) -> bool:
        """Whether a record is to be written, and was not."""
        return bool(self._every) and record not in self._records and (last or record % self._every == 0)

    def add(self, record: int, sample: Sample, last: bool = False) -> None:
        """Write a record if it is due, or the last."""
        if not self.is_due(record, last):
            return
        meshes = {PARTICLES: particle_mesh(sample, self._start[0]), CONTACTS: contact_mesh(sample)}
        if self._grid is not None:
            meshes[FIELDS] = field_mesh(sample, self._start, self._grid)
        self.write(record, meshes)

    def write(self, record: int, meshes: dict[str, meshio.Mesh]) -> None:
        """Write the meshes of a record by their series."""
        for series, mesh in meshes.items():
            _write(self._folder / _name(series, record), mesh)
        self._records.append(record)
        for series in meshes:
            entries = [
                f'    <DataSet timestep="{number}" part="0" file={quoteattr(_name(series, number))}/>'
                for number in self._records
            ]
            lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "  <Collection>"]
            text = "\n".join([*lines, *entries, "  </Collection>", "</VTKFile>", ""])
            files.write_text(self._folder / f"{series}.pvd", text)


def _write(path: Path, mesh: meshio.Mesh) -> None:
    files.write_whole(path, lambda temporary: meshio.vtu.write(str(temporary), mesh, compression="zlib"))


def _name(series: str, record: int) -> str:
    return f"{series}_{record:05d}.vtu"

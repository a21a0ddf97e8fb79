"""Unstructured grids in VTK's XML format: raw binary after the header; mesh and lasting fields are encoded once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numba
import numpy as np
from numpy.typing import NDArray

from .compression import COMPRESSORS, Compression, encoded

_TYPES = {
    np.dtype("float64"): "Float64",
    np.dtype("int64"): "Int64",
    np.dtype("int32"): "Int32",
    np.dtype("uint8"): "UInt8",
}
# VTK's number of each kind of cell.
_CELLS = {"vertex": 1, "triangle": 5, "triangle6": 22, "quad": 9, "quad9": 28}

Fields = Mapping[str, NDArray]
Cells = Sequence[tuple[str, NDArray[np.int64]]]
"""Blocks of cells of one kind each: "vertex", "triangle", "triangle6", "quad" or "quad9", and their points in VTK's
order, shape (ncells, points per cell)."""
_Encoded = tuple[str, bytes]
Described = dict[str, list[str]]
"""Attributes of the arrays of a file, by section."""


class GridWriter:
    """Writes files that share one mesh.

    Parameters
    ----------
    points : ndarray, shape (npoints, 3)
    cells : sequence of (str, ndarray of int64)
        Blocks of cells, see `Cells`.
    compression : {"none", "fast", "small"}
    lasting, lasting_of_cells : mapping of str to ndarray, optional
        Fields that are the same in every file, of points and of cells.
    """

    def __init__(
        self,
        points: NDArray[np.float64],
        cells: Cells,
        compression: Compression = "fast",
        lasting: Fields | None = None,
        lasting_of_cells: Fields | None = None,
    ) -> None:
        self._npoints = len(points)
        self._ncells = sum(len(block) for _, block in cells)
        self._compression = compression
        width = np.concatenate([np.full(len(block), block.shape[1], dtype=np.int64) for _, block in cells])
        kinds = np.concatenate([np.full(len(block), _CELLS[kind], dtype=np.uint8) for kind, block in cells])
        connectivity = np.concatenate([block.ravel() for _, block in cells]).astype(np.int64, copy=False)
        self._points = [self._encoded("Points", points)]
        self._cells = [
            self._encoded("connectivity", connectivity),
            self._encoded("offsets", np.cumsum(width)),
            self._encoded("types", kinds),
        ]
        self._check(lasting or {}, self._npoints, "points")
        self._check(lasting_of_cells or {}, self._ncells, "cells")
        self._lasting = [self._encoded(name, values) for name, values in (lasting or {}).items()]
        self._of_cells = [self._encoded(name, values) for name, values in (lasting_of_cells or {}).items()]

    def _encoded(self, name: str, values: NDArray) -> _Encoded:
        return _described(name, values), encoded(values, self._compression)

    @staticmethod
    def _check(fields: Fields, count: int, what: str) -> None:
        for name, values in fields.items():
            if values.shape[:1] != (count,):
                raise ValueError(f"field {name!r} has the shape {values.shape}, but there are {count} {what}")

    def _all_encoded(self, fields: Iterable[tuple[str, NDArray]]) -> list[_Encoded]:
        threads = numba.get_num_threads()
        if threads == 1:
            return [self._encoded(name, values) for name, values in fields]
        # threads of this call alone: a pool that is kept would be copied without its threads by a fork
        with ThreadPoolExecutor(threads, thread_name_prefix="granfabric-output") as pool:
            return list(pool.map(lambda field: self._encoded(*field), fields))

    def write(self, path: Path, fields: Fields, of_cells: Fields | None = None) -> Described:
        """Write one file; until it is complete it has another name.

        Parameters
        ----------
        path : Path
        fields : mapping of str to ndarray, shape (npoints,) or (npoints, components)
        of_cells : mapping of str to ndarray, shape (ncells,) or (ncells, components), optional

        Returns
        -------
        Described
            For `write_pieces`.

        Raises
        ------
        OSError
        ValueError
            If a field has another number of rows than there are points or cells.
        """
        of_cells = of_cells or {}
        self._check(fields, self._npoints, "points")
        self._check(of_cells, self._ncells, "cells")
        blocks = self._all_encoded([*fields.items(), *of_cells.items()])
        sections = {
            "PointData": [*blocks[: len(fields)], *self._lasting],
            "CellData": [*blocks[len(fields) :], *self._of_cells],
            "Points": self._points,
            "Cells": self._cells,
        }
        compressor = COMPRESSORS[self._compression]
        head = [
            '<?xml version="1.0"?>',
            '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
            + (f' compressor="{compressor}">' if compressor else ">"),
            "<UnstructuredGrid>",
            f'<Piece NumberOfPoints="{self._npoints}" NumberOfCells="{self._ncells}">',
        ]
        # The last array's bytes come first. meshio looks arrays up by their place in the file, taking the first that
        # matches, and puts another place there once it has one: in this order those still to come are found before.
        offset = sum(len(block) for members in sections.values() for _, block in members)
        ordered: list[bytes] = []
        for section, members in sections.items():
            if not members:
                continue
            head.append(f"<{section}>")
            for text, block in members:
                offset -= len(block)
                head.append(f'<DataArray {text} format="appended" offset="{offset}"/>')
                ordered.append(block)
            head.append(f"</{section}>")
        head += ["</Piece>", "</UnstructuredGrid>", '<AppendedData encoding="raw">', "_"]
        hidden = path.with_name(f".{path.name}")
        with hidden.open("wb") as file:
            file.write("\n".join(head).encode())
            file.writelines(reversed(ordered))
            file.write(b"\n</AppendedData>\n</VTKFile>\n")
        os.replace(hidden, path)
        return {section: [text for text, _ in members] for section, members in sections.items() if members}


def write_pieces(path: Path, described: Described, pieces: Sequence[str], compression: Compression) -> None:
    """Write the `.pvtu` of files beside it that hold a piece each.

    Parameters
    ----------
    path : Path
    described : Described
        Of any of them: all hold the same arrays.
    pieces : sequence of str
        Names of the files.
    compression : {"none", "fast", "small"}
        Theirs.

    Raises
    ------
    OSError
    """
    compressor = COMPRESSORS[compression]
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PUnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
        + (f' compressor="{compressor}">' if compressor else ">"),
        '<PUnstructuredGrid GhostLevel="0">',
    ]
    for section in ("PointData", "CellData", "Points"):
        lines += [f"<P{section}>", *(f"<PDataArray {text}/>" for text in described.get(section, [])), f"</P{section}>"]
    lines += [f"<Piece Source={quoteattr(piece)}/>" for piece in pieces]
    hidden = path.with_name(f".{path.name}")
    hidden.write_text("\n".join([*lines, "</PUnstructuredGrid>", "</VTKFile>", ""]))
    os.replace(hidden, path)


def _described(name: str, values: NDArray) -> str:
    """Attributes of an array but for its place in the file."""
    components = "" if values.ndim == 1 else f' NumberOfComponents="{values.shape[1]}"'
    return f'type="{_TYPES[values.dtype]}" Name={quoteattr(name)}{components}'

"""Unstructured grids in VTK's XML format: raw binary appended after the header, zlib, the mesh encoded once.

Doubles of a computation are noise in their lower bits and hardly compress; what does are the zeros that pad vectors and
tensors and fields that are constant. Runs of equal bytes are all that zlib is asked to look for, at several times the
speed of its usual search.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numba
import numpy as np
from numpy.typing import NDArray

_TYPES = {
    np.dtype("float64"): "Float64",
    np.dtype("int64"): "Int64",
    np.dtype("int32"): "Int32",
    np.dtype("uint8"): "UInt8",
}
# VTK's number of each kind of cell.
_CELLS = {"vertex": 1, "triangle": 5, "triangle6": 22, "quad": 9, "quad9": 28}


def encoded(values: NDArray) -> bytes:
    """An array as VTK's zlib reader wants it: four numbers (blocks, their size, size of a partial one, compressed
    size) and one compressed block."""
    raw = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<"), copy=False)
    if not raw.nbytes:
        return np.zeros(3, dtype="<u8").tobytes()
    press = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    block = press.compress(raw.data.cast("B")) + press.flush()
    return np.array([1, raw.nbytes, 0, len(block)], dtype="<u8").tobytes() + block


def _longer(block: bytes) -> bytes:
    """The same array in a few bytes more: an empty block of the compressed stream before its end."""
    raw = zlib.decompress(block[32:])
    press = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    stream = press.compress(raw) + press.flush(zlib.Z_SYNC_FLUSH) + press.flush()
    return np.array([1, len(raw), 0, len(stream)], dtype="<u8").tobytes() + stream


def placed(blocks: Sequence[bytes]) -> list[bytes]:
    """Blocks as meshio tells them apart.

    It finds an array by its offset and writes another one there, its place among the uncompressed arrays in base64
    (multiples of 4, 12 or more apart); an array that begins where an earlier one was put so is taken for that one.
    """
    chosen, offset, other, taken = [], 0, 0, set()
    for block in blocks:
        taken.add(other)
        size = int(np.frombuffer(block, "<u8", 2)[1])
        other += 4 * -(-(8 + size) // 3)
        if offset + len(block) in taken and size:
            block = _longer(block)
        chosen.append(block)
        offset += len(block)
    return chosen


class GridWriter:
    """Writes files that share one mesh.

    Parameters
    ----------
    points : ndarray, shape (npoints, 3)
    kind : {"vertex", "triangle", "triangle6", "quad", "quad9"}
        Of all cells.
    cells : ndarray of int64, shape (ncells, nodes per cell)
        In VTK's order.
    """

    def __init__(self, points: NDArray[np.float64], kind: str, cells: NDArray[np.int64]) -> None:
        self._npoints = len(points)
        self._ncells = len(cells)
        ends = np.arange(1, len(cells) + 1, dtype=np.int64) * cells.shape[1]
        self._points = (_described("Points", points), encoded(points))
        self._cells = [
            (_described("connectivity", cells.ravel()), encoded(cells.ravel())),
            (_described("offsets", ends), encoded(ends)),
            (_described("types", np.empty(0, np.uint8)), encoded(np.full(len(cells), _CELLS[kind], dtype=np.uint8))),
        ]

    def write(self, path: Path, fields: Mapping[str, NDArray]) -> None:
        """Write one file; until it is complete it has another name.

        Parameters
        ----------
        path : Path
        fields : mapping of str to ndarray, shape (npoints,) or (npoints, components)

        Raises
        ------
        OSError
        ValueError
            If a field has another number of rows than there are points.
        """
        for name, values in fields.items():
            if values.shape[:1] != (self._npoints,):
                raise ValueError(f"field {name!r} has the shape {values.shape}, but there are {self._npoints} points")
        # threads of this call alone: a pool that is kept would be copied without its threads by a fork
        with ThreadPoolExecutor(numba.get_num_threads(), thread_name_prefix="granfabric-output") as pool:
            blocks = list(pool.map(encoded, fields.values()))
        texts = [_described(name, values) for name, values in fields.items()]
        mesh = [self._points, *self._cells]
        blocks = placed([*blocks, *(block for _, block in mesh)])
        arrays = list(zip([*texts, *(text for text, _ in mesh)], blocks))
        n = len(texts)
        head = [
            '<?xml version="1.0"?>',
            '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
            'compressor="vtkZLibDataCompressor">',
            "<UnstructuredGrid>",
            f'<Piece NumberOfPoints="{self._npoints}" NumberOfCells="{self._ncells}">',
        ]
        offset = 0
        for section, members in (("PointData", arrays[:n]), ("Points", arrays[n : n + 1]), ("Cells", arrays[n + 1 :])):
            head.append(f"<{section}>")
            for text, block in members:
                head.append(f'<DataArray {text} format="appended" offset="{offset}"/>')
                offset += len(block)
            head.append(f"</{section}>")
        head += ["</Piece>", "</UnstructuredGrid>", '<AppendedData encoding="raw">', "_"]
        hidden = path.with_name(f".{path.name}")
        with hidden.open("wb") as file:
            file.write("\n".join(head).encode())
            for block in blocks:
                file.write(block)
            file.write(b"\n</AppendedData>\n</VTKFile>\n")
        os.replace(hidden, path)


def _described(name: str, values: NDArray) -> str:
    """Attributes of an array but for its place in the file."""
    components = "" if values.ndim == 1 else f' NumberOfComponents="{values.shape[1]}"'
    return f'type="{_TYPES[values.dtype]}" Name={quoteattr(name)}{components}'

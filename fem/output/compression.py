"""How arrays become bytes of a VTK file: as they are, compressed quickly, or compressed well.

Doubles of a computation are noise in their lower bits; what compresses are the zeros that pad vectors and tensors and
fields that are constant. "fast" asks zlib for runs of equal bytes alone, at twice the speed of its usual search, and
keeps what has none as it is. The same numbers give the same bytes whatever ran before; igzip, at four times this speed,
does not keep that.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Compression = Literal["none", "fast", "small"]

COMPRESSORS: dict[str, str | None] = {
    "none": None,
    "fast": "vtkZLibDataCompressor",
    "small": "vtkLZMADataCompressor",
}
"""What a reader has to be told; LZ4, which VTK knows as well, is none that meshio reads."""

_LZMA = [{"id": lzma.FILTER_LZMA2, "preset": 0, "lc": 0, "lp": 3, "pb": 3}]
"""Numbers of eight bytes each."""


SAMPLE = 4096
"""Bytes at the beginning of an array by which it is told whether it compresses."""
WORTH = 0.55
"""Compressed over plain size of these up to which the array is compressed."""


def _runs(raw: memoryview, level: int) -> bytes:
    press = zlib.compressobj(level, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    return press.compress(raw) + press.flush()


def _fast(raw: memoryview) -> bytes:
    head = raw[:SAMPLE]
    return _runs(raw, 1 if len(_runs(head, 1)) <= WORTH * len(head) else 0)


def _small(raw: memoryview) -> bytes:
    return lzma.compress(raw, lzma.FORMAT_XZ, filters=_LZMA)


_PRESSES: dict[str, Callable[[memoryview], bytes]] = {"fast": _fast, "small": _small}


def encoded(values: NDArray, compression: Compression = "fast") -> bytes:
    """An array as VTK's readers want it.

    Uncompressed: its size in bytes, then itself. Compressed: four numbers (blocks, their size, size of a partial one,
    compressed size) and one compressed block.
    """
    raw = np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<"), copy=False)
    data = raw.data.cast("B") if raw.nbytes else memoryview(b"")
    if compression == "none":
        return np.array([raw.nbytes], dtype="<u8").tobytes() + data.tobytes()
    if not raw.nbytes:
        return np.zeros(3, dtype="<u8").tobytes()
    block = _PRESSES[compression](data)
    return np.array([1, raw.nbytes, 0, len(block)], dtype="<u8").tobytes() + block

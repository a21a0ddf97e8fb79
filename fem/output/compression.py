"""How arrays become bytes of a VTK file: as they are, compressed quickly, or compressed well.

Doubles of a computation are noise in their lower bits; what compresses are their exponents, the zeros that pad vectors
and tensors, the components that a symmetric tensor has twice, and fields that are constant. Intel's igzip (package
`isal`, of the extra `fast`) finds these at several times the speed of zlib and writes the same format. Without it zlib
is asked to look for runs of equal bytes alone, at twice the speed of its usual search.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

try:
    from isal import isal_zlib
except ImportError:  # an extra
    isal_zlib = None  # type: ignore[assignment]

Compression = Literal["none", "fast", "small"]

COMPRESSORS: dict[str, str | None] = {
    "none": None,
    "fast": "vtkZLibDataCompressor",
    "small": "vtkLZMADataCompressor",
}
"""What a reader has to be told; LZ4, which VTK knows as well, is none that meshio reads."""

_LZMA = [{"id": lzma.FILTER_LZMA2, "preset": 0, "lc": 0, "lp": 3, "pb": 3}]
"""Numbers of eight bytes each."""


def _fast(raw: memoryview) -> bytes:
    if isal_zlib is not None:
        return isal_zlib.compress(raw, 1)
    press = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_RLE)
    return press.compress(raw) + press.flush()


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

"""Arrays from an `.npz` file of whatever origin: plain numbers or an error, and no more memory than the file is long.

`numpy.load` without pickles runs nothing, but it inflates what is compressed and allocates what an array's header
claims: a few kilobytes can ask for any amount of memory. What this program writes is not compressed, and an array fills
its member exactly; anything else is refused before it is read. (`fem/equilibrium/stored_arrays.py` is the same for the
same reason: the reference DEM shares no code with the law that it verifies.)
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

MOST_ARRAYS = 1000
DAMAGED = (
    *(OSError, ValueError, KeyError, IndexError, TypeError, EOFError, RuntimeError, NotImplementedError, MemoryError),
    *(SyntaxError, OverflowError, AttributeError, zipfile.BadZipFile, struct.error, zlib.error),
)
"""What reading a damaged archive raises; RuntimeError where a flipped bit claims encryption."""


class StoredArrayError(ValueError):
    """A file is not an archive of plain arrays; the text says why."""


def read_stored_arrays(path: Path) -> dict[str, NDArray]:
    """Arrays of a file written by `numpy.savez`.

    Raises
    ------
    StoredArrayError
        If the file is damaged, compressed, or not of this kind.
    FileNotFoundError
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check(members, path.stat().st_size)
            return {member.filename.removesuffix(".npy"): _array(archive.read(member)) for member in members}
    except (FileNotFoundError, StoredArrayError):
        raise
    except DAMAGED as error:
        reason = str(error)
        # some quote the bytes that they stumbled over
        raise StoredArrayError(reason if 0 < len(reason) < 100 and "\\x" not in reason else "damaged") from None


def _check(members: list[zipfile.ZipInfo], size: int) -> None:
    names = [member.filename for member in members]
    if len(names) > MOST_ARRAYS or len(set(names)) < len(names):
        raise StoredArrayError("too many arrays, or two of one name")
    for member in members:
        if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
            raise StoredArrayError(f"the array {member.filename!r} is compressed")
    if sum(member.file_size for member in members) > size:
        raise StoredArrayError("its arrays are larger than the file")


def _array(data: bytes) -> NDArray:
    """The one array that fills these bytes, whose checksum was right."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise StoredArrayError(f"an array has the format {version}")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject or dtype.kind not in "biufU" or any(not 0 <= length < 2**62 for length in shape):
        raise StoredArrayError(f"an array holds {dtype}, not plain numbers")
    count = 1
    for length in shape:
        count *= length
    rest = len(data) - stream.tell()
    if count * dtype.itemsize != rest:
        raise StoredArrayError(f"an array of the shape {shape} does not fill its {rest} bytes")
    values = np.frombuffer(data, dtype=dtype, count=count, offset=stream.tell())
    return values.reshape(shape, order="F" if fortran else "C").copy()

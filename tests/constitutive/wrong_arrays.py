"""Arrays as callers make them: what has to be taken as it stands, copied, or refused.

A variant is a function of a good array; it returns the array to hand over, or `SAME` where it would be no variant (a
transposed square is as good as any).
"""

from __future__ import annotations

import tempfile
import warnings

import numpy as np

SAME = object()


def _strided(a):
    wide = np.full((2 * a.shape[0] + 1, *a.shape[1:]), 7, dtype=a.dtype)
    wide[1 : 2 * a.shape[0] : 2] = a
    return wide[1 : 2 * a.shape[0] : 2]


def _columns_of_a_wider_one(a):
    wide = np.full((*a.shape[:-1], 2 * a.shape[-1] + 1), 7, dtype=a.dtype)
    wide[..., : a.shape[-1]] = a
    return wide[..., : a.shape[-1]]


def _read_only(a):
    a = a.copy()
    a.flags.writeable = False
    return a


def _misaligned(a):
    if not a.size:
        return SAME
    room = np.zeros(a.nbytes + 1, dtype=np.uint8)
    odd = room[1:].view(a.dtype).reshape(a.shape)
    odd[...] = a
    return odd


def memory_map(a, mode="r"):
    """A map of a temporary file that holds the array."""
    if not a.size:
        return SAME
    with tempfile.TemporaryFile() as file:
        file.write(a.tobytes())
        file.flush()
        return np.memmap(file, dtype=a.dtype, mode=mode, shape=a.shape)


def matrix(a):
    """The subclass that NumPy advises against."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        return np.matrix(a) if a.ndim == 2 else SAME


COPIED = {
    "list": lambda a: a.tolist() if a.size else SAME,
    "tuple of rows": lambda a: tuple(a) if len(a) else SAME,
    "float32": lambda a: a.astype(np.float32),
    "float16": lambda a: a.astype(np.float16) if np.abs(a).max(initial=0) < 6e4 else SAME,
    "longdouble": lambda a: a.astype(np.longdouble),
    "int64": lambda a: a.astype(np.int64),
    "big-endian": lambda a: a.astype(">f8"),
    "Fortran order": np.asfortranarray,
    "strided": _strided,
    "columns of a wider one": _columns_of_a_wider_one,
    "backwards": lambda a: a[::-1].copy()[::-1],
    "read-only": _read_only,
    "misaligned": _misaligned,
    "broadcast": lambda a: np.broadcast_to(a[:1], a.shape) if len(a) else SAME,
    "memory map": memory_map,
    "matrix": matrix,
}
"""Numbers of the right shape, whatever holds them."""

REFUSED = {
    "one row more": lambda a: np.concatenate([a, np.ones((1, *a.shape[1:]))]),
    "one row less": lambda a: a[:-1].copy() if len(a) else SAME,
    "one row": lambda a: a[:1].copy() if len(a) > 1 else SAME,
    "one row for all": lambda a: a[0].copy() if len(a) else SAME,
    "one column more": lambda a: np.zeros((*a.shape[:-1], a.shape[-1] + 1)) if a.ndim > 1 else SAME,
    "two columns": lambda a: a[..., :2].copy() if a.ndim > 1 and a.shape[-1] > 2 else SAME,
    "Voigt 6": lambda a: np.zeros((len(a), 6)) if a.ndim == 2 and a.shape[1] != 6 else SAME,
    "transposed": lambda a: np.ascontiguousarray(a.T) if a.T.shape != a.shape else SAME,
    "flat": lambda a: a.ravel().copy() if a.ndim > 1 else SAME,
    "one dimension more": lambda a: a[None].copy(),
    "nothing": lambda a: np.zeros((0, *a.shape[1:])) if len(a) else SAME,
    "0-d": lambda a: np.array(1.0),
    "number": lambda a: 1.0,
    "None": lambda a: None,
    "complex": lambda a: a.astype(np.complex128),
    "object": lambda a: a.astype(object),
    "text": lambda a: a.astype(str) if a.size else a.astype("U4"),
    "bytes": lambda a: a.astype("S8"),
    "bool": lambda a: a.astype(bool),
    "dates": lambda a: np.zeros(a.shape, dtype="datetime64[s]"),
    "records": lambda a: np.zeros(a.shape, dtype=[("x", "f8")]),
    "masked": lambda a: np.ma.masked_array(a, mask=np.zeros(a.shape, dtype=bool)),
    "ragged": lambda a: [[1.0, 2.0], [1.0]],
    "a word": lambda a: "stress",
    "a dictionary": lambda a: {"xx": a},
    "a generator": lambda a: (row for row in a),
    "huge whole numbers": lambda a: [[10**400] * 3] * len(a) if len(a) else SAME,
}
"""What is no array of numbers of that shape."""

OUTPUT_REFUSED = {
    **{name: REFUSED[name] for name in REFUSED if name not in ("number", "huge whole numbers")},
    **{name: COPIED[name] for name in ("float32", "int64", "big-endian", "read-only", "misaligned", "longdouble")},
    "list": lambda a: a.tolist(),
    "Fortran order": lambda a: np.asfortranarray(a) if not np.asfortranarray(a).flags.c_contiguous else SAME,
    "strided": lambda a: _strided(a) if not _strided(a).flags.c_contiguous else SAME,
    "columns": lambda a: _columns_of_a_wider_one(a) if not _columns_of_a_wider_one(a).flags.c_contiguous else SAME,
    "memory map": memory_map,
}
"""What cannot be written as it stands; an array of no elements is contiguous and writable in any order."""

OUTPUT_TAKEN = {
    "a part of a larger one": lambda a: np.zeros((len(a) + 2, *a.shape[1:]))[1 : len(a) + 1],
    "memory map": lambda a: memory_map(a, "r+"),
    "matrix": matrix,
}

INDEX_COPIED = {
    "int64": lambda a: a.astype(np.int64),
    "uint8": lambda a: a.astype(np.uint8),
    "uint64": lambda a: a.astype(np.uint64),
    "big-endian": lambda a: a.astype(">i4"),
    "list": lambda a: a.tolist(),
    "read-only": _read_only,
    "strided": _strided,
    "misaligned": _misaligned,
}

INDEX_REFUSED = {
    "float": lambda a: a.astype(float) if a.size else SAME,
    "bool": lambda a: a.astype(bool),
    "negative": lambda a: a - 1 - a.max() if a.size else SAME,
    "too large": lambda a: a + 2 if a.size else SAME,
    "wraps to a legal one": lambda a: a.astype(np.int64) + 2**32 if a.size else SAME,
    "unsigned largest": lambda a: np.full(a.shape, 2**64 - 1, dtype=np.uint64) if a.size else SAME,
    "column": lambda a: a[:, None].copy(),
    "one for all": lambda a: a[:1].copy() if len(a) > 1 else SAME,
    "too long": lambda a: np.concatenate([a, a[:1], np.zeros(1, a.dtype)]),
    "number": lambda a: 0,
    "object": lambda a: a.astype(object),
    "text": lambda a: a.astype(str),
    "masked": lambda a: np.ma.masked_array(a),
}

CODES_COPIED = {
    "bool": lambda a: a.astype(bool),
    "int64": lambda a: a.astype(np.int64),
    "float": lambda a: a.astype(float),
    "list": lambda a: a.tolist() if a.size else SAME,
    "read-only": _read_only,
    "Fortran order": np.asfortranarray,
    "strided": _strided,
}

CODES_REFUSED = {
    "code 2": lambda a: a + 2 if a.size else SAME,
    "code 255": lambda a: np.full_like(a, 255) if a.size else SAME,
    "code 256": lambda a: np.full(a.shape, 256) if a.size else SAME,
    "minus one": lambda a: -np.ones(a.shape, dtype=int) if a.size else SAME,
    "half": lambda a: np.full(a.shape, 0.5) if a.size else SAME,
    "not a number": lambda a: np.full(a.shape, np.nan) if a.size else SAME,
    "one row": lambda a: np.ones((1, 3), dtype=np.uint8) if len(a) != 1 else SAME,
    "one row for all": lambda a: np.ones(3, dtype=np.uint8),
    "one a point": lambda a: np.ones(len(a), dtype=np.uint8),
    "words": lambda a: np.full(a.shape, "stress"),
    "object": lambda a: a.astype(object),
    "None": lambda a: None,
    "complex": lambda a: a.astype(complex),
}

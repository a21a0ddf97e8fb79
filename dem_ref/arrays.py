"""What the compiled parts of the DEM may be handed: the one place where numbers and arrays of a caller are checked.

A compiled kernel believes what it is told: a particle that does not exist is read from whatever lies behind the array,
and a new kind of array (read-only, strided, of other numbers) sends it to the compiler again. (`constitutive/arrays.py`
does the like for the law: the reference DEM shares no code with the law that it verifies.)
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

FLOAT = np.dtype(np.float64)
ANY = -1
"""In a wanted shape: any length."""


class SampleError(ValueError):
    """A sample or a stored sample that cannot be used; the message says why."""


def is_number(value: object) -> bool:
    """Whether this is a real number and no truth value."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def is_within(value: object, low: float, high: float) -> bool:
    """Whether this is a real number within bounds; NaN is not."""
    # as Python's own number: a bound would be rounded to the precision of a float32
    plain: Any = value.item() if isinstance(value, np.generic) else value
    return is_number(value) and bool(low <= plain <= high)


def is_whole(value: object) -> bool:
    """Whether this is an integer and no truth value."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)


def number(name: str, value: Any, low: float, high: float) -> float:
    """A number within bounds, as float64 whatever it was.

    Raises
    ------
    SampleError
    """
    if not is_within(value, low, high):
        raise SampleError(f"{name} is {value}, legal are {low:g} to {high:g}")
    return float(value)


def whole(name: str, value: Any, low: int, high: int = 2**53) -> int:
    """A whole number within bounds.

    Raises
    ------
    SampleError
    """
    if not is_whole(value) or not low <= value <= high:
        raise SampleError(f"{name} is {value}, legal are whole numbers from {low} to {high}")
    return int(value)


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    return len(shape) == len(wanted) and all(length in (ANY, given) for given, length in zip(shape, wanted))


def _wanted(shape: tuple[int, ...] | None) -> str:
    if shape is None:
        return "an array of numbers"
    return f"an array of numbers of shape {str(shape).replace('-1', 'n')}"


def _found(value: object) -> str:
    if not isinstance(value, np.ndarray):
        return f"a {type(value).__name__}"
    words = [str(value.dtype), str(value.shape)]
    if isinstance(value, np.ma.MaskedArray):
        words.append("masked")
    return " ".join(words) + ("" if value.flags.writeable else " read-only")


def numbers(name: str, value: object, shape: tuple[int, ...] | None = None) -> NDArray[np.float64]:
    """An aligned, writable, C-contiguous float64 array: the caller's own if it is one, else a copy of its numbers.

    Parameters
    ----------
    shape : tuple of int, optional
        Wanted; `ANY` stands for any length.

    Raises
    ------
    SampleError
    """
    if type(value) is np.ndarray and value.dtype == FLOAT and value.flags.carray:
        array = value
    else:
        try:
            array = np.asarray(value)
        except (ValueError, TypeError, OverflowError, RuntimeError, AttributeError):
            raise SampleError(f"{name} must be {_wanted(shape)}, got {_found(value)}") from None
        empty = array.size == 0 and array.dtype == FLOAT
        if isinstance(value, np.ma.MaskedArray) or (array.dtype.kind not in "iuf" and not empty):
            raise SampleError(f"{name} must be {_wanted(shape)}, got {_found(value)}")
        with np.errstate(over="ignore", invalid="ignore"):
            array = np.require(array, FLOAT, ["C", "A", "W"])
    if shape is not None and not _fits(array.shape, shape):
        raise SampleError(f"{name} must be {_wanted(shape)}, got {_found(array)}")
    return array


def finite(name: str, value: object, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """As `numbers`; NaN and infinity are refused.

    Raises
    ------
    SampleError
    """
    array = numbers(name, value, shape)
    # a few numbers are looked at faster without NumPy, many with it
    if not (all(map(isfinite, array.ravel().tolist())) if array.size < 16 else np.isfinite(array).all()):
        raise SampleError(f"{name} must be finite")
    return array


def changed_in_place(name: str, value: object, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """An array that will be written, and that a copy could therefore not stand in for.

    Raises
    ------
    SampleError
        If it is not a writable, C-contiguous float64 array of finite values.
    """
    array = finite(name, value, shape)
    if array is not value:
        raise SampleError(
            f"{name} is changed in place and must be a writable C-contiguous float64 array, got {_found(value)}"
        )
    return array


def indices(name: str, value: object, kind: type[np.integer], length: int, count: int) -> NDArray[Any]:
    """Numbers of particles, each below `count`, as the kernels take them.

    Raises
    ------
    SampleError
    """
    return _whole_numbers(name, value, kind, (length,), 0, count - 1)


def images(name: str, value: object, length: int) -> NDArray[np.int8]:
    """Periodic images, shape (length, 2), as the kernels take them.

    Raises
    ------
    SampleError
    """
    return _whole_numbers(name, value, np.int8, (length, 2), -127, 127)


def _whole_numbers(
    name: str, value: object, kind: type[np.integer], shape: tuple[int, ...], low: int, high: int
) -> NDArray[Any]:
    suits = type(value) is np.ndarray and value.dtype == kind and value.flags.carray and value.shape == shape
    # one look at the largest is enough for what has no sign, none for what cannot be out of range
    if suits and (not value.size or kind is np.int8 or (kind is np.uint32 and value.max() <= high)):  # type: ignore[attr-defined]
        return value  # type: ignore[return-value]
    wanted = f"an array of whole numbers from {low} to {high} of shape {shape}"
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError, RuntimeError, AttributeError):
        raise SampleError(f"{name} must be {wanted}, got {_found(value)}") from None
    empty = array.size == 0 and array.dtype == FLOAT
    if (array.dtype.kind not in "iu" and not empty) or array.shape != shape:
        raise SampleError(f"{name} must be {wanted}, got {_found(array)}")
    if array.size and not (low <= int(array.min()) and int(array.max()) <= high):
        raise SampleError(f"{name} must be {wanted}, but runs from {array.min()} to {array.max()}")
    return np.require(array, kind, ["C", "A", "W"])


def disks(position: object, radius: object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres (n, 2) and radii (n,) of the same disks.

    Raises
    ------
    SampleError
    """
    at, size = numbers("position", position, (ANY, 2)), numbers("radius", radius, (ANY,))
    if len(at) != len(size):
        raise SampleError(f"position has the shape {at.shape}, radius {size.shape}: they are not of the same disks")
    return at, size

"""What a compiled kernel may be handed: the one place where arrays of a caller are checked.

A compiled kernel believes what it is told: a row that is missing is read from whatever lies behind the array, and a new
kind of array (read-only, strided, misaligned, of other numbers) sends it to the compiler again, for some 20 s. Hence:

* arrays that are read come out as aligned, writable, C-contiguous float64; another kind of numbers is copied;
* arrays that are written must be so already, since a copy would not reach the caller;
* indices and codes are integers in their range;
* what is written overlaps nothing else.

What does not fit is a ValueError that names the array, what is wanted, and what came. Values that are not finite are no
matter of the array's kind: points that hold one get a status of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, TypeGuard, get_args

import numpy as np
from numpy.typing import NDArray

from .contract import Array, TangentKind

FLOAT = np.dtype(np.float64)
INDEX = np.dtype(np.int32)
CODE = np.dtype(np.uint8)


class ArrayError(ValueError):
    """An array that no kernel may be handed; the text names it, says what is wanted and what came."""


ANY = -1
"""In a wanted shape: any number of points."""

_NUMBERS = "iuf"
_MOST_WORK = 100_000
"""Bound on the search for an element that two interleaved views share; one that is harder counts as sharing."""

ALL_STRESS = object()
"""Instead of codes: every component is one of stress."""

TANGENT_KINDS: tuple[str, ...] = get_args(TangentKind)
NO_TANGENT = np.empty((0, 3, 3))


def _text(shape: tuple[int, ...]) -> str:
    entries = ["npt" if length == ANY else str(length) for length in shape]
    return f"({', '.join(entries)}{',' if len(entries) == 1 else ''})"


def found(value: object) -> str:
    """What came instead, in a few words."""
    if not isinstance(value, np.ndarray):
        return "nothing" if value is None else f"a {type(value).__name__}"
    words = [str(value.dtype), str(value.shape)]
    if isinstance(value, np.ma.MaskedArray):
        words.append("masked")
    if not value.flags.c_contiguous:
        words.append("not contiguous")
    if not value.flags.aligned:
        words.append("not aligned")
    if not value.flags.writeable:
        words.append("read-only")
    return " ".join(words)


def _fits(shape: tuple[int, ...], wanted: tuple[int, ...]) -> bool:
    if len(shape) != len(wanted):
        return False
    return all(length in (ANY, given) for given, length in zip(shape, wanted))


def _as_array(name: str, value: object, kinds: str, wanted: str) -> NDArray[Any]:
    """Any array-like as a plain array of one of the kinds of numbers; values are not changed.

    Raises
    ------
    ArrayError
    """
    if isinstance(value, np.ma.MaskedArray):
        raise ArrayError(f"{name} must be {wanted}, got {found(value)}: fill what is masked")
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError, RuntimeError, AttributeError):
        raise ArrayError(f"{name} must be {wanted}, got {found(value)}") from None
    # what holds nothing is of no kind: an empty list
    if array.dtype.kind not in kinds and not (array.size == 0 and array.dtype == FLOAT):
        raise ArrayError(f"{name} must be {wanted}, got {found(array)}")
    return array


def _is_ready(value: object) -> TypeGuard[Array]:
    """Whether a kernel can read this as it is, whatever its shape."""
    return type(value) is np.ndarray and value.dtype == FLOAT and value.flags.carray


def read(name: str, value: object, shape: tuple[int, ...]) -> Array:
    """An array that a kernel reads: the caller's own if it is of the right kind, else a copy of its numbers.

    Parameters
    ----------
    name : str
        For the message.
    value : array_like
        Integers or floats.
    shape : tuple of int
        Wanted; `ANY` is the number of points where they are counted.

    Returns
    -------
    ndarray of float64
        Aligned, writable, C-contiguous.

    Raises
    ------
    ArrayError
    """
    if _is_ready(value):
        if value.shape == shape:
            return value
        array = value
    else:
        wanted = f"an array of numbers of shape {_text(shape)}"
        array = _as_array(name, value, _NUMBERS, wanted)
        if _fits(array.shape, shape):
            with np.errstate(over="ignore", invalid="ignore"):
                array = np.require(array, FLOAT, ["C", "A", "W"])
    if not _fits(array.shape, shape):
        raise ArrayError(f"{name} must be an array of numbers of shape {_text(shape)}, got {found(array)}")
    return array


def finite(name: str, value: object, shape: tuple[int, ...]) -> Array:
    """As `read`, for what has no status: NaN and infinity are refused, with their place.

    Raises
    ------
    ArrayError
    """
    array = read(name, value, shape)
    wrong = ~np.isfinite(array)
    if wrong.any():
        place = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise ArrayError(f"{name} must be finite, but holds {array[place]} at {place}")
    return array


def written(name: str, value: object, shape: tuple[int, ...]) -> Array:
    """An array that a kernel writes, as it is.

    Raises
    ------
    ArrayError
        If it is not a writable, C-contiguous float64 array of that shape.
    """
    if isinstance(value, np.ndarray) and value.shape == shape and value.dtype == FLOAT and value.flags.carray:
        if type(value) is np.ndarray:
            return value
        if not isinstance(value, np.ma.MaskedArray):
            return value.view(np.ndarray)  # a memory map, a matrix: the same memory
    wanted = f"a writable C-contiguous float64 array of shape {_text(shape)}"
    raise ArrayError(f"{name} must be {wanted}, got {found(value)}")


def index(name: str, value: object, npt: int, rows: int) -> NDArray[np.int32]:
    """Row of a table for each point; zeros if None.

    Raises
    ------
    ArrayError
        If it is not of integers in 0 ... rows - 1, shape (npt,).
    """
    if value is None:
        return np.zeros(npt, dtype=INDEX)
    suits = type(value) is np.ndarray and value.dtype == INDEX and value.flags.carray and value.shape == (npt,)
    # read without its sign, a negative number is a large one
    if suits and (npt == 0 or value.view(np.uint32).max() < rows):  # type: ignore[attr-defined]
        return value  # type: ignore[return-value]
    wanted = f"an array of integers in 0 ... {rows - 1} of shape ({npt},)"
    array = _as_array(name, value, "iu", wanted)
    if array.shape != (npt,):
        raise ArrayError(f"{name} must be {wanted}, got {found(array)}")
    if npt:
        # compared as they are: a conversion would wrap numbers around
        least, most = int(array.min()), int(array.max())
        if least < 0 or most >= rows:
            raise ArrayError(f"{name} must be {wanted}, but holds {least if least < 0 else most}")
    return np.require(array, INDEX, ["C", "A", "W"])


def codes(name: str, value: object, npt: int) -> NDArray[np.uint8]:
    """What is prescribed of each component: 1 stress, 0 strain; booleans will do.

    Raises
    ------
    ArrayError
        If it is not of zeros and ones, shape (npt, 3).
    """
    suits = type(value) is np.ndarray and value.dtype == CODE and value.flags.carray and value.shape == (npt, 3)
    if suits and (npt == 0 or value.max() <= 1):  # type: ignore[attr-defined]
        return value  # type: ignore[return-value]
    wanted = f"an array of codes 0 (strain) and 1 (stress) of shape ({npt}, 3)"
    array = _as_array(name, value, "biuf", wanted)
    if array.shape != (npt, 3):
        raise ArrayError(f"{name} must be {wanted}, got {found(array)}")
    wrong = array > 1 if array.dtype == CODE else (array != 0) & (array != 1)
    if wrong.any():
        raise ArrayError(f"{name} must be {wanted}, but holds {array[wrong][0]}")
    return np.require(array, CODE, ["C", "A", "W"])


def _overlap(one: NDArray[Any], other: NDArray[Any]) -> bool:
    if one is other:
        return one.size > 0
    if not np.may_share_memory(one, other):
        return False
    try:
        return bool(np.shares_memory(one, other, max_work=_MOST_WORK))  # type: ignore[arg-type]
    except RuntimeError:  # too hard to tell
        return True


def _have_own_memory(arrays: Iterable[NDArray[Any]]) -> bool:
    """Whether no two of these can share memory, as told by who owns it: the array, or the one that it is a view of."""
    number, owners = 0, set()
    for array in arrays:
        owner = array if array.base is None else array.base
        if type(owner) is not np.ndarray or not owner.flags.owndata:
            return False
        number += 1
        owners.add(id(owner))
    return len(owners) == number


def keep_apart(outputs: dict[str, Array], inputs: Sequence[tuple[str, NDArray[Any], object]]) -> None:
    """Refuse an array to be written that shares memory with another one, read or written.

    Parameters
    ----------
    outputs : dict of ndarray
    inputs : sequence of (str, ndarray, object)
        Name, the array that the kernel reads, and what the caller gave: if that was copied it must not change either.

    Raises
    ------
    ArrayError
    """
    others: list[tuple[str, NDArray[Any]]] = [(name, used) for name, used, _ in inputs]
    others += [(name, came) for name, used, came in inputs if came is not used and isinstance(came, np.ndarray)]
    if _have_own_memory([*outputs.values(), *(array for _, array in others)]):
        return
    for name, output in outputs.items():
        for other_name, other in others:
            if _overlap(output, other):
                raise ArrayError(
                    f"{name} must be a C-contiguous float64 array of its own, but shares memory with {other_name}"
                )
        others.append((name, output))


def _usual(came: tuple[object, ...], tangent: object, nstate: int) -> bool:
    """Whether increment, stress and state at the start and end, and tangent are as a host makes them, fit to be handed
    on as they are. Whatever else is right or wrong is told apart afterwards, in more time.
    """
    increment = came[0]
    if type(increment) is not np.ndarray or increment.ndim != 2 or increment.shape[1] != 3:
        return False
    npt = increment.shape[0]
    arrays, shapes = came, ((npt, 3), (npt, 3), (npt, nstate), (npt, 3), (npt, nstate))
    if tangent is not None:
        arrays, shapes = (*came, tangent), (*shapes, (npt, 3, 3))  # type: ignore[assignment]
    for array, shape in zip(arrays, shapes):
        if type(array) is not np.ndarray or array.shape != shape or array.dtype != FLOAT or not array.flags.carray:
            return False
    return True


class UpdateArrays(NamedTuple):
    """The arrays of `contract.Law.update`, checked; `tangent` and `strain_increment` are empty if not wanted."""

    increment: Array
    stress_start: Array
    state_start: Array
    stress_end: Array
    state_end: Array
    tangent: Array
    rows: NDArray[np.int32]
    control: NDArray[np.uint8] | None
    strain_increment: Array | None


def _control(control: object, npt: int) -> NDArray[np.uint8]:
    return np.ones((npt, 3), dtype=CODE) if control is ALL_STRESS else codes("control", control, npt)


def update_arrays(
    sizes: tuple[int, int],
    increment: object,
    stress_start: object,
    state_start: object,
    stress_end: object,
    state_end: object,
    tangent: object,
    tangent_kind: object,
    material_index: object,
    control: object = None,
    strain_increment: object = None,
    mixed: str = "",
) -> UpdateArrays:
    """Check the arguments of an update.

    Parameters
    ----------
    sizes : (int, int)
        State columns and rows of the parameter table.
    control, strain_increment : array_like, ndarray
        Of mixed control; for stress alone `ALL_STRESS` will do.
    mixed : str
        Under mixed control the name of the increment.
    increment, stress_start, state_start, stress_end, state_end, tangent, tangent_kind, material_index :
        As in `contract.Law.update`.

    Raises
    ------
    ArrayError
    """
    nstate, rows = sizes
    if not mixed and isinstance(tangent_kind, str) and tangent_kind in TANGENT_KINDS:
        came = (increment, stress_start, state_start, stress_end, state_end)
        if _usual(came, tangent, nstate):
            of_table = index("material_index", material_index, len(increment), rows)  # type: ignore[arg-type]
            used = came if tangent is None else (*came, tangent)
            if _have_own_memory(used if material_index is None else (*used, of_table)):  # type: ignore[arg-type]
                stiffness = NO_TANGENT if tangent is None else tangent
                return UpdateArrays(*came, stiffness, of_table, None, None)  # type: ignore[arg-type]
    name = mixed or "strain_increment"
    given = read(name, increment, (ANY, 3))
    npt = len(given)
    stress = read("stress_start", stress_start, (ANY, 3))
    if len(stress) != npt:
        raise ArrayError(
            f"{name} has the shape {given.shape}, stress_start {stress.shape}: all arrays of a call are of one number "
            "of points"
        )
    if not isinstance(tangent_kind, str) or tangent_kind not in TANGENT_KINDS:
        raise ValueError(f"tangent_kind = {tangent_kind!r} is not one of {', '.join(TANGENT_KINDS)}")
    state = read("state_start", state_start, (npt, nstate))
    end = written("stress_end", stress_end, (npt, 3))
    end_state = written("state_end", state_end, (npt, nstate))
    stiffness = NO_TANGENT if tangent is None else written("tangent", tangent, (npt, 3, 3))
    of_table = index("material_index", material_index, npt, rows)
    under_control = _control(control, npt) if mixed else None
    strain = written("strain_increment", strain_increment, (npt, 3)) if mixed else None
    outputs = {"stress_end": end, "state_end": end_state}
    if tangent is not None:
        outputs["tangent"] = stiffness
    if strain is not None:
        outputs["strain_increment"] = strain
    inputs: list[tuple[str, NDArray[Any], object]] = [
        (name, given, increment),
        ("stress_start", stress, stress_start),
        ("state_start", state, state_start),
    ]
    if material_index is not None:
        inputs.append(("material_index", of_table, material_index))
    if under_control is not None:
        inputs.append(("control", under_control, control))
    keep_apart(outputs, inputs)
    return UpdateArrays(given, stress, state, end, end_state, stiffness, of_table, under_control, strain)


def stress_and_index(stress: object, material_index: object, rows: int) -> tuple[Array, NDArray[np.int32]]:
    """Check the arguments of `contract.Law.initial_state`.

    Raises
    ------
    ArrayError
    """
    values = finite("stress", stress, (ANY, 3))
    return values, index("material_index", material_index, len(values), rows)

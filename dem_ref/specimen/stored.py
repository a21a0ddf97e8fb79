"""A specimen as plain arrays, from which it goes on to the same bits."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.sample.disks import SampleError, sample_arrays, sample_from_arrays

from .cut import SpecimenOptions
from .history import COLUMNS
from .specimen import Consolidated, Specimen

_NUMBERS = 10
SAMPLE = "sample_"


def fingerprint(options: SpecimenOptions) -> str:
    """JSON text that two equal sets of options share."""
    return json.dumps(asdict(options), sort_keys=True)


def specimen_arrays(specimen: Specimen) -> dict[str, NDArray]:
    """Everything that a consolidated specimen between two legs of its path is gone on with from; copies."""
    start = specimen.start
    if start is None:
        raise SampleError("a specimen is consolidated before it is stored")
    arrays = {f"{SAMPLE}{name}": np.array(values) for name, values in sample_arrays(specimen.sample).items()}
    disk, side, elongation = specimen._wall
    arrays |= {
        "options": np.frombuffer(fingerprint(specimen.options).encode(), np.uint8),
        "motion": specimen.velocity.copy(), "platens": specimen.platens.copy(), "reactions": specimen.reactions.copy(),
        "tally": specimen.tally.copy(), "measures": specimen.measures.copy(), "rows": np.array(specimen.rows),
        "wall_disk": disk.copy(), "wall_side": side.copy(), "wall_elongation": elongation.copy(),
        "left": specimen.left.copy(), "right": specimen.right.copy(), "start_position": start.position.copy(),
        "specimen_numbers": np.array(
            [
                specimen.pressure, specimen._room, specimen._widening,
                float(specimen.steps_done), float(specimen._apart), start.height, start.width, start.elastic_energy,
                *specimen._friction,
            ]
        ),
    }  # fmt: skip
    return arrays


def _shapes(arrays: dict[str, NDArray], count: int) -> dict[str, tuple[str, tuple[int, ...]]]:
    def length(name: str) -> int:
        return len(arrays[name]) if name in arrays and arrays[name].ndim else 0

    return {
        "motion": ("f8", (count, 4)), "platens": ("f8", (2,)), "reactions": ("f8", (2, 2)), "tally": ("f8", (5,)),
        "measures": ("f8", (4,)), "rows": ("f8", (length("rows"), len(COLUMNS))),
        "wall_disk": ("i8", (length("wall_disk"),)), "wall_side": ("i8", (length("wall_disk"),)),
        "wall_elongation": ("f8", (length("wall_disk"),)), "left": ("i8", (length("left"),)),
        "right": ("i8", (length("right"),)), "start_position": ("f8", (count, 2)),
        "specimen_numbers": ("f8", (_NUMBERS,)),
    }  # fmt: skip


def specimen_from_arrays(arrays: dict[str, NDArray], options: SpecimenOptions, origin: str) -> Specimen:
    """Inverse of `specimen_arrays`; every shape, type and bound is checked, `origin` names the source in messages.

    Raises
    ------
    SampleError
        If these are not such arrays, or those of a specimen with other options.
    """
    if "options" not in arrays:
        raise SampleError(f"{origin}: not a stored specimen")
    if bytes(arrays["options"].astype(np.uint8)).decode(errors="replace") != fingerprint(options):
        raise SampleError(f"{origin}: stored of a specimen with other options")
    stored = {name.removeprefix(SAMPLE): a for name, a in arrays.items() if name.startswith(SAMPLE)}
    sample = sample_from_arrays(stored, origin)
    for name, (kind, shape) in _shapes(arrays, sample.count).items():
        array = arrays.get(name)
        if array is None or array.dtype != np.dtype(kind) or array.shape != shape or not np.isfinite(array).all():
            raise SampleError(f"{origin}: array '{name}' is missing or damaged")
    for name, most in (("wall_disk", sample.count), ("wall_side", 2), ("left", sample.count), ("right", sample.count)):
        if len(arrays[name]) and not 0 <= arrays[name].min() <= arrays[name].max() < most:
            raise SampleError(f"{origin}: array '{name}' names what there is not")
    numbers = arrays["specimen_numbers"].tolist()
    bottom, top = arrays["platens"].tolist()
    if not (top > bottom and numbers[0] > 0.0 and numbers[5] > 0.0 and numbers[6] > 0.0 and len(arrays["rows"])
            and len(arrays["left"]) and len(arrays["right"]) and 0.0 <= numbers[3] < 2**53):  # fmt: skip
        raise SampleError(f"{origin}: its numbers are not those of a specimen")
    specimen = Specimen.__new__(Specimen)
    specimen.options = options
    specimen.pressure = numbers[0]
    specimen._begin(sample, arrays["platens"].copy())
    specimen.velocity[:] = arrays["motion"]
    specimen.reactions, specimen.tally = arrays["reactions"].copy(), arrays["tally"].copy()
    specimen.measures, specimen.rows = arrays["measures"].copy(), arrays["rows"].tolist()
    specimen._wall = arrays["wall_disk"].copy(), arrays["wall_side"].copy(), arrays["wall_elongation"].copy()
    specimen.left, specimen.right = arrays["left"].copy(), arrays["right"].copy()
    specimen._room, specimen._widening = numbers[1:3]
    specimen.steps_done, specimen._apart = int(numbers[3]), int(numbers[4])
    specimen.start = Consolidated(
        height=numbers[5], width=numbers[6], elastic_energy=numbers[7], position=arrays["start_position"].copy()
    )
    specimen._friction = numbers[8], numbers[9]
    specimen._make_room()
    return specimen

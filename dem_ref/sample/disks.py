"""A sample of disks in a periodic cell: everything that has to be kept to continue from it.

Units of a `Sample`: lengths in any unit, stiffness in Pa (force per length and per metre of thickness), stress in Pa.
Time does not appear: velocities are displacements per step, masses follow from the step (see `motion`).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError as SampleError
from granfabric.dem_ref.arrays import disks, is_number, is_within, numbers, whole

from .checks import implausible
from .neighbours import CellTooSmallError, NearPairs, find_near_pairs
from .stored_arrays import StoredArrayError, read_stored_arrays

FORMAT = 1
SMALLEST, LARGEST = 1e-300, 1e300
"""Of what has to be positive, and finite."""


@dataclass
class Sample:
    """Disks, periodic cell and contact history.

    Attributes
    ----------
    position : (n, 2) float64
        Centres. Not wrapped into the cell while loading, so that displacements are plain differences.
    radius : (n,) float64
    cell : (2, 2) float64
        Rows are the two lattice vectors.
    normal_stiffness : float
        kn, Pa.
    stiffness_ratio : float
        kt/kn.
    friction : float
        Coulomb coefficient between particles.
    velocity : (n, 2) float64
        Displacement per step beyond the homogeneous deformation.
    spin : (n,) float64
        Angular velocity times radius: displacement of the surface per step.
    strain_rate : (3,) float64
        Tensor strain of the last step (xx, yy, xy), tension positive.
    strain : (3,) float64
        Accumulated tensor strain, tension positive.
    pairs : NearPairs
        Near pairs with their tangential elongation.
    seed : int
        Seed that made the packing (for the record), -1 when unknown.

    Raises
    ------
    SampleError
        If an array has another shape or kind, or a pair names a disk that does not exist. Arrays of other numbers,
        read-only or strided ones are copied.
    """

    position: NDArray[np.float64]
    radius: NDArray[np.float64]
    cell: NDArray[np.float64]
    normal_stiffness: float
    stiffness_ratio: float
    friction: float
    velocity: NDArray[np.float64]
    spin: NDArray[np.float64]
    pairs: NearPairs
    strain_rate: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    strain: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    seed: int = -1

    def __post_init__(self) -> None:
        self.bring_into_form()

    def bring_into_form(self) -> None:
        """Check every array, as the compiled kernels need it; one of another kind is replaced by a copy.

        Raises
        ------
        SampleError
        """
        self.position, self.radius = disks(self.position, self.radius)
        n = len(self.radius)
        self.cell = numbers("cell", self.cell, (2, 2))
        self.velocity = numbers("velocity", self.velocity, (n, 2))
        self.spin = numbers("spin", self.spin, (n,))
        self.strain_rate = numbers("strain_rate", self.strain_rate, (3,))
        self.strain = numbers("strain", self.strain, (3,))
        for name in ("normal_stiffness", "stiffness_ratio", "friction"):
            value = getattr(self, name)
            if type(value) is not float:
                if not is_number(value):
                    raise SampleError(f"{name} is {value}, not a number")
                setattr(self, name, float(value))
        if not isinstance(self.pairs, NearPairs):
            raise SampleError(f"pairs is {self.pairs!r}, not a list of near pairs")
        self.pairs.bring_into_form(n)

    @property
    def count(self) -> int:
        """Number of disks."""
        return len(self.radius)

    @property
    def area(self) -> float:
        """Area of the periodic cell."""
        return float(self.cell[0, 0] * self.cell[1, 1] - self.cell[0, 1] * self.cell[1, 0])

    @property
    def solid_fraction(self) -> float:
        """Area of the disks over area of the cell (overlaps counted twice)."""
        return float(np.pi * np.sum(self.radius**2) / self.area)

    @property
    def void_ratio(self) -> float:
        """Area of voids over area of solids."""
        return 1.0 / self.solid_fraction - 1.0

    @property
    def mean_diameter(self) -> float:
        """Mean diameter by number."""
        return 2.0 * float(self.radius.mean())

    def copy(self) -> Sample:
        """An independent copy."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        pairs = self.pairs
        values["pairs"] = NearPairs(
            pairs.first.copy(), pairs.second.copy(), pairs.image.copy(), pairs.tangential.copy()
        )
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                values[name] = value.copy()
        return Sample(**values)

    def with_friction(self, friction: float) -> Sample:
        """A copy at rest with another friction coefficient and no tangential forces."""
        _check_stiffness(self.normal_stiffness, self.stiffness_ratio, friction)
        other = self.copy()
        other.friction = float(friction)
        other.pairs.tangential[:] = 0.0
        other.velocity[:] = 0.0
        other.spin[:] = 0.0
        other.strain_rate[:] = 0.0
        return other

    def rotated(self, angle: float) -> Sample:
        """A copy turned by `angle` (radians, counter-clockwise), cell and motion included."""
        if not is_within(angle, -LARGEST, LARGEST):
            raise SampleError(f"angle is {angle}, legal are finite values")
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, s], [-s, c]])  # acts on rows from the right
        other = self.copy()
        other.position = self.position @ turn
        other.velocity = self.velocity @ turn
        other.cell = self.cell @ turn
        for name in ("strain_rate", "strain"):
            e = getattr(self, name)
            tensor = turn.T @ np.array([[e[0], e[2]], [e[2], e[1]]]) @ turn
            setattr(other, name, np.array([tensor[0, 0], tensor[1, 1], tensor[0, 1]]))
        return other


def new_sample(
    position: NDArray[np.float64],
    radius: NDArray[np.float64],
    cell: NDArray[np.float64],
    *,
    normal_stiffness: float = 1.0e9,
    stiffness_ratio: float = 1.0,
    friction: float = 0.5,
    seed: int = -1,
) -> Sample:
    """A sample at rest from given disks; checks every value.

    Raises
    ------
    SampleError
        On shapes, values that are not finite, radii or a cell that are not positive, or stiffnesses out of range.
    CellTooSmallError
        If the cell is below three interaction distances.
    """
    position = numbers("position", position).copy()
    radius = numbers("radius", radius).copy()
    cell = numbers("cell", cell).copy()
    seed = whole("seed", seed, -1, 2**63 - 1)
    _check_disks(position, radius, cell)
    _check_stiffness(normal_stiffness, stiffness_ratio, friction)
    n = len(radius)
    pairs = find_near_pairs(position, radius, cell, 0.02 * 2.0 * float(radius.mean()))
    return Sample(
        position, radius, cell, float(normal_stiffness), float(stiffness_ratio), float(friction),
        np.zeros((n, 2)), np.zeros(n), pairs, seed=int(seed),
    )  # fmt: skip


def _check_disks(position: NDArray, radius: NDArray, cell: NDArray) -> None:
    if radius.ndim != 1 or len(radius) < 1 or position.shape != (len(radius), 2) or cell.shape != (2, 2):
        raise SampleError(
            f"disks need position (n, 2), radius (n,), cell (2, 2); got {position.shape}, {radius.shape}, {cell.shape}"
        )
    if not (np.isfinite(position).all() and np.isfinite(radius).all() and np.isfinite(cell).all()):
        raise SampleError("positions, radii and cell must be finite")
    if radius.min() <= 0.0:
        raise SampleError(f"the smallest radius is {radius.min():.4g}, legal are values > 0")
    if np.linalg.det(cell) <= 0.0:
        raise SampleError(f"the cell's area is {np.linalg.det(cell):.4g}; its rows must be a right-handed pair")


def _check_stiffness(normal_stiffness: float, stiffness_ratio: float, friction: float) -> None:
    if not is_within(normal_stiffness, SMALLEST, LARGEST):
        raise SampleError(f"normal_stiffness is {normal_stiffness}, legal are finite values > 0")
    if not is_within(stiffness_ratio, SMALLEST, 1.0):
        raise SampleError(f"stiffness_ratio is {stiffness_ratio}, legal are 0 < kt/kn <= 1")
    if not is_within(friction, 0.0, LARGEST):
        raise SampleError(f"friction is {friction}, legal are finite values >= 0")


_ARRAYS = {
    "position": ("f8", 2), "radius": ("f8", 1), "cell": ("f8", 2), "velocity": ("f8", 2), "spin": ("f8", 1),
    "strain_rate": ("f8", 1), "strain": ("f8", 1), "first": ("u4", 1), "second": ("u4", 1), "image": ("i1", 2),
    "tangential": ("f8", 1), "numbers": ("f8", 1), "header": ("i8", 1),
}  # fmt: skip


def sample_arrays(sample: Sample) -> dict[str, NDArray]:
    """All of a sample as named plain arrays, for `numpy.savez`."""
    pairs = sample.pairs
    return {
        "position": sample.position, "radius": sample.radius, "cell": sample.cell, "velocity": sample.velocity,
        "spin": sample.spin, "strain_rate": sample.strain_rate, "strain": sample.strain, "first": pairs.first,
        "second": pairs.second, "image": pairs.image, "tangential": pairs.tangential,
        "numbers": np.array([sample.normal_stiffness, sample.stiffness_ratio, sample.friction]),
        "header": np.array([FORMAT, sample.seed], np.int64),
    }  # fmt: skip


def sample_from_arrays(arrays: dict[str, NDArray], origin: str) -> Sample:
    """Inverse of `sample_arrays`; every shape, type and bound is checked, `origin` names the source in messages."""
    for name, (kind, dimensions) in _ARRAYS.items():
        if name not in arrays:
            raise SampleError(f"{origin}: no array '{name}', this is not a stored sample")
        if arrays[name].dtype != np.dtype(kind) or arrays[name].ndim != dimensions:
            raise SampleError(f"{origin}: array '{name}' has type {arrays[name].dtype} and shape {arrays[name].shape}")
    get = {name: np.array(arrays[name], order="C") for name in _ARRAYS}
    n, m = len(get["radius"]), len(get["first"])
    shapes = {
        "header": (2,), "numbers": (3,), "velocity": (n, 2), "spin": (n,), "strain": (3,), "strain_rate": (3,),
        "second": (m,), "image": (m, 2), "tangential": (m,),
    }  # fmt: skip
    for name, shape in shapes.items():
        if get[name].shape != shape:
            raise SampleError(f"{origin}: array '{name}' has shape {get[name].shape}, expected {shape}")
        if not np.isfinite(get[name]).all():
            raise SampleError(f"{origin}: array '{name}' is not finite")
    if get["header"][0] != FORMAT:
        raise SampleError(f"{origin}: stored in format {get['header'][0]}, this version reads {FORMAT}")
    try:
        _check_disks(get["position"], get["radius"], get["cell"])
        _check_stiffness(*get["numbers"])
    except SampleError as error:
        raise SampleError(f"{origin}: {error}") from None
    first, second = get["first"].astype(np.int64), get["second"].astype(np.int64)
    key = first * n + second
    if m and (second.max() >= n or (first >= second).any() or (np.diff(key) <= 0).any()):
        raise SampleError(f"{origin}: the list of pairs is not a sorted half list of {n} particles")
    kn, ratio, friction = (float(v) for v in get["numbers"])
    pairs = NearPairs(get["first"], get["second"], get["image"], get["tangential"])
    try:
        reason = implausible(get["position"], get["radius"], get["cell"], pairs)
    except CellTooSmallError as error:
        reason = str(error)
    if reason:
        raise SampleError(f"{origin}: {reason}")
    return Sample(
        get["position"], get["radius"], get["cell"], kn, ratio, friction, get["velocity"], get["spin"], pairs,
        get["strain_rate"], get["strain"], int(get["header"][1]),
    )  # fmt: skip


def write_atomically(path: Path, arrays: dict[str, NDArray]) -> None:
    """Write an `.npz` so that the file is either the old one or the whole new one."""
    part = path.with_name(path.name + ".part")
    with open(part, "wb") as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(part, path)


def read_arrays(path: str | Path) -> dict[str, NDArray]:
    """Arrays of an `.npz`; never unpickles.

    Raises
    ------
    SampleError
        If the file is missing or not such a file.
    """
    try:
        return read_stored_arrays(Path(path))
    except FileNotFoundError:
        raise SampleError(f"{path}: no such file") from None
    except StoredArrayError as error:
        raise SampleError(f"{path}: not a stored sample ({error})") from None


def save_sample(path: str | Path, sample: Sample) -> None:
    """Write a sample to an `.npz` file, atomically and without pickles."""
    write_atomically(Path(path), sample_arrays(sample))


def load_sample(path: str | Path) -> Sample:
    """Read a sample written by `save_sample`.

    Raises
    ------
    SampleError
        If the file is missing, not such a file, or its content is not a consistent sample.
    """
    return sample_from_arrays(read_arrays(path), str(path))

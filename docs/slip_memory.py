"""Figure `docs/figures/slip_memory.png` and the table of docs/theory/closures.md: the law with and without memory of
tangential forces against the DEM curves of a map.

    granfabric verify --paths all --materials all --particles 3000 --seeds 3 -o results/map
    python docs/slip_memory.py results/map

Left: a_t on a loop of q/p, friction 0.5 and 0.2. Middle: by which angle a_t leads the stress while that turns at
q/p = 0.2. Right: largest error of a_t over all materials but friction 0.2, by the number of slip classes.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

import numpy as np

from granfabric.cases.pictures.style import BLACK, BLUE, ORANGE, picture
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.network import slip_memory
from granfabric.constitutive.parameters import Closure, Material
from granfabric.constitutive.path import Leg, drive

WEAK = "friction_0.2"
PATHS = ("loop", "cycles", "cyclic", "rotation", "rotation_small", "pressure_doubled")
NUMBERS = (1, 2, 3, 4, 6, 8)
TURNS = ("loop", "cycles", "cyclic", "rotation", "rotation_small")
LARGEST = 0.302
"""Stress ratio up to which is compared."""
QUANTITIES = {
    "fabric_anisotropy": "fabric",
    "normal_force_anisotropy": "normal_force",
    "tangential_force_anisotropy": "tangential_force",
}


class Curves:
    """Means over the packings of a material on a path: stress and double-angle vectors, since the start."""

    def __init__(self, folder: Path, material: str, path: str) -> None:
        files = sorted((folder / "dem").glob(f"{material}_*_disks_seed_*_{path}.csv"))
        tables = [np.genfromtxt(file, delimiter=",", names=True) for file in files]
        rows = min(map(len, tables))
        stress = np.mean([[table[f"stress_{c}"][:rows] for c in ("xx", "yy", "xy")] for table in tables], axis=0).T
        start = 0.5 * stress[0, :2].sum()
        stress[0] = start, start, 0.0
        moved = np.r_[True, np.abs(np.diff(stress, axis=0)).max(axis=1) > -1e-5 * start]
        self.stress = stress[moved]
        self.z = np.mean([(table["coordination"] / table["coordination"][0])[:rows] for table in tables], axis=0)[moved]
        self.vectors = {}
        for name, column in QUANTITIES.items():
            both = [[table[f"{column}_{c}"][:rows] for c in ("xx", "xy")] for table in tables]
            mean = np.mean(both, axis=0)[:, moved]
            self.vectors[name] = mean - mean[:, :1]
        p = -0.5 * (self.stress[:, 0] + self.stress[:, 1])
        self.s = np.stack([-0.5 * (self.stress[:, 0] - self.stress[:, 1]), -self.stress[:, 2]]) / p
        self.ratio = p / p[0]


def tables_of(folder: Path, material: str) -> tuple[Material, Closure]:
    """Measured inputs."""
    read = tomllib.loads((folder / f"material_{material}.toml").read_text(encoding="utf-8"))
    return Material(**read["material"]), Closure(tangential="frictional", **read["closure"])


def followed(folder: Path, material: str, curves: Curves, memory: bool) -> dict[str, np.ndarray]:
    """z over its start and vectors since the start, by the law along the stresses of the DEM."""
    packing, closure = tables_of(folder, material)
    law = ContactLaw([packing], closure, Effects(tangential_memory=memory))
    targets = [tuple(target) for target in curves.stress[1:].tolist()]
    columns = drive(law, tuple(curves.stress[0].tolist()), [Leg(target=target) for target in targets]).columns
    found = {"z": columns["coordination"] / columns["coordination"][0]}
    for name in QUANTITIES:
        vector = np.stack([columns[f"{name}_{i}"] for i in (1, 2)])
        found[name] = vector - vector[:, :1]
    return found


def errors(curves: Curves, found: dict[str, np.ndarray]) -> list[float]:
    """Largest of z [%], a_c, a_n, a_t up to `LARGEST`."""
    rows = len(found["z"])
    inside = np.hypot(*curves.s[:, :rows]) <= LARGEST
    out = [100.0 * np.abs(found["z"] - curves.z[:rows])[inside].max()]
    for name in QUANTITIES:
        out.append(np.hypot(*(found[name] - curves.vectors[name][:, :rows]))[inside].max())
    return [float(value) for value in out]


def by_number(closure: Closure, curves: Curves, number: int) -> float:
    """Largest error of a_t at constant pressure with so many classes, from the elements alone."""
    c_t, k = float(closure.tangential_force_ratio), float(closure.slip)
    kept, slip_memory.CLASSES = slip_memory.CLASSES, number
    classes = slip_memory.slip_classes(c_t, k)
    slip_memory.CLASSES = kept
    held = np.zeros((number, 2))
    worst, before = 0.0, np.zeros(2)
    for s, wanted in zip(curves.s.T, curves.vectors["tangential_force_anisotropy"].T):
        m = np.hypot(*s)
        a_t = (c_t - k * min(m, 0.5 * c_t / k)) * min(1.0, 0.5 * c_t / k / max(m, 1e-12)) * s
        for i, (threshold, share) in enumerate(classes):
            held[i] = slip_memory.swept(*held[i], *(s - before), threshold)[0]
            a_t = a_t + c_t * share * (held[i] - slip_memory.straight_on(*s, threshold)[0])
        worst = max(worst, float(np.hypot(*(a_t - wanted))))
        before = s
    return worst


def lead(vector: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Angle by which a vector is ahead of s [degrees]."""
    return np.degrees(np.arctan2(vector[1] * s[0] - vector[0] * s[1], vector[0] * s[0] + vector[1] * s[1]))


def main() -> None:
    """Table and figure."""
    folder = Path(sys.argv[1])
    materials = [file.stem.removeprefix("material_") for file in sorted(folder.glob("material_*.toml"))]
    print("largest errors of z [%], a_c, a_n, a_t: without memory; with")
    known: dict[tuple[str, str], tuple[Curves, dict, dict]] = {}
    for path in PATHS:
        for material in materials:
            curves = Curves(folder, material, path)
            without, found = (followed(folder, material, curves, memory) for memory in (False, True))
            known[path, material] = curves, without, found
            first, second = errors(curves, without), errors(curves, found)
            shown = "; ".join("{:.1f} {:.3f} {:.3f} {:.3f}".format(*values) for values in (first, second))
            print(f"{path:18} {material:14} {shown}")
    scale = {
        number: {
            path: max(by_number(tables_of(folder, name)[1], known[path, name][0], number)
                      for name in materials if name != WEAK)
            for path in TURNS
        }
        for number in NUMBERS
    }  # fmt: skip
    for number, worst in scale.items():
        print(f"{number:2} classes", " ".join(f"{path} {value:.4f}" for path, value in worst.items()))
    with picture(Path(__file__).parent / "figures" / "slip_memory.png", 13.0, 3.9) as figure:
        left, middle, right = figure.subplots(1, 3)
        for material, title, style in (("source", "friction 0.5", "-"), (WEAK, "friction 0.2", "--")):
            curves, without, found = known["loop", material]
            for values, colour, what in ((curves.vectors, BLACK, "DEM"), (without, ORANGE, "law without memory"),
                                         (found, BLUE, "law")):  # fmt: skip
                a_t = -values["tangential_force_anisotropy"][0]
                left.plot(-curves.s[0, : len(a_t)], a_t, style, color=colour, label=f"{what}, {title}")
            curves, without, found = known["rotation", material]
            turned = np.degrees(np.unwrap(np.arctan2(curves.s[1], curves.s[0])))
            begun = int(np.argmax(np.hypot(*curves.s) > 0.199))
            for values, colour in ((curves.vectors, BLACK), (without, ORANGE), (found, BLUE)):
                a_t = values["tangential_force_anisotropy"]
                stop = a_t.shape[1]
                angle = 0.5 * np.abs(turned[begun:stop] - turned[begun])
                ahead = lead(a_t, curves.s[:, :stop])[begun:] * np.sign(turned[-1] - turned[begun])
                middle.plot(angle, ahead, style, color=colour)
        left.set(xlabel="q/p", ylabel="a_t", title="(a) loop of q/p")
        left.legend(fontsize=7)
        middle.set(xlabel="turn of the principal axes [degrees]", ylabel="a_t ahead of s [degrees]",
                   title="(b) principal stress rotation")  # fmt: skip
        for path, colour in zip(("loop", "cycles", "rotation"), (BLACK, BLUE, ORANGE)):
            right.plot(NUMBERS, [scale[number][path] for number in NUMBERS], "o-", color=colour, label=path)
        right.set(xlabel="slip classes", ylabel="largest error of a_t", title="(c) number of classes", ylim=(0.0, None))
        right.legend()


if __name__ == "__main__":
    main()

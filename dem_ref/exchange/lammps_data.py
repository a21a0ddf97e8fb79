"""Data files of LAMMPS (`read_data`, `write_data`): disks of the atom style sphere in a periodic box.

A data file knows nothing of contact forces and friction; stiffness and friction stand in the input script. The first
line is a comment of any text; this program puts the numbers of the contact law there.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError
from granfabric.dem_ref.sample.disks import Sample

from .columns import Rows, disks_of
from .raw import KEYS, RawDisks
from .text import TextFile

COLUMNS = {
    "sphere": ("id", "type", "diameter", "density", "x", "y", "z"),
    "bpm/sphere": ("id", "mol", "type", "diameter", "density", "x", "y", "z"),
}
IMAGES = ("ix", "iy", "iz")
HEADER = re.compile(
    r"(atoms|atom types|xlo xhi|ylo yhi|zlo zhi|xy xz yz|avec|bvec|cvec|abc origin|ellipsoids|lines|triangles|bodies)$"
)
SHAPES = ("ellipsoids", "lines", "triangles", "bodies")
SECTION = re.compile(r"[A-Z][A-Za-z]*(?: [A-Z][A-Za-z]*)*$")
UNITS = re.compile(r"units\s*=\s*(\w+)")
KEY = re.compile(rf"({'|'.join(KEYS)}) = ([^\s,;]+)")


@dataclass
class _Parts:
    header: dict[str, tuple[int, list[str]]] = field(default_factory=dict)
    sections: dict[str, tuple[int, str, Rows]] = field(default_factory=dict)
    """By name: line, comment behind the name, rows."""


def _parts(file: TextFile) -> _Parts:
    found = _Parts()
    rows: Rows | None = None
    for line, raw in enumerate(file.lines[1:], start=2):
        text, _, comment = raw.partition("#")
        text = text.strip()
        if not text:
            continue
        if SECTION.match(text):
            if text in found.sections:
                raise file.error(line, f"the section {text} stands in line {found.sections[text][0]} already")
            rows = []
            found.sections[text] = (line, comment.strip(), rows)
        elif rows is not None:
            rows.append((line, text.split()))
        elif key := HEADER.search(text):
            found.header[key[1]] = (line, text[: key.start()].split())
    return found


def read_lammps_data(file: TextFile) -> RawDisks:
    """Disks of a data file.

    Raises
    ------
    SampleError
    """
    parts = _parts(file)
    for shape in SHAPES:
        if shape in parts.header and parts.header[shape][1] != ["0"]:
            raise file.error(parts.header[shape][0], f"{shape}; only disks (atom style sphere) are read")
    if "Atoms" not in parts.sections:
        raise SampleError(f"{file.origin}: no section Atoms; is this a data file of LAMMPS?")
    line, style, rows = parts.sections["Atoms"]
    if not rows:
        raise file.error(line, "the section Atoms has no disks")
    names = _columns(file, line, style.split()[0] if style else "", len(rows[0][1]))
    if "atoms" in parts.header:
        at, tokens = parts.header["atoms"]
        count = file.whole(tokens[0] if tokens else "", at, "number of atoms", 1)
        if count != len(rows):
            raise file.error(at, f"{count} atoms are announced, the section Atoms has {len(rows)}: is the file whole?")
    disks, plane = disks_of(file, line, names, rows)
    if plane != "xy":
        raise SampleError(f"{file.origin}: the disks lie in the plane {plane}; LAMMPS's own is xy (dimension 2)")
    disks.cell = _box(file, parts)
    disks.keys.update(_keys(file))
    if found := UNITS.search(file.lines[0]):
        disks.remarks.append(f"the file says units {found[1]}")
    return disks


def _columns(file: TextFile, line: int, style: str, width: int) -> list[str]:
    if style and style not in COLUMNS:
        raise file.error(
            line,
            f"atom style {style!r}; read are {' and '.join(COLUMNS)} (of others a dump with "
            "`dump ... custom ... id x y radius` tells the disks)",
        )
    for name in (style,) if style else COLUMNS:
        names = [*COLUMNS[name]]
        if width in (len(names), len(names) + len(IMAGES)):
            return names if width == len(names) else [*names, *IMAGES]
    wanted = COLUMNS[style or "sphere"]
    raise file.error(
        line, f"rows of {width} entries are not those of spheres ({', '.join(wanted)} and perhaps {', '.join(IMAGES)})"
    )


def _keys(file: TextFile) -> dict[str, float]:
    return {name: file.number(value, 1, name) for name, value in KEY.findall(file.lines[0])}


def _box(file: TextFile, parts: _Parts) -> NDArray[np.float64]:
    def numbers(name: str, wanted: int) -> tuple[int, list[float]]:
        line, tokens = parts.header[name]
        if len(tokens) != wanted:
            raise file.error(line, f"{name} has {len(tokens)} numbers, wanted are {wanted}")
        return line, [file.number(token, line, name) for token in tokens]

    if "avec" in parts.header:
        for name in ("bvec", "cvec"):
            if name not in parts.header:
                raise SampleError(f"{file.origin}: avec without {name}")
        return general_cell(numbers("avec", 3)[1], numbers("bvec", 3)[1], file.error, parts.header["bvec"][0])
    for name in ("xlo xhi", "ylo yhi"):
        if name not in parts.header:
            raise SampleError(f"{file.origin}: no line {name!r}: the box is missing")
    sizes = []
    for name in ("xlo xhi", "ylo yhi"):
        line, (low, high) = numbers(name, 2)
        if not high > low:
            raise file.error(line, f"{name} = {low:g} {high:g} is no box")
        sizes.append(high - low)
    tilt = 0.0
    if "xy xz yz" in parts.header:
        line, (tilt, xz, yz) = numbers("xy xz yz", 3)
        if xz or yz:
            raise file.error(line, f"xz = {xz:g} and yz = {yz:g} tilt the box out of the plane; both have to be 0")
    return np.array([[sizes[0], 0.0], [tilt, sizes[1]]])


def general_cell(
    a: list[float], b: list[float], error: Callable[[int, str], SampleError], line: int
) -> NDArray[np.float64]:
    """Cell from two lattice vectors in space, which have to lie in the plane xy.

    Raises
    ------
    SampleError
    """
    if a[2] or b[2]:
        raise error(line, f"lattice vectors with a component along z ({a[2]:g}, {b[2]:g}); both have to lie in xy")
    return np.array([a[:2], b[:2]])


def lammps_data_text(sample: Sample) -> str:
    """Disks of a sample as a data file, every digit kept.

    A cell whose first vector lies along x is written as a (tilted) box, any other one by its vectors (``avec``,
    ``bvec``), which LAMMPS reads since 2024 and turns into its own axes.
    """
    cell = sample.cell.tolist()
    law = (
        f"normal_stiffness = {sample.normal_stiffness!r}, stiffness_ratio = {sample.stiffness_ratio!r}, "
        f"friction = {sample.friction!r}"
    )
    lines = [f"disks of granfabric; {law}", "", f"{sample.count} atoms", "1 atom types", ""]
    if cell[0][1] == 0.0:
        lines += [f"0.0 {cell[0][0]!r} xlo xhi", f"0.0 {cell[1][1]!r} ylo yhi", "-0.5 0.5 zlo zhi"]
        if cell[1][0] != 0.0:
            lines.append(f"{cell[1][0]!r} 0.0 0.0 xy xz yz")
    else:
        lines += [
            f"{cell[0][0]!r} {cell[0][1]!r} 0.0 avec", f"{cell[1][0]!r} {cell[1][1]!r} 0.0 bvec",
            "0.0 0.0 1.0 cvec", "0.0 0.0 -0.5 abc origin",  # the only ones that LAMMPS takes in a plane
        ]  # fmt: skip
    lines += ["", "Atoms # sphere", ""]
    for number, (at, diameter) in enumerate(zip(sample.position.tolist(), (2.0 * sample.radius).tolist()), start=1):
        lines.append(f"{number} 1 {diameter!r} 1.0 {at[0]!r} {at[1]!r} 0.0")
    return "\n".join([*lines, ""])

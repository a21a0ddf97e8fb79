"""Dumps of LAMMPS as text: `dump custom` with the disks, `dump local` with the contacts.

The default format of a dump has six digits, too few for overlaps of a ten thousandth of a disk:
``dump_modify ID format float %.17g`` writes them all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError
from granfabric.dem_ref.sample.disks import Sample

from .columns import Rows, contacts_of_rows, disks_of
from .lammps_data import general_cell
from .raw import RawContacts, RawDisks
from .table import CONTACT_NAMES, contact_rows
from .text import TextFile, shown

ITEM = "ITEM:"
ATOMS, ENTRIES, BOX, STEP, UNITS = "ATOMS", "ENTRIES", "BOX BOUNDS", "TIMESTEP", "UNITS"
COUNTS = {ATOMS: "NUMBER OF ATOMS", ENTRIES: "NUMBER OF ENTRIES"}


@dataclass
class _Item:
    name: str
    words: list[str]
    line: int
    rows: Rows


def _items(file: TextFile) -> list[_Item]:
    heads = (ATOMS, ENTRIES, BOX, STEP, UNITS, *COUNTS.values())
    found: list[_Item] = []
    for line, raw in enumerate(file.lines, start=1):
        text = raw.strip()
        if text.startswith(ITEM):
            rest = text[len(ITEM) :].strip()
            name = next((head for head in heads if rest == head or rest.startswith(f"{head} ")), rest)
            found.append(_Item(name, rest[len(name) :].split(), line, []))
        elif text and found:
            found[-1].rows.append((line, text.split()))
        elif text:
            raise file.error(line, f"{shown(text)} stands before the first {ITEM} of a dump of LAMMPS")
    return found


def _frame(file: TextFile, step: int | None, what: str) -> list[_Item]:
    """Items of one snapshot, that of a time step or the last."""
    frames: list[tuple[int, list[_Item]]] = []
    units: list[_Item] = []
    for item in _items(file):
        if item.name == STEP:
            if not item.rows:
                raise file.error(item.line, "no number of a time step: is the file whole?")
            line, tokens = item.rows[0]
            frames.append((file.whole(tokens[0], line, "time step"), []))
        elif item.name == UNITS:
            units.append(item)
        elif frames:
            frames[-1][1].append(item)
    if not frames:
        raise SampleError(f"{file.origin}: no {ITEM} {STEP}; is this a dump of LAMMPS?")
    chosen = frames[-1]
    if step is not None:
        same = [frame for frame in frames if frame[0] == step]
        if not same:
            known = ", ".join(str(frame[0]) for frame in frames[:12]) + (" ..." if len(frames) > 12 else "")
            raise SampleError(f"{file.origin}: no time step {step}; it holds {known}")
        chosen = same[-1]
    names = [item.name for item in chosen[1]]
    for name in (what, COUNTS[what]):
        if name not in names:
            kind = "`dump custom`" if what == ATOMS else "`dump local`"
            raise SampleError(f"{file.origin}: no {ITEM} {name} at time step {chosen[0]}; wanted is a {kind} as text")
    body = next(item for item in chosen[1] if item.name == what)
    count = next(item for item in chosen[1] if item.name == COUNTS[what])
    tokens = count.rows[0][1] if count.rows else [""]
    announced = file.whole(tokens[0], count.line + 1, COUNTS[what].lower(), 0)
    if announced != len(body.rows):
        raise file.error(
            count.line + 1, f"{announced} are announced, {len(body.rows)} rows follow: is the file whole?"
        )
    return [*units, *chosen[1]]


def read_lammps_dump(file: TextFile, step: int | None = None) -> RawDisks:
    """Disks of a dump: of the given time step, or the last.

    Raises
    ------
    SampleError
    """
    items = _frame(file, step, ATOMS)
    box = next((item for item in items if item.name == BOX), None)
    if box is None:
        raise SampleError(f"{file.origin}: no {ITEM} {BOX}")
    cell = _cell(file, box)
    body = next(item for item in items if item.name == ATOMS)
    disks, plane = disks_of(file, body.line, body.words, body.rows, cell)
    if plane != "xy":
        raise SampleError(f"{file.origin}: the disks lie in the plane {plane}; LAMMPS's own is xy (dimension 2)")
    disks.cell = cell
    units = [item.rows[0][1][0] for item in items if item.name == UNITS and item.rows]
    if units:
        disks.remarks.append(f"the file says units {units[-1]}")
    return disks


def _cell(file: TextFile, box: _Item) -> NDArray[np.float64]:
    flags = [word for word in box.words if len(word) == 2 and set(word) <= set("pfsm")]
    for axis, flag in zip("xy", flags):
        if flag != "pp":
            raise file.error(box.line, f"the boundary along {axis} is {flag!r}; only periodic packings (pp) are read")
    if len(box.rows) < 3:
        raise file.error(box.line, f"{len(box.rows)} rows follow, wanted are 3")
    table = [[file.number(token, line, BOX.lower()) for token in tokens] for line, tokens in box.rows[:3]]
    wanted = 4 if "abc" in box.words else 3 if "xy" in box.words else 2
    for (line, tokens), row in zip(box.rows, table):
        if len(row) != wanted:
            raise file.error(line, f"{len(tokens)} numbers of the box, wanted are {wanted}")
    if wanted == 4:
        return general_cell(table[0][:3], table[1][:3], file.error, box.rows[0][0])
    xy = table[0][2] if wanted == 3 else 0.0
    if wanted == 3 and (table[1][2] or table[2][2]):
        raise file.error(box.rows[1][0], "xz and yz tilt the box out of the plane; both have to be 0")
    # a tilted box is told by the rectangle around it
    width = (table[0][1] - max(0.0, xy)) - (table[0][0] - min(0.0, xy))
    height = table[1][1] - table[1][0]
    if not (width > 0.0 and height > 0.0):
        raise file.error(box.line, f"a box of {width:g} by {height:g}")
    return np.array([[width, 0.0], [xy, height]])


def read_lammps_local(file: TextFile, columns: Sequence[str] | None = None, step: int | None = None) -> RawContacts:
    """Contacts of a `dump local`; `columns` gives the meaning of those that LAMMPS names ``c_1[1]`` and the like.

    Raises
    ------
    SampleError
    """
    items = _frame(file, step, ENTRIES)
    body = next(item for item in items if item.name == ENTRIES)
    if columns is not None and len(columns) != len(body.words):
        raise file.error(
            body.line, f"contact_columns names {len(columns)} columns, the file has {len(body.words)}: "
            f"{', '.join(body.words)}"
        )  # fmt: skip
    contacts = contacts_of_rows(file, body.line, columns or body.words, body.rows)
    box = next((item for item in items if item.name == BOX), None)
    contacts.cell = None if box is None else _cell(file, box)
    return contacts


def _box_lines(sample: Sample) -> list[str]:
    (ax, ay), (bx, by) = sample.cell.tolist()
    if ay == 0.0 and bx == 0.0:
        return [f"{ITEM} {BOX} pp pp pp", f"0.0 {ax!r}", f"0.0 {by!r}", "-0.5 0.5"]
    return [
        f"{ITEM} {BOX} abc origin pp pp pp", f"{ax!r} {ay!r} 0.0 0.0", f"{bx!r} {by!r} 0.0 0.0",
        "0.0 0.0 1.0 -0.5",
    ]  # fmt: skip


def lammps_dump_text(sample: Sample) -> str:
    """Disks of a sample as a dump of one time step, every digit kept; a tilted cell by its vectors (``abc origin``)."""
    lines = [f"{ITEM} {STEP}", "0", f"{ITEM} {COUNTS[ATOMS]}", str(sample.count), *_box_lines(sample)]
    lines.append(f"{ITEM} {ATOMS} id type xu yu radius")
    rows = zip(sample.position.tolist(), sample.radius.tolist())
    lines += [f"{number} 1 {at[0]!r} {at[1]!r} {radius!r}" for number, (at, radius) in enumerate(rows, start=1)]
    return "\n".join([*lines, ""])


def lammps_local_text(sample: Sample) -> str:
    """Contacts of a sample as a dump of local quantities with columns that bear their names."""
    rows = contact_rows(sample)
    lines = [f"{ITEM} {STEP}", "0", f"{ITEM} {COUNTS[ENTRIES]}", str(len(rows)), *_box_lines(sample)]
    lines.append(f"{ITEM} {ENTRIES} {' '.join(CONTACT_NAMES)}")
    lines += [f"{i} {j} {fn!r} {ft!r} {slip!r}" for i, j, fn, ft, slip in rows]
    return "\n".join([*lines, ""])

"""Tables of disks and of contacts as text: CSV with a header, and the text files of YADE.

A file of disks has the columns ``x, y, r`` (or ``d``), ``id`` if contacts are to name them, and the periodic cell as a
key in a comment::

    # cell = 40.0 0.0 1.5 38.0
    # normal_stiffness = 1e9
    id,x,y,r
    1,0.51,3.2,0.48

`cell` holds either width and height or both lattice vectors, one after the other. YADE tells its columns in a line
``#format x_y_z_r`` and its cell, if it is a rectangle, in ``##PERIODIC:: width height depth``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.arrays import SampleError
from granfabric.dem_ref.measures.contacts import contacts_of
from granfabric.dem_ref.sample.disks import Sample

from .columns import Rows, contacts_of_rows, disks_of
from .raw import KEYS, RawContacts, RawDisks
from .text import TextFile

KEY = re.compile(r"#\s*([A-Za-z_]+)\s*[=:]\s*(.*)")
PERIODIC = "##PERIODIC::"
FORMAT = "#format"


def read_table(file: TextFile) -> RawDisks:
    """Disks of a table.

    Raises
    ------
    SampleError
    """
    header, names, rows, keys, comments = _split(file)
    periodic = next(((line, text) for line, text in comments if text.startswith(PERIODIC)), None)
    if names is None and (periodic is not None or not rows or len(rows[0][1]) != 4):
        names = ["x", "y", "z", "r"] if periodic is not None else None
    if names is None:
        raise SampleError(
            f"{file.origin}: no names of columns; wanted is a first line such as x,y,r (or, as YADE writes it, "
            "#format x_y_z_r)"
        )
    disks, plane = disks_of(file, header, names, rows)
    if "cell" in keys:
        disks.cell = _cell(file, *keys["cell"])
    elif periodic is not None:
        disks.cell = _periodic(file, *periodic, plane)
    for name in KEYS:
        if name in keys:
            line, text = keys[name]
            disks.keys[name] = file.number(_first_word(text), line, name)
    if "seed" in keys and _first_word(keys["seed"][1]).lstrip("-").isdecimal():
        disks.seed = int(_first_word(keys["seed"][1]))
    return disks


def _first_word(text: str) -> str:
    """A value without the unit that may stand behind it."""
    return text.split()[0] if text.split() else ""


def read_contact_table(file: TextFile, columns: Sequence[str] | None = None) -> RawContacts:
    """Contacts of a table; `columns` names them where the file does not.

    Raises
    ------
    SampleError
    """
    header, names, rows, _, _ = _split(file)
    if columns is not None:
        names = list(columns)
    if names is None:
        raise SampleError(f"{file.origin}: no names of columns; wanted is a first line such as id1,id2,fn,ft")
    return contacts_of_rows(file, header, names, rows)


def cell_of(numbers: Sequence[float]) -> NDArray[np.float64]:
    """Rows of the cell from width and height, or from both lattice vectors.

    Raises
    ------
    SampleError
    """
    if len(numbers) == 2:
        return np.diag(np.array(numbers, dtype=np.float64))
    if len(numbers) == 4:
        return np.array(numbers, dtype=np.float64).reshape(2, 2)
    raise SampleError(
        f"cell has {len(numbers)} numbers, wanted are 2 (width, height) or 4 (both lattice vectors: a_x a_y b_x b_y)"
    )


def _cell(file: TextFile, line: int, text: str) -> NDArray[np.float64]:
    tokens = [token for token in re.split(r"[\s,;\[\]()]+", text) if token]
    try:
        return cell_of([file.number(token, line, "cell") for token in tokens])
    except SampleError as error:
        raise error if str(error).startswith(file.origin) else file.error(line, str(error)) from None


def _periodic(file: TextFile, line: int, text: str, plane: str) -> NDArray[np.float64]:
    sizes = [file.number(token, line, PERIODIC) for token in text.split()[1:]]
    if len(sizes) != 3:
        raise file.error(line, f"{PERIODIC} has {len(sizes)} numbers, wanted are 3")
    return np.diag([sizes["xyz".index(axis)] for axis in plane])


def _split(
    file: TextFile,
) -> tuple[int, list[str] | None, Rows, dict[str, tuple[int, str]], list[tuple[int, str]]]:
    """Line of the header, names, rows, keys of comments, comments."""
    header, names, separator = 1, None, None
    rows: Rows = []
    keys: dict[str, tuple[int, str]] = {}
    comments = []
    for line, raw in enumerate(file.lines, start=1):
        text = raw.strip()
        if not text:
            continue
        if text.startswith("#"):
            comments.append((line, text))
            if text.startswith(FORMAT):
                header, names = line, text[len(FORMAT) :].strip().split("_")
            elif found := KEY.fullmatch(text):
                name = found[1].lower()
                if name in keys and name in (*KEYS, "cell"):
                    raise file.error(line, f"the key {name!r} stands in line {keys[name][0]} already")
                keys[name] = (line, found[2])
            continue
        if separator is None:
            separator = next((mark for mark in (",", ";") if mark in text), " ")
        tokens = [token.strip().strip('"') for token in (text.split() if separator == " " else text.split(separator))]
        if names is None and not rows and not _is_number(tokens[0]):
            header, names = line, tokens
        else:
            rows.append((line, tokens))
    return header, names, rows, keys, comments


def _is_number(token: str) -> bool:
    try:
        float(token)
    except ValueError:
        return False
    return token.lower().lstrip("+-") not in ("nan", "inf", "infinity")


def table_text(sample: Sample) -> str:
    """Disks of a sample as CSV, every digit kept; `cell` and the numbers of the contact law as keys."""
    cell = " ".join(repr(float(value)) for value in sample.cell.ravel())
    lines = [
        "# disks in a periodic cell; lengths in m, stiffness in Pa",
        f"# cell = {cell}",
        f"# normal_stiffness = {sample.normal_stiffness!r}",
        f"# stiffness_ratio = {sample.stiffness_ratio!r}",
        f"# friction = {sample.friction!r}",
        f"# seed = {sample.seed}",
        "id,x,y,r",
    ]
    rows = zip(sample.position.tolist(), sample.radius.tolist())
    lines += [f"{number},{at[0]!r},{at[1]!r},{radius!r}" for number, (at, radius) in enumerate(rows, start=1)]
    return "\n".join([*lines, ""])


CONTACT_NAMES = ("id1", "id2", "fn", "ft", "tangential_elongation")


def contact_rows(sample: Sample) -> list[tuple[int, int, float, float, float]]:
    """Contacts of a sample under `CONTACT_NAMES`; disks count from 1."""
    contacts = contacts_of(sample)
    stiffness = sample.normal_stiffness * sample.stiffness_ratio
    key = sample.pairs.first.astype(np.int64) * sample.count + sample.pairs.second
    elongation = sample.pairs.tangential[np.searchsorted(key, contacts.key)]
    tangential = -stiffness * elongation + 0.0
    return list(
        zip(
            (contacts.first + 1).tolist(), (contacts.second + 1).tolist(), contacts.normal_force.tolist(),
            tangential.tolist(), elongation.tolist(),
        )
    )  # fmt: skip


def contact_table_text(sample: Sample) -> str:
    """Contacts of a sample as CSV; forces in N per metre of thickness."""
    lines = ["# contacts; forces in N per metre of thickness, elongation in m", ",".join(CONTACT_NAMES)]
    lines += [f"{i},{j},{fn!r},{ft!r},{slip!r}" for i, j, fn, ft, slip in contact_rows(sample)]
    return "\n".join([*lines, ""])


def write_text(path: Path, text: str) -> None:
    """Write a text so that the file is either the old one or the whole new one."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)

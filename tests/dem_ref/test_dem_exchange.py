"""Packings from and to files of other codes: round trips to the last bit, files that LAMMPS wrote, kinds of damage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from granfabric.dem_ref.exchange.files import FORMATS, import_packing, load_packing, save_packing
from granfabric.dem_ref.measures.contacts import contacts_of, love_weber_stress, unbalanced_force
from granfabric.dem_ref.sample.disks import Sample, SampleError, new_sample

LAMMPS = Path(__file__).with_name("packings")
"""`sheared.*`: written by LAMMPS (22 Jul 2025) at the end of `sheared.lmp`, which reads what `save_packing` wrote."""
LAMMPS_STRESS = (-1.06455074063, -1.0518366013, 0.285483858527)
"""Minus Pxx, Pyy, Pxy of the last line that LAMMPS printed; its shear stress is not made symmetric (6e-7 of it)."""
LAW = {"normal_stiffness": 1e4, "stiffness_ratio": 0.5, "friction": 0.4}
COLUMNS = ["-", "id1", "id2", "-", "-", "fn", "-", "-", "-", "ft1_x", "ft1_y", "-", "-"]


def lattice(
    columns: int, rows: int, shear: float, turn: float, noise: float, seed: int, law: dict[str, float]
) -> Sample:
    """Disks of several sizes near the points of a lattice, some touching, springs within friction."""
    random = np.random.default_rng(seed)
    cell = np.array([[columns, 0.0], [shear * rows, rows]])
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, s], [-s, c]]) if turn else np.eye(2)
    at = np.array([[i, j] for j in range(rows) for i in range(columns)], dtype=float)
    at += 0.3 + noise * random.uniform(-1.0, 1.0, at.shape)
    position = (at / [columns, rows]) @ cell @ rotation
    sample = new_sample(position, random.uniform(0.47, 0.53, len(at)), cell @ rotation, seed=seed % 1000, **law)
    contacts = contacts_of(sample)
    key = sample.pairs.first.astype(np.int64) * sample.count + sample.pairs.second
    most = law["friction"] * contacts.normal_force / (law["normal_stiffness"] * law["stiffness_ratio"])
    sample.pairs.tangential[np.searchsorted(key, contacts.key)] = random.uniform(-0.9, 0.9, contacts.count) * most
    return sample


def same_state(one: Sample, other: Sample) -> None:
    for name in ("position", "radius", "cell"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    a, b = contacts_of(one), contacts_of(other)
    for name in ("first", "second", "image", "normal_force", "tangential_force"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("exchange")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    columns=st.integers(4, 7),
    rows=st.integers(4, 7),
    shear=st.floats(-0.4, 0.4),
    turn=st.sampled_from([0.0, 0.3, -2.5]) | st.floats(-3.0, 3.0),
    noise=st.floats(0.0, 0.05),
    seed=st.integers(0, 2**31),
    stiffness=st.floats(1e-3, 1e12),
    ratio=st.floats(1e-3, 1.0),
    friction=st.floats(0.0, 2.0),
    format=st.sampled_from(FORMATS),
    local=st.booleans(),
)
def test_a_packing_written_and_read_is_the_same_to_the_last_bit(
    folder: Path, columns: int, rows: int, shear: float, turn: float, noise: float, seed: int, stiffness: float,
    ratio: float, friction: float, format: str, local: bool,
) -> None:  # fmt: skip
    law = {"normal_stiffness": stiffness, "stiffness_ratio": ratio, "friction": friction}
    sample = lattice(columns, rows, shear, turn, noise, seed, law)
    path, contacts = folder / "packing", folder / ("contacts.local" if local else "contacts.csv")
    if format == "npz":
        save_packing(path, sample, format=format)
        same_state(sample, load_packing(path, format=format))
        return
    save_packing(path, sample, format=format, contacts=contacts)
    given_law = law if format == "lammps_dump" else {}
    back = load_packing(path, format=format, contacts=contacts, **given_law)
    same_state(sample, back)
    assert {name: getattr(back, name) for name in law} == law
    assert format != "csv" or back.seed == sample.seed
    # what the file holds tells the format as well; without contacts there are no tangential forces
    told = import_packing(path, **given_law)
    assert told.format == format and not told.forces_given and not told.sample.pairs.tangential.any()
    assert any("tangential forces are unknown" in line for line in told.remarks)


@pytest.mark.parametrize(("name", "contacts"), [("a.data", "c.csv"), ("a.dump", "c.local"), ("a.csv", "c.csv")])
def test_a_made_packing_goes_round(folder: Path, packing: Sample, name: str, contacts: str) -> None:
    save_packing(folder / name, packing, contacts=folder / contacts)
    law = {"stiffness_ratio": 1.0, "friction": 0.5} if name == "a.dump" else {}
    back = import_packing(folder / name, contacts=folder / contacts, **law)
    np.testing.assert_array_equal(back.sample.position, packing.position)
    assert back.sample.normal_stiffness == pytest.approx(1e9, rel=1e-9)  # of a dump from its forces
    assert unbalanced_force(back.sample) < 1e-4 and back.forces_given


# what LAMMPS wrote


def test_a_dump_with_contacts_of_lammps_carries_the_stress_that_lammps_printed() -> None:
    made = import_packing(
        LAMMPS / "sheared.dump", contacts=LAMMPS / "sheared.local", contact_columns=COLUMNS, stiffness_ratio=0.5,
        friction=0.4,
    )  # fmt: skip
    assert love_weber_stress(made.sample) == pytest.approx(LAMMPS_STRESS, rel=1e-6)
    assert unbalanced_force(made.sample) < 1e-9  # with tangential forces of the wrong sign 0.3
    assert made.sample.normal_stiffness == pytest.approx(1e4, rel=1e-9)
    assert any("follows from forces and overlaps" in line for line in made.remarks)
    assert any("units lj" in line for line in made.remarks)
    contacts = contacts_of(made.sample)
    ratio = np.abs(contacts.tangential_force) / contacts.normal_force
    assert 0.395 < ratio.max() <= 0.4 and np.sum(ratio > 0.1) > 40


def test_a_data_file_of_lammps_is_the_dump_of_the_same_state() -> None:
    dump, data = (load_packing(LAMMPS / f"sheared.{ending}", **LAW) for ending in ("dump", "data"))
    for one in (dump, data):
        assert one.count == 64
    np.testing.assert_allclose(data.cell, dump.cell, rtol=1e-12, atol=1e-12)
    # write_data wraps disks into the box, the dump does not
    apart = (data.position - dump.position) @ np.linalg.inv(dump.cell)
    np.testing.assert_allclose(apart, np.round(apart), atol=1e-12)
    assert contacts_of(data).count == contacts_of(dump).count
    np.testing.assert_array_equal(contacts_of(data).key, contacts_of(dump).key)


def test_units_scale_lengths_and_forces() -> None:
    one = load_packing(LAMMPS / "sheared.dump", **LAW)
    small = load_packing(
        LAMMPS / "sheared.dump", contacts=LAMMPS / "sheared.local", contact_columns=COLUMNS, stiffness_ratio=0.5,
        friction=0.4, length_unit=1e-3, force_unit=50.0,
    )  # fmt: skip
    np.testing.assert_allclose(small.position, 1e-3 * one.position)
    assert small.normal_stiffness == pytest.approx(1e4 * 50.0 / 1e-3, rel=1e-9)  # force over length
    assert love_weber_stress(small) == pytest.approx(np.array(LAMMPS_STRESS) * 5e4, rel=1e-6)


def test_relaxing_lets_tangential_forces_build_up(packing: Sample, folder: Path) -> None:
    """At constant stress: what was lost of the forces is replaced by what the disks need."""
    loaded = import_packing(LAMMPS / "sheared.dump", **LAW)
    assert unbalanced_force(loaded.sample) > 0.05
    relaxed = import_packing(LAMMPS / "sheared.dump", relax=True, **LAW)
    assert unbalanced_force(relaxed.sample) < 1e-4 and relaxed.sample.pairs.tangential.any()
    assert love_weber_stress(relaxed.sample) == pytest.approx(love_weber_stress(loaded.sample), rel=1e-2, abs=1e-3)
    assert "relaxed at its stress" in relaxed.remarks[-1]


# tables and YADE


def table(path: Path, sample: Sample, head: str, row: Callable[[int, float, float, float], str]) -> Path:
    at, radius = sample.position.tolist(), sample.radius.tolist()
    rows = [row(i, *at[i], radius[i]) for i in range(sample.count)]
    path.write_text("\n".join([head, *rows, ""]))
    return path


@pytest.fixture(scope="module")
def disks() -> Sample:
    return lattice(5, 4, 0.0, 0.0, 0.02, 7, LAW)


def test_yades_text_formats(folder: Path, disks: Sample) -> None:
    width, height = disks.cell[0, 0], disks.cell[1, 1]
    texts = {
        "ext.txt": ("#format x_y_z_r", lambda i, x, y, r: f"{x!r}\t{y!r}\t0.0\t{r!r}", {"cell": (width, height)}),
        "mat.txt": (
            "#format x_y_z_r_matId\n# a comment", lambda i, x, y, r: f"{x!r} {y!r} 2.5 {r!r} 0",
            {"cell": (width, height)},
        ),
        "pack.spheres": (f"##PERIODIC:: {width} {height} 1.0", lambda i, x, y, r: f"{x!r} {y!r} 0.5 {r!r}", {}),
        "xz.txt": (f"##PERIODIC:: {width} 9.0 {height}", lambda i, x, y, r: f"{x!r} 0.5 {y!r} {r!r}", {}),
    }  # fmt: skip
    for name, (head, row, cell) in texts.items():
        back = load_packing(table(folder / name, disks, head, row), **cell, **LAW)
        np.testing.assert_array_equal(back.position, disks.position)
        np.testing.assert_array_equal(back.radius, disks.radius)
        np.testing.assert_array_equal(back.cell, disks.cell)


def test_contacts_as_vectors_name_their_disks_in_any_order(folder: Path, disks: Sample) -> None:
    """YADE's numbers begin at 0, its forces act on the second disk; the list may be turned around."""
    path = table(
        folder / "numbered.csv", disks, f"# cell: {disks.cell[0, 0]} {disks.cell[1, 1]}\nid;d;x;y;mass",
        lambda i, x, y, r: f"{i};{2 * r!r};{x!r};{y!r};1.0",
    )  # fmt: skip
    c = contacts_of(disks)
    assert c.count > 10
    across = np.column_stack([-c.normal[:, 1], c.normal[:, 0]])
    normal, tangential = c.normal_force[:, None] * c.normal, c.tangential_force[:, None] * across
    for flipped in (False, True):
        ends, sign = ((c.second, c.first), -1.0) if flipped else ((c.first, c.second), 1.0)
        rows = np.column_stack([*ends, sign * normal, sign * tangential])[::-1]
        text = "\n".join(",".join([str(int(row[0])), str(int(row[1])), *map(repr, row[2:].tolist())]) for row in rows)
        (folder / "vectors.csv").write_text("i,j,fn_x,fn_y,ft_x,ft_y\n" + text)
        back = load_packing(path, contacts=folder / "vectors.csv", stiffness_ratio=0.5, friction=0.4)
        np.testing.assert_allclose(contacts_of(back).tangential_force, c.tangential_force, rtol=1e-9, atol=1e-12)
        assert back.normal_stiffness == pytest.approx(1e4, rel=1e-9)


# damage


def changed(text: str, line: int, new: str) -> str:
    lines = text.split("\n")
    lines[line - 1] = new
    return "\n".join(lines)


def without(text: str, line: int) -> str:
    lines = text.split("\n")
    del lines[line - 1]
    return "\n".join(lines)


DAMAGED: list[tuple[str, str, Callable[[str], str], list[str]]] = [
    ("a number", "packing.csv", lambda t: changed(t, 10, "3,1.x,2.0,0.5"), ["line 10: x = '1.x'", "finite number"]),
    ("decimal comma", "packing.csv", lambda t: changed(t.replace(",", ";"), 10, "3;1,5;2.0;0.5"),
     ["line 10: x = '1,5'", "decimals need a point"]),
    ("not finite", "packing.csv", lambda t: changed(t, 10, "3,nan,2.0,0.5"), ["line 10: x = 'nan'", "finite"]),
    ("radius", "packing.csv", lambda t: changed(t, 9, "2,1.3,0.3,-0.5"),
     ["line 9: radius = -0.5", "legal are values > 0"]),
    ("short row", "packing.csv", lambda t: changed(t, 9, "2,1.3,0.3"), ["line 9: 3 entries where 4", "id, x, y, r"]),
    ("id twice", "packing.csv", lambda t: t.replace("\n3,", "\n2,"), ["line 10: id = 2", "line 9 already"]),
    ("no header", "packing.csv", lambda t: without(t, 7), ["no names of columns", "x,y,r"]),
    ("no size", "packing.csv", lambda t: t.replace("id,x,y,r", "id,x,y,s"),
     ["line 7", "neither a radius nor a diameter"]),
    ("no y", "packing.csv", lambda t: t.replace("id,x,y,r", "id,x,q,r"), ["no column y", "wanted are x, y and r"]),
    ("column twice", "packing.csv", lambda t: t.replace("id,x,y,r", "id,x,x,r"), ["column 'x' stands there 2 times"]),
    ("no cell", "packing.csv", lambda t: without(t, 2), ["periodic cell is not told", "# cell = WIDTH HEIGHT"]),
    ("cell of three", "packing.csv", lambda t: changed(t, 2, "# cell = 5 0 4"),
     ["line 2", "cell has 3 numbers", "2 (width, height) or 4"]),
    ("cell turned", "packing.csv", lambda t: changed(t, 2, "# cell = 0 4 5 0"),
     ["area -20", "to the left of the first"]),
    ("key", "packing.csv", lambda t: changed(t, 3, "# normal_stiffness = stiff"),
     ["line 3: normal_stiffness = 'stiff'"]),
    ("key's bound", "packing.csv", lambda t: changed(t, 4, "# stiffness_ratio = 2.0"),
     ["stiffness_ratio is 2.0", "0 < kt/kn <= 1"]),
    ("key twice", "packing.csv", lambda t: changed(t, 4, "# cell = 5 4"), ["line 4: the key 'cell' stands in line 2"]),
    ("missing", "packing.csv", lambda t: without(without(t, 5), 4), ["stiffness_ratio and friction", "# KEY = VALUE"]),
    ("far away", "packing.csv", lambda t: changed(t, 10, "3,2300.0,0.3,0.5"),
     ["line 10: the disk at x = 2300", "same unit"]),
    ("on one another", "packing.csv", lambda t: changed(t, 9, "2,0.3,0.3,0.5"),
     ["disks 1 (line 8) and 2 (line 9) overlap by"]),
    ("in space", "packing.csv", lambda t: t.replace("id,x,y,r", "z,x,y,r"), ["a packing in space", "disks in a plane"]),
    ("nothing", "packing.csv", lambda t: "", ["no names of columns"]),
    ("only a head", "packing.csv", lambda t: "# cell = 5 4\nx,y,r\n", ["no disks"]),
    ("dump: no frame", "packing.dump", lambda t: "ITEM: UNITS\nsi\n", ["ITEM: TIMESTEP", "dump of LAMMPS"]),
    ("dump: cut off", "packing.dump", lambda t: t[: len(t) // 2].rpartition("\n")[0], ["20 are announced", "whole"]),
    ("dump: walls", "packing.dump", lambda t: t.replace("pp pp pp", "pp ff pp"),
     ["boundary along y is 'ff'", "periodic"]),
    ("dump: no atoms", "packing.dump", lambda t: t.replace("ITEM: ATOMS", "ITEM: ENTRIES"),
     ["no ITEM: ATOMS", "dump custom"]),
    ("dump: box", "packing.dump", lambda t: t.replace("0.0 5.0", "5.0 0.0"), ["a box of -5 by 4"]),
    ("data: cut off", "packing.data", lambda t: t[: len(t) * 2 // 3].rpartition("\n")[0], ["20 atoms are announced"]),
    ("data: style", "packing.data", lambda t: t.replace("# sphere", "# atomic"), ["atom style 'atomic'", "sphere"]),
    ("data: width", "packing.data", lambda t: t.replace(" 0.0\n", "\n"), ["rows of 6 entries"]),
    ("data: no box", "packing.data", lambda t: t.replace("xlo xhi", "xlow xhigh"), ["no line 'xlo xhi'"]),
    ("data: no atoms", "packing.data", lambda t: t.replace("Atoms", "Bonds"), ["no section Atoms"]),
    ("data: out of plane", "packing.data", lambda t: t.replace("Atoms", "0.0 0.3 0.0 xy xz yz\n\nAtoms"),
     ["xz = 0.3", "both have to be 0"]),
    ("contacts: force", "contacts.csv", lambda t: changed(t, 4, "1,2,a,0,0"), ["line 4: fn = 'a'"]),
    ("contacts: no disk", "contacts.csv", lambda t: changed(t, 4, "1,200,1.0,0,0"),
     ["line 4: there is no disk with id = 200"]),
    ("contacts: itself", "contacts.csv", lambda t: changed(t, 4, "1,1,1.0,0,0"), ["line 4: id1 = id2 = 1"]),
    ("contacts: twice", "contacts.csv", lambda t: t + t.split("\n")[4] + "\n", ["stands in line 5 already"]),
    ("contacts: missing", "contacts.csv", lambda t: without(t, 4), ["contacts that the disks have are not in it"]),
    ("contacts: apart", "contacts.csv", lambda t: t + "1,9,300.0,0,0\n", ["which do not touch", "same state"]),
    ("contacts: stiffness", "contacts.csv", lambda t: twice(t, 2, 2.0),
     ["kn = 20000 Pa would fit best", "kn x overlap"]),
    ("contacts: friction", "contacts.csv", lambda t: twice(t, 4, 20.0), ["above friction = 0.4", "times the normal"]),
    ("contacts: names", "contacts.csv", lambda t: t.replace("id1,id2", "a,b"),
     ["no column id1 and id2", "contact_columns"]),
]  # fmt: skip


def twice(text: str, column: int, factor: float) -> str:
    """The numbers of a column of a list of contacts times a factor."""
    lines = text.split("\n")
    for place in range(2, len(lines) - 1):
        entries = lines[place].split(",")
        entries[column] = repr(factor * float(entries[column]))
        lines[place] = ",".join(entries)
    return "\n".join(lines)


@pytest.mark.parametrize(("file", "damage", "parts"), [case[1:] for case in DAMAGED], ids=[case[0] for case in DAMAGED])
def test_damage_is_told_with_file_line_and_value(
    folder: Path, disks: Sample, file: str, damage: Callable[[str], str], parts: list[str]
) -> None:
    name = "packing.csv" if file == "contacts.csv" else file
    path, contacts = folder / name, folder / "contacts.csv"
    save_packing(path, disks, contacts=contacts)
    broken = folder / file
    broken.write_text(damage(broken.read_text()))
    law = LAW if file == "packing.dump" else {}
    with pytest.raises(SampleError) as caught:
        load_packing(path, contacts=contacts if file == "contacts.csv" else None, **law)
    said = str(caught.value)
    assert said.startswith(str(broken)) and "\n" not in said
    for part in parts:
        assert part in said


def test_six_digits_are_refused_where_they_lose_the_forces(folder: Path, packing: Sample) -> None:
    """What LAMMPS and YADE write unless told otherwise; overlaps are a ten thousandth of a disk."""
    rows = [f"{x:g},{y:g},{r:g}" for (x, y), r in zip(packing.position, packing.radius)]
    cell = " ".join(f"{value:.9g}" for value in packing.cell.ravel())
    (folder / "coarse.csv").write_text("\n".join([f"# cell = {cell}", "x,y,r", *rows]))
    law = {"normal_stiffness": 1e9, "stiffness_ratio": 1.0, "friction": 0.5}
    with pytest.raises(SampleError, match=r"coordinates of 6 digits .* lost in rounding .*%\.17g"):
        load_packing(folder / "coarse.csv", **law)
    fine = [f"{x:.12g},{y:.12g},{r:.12g}" for (x, y), r in zip(packing.position, packing.radius)]
    (folder / "coarse.csv").write_text("\n".join([f"# cell = {cell}", "x,y,r", *fine]))
    assert load_packing(folder / "coarse.csv", **law).count == packing.count


def test_forces_on_the_other_disk_are_noticed() -> None:
    turned = [name.replace("ft1", "ft") for name in COLUMNS]
    with pytest.raises(SampleError, match=r"opposite sign .* ft1_x, ft1_y those on id1"):
        load_packing(
            LAMMPS / "sheared.dump", contacts=LAMMPS / "sheared.local", contact_columns=turned, stiffness_ratio=0.5,
            friction=0.4,
        )  # fmt: skip


def test_anonymous_columns_of_a_dump_local_ask_for_their_meaning() -> None:
    with pytest.raises(SampleError, match=r"c_pr\[1\].* contact_columns"):
        load_packing(LAMMPS / "sheared.dump", contacts=LAMMPS / "sheared.local", **LAW)
    with pytest.raises(SampleError, match="names 2 columns, the file has 13"):
        load_packing(LAMMPS / "sheared.dump", contacts=LAMMPS / "sheared.local", contact_columns=["id1", "id2"], **LAW)


def test_a_time_step_is_chosen(folder: Path) -> None:
    text = (LAMMPS / "sheared.dump").read_text()
    later = text.replace("500000", "600000").replace("0.10", "0.11", 0)
    (folder / "two.dump").write_text(text + later.partition("lj\n")[2])
    assert load_packing(folder / "two.dump", step=500000, **LAW).count == 64
    with pytest.raises(SampleError, match="no time step 7; it holds 500000, 600000"):
        load_packing(folder / "two.dump", step=7, **LAW)
    with pytest.raises(SampleError, match="time step is for dumps"):
        load_packing(LAMMPS / "sheared.data", step=7, **LAW)


def test_arguments_are_checked(folder: Path, disks: Sample) -> None:
    path = folder / "plain.csv"
    save_packing(path, disks)
    for arguments, part in (
        ({"format": "lammps"}, "format = 'lammps' is unknown, legal are npz"),
        ({"friction": -1.0}, "friction is -1.0"),
        ({"length_unit": 0.0}, "length_unit = 0.0, legal are finite values > 0"),
        ({"cell": (1.0, 2.0, 3.0)}, "cell has 3 numbers"),
        ({"contacts": folder / "none.csv"}, "none.csv: no such file"),
    ):
        with pytest.raises(SampleError, match=part):
            load_packing(path, **arguments)  # type: ignore[arg-type]
    told = import_packing(path, friction=0.7)
    assert told.sample.friction == 0.7 and any("friction = 0.7 as given, not 0.4" in line for line in told.remarks)
    with pytest.raises(SampleError, match="no such file"):
        load_packing(folder / "none.data")
    with pytest.raises(SampleError, match="the ending tells no format"):
        save_packing(folder / "packing.xyz", disks)
    with pytest.raises(SampleError, match="contacts are written as"):
        save_packing(path, disks, contacts=folder / "c.data")
    with pytest.raises(SampleError, match="cannot be written"):
        save_packing(folder / "missing" / "a.csv", disks)
    (folder / "a.gz").write_bytes(b"\x1f\x8b\x08aaaa")
    with pytest.raises(SampleError, match="compressed; unpack it"):
        load_packing(folder / "a.gz")
    (folder / "latin.csv").write_bytes("x,y,r\n# größe\n".encode("latin-1"))
    with pytest.raises(SampleError, match="line 2: not a text in UTF-8"):
        load_packing(folder / "latin.csv")
    save_packing(folder / "a.npz", disks)
    with pytest.raises(SampleError, match="knows all of itself; leave out friction"):
        load_packing(folder / "a.npz", friction=0.3)


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), name=st.sampled_from(["packing.csv", "packing.data", "packing.dump", "contacts.csv"]))
def test_any_damage_gives_one_sentence_or_a_packing(
    folder: Path, disks: Sample, data: st.DataObject, name: str
) -> None:
    """Lines and characters dropped, doubled or replaced: never another error, never numbers that are not finite."""
    disk_file = folder / ("packing.csv" if name == "contacts.csv" else name)
    contacts = folder / "contacts.csv"
    save_packing(disk_file, disks, contacts=contacts)
    broken = folder / name
    lines = broken.read_text().split("\n")
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(lines) - 1))
        kind = data.draw(st.sampled_from(["drop", "double", "cut", "token", "swap"]))
        if kind == "drop":
            del lines[at]
            lines = lines or [""]
        elif kind == "double":
            lines.insert(at, lines[at])
        elif kind == "cut":
            lines[at] = lines[at][: data.draw(st.integers(0, len(lines[at])))]
        elif kind == "token":
            separator = "," if "," in lines[at] else " "
            tokens = lines[at].split(separator)
            tokens[data.draw(st.integers(0, len(tokens) - 1))] = data.draw(
                st.sampled_from(["", "nan", "-1", "1e400", "1e300", "x", "0", "99", "1_0", "-inf", "7.5"])
            )
            lines[at] = separator.join(tokens)
        else:
            other = data.draw(st.integers(0, len(lines) - 1))
            lines[at], lines[other] = lines[other], lines[at]
    broken.write_text("\n".join(lines))
    try:
        sample = load_packing(disk_file, contacts=contacts if name == "contacts.csv" else None, **LAW)
    except SampleError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(sample.position).all() and sample.radius.min() > 0.0
        assert np.isfinite(contacts_of(sample).tangential_force).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("length", [1e141, 1e200, 1e300])
def test_a_cell_whose_size_cannot_be_squared_is_refused(tmp_path, length):
    path = tmp_path / "far.csv"
    path.write_text(f"# cell = {length:g} {length:g}\nx,y,r\n0.5,0.5,0.5\n1.5,0.5,0.5\n0.5,1.5,0.5\n")
    with pytest.raises(SampleError, match=r"cell = .* is too large for its area to be a number"):
        load_packing(path, **LAW)

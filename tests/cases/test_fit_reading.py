"""Curves as users write them: names, units, signs, and one sentence on what is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.errors import InputError
from granfabric.cases.fit.columns import BY_NAME, COLUMNS, LEGAL, PASSED_OVER
from granfabric.cases.fit.following import follow
from granfabric.cases.fit.reading import Curve, curve_of, read_curve

GOOD = "p [kPa],q/p,z,a_c\n100,0.0,4.06,0.0\n100,0.1,3.93,0.05\n100,0.2,3.80,0.11\n"


def read(tmp_path: Path, text: str | bytes) -> Curve:
    file = tmp_path / "c.csv"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_curve(file)


def followed(text: str, tmp_path: Path, control: str = "stress", initial: object = None):
    return follow(read(tmp_path, text), control, None if initial is None else np.array(initial))


def test_names_units_marks_and_comments(tmp_path: Path) -> None:
    curve = read(tmp_path, GOOD)
    np.testing.assert_array_equal(curve.columns["p"], [1e5, 1e5, 1e5])
    assert set(curve.columns) == {"p", "stress_ratio", "coordination", "fabric_anisotropy"} and curve.lines == [2, 3, 4]
    marked = "\ufeff# a test\r\n\r\np (kPa); eta ;coordination;fabric_anisotropy\r\n 1e2 ;0;4.06;0\r\n"
    other = read(tmp_path, marked + "100;.1;3.93;5e-2\r\n# end\r\n100;0.2;3.8;\r\n")
    np.testing.assert_array_equal(other.columns["p"], curve.columns["p"])
    assert other.lines == [4, 5, 7] and np.isnan(other.columns["fabric_anisotropy"][2])
    tabs = read(tmp_path, "stress_xx [MPa]\tstress_yy [MPa]\teps_yy [%]\n-0.1\t-0.1\t0\n-0.1\t-0.2\t-0.01\n")
    np.testing.assert_allclose(tabs.columns["stress_yy"], [-1e5, -2e5])
    np.testing.assert_allclose(tabs.columns["strain_yy"], [0.0, -1e-4])
    quoted = read(tmp_path, '"p","q","z","_my, own"\n1e5,0,4,x\n1e5,1e4,3.9,"y, z"\n')
    assert set(quoted.columns) == {"p", "q", "coordination"} and quoted.notes == ("c.csv: passed over _my, own",)


def test_own_histories_are_read(tmp_path: Path) -> None:
    """Every column of the program's files is legal or passed over, and none is both."""
    from granfabric.constitutive.path import POINT_COLUMNS, SLIDING_COLUMNS
    from granfabric.dem_ref.loading.run import HISTORY_COLUMNS

    for name in (*POINT_COLUMNS, *SLIDING_COLUMNS, *HISTORY_COLUMNS):
        assert (name in LEGAL) != (name in PASSED_OVER), name
    assert len(LEGAL) == len({name for column in COLUMNS for name in (column.name, *column.short)})
    assert {"coordination_without_rattlers", "void_ratio", "substeps"} <= PASSED_OVER
    assert all(column.meaning and column.unit in ("Pa", "-", "degrees") for column in BY_NAME.values())


WRONG = {
    "": ["the file is empty"],
    "p,q\n": ["0 row(s) of numbers; a curve has at least two"],
    "p,q,z\n1,2,3\n": ["1 row(s)"],
    "1,2\n3,4\n5,6\n": ["line 1: numbers where the names of the columns belong", "coordination (z)"],
    GOOD.replace("z,", "zz,"): ["the column 'zz' is unknown; the nearest is 'z'", "legal: stress_xx (sigma_xx)"],
    GOOD.replace("a_c", "fabric_anistropy"): ["the nearest is 'fabric_anisotropy'"],
    GOOD.replace("a_c", "fabric_anistropy_error"): ["the nearest is 'fabric_anisotropy_error'"],
    GOOD.replace("kPa", "psi"): ["the unit 'psi' of the column p is unknown; legal: Pa, kPa, MPa, GPa", "nearest is"],
    GOOD.replace("3.93", "3,93"): ["line 3: 5 cells, but 4 names in line 1"],
    GOOD.replace("3.93", "3.93 m"): ["line 3, column z: '3.93 m' is not a finite number"],
    GOOD.replace("3.93", "inf"): ["line 3, column z: 'inf' is not a finite number"],
    GOOD.replace("3.93", "1e999"): ["line 3, column z: '1e999' is not a finite number"],
    GOOD.replace("3.93", "1_0"): ["line 3, column z: '1_0' is not a finite number"],
    GOOD.replace("100,0.1", ",0.1"): ["line 3, column p: an empty cell, but this column prescribes the path"],
    GOOD.replace("100,0.1", "-100,0.1"): ["line 3: the mean pressure is -100000 Pa", "compression in p"],
    GOOD.replace("100,0.1", "100,1.2"): ["line 3: q is 1.2 times p, so that a principal stress pulls"],
    GOOD.replace("a_c", "z"): ["the column coordination is there twice"],
    GOOD.replace("a_c", "a_c_error"): ["the column fabric_anisotropy_error belongs to no column fabric_anisotropy"],
    GOOD.replace("a_c", "z_error"): ["line 2, column coordination_error: 0 is not a standard error"],
    "z,a_c\n4,0\n3.9,0.1\n": ["no column tells the path"],
    "p,z\n1,4\n1,3.9\n": ["p without q or stress_ratio (q/p); write q = 0"],
    "q,z\n1,4\n1,3.9\n": ["q without p or stress_ratio"],
    "q/p,z\n0,4\n0.1,3.9\n": ["stress_ratio (q/p) without p", "--set initial.stress"],
    "strain_yy,z\n0,4\n-1e-5,3.9\n": ["the first row does not tell stress_xx and stress_yy"],
    "p,q\n1,0\n1,0.1\n": ["every column is needed to tell the path"],
    "stress_xx,stress_yy,z\n100,100,4\n100,110,3.9\n": ["line 2: the mean pressure is -100 Pa", "tension is positive"],
    "stress_xx,stress_yy,p,z\n-100,-100,100,4\n-100,-110,150,4\n": ["line 3, column p: 150 contradicts", "it is 105"],
    "stress_xx,stress_yy,stress_xy,q,z\n-9,-9,0,0,4\n-9,-9,3,1,4\n": ["line 3, column q: 1 contradicts", "it is 3"],
    "p,q,strain_yy,z\n1,0,,4\n1,0,0,4\n": ["line 2, column strain_yy: an empty cell in the first row"],
    'p,q,z\n1,"2,3\n1,2,3\n1,2,3\n': ["line 2: not comma-separated text"],
    "step,void_ratio\n1,2\n1,3\n": ["none of the columns is known"],
    "q,q/p,z\n0,0,4\n1,0.1,3\n": ["q and q/p do not tell p where they are zero"],
}


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_what_is_wrong_is_one_sentence(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        followed(text, tmp_path)
    said = str(told.value)
    assert "c.csv" in said and "\n" not in said
    for words in WRONG[text]:
        assert words in said, said


def test_every_wrong_cell_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        read(tmp_path, GOOD.replace("3.93", "x").replace("3.80", "y"))
    assert [line.rpartition("line ")[2][:1] for line in str(told.value).split("\n")] == ["3", "4"]


def test_other_files(tmp_path: Path) -> None:
    for file, words in ((tmp_path, "a folder"), (tmp_path / "none.csv", "No such file")):
        with pytest.raises(InputError, match=words):
            read_curve(file)
    with pytest.raises(InputError, match="saved as UTF-16"):
        read(tmp_path, GOOD.encode("utf-16"))


def test_p_and_q_are_stresses_along_the_axes(tmp_path: Path) -> None:
    """q/p = 0.2 at p = 100 kPa: 120 kPa along y, 80 kPa along x; the other way round below zero, or at 0 degrees."""
    path = followed(GOOD, tmp_path)
    np.testing.assert_allclose([leg.target for leg in path.legs], [(-9e4, -11e4, 0.0), (-8e4, -12e4, 0.0)])
    np.testing.assert_allclose(path.initial_stress, [-1e5, -1e5, 0.0])
    np.testing.assert_allclose(path.axis, [-1.0, 0.0], atol=1e-12)
    assert path.driven == ["p", "stress_ratio"] and set(path.compared) == {"coordination", "fabric_anisotropy"}
    np.testing.assert_allclose(path.pressure, 1e5)
    np.testing.assert_allclose(path.stress_ratio, [0.0, 0.1, 0.2], atol=1e-12)
    turned = followed("p,q,z\n1e5,0,4\n1e5,-1e4,4\n", tmp_path)
    np.testing.assert_allclose(turned.legs[0].target, (-11e4, -9e4, 0.0))
    aside = followed("p,q,theta,z\n1e5,0,45,4\n1e5,1e4,45,4\n", tmp_path)
    # the major stress at 45 degrees: a compressive shear, below zero where tension is positive
    np.testing.assert_allclose(aside.legs[0].target, (-1e5, -1e5, -1e4))
    from_q = followed("q,q/p,z\n1e4,0.1,4\n2e4,0.1,4\n", tmp_path)
    np.testing.assert_allclose(from_q.pressure, [1e5, 2e5])


def test_what_prescribes_and_what_is_compared(tmp_path: Path) -> None:
    text = "stress_xx,stress_yy,strain_xx,strain_yy,z\n-1e5,-1e5,1e-5,1e-5,4\n-1e5,-1.1e5,2e-5,-3e-5,4\n"
    by_stress = followed(text, tmp_path)
    assert by_stress.driven == ["stress_xx", "stress_yy"] and by_stress.legs[0].control == ("stress",) * 3
    np.testing.assert_allclose(by_stress.compared["strain_yy"], [0.0, -4e-5])  # from the first row
    np.testing.assert_allclose(by_stress.scales["strain_yy"], 0.02 * 4e-5)
    by_strain = followed(text, tmp_path, "strain")
    assert by_strain.driven == ["strain_xx", "strain_yy"]
    assert by_strain.legs[0].control == ("strain", "strain", "stress")
    np.testing.assert_allclose(by_strain.legs[0].target, (1e-5, -4e-5, 0.0))
    np.testing.assert_allclose(by_strain.scales["stress_yy"], 1e3)
    mixed = follow(read(tmp_path, text), ["stress", "strain", "stress"])
    assert set(mixed.compared) == {"stress_yy", "strain_xx", "coordination"}
    lateral = followed("stress_yy,strain_xx,z\n-1e5,0,4\n-1.1e5,1e-6,4\n", tmp_path, initial=[-9e4, -8e4, 0.0])
    np.testing.assert_allclose(lateral.initial_stress, [-9e4, -1e5, 0.0])  # what the row tells is of the row
    assert lateral.legs[0].control == ("strain", "stress", "stress")
    alone = followed("stress_yy,z\n-1e5,4\n-1.1e5,4\n", tmp_path, initial=[-9e4, -8e4, 0.0])
    np.testing.assert_allclose(alone.legs[0].target, (-9e4, -1.1e5, 0.0))  # what nobody tells stays


def test_each_quantity_is_compared_once(tmp_path: Path) -> None:
    """Histories of the program hold a_c three times; the axes tell which counts."""
    head = "p,q,fabric_anisotropy,fabric_anisotropy_1,fabric_anisotropy_2\n"
    plain = followed(head + "1e5,0,0.02,-0.02,0\n1e5,1e4,0.05,-0.05,0\n", tmp_path)
    np.testing.assert_allclose(plain.compared["fabric_anisotropy"], [0.02, 0.05])
    assert set(plain.compared) == {"fabric_anisotropy"}
    head = head.replace("p,q", "p,q,theta")
    turning = followed(head + "1e5,1e4,90,0.02,-0.02,0\n1e5,1e4,60,0.05,-0.03,0.04\n", tmp_path)
    assert set(turning.compared) == {"fabric_anisotropy_1", "fabric_anisotropy_2"}
    rounding = "stress_xx,stress_yy,strain_yy,strain_xy\n-1,-1,0,0\n-1,-1.1,-1e-5,1e-22\n"
    assert set(followed(rounding, tmp_path).compared) == {"strain_yy"}


def test_errors_are_scales(tmp_path: Path) -> None:
    text = "p,q,z,z_error\n1e5,0,4,0.01\n1e5,1e4,,\n1e5,2e4,3.9,0.02\n"
    path = followed(text, tmp_path)
    np.testing.assert_allclose(path.scales["coordination"], [0.01, 1.0, 0.02])
    assert path.known_errors == {"coordination"}
    given = follow(read(tmp_path, GOOD), "stress", scales={"coordination": 0.5})
    np.testing.assert_allclose(given.scales["coordination"], 0.5)


def test_columns_from_memory() -> None:
    curve = curve_of({"p": [1e5, 1e5], "q": (0, 1e4), "z": np.array([4.0, np.nan])})
    assert curve.lines == [1, 2] and np.isnan(curve.columns["coordination"][1])
    for columns, words in (
        ({}, "0 row"), ({"p": [1.0, 2.0], "q": [1.0]}, "1 values in 'q', 2 in the first column"),
        ({"p": ["a", "b"]}, "line 1, column p: 'a' is not a finite number"), ({"z": [np.inf, 1.0]}, "not a finite"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words):
            curve_of(columns)

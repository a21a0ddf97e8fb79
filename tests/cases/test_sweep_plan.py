"""Values of a sweep as they are written, the runs that follow, their names, and numbers taken from their files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.sweep.plan import Request, plan_of
from granfabric.cases.sweep.results import evaluate, first_crossing, result_of, results_of
from granfabric.cases.sweep.values import bounds_of, parted, values_of

# values


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a=1,2,3", ["1", "2", "3"]),
        ("a.b = 1 , 2", ["1", "2"]),
        ("a=[-1e5, -1e5, 0],[-2e5,-2e5,0]", ["[-1e5, -1e5, 0]", "[-2e5,-2e5,0]"]),
        ("a=[[1,2],[3,4]],[[5,6],[7,8]]", ["[[1,2],[3,4]]", "[[5,6],[7,8]]"]),
        ("a={x=1, y=2},{x=3, y=4}", ["{x=1, y=2}", "{x=3, y=4}"]),
        ('a="one, two","three"', ['"one, two"', '"three"']),
        ("a='one, two',three", ["'one, two'", "three"]),
        (r'a="say \"a, b\"",x', [r'"say \"a, b\""', "x"]),
        ("a=mean_field,shifted_distribution", ["mean_field", "shifted_distribution"]),
        ("a=true,false", ["true", "false"]),
        ("a=0:1:3", ["0.0", "0.5", "1.0"]),
        ("a=0.1:0.3:3", ["0.1", "0.2", "0.3"]),
        ("a=-1.0:1:2,5", ["-1.0", "1.0", "5"]),
        ("a=1:5:5", ["1", "2", "3", "4", "5"]),
        ("a=1:2:3", ["1.0", "1.5", "2.0"]),
        ("a=1e7:1e9:3:log", ["10000000.0", "100000000.0", "1000000000.0"]),
        ("a=4:2:2", ["4", "2"]),
        ("a=materials/x.toml,y", ["materials/x.toml", "y"]),
    ],
)
def test_values_are_parted_at_commas_outside_brackets_and_quotation_marks(text: str, values: list[str]) -> None:
    assert values_of(text)[1] == values


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a", "not of the form key=value"),
        ("a=", "a value is missing"),
        ("=1,2", "not of the form key=value"),
        ("a=1,,2", "nothing between two commas"),
        ("a=1,2,", "nothing between two commas"),
        ("a=[1,2", "cannot be parted into values: ']' is missing"),
        ('a="x,1', "'\"' is missing"),
        ("a=1],2", "']' closes nothing"),
        ("a=[1},2", "'}' closes nothing"),
        ("a=1,1 2", "not a TOML value"),
        ("a=1,2,1", "'1' is given twice"),
        ("a=1:2:1", "not LO:HI:N"),
        ("a=1:1:3", "two different numbers"),
        ("a=-1:1:3:log", "both ends are above zero"),
        ("a=0:1:3:log", "both ends are above zero"),
    ],
)
def test_values_that_are_not_legal_are_refused(text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        values_of(text)
    assert said in str(error.value)


def test_parting_loses_no_letter() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        text = "".join(rng.choice(list("a1,[]{}\"'\\ "), 12))
        try:
            assert ",".join(parted(text)) == text
        except ValueError:
            continue


def test_ranges_of_the_hypercube() -> None:
    assert bounds_of("a.b=1:2") == ("a.b", 1.0, 2.0, False)
    assert bounds_of("a = 1e6:1e9:log") == ("a", 1e6, 1e9, True)
    for text in ("a=2:1", "a=1:1", "a=1", "a=1:x", "=1:2", "a=-1:1:log"):
        with pytest.raises(InputError, match="--latin"):
            bounds_of(text)


# runs


def test_all_combinations_the_last_key_fastest() -> None:
    plan = plan_of(Request(["material.coordination=3.9,4", "closure.force_change=mean_field,x", "title=same"]))
    assert plan.keys == ("material.coordination", "closure.force_change")
    assert [run.name for run in plan.runs] == [
        f"coordination={z}_force_change={closure}" for z in ("3.9", "4") for closure in ("mean_field", "x")
    ]
    assert plan.runs[1].assignments == ("title=same", "material.coordination=3.9", "closure.force_change=x")
    assert plan.runs[1].values == {"material.coordination": "3.9", "closure.force_change": "x"}


def test_names_are_readable_different_and_legal() -> None:
    both = plan_of(Request(["a.x=1,2", "b.x=[1, 2],[3, 4]"]))
    assert both.runs[0].name == "a.x=1_b.x=_1_2"
    long = plan_of(Request([f"{'k' * 90}=1,2"]))
    assert [run.name for run in long.runs] == ["run_0001", "run_0002"]
    alike = plan_of(Request(['a="x y",x_y']))
    assert [run.name for run in alike.runs] == ["run_0001", "run_0002"]
    cases = plan_of(Request(["a=mesh,MESH"]))  # one folder where capitals do not count
    assert [run.name for run in cases.runs] == ["run_0001", "run_0002"]
    for name in (run.name for plan in (both, long, alike) for run in plan.runs):
        assert Path(name).name == name and not name.startswith(".")


def test_a_table_has_a_run_a_line(tmp_path: Path) -> None:
    table = tmp_path / "runs.csv"
    table.write_text('name,a.x,b\nfirst,1,"[1, 2]"\nsecond,,word\n')
    plan = plan_of(Request(["c=5"], table))
    assert plan.keys == ("a.x", "b") and [run.name for run in plan.runs] == ["first", "second"]
    assert plan.runs[0].assignments == ("c=5", "a.x=1", "b=[1, 2]")
    assert plan.runs[1].assignments == ("c=5", "b=word") and plan.runs[1].origin == f"{table}, line 3"
    both = plan_of(Request(["c=5,6"], table))
    assert [run.values for run in both.runs][:2] == [
        {"a.x": "1", "b": "[1, 2]", "c": "5"}, {"a.x": "1", "b": "[1, 2]", "c": "6"},
    ]  # fmt: skip
    assert len({run.name for run in both.runs}) == 4


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "has no lines below its heads"),
        ("a,b\n", "has no lines below its heads"),
        ("a;b\n1;2\n", "parted by semicolons"),
        ("a,b\n1\n", "line 2 has 1 entries, the first line 2"),
        ("a,a\n1,2\n", "the head 'a' twice"),
        ("a,\n1,2\n", "an empty head"),
        ("name\nx\n", "names runs only"),
        ("name,a\nx,1\nx,2\n", "the name 'x' is given twice"),
        ("name,a\n../x,1\n", "'../x' is not of letters"),
        ("name,a\n.x,1\n", "'.x' is not of letters"),
        ("name,a\n,1\n", "the name '' is not of letters"),
        ("a\n1 2\n", "line 2: a: '1 2' is not a TOML value"),
    ],
)
def test_a_table_that_is_not_legal_is_refused(tmp_path: Path, text: str, said: str) -> None:
    table = tmp_path / "runs.csv"
    table.write_text(text)
    with pytest.raises(InputError) as error:
        plan_of(Request([], table))
    assert said in str(error.value) and str(error.value).startswith(("--table", str(table)))


def test_a_table_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        plan_of(Request([], tmp_path / "missing.csv"))
    with pytest.raises(InputError, match="cannot be read"):
        plan_of(Request([], tmp_path))


def test_each_part_of_a_range_has_one_sample() -> None:
    plan = plan_of(Request([], None, ["a=2:4", "b=1e6:1e9:log", "c=-8:-2:log"], 20, 5))
    assert [run.name for run in plan.runs][::19] == ["run_0001", "run_0020"]
    columns = {key: np.array([float(run.values[key]) for run in plan.runs]) for key in plan.keys}
    fractions = {
        "a": (columns["a"] - 2) / 2,
        "b": np.log10(columns["b"] / 1e6) / 3,
        "c": np.log(-columns["c"] / 8) / np.log(2 / 8),
    }
    for values in fractions.values():
        assert sorted(np.floor(20 * values).astype(int)) == list(range(20))
    again = plan_of(Request([], None, ["a=2:4", "b=1e6:1e9:log", "c=-8:-2:log"], 20, 5))
    assert again == plan
    fewer = plan_of(Request([], None, ["a=2:4"], 20, 5))  # a further key leaves the others as they are
    assert [run.values["a"] for run in fewer.runs] == [run.values["a"] for run in plan.runs]
    other = plan_of(Request([], None, ["a=2:4"], 20, 6))
    assert [run.values["a"] for run in other.runs] != [run.values["a"] for run in fewer.runs]


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (Request(), "a sweep needs something that varies"),
        (Request(["a=1"]), "a sweep needs something that varies"),
        (Request(["a=1,2", "a=3,4"]), "--set a is given twice"),
        (Request(["a=1,2"], None, ["a=1:2"], 3), "the key 'a' is given twice"),
        (Request(["a=1"], None, ["a=1:2"], 3), "the key 'a' is given twice"),
        (Request([], None, ["a=1:2", "a=1:3"], 3), "--latin names a key twice"),
        (Request([], None, ["a=1:2"]), "--latin needs --samples N"),
        (Request([], None, ["a=1:2"], 1), r"--samples 1 is outside [2, "),
        (Request([], None, ["a=1:2"], 3, -1), "--seed -1 is outside [0, "),
        (Request(["a=1,2"], samples=3), "--samples goes with --latin"),
        (Request(["a=1,2"], seed=3), "--seed goes with --latin"),
        (Request(["a=0:1:1000", "b=0:1:1000"]), "1000000 combinations are more than the 100000 runs"),
        (Request(["a=0:1:1000"], None, ["b=0:1"], 1000), "1000000 runs are more than the 100000"),
    ],
)
def test_requests_that_are_not_legal_are_refused(request_: Request, said: str) -> None:
    with pytest.raises(InputError) as error:
        plan_of(request_)
    assert said in str(error.value)


# numbers


def test_numbers_of_a_history(tmp_path: Path) -> None:
    p, q = [100.0, 100.0, 50.0], [0.0, 30.0, 5.0]
    rows = list(zip([0, 1, 2], p, q, [4.0, 3.0, 3.5], ["load", "load", "end"]))
    files.write_text(tmp_path / "history.csv", files.csv_text(["step", "p", "q", "coordination", "stage"], rows))
    files.write_json(tmp_path / "run.json", {"program": "granfabric", "timing": {"total": 1.5}})
    texts = ["coordination", "coordination:first", "coordination:min", "coordination:max", "coordination:mean",
             "q/p", "q/p:max", "coordination:at:q/p=0.15", "q:at:step=2", "q:at:p=75", "q:at:q/p=0.9", "substeps",
             "timing.total", "timing.nothing"]  # fmt: skip
    results = [result_of(text, "point") for text in texts]
    found = evaluate(tmp_path, results)
    assert list(found) == texts
    expected = [3.5, 4.0, 3.0, 4.0, 3.5, 0.1, 0.3, 3.5, 5.0, 17.5, math.nan, math.nan, 1.5, math.nan]
    np.testing.assert_allclose(list(found.values()), expected, rtol=1e-14)
    assert all(math.isnan(value) for value in evaluate(tmp_path / "none", results).values())


def test_the_stress_ratio_is_that_of_the_grains(tmp_path: Path) -> None:
    rows = [(0, 100.0, 60.0, 0.0), (1, 100.0, 40.0, 20.0)]  # total and effective pressure
    files.write_text(tmp_path / "history.csv", files.csv_text(["step", "p", "effective_p", "q"], rows))
    for kind in ("point", "field"):
        wanted = [result_of(text, kind) for text in ("q/p", "step:at:q/p=0.25")]
        assert list(evaluate(tmp_path, wanted).values()) == pytest.approx([0.5, 0.5], rel=1e-14)


@pytest.mark.parametrize(
    "column", ["load_factor", "rigid_footing_displacement_y", "spring_bottom_y", "region_clay_p", "reaction_top_moment"]
)
def test_all_columns_of_a_field_can_be_asked_for(column: str) -> None:
    assert result_of(f"{column}:max", "field").column == column
    with pytest.raises(InputError, match="unknown"):
        result_of(f"{column}:max", "point")


def test_the_first_crossing_is_linear_between_rows() -> None:
    other, values = np.array([0.0, 2.0, 1.0, 3.0]), np.array([0.0, 10.0, 20.0, 30.0])
    assert first_crossing(other, values, 1.5) == pytest.approx(7.5)
    assert first_crossing(other, values, 2.0) == 10.0
    assert first_crossing(other, values, 2.5) == pytest.approx(27.5)
    assert math.isnan(first_crossing(other, values, 4.0)) and math.isnan(first_crossing(other, values, -1.0))
    assert first_crossing(np.array([3.0, 1.0]), np.array([0.0, 1.0]), 2.0) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("text", "kind", "said"),
    [
        ("coord", "point", "the nearest is 'coordination'"),
        ("void_ratio", "point", "is unknown"),
        ("stage", "field", "holds words"),
        ("coordination:largest", "field", "legal: last, first, max, min, mean, at:COLUMN=VALUE"),
        ("coordination:at", "dem", "not of the form at:COLUMN=VALUE"),
        ("coordination:at:q/p", "dem", "not of the form at:COLUMN=VALUE"),
        ("coordination:at:q/p=many", "dem", "not of the form at:COLUMN=VALUE"),
        ("coordination:at:qp=1", "dem", "is unknown"),
        ("material.coordination", "point", "only a DEM run measures"),
        ("material.coord", "dem", "the nearest is 'coordination'"),
        ("material.coordination:max", "dem", "nothing comes after it"),
    ],
)
def test_results_that_are_not_legal_are_refused(text: str, kind: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        results_of([text], kind)
    assert said in str(error.value)

"""Gradings against closed forms; packings compacted with friction: looser, at rest, with what was wanted of them."""

from __future__ import annotations

from math import erf, exp, log, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granfabric.dem_ref.dynamics.packing import PackingError, PackingOptions, mean_diameter_of, random_diameters
from granfabric.dem_ref.dynamics.packing import make_packing as make_frictionless_packing
from granfabric.dem_ref.inputs.probes import is_at_rest
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number, love_weber_stress
from granfabric.dem_ref.preparation.compaction import make_packing, prepare_packing
from granfabric.dem_ref.preparation.grading import grading_of, largest_departure, read_grading
from granfabric.dem_ref.sample.disks import SampleError

RANDOM = np.random.default_rng(0)


def written(folder: Path, text: str) -> Path:
    file = folder / "grading.csv"
    file.write_text(text)
    return file


def test_lognormal_diameters_have_the_distribution_of_their_name() -> None:
    ratio, deviation = 4.0, 0.5
    options = PackingOptions(distribution="lognormal", diameter_ratio=ratio, size_deviation=deviation)
    d = random_diameters(20_000, options, RANDOM)
    half = 0.5 * log(ratio)
    level = np.log(d / d.min()) - half  # the smallest lies at -half

    def below(x: float) -> float:
        inside = erf(half / deviation / sqrt(2.0))
        return 0.5 + 0.5 * erf(x / deviation / sqrt(2.0)) / inside

    for x in (-0.5, -0.2, 0.0, 0.3, 0.6):
        assert np.mean(level < x) == pytest.approx(below(x), abs=2e-3)
    assert d.max() / d.min() == pytest.approx(ratio, rel=1e-2) and d.mean() == pytest.approx(1.0)
    # a deviation that is not given is a quarter of ln(ratio)
    quarter = PackingOptions(distribution="lognormal", diameter_ratio=ratio, size_deviation=log(ratio) / 4.0)
    left = PackingOptions(distribution="lognormal", diameter_ratio=ratio)
    np.testing.assert_array_equal(*(np.sort(random_diameters(500, one, RANDOM)) for one in (quarter, left)))


def test_passing_by_area_gives_that_share_of_the_area(tmp_path: Path) -> None:
    """Area spread evenly between 1 and 2 mm: a number density as 1/d^2, of which the mean is 2 ln 2 mm."""
    curve = read_grading(written(tmp_path, "size,passing_by_area\n1e-3,0\n2e-3,1\n"))
    options = PackingOptions(distribution="given", grading=curve)
    assert mean_diameter_of(20_000, options) == pytest.approx(2e-3 * log(2.0), rel=1e-4)
    d = np.sort(random_diameters(20_000, options, RANDOM)) * mean_diameter_of(20_000, options)
    area = np.cumsum(d**2) / np.sum(d**2)
    for size in (1.2e-3, 1.5e-3, 1.8e-3):
        assert np.interp(size, d, area) == pytest.approx(size / 1e-3 - 1.0, abs=1e-3)


@pytest.mark.parametrize("column", ["passing_by_area", "passing_by_mass", "passing_by_number"])
def test_a_gap_grading_has_its_two_sizes(tmp_path: Path, column: str) -> None:
    text = f"# two sieves\nsize, {column}\n1.0, 0\n1.0, 30\n2.0, 30\n2.0, 100\n"
    options = PackingOptions(distribution="given", grading=read_grading(written(tmp_path, text)))
    d = random_diameters(1000, options, RANDOM) * mean_diameter_of(1000, options)
    share = 0.3 if column == "passing_by_number" else 0.3 / (0.3 + 0.7 / 4.0)  # four times the area each
    assert np.mean(np.isclose(d, 1.0)) == pytest.approx(share, abs=2e-3)
    assert np.mean(np.isclose(d, 2.0)) == pytest.approx(1.0 - share, abs=2e-3)


@settings(max_examples=40, deadline=None)
@given(
    steps=st.lists(st.tuples(st.floats(0.0, 0.5), st.floats(0.0, 1.0)), min_size=1, max_size=6),
    power=st.sampled_from(["passing_by_area", "passing_by_number"]),
    percent=st.booleans(),
)
def test_any_grading_is_found_again_in_the_disks(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[float, float]], power: str, percent: bool
) -> None:
    size, passing = [1.0], [0.0]
    for wider, more in steps:
        size.append(size[-1] + wider)
        passing.append(passing[-1] + more)
    if passing[-1] < 1e-3:
        return
    whole = 100.0 if percent else 1.0
    levels = [min(whole, whole * value / passing[-1]) for value in passing[:-1]] + [whole]
    rows = "\n".join(f"{a!r},{b!r}" for a, b in zip(size, levels))
    curve = read_grading(written(tmp_path_factory.mktemp("grading"), f"size,{power}\n{rows}\n"))
    options = PackingOptions(distribution="given", grading=curve)
    options.check()
    d = random_diameters(4000, options, RANDOM) * mean_diameter_of(4000, options)
    assert largest_departure(0.5 * d, curve) < 2e-3


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "is empty"),
        ("size,passing\n1,0\n2,1\n", "line 1: columns size, passing; wanted are size"),
        ("size,passing_by_area,passing_by_number\n1,0,0\n", "wanted are size"),
        ("size,passing_by_area\n1,0\n", "1 points"),
        ("size,passing_by_area\n1,0\n2,0.9\n", "line 3: passing runs from 0 to 0.9"),
        ("size,passing_by_area\n1,0.1\n2,1\n", "line 2: passing runs from 0.1 to 1"),
        ("size,passing_by_area\n2,0\n1,1\n", "line 3: size = 1 is below"),
        ("size,passing_by_area\n1,0\n2,0.5\n3,0.4\n4,1\n", "line 4: passing = 0.4 is below"),
        ("size,passing_by_area\n-1,0\n2,1\n", "line 2: size = -1"),
        ("size,passing_by_area\n1,0\n2,x\n", "line 3: passing_by_area = 'x'"),
        ("size,passing_by_area\n1,0\n8,1\n", "line 3: size = 8 is 8 times the smallest"),
        ("size,passing_by_area\n1,0\n2\n", "line 3: 1 entries"),
    ],
)
def test_a_bad_grading_is_told_with_its_line(tmp_path: Path, text: str, part: str) -> None:
    with pytest.raises(SampleError) as caught:
        read_grading(written(tmp_path, text))
    assert part in str(caught.value) and "grading.csv" in str(caught.value)


def test_what_is_told_of_a_grading() -> None:
    told = grading_of(0.5 * np.array([1.0, 1.0, 1.0, 1.0, 2.0]))
    assert told["smallest"] == 1.0 and told["largest"] == 2.0 and told["mean"] == 1.2
    assert told["d10"] == 1.0 and told["d50"] == 1.0 and told["d90"] == 2.0  # half of the area each


def test_friction_during_compaction_loosens() -> None:
    """z falls from about 4 towards 3 (without rattlers), the solid fraction from 0.84 towards 0.78."""
    z, solid = [], []
    for friction in (0.03, 0.5):
        sample = make_packing(300, 2, PackingOptions(preparation_friction=friction, mean_diameter=2e-3))
        assert is_at_rest(sample) and sample.friction == 0.5 and sample.mean_diameter == pytest.approx(2e-3)
        assert love_weber_stress(sample) == pytest.approx([-1e5, -1e5, 0.0], rel=1e-3, abs=100.0)
        contacts = contacts_of(sample)
        assert np.abs(contacts.tangential_force).max() > 0.0
        # springs and overlaps are half a step apart, which shows where hardly any force is
        felt = contacts.normal_force > 1e-3 * contacts.normal_force.mean()
        assert (np.abs(contacts.tangential_force) <= 1.005 * friction * contacts.normal_force)[felt].all()
        z.append(coordination_number(sample).without_rattlers)
        solid.append(sample.solid_fraction)
    assert 3.75 < z[0] < 4.05 and 3.1 < z[1] < 3.45
    assert solid[1] < solid[0] - 0.02


def test_no_friction_is_the_recipe_without_friction() -> None:
    for options in (PackingOptions(), PackingOptions(preparation_friction=0.0)):
        made, plain = make_packing(100, 4, options), make_frictionless_packing(100, 4)
        np.testing.assert_array_equal(made.position, plain.position)


def test_a_wanted_coordination_is_found_and_told() -> None:
    made = prepare_packing(150, 1, PackingOptions(coordination=3.6, counted="excluded"))
    assert coordination_number(made.sample).without_rattlers == pytest.approx(3.6, abs=0.06)
    assert 0.02 < made.friction < 0.5 and is_at_rest(made.sample)
    tried = dict(made.trials)
    assert tried[made.friction] == coordination_number(made.sample).without_rattlers
    again = make_packing(150, 1, PackingOptions(preparation_friction=made.friction))
    np.testing.assert_array_equal(again.position, made.sample.position)  # the friction found makes the same packing


def test_what_no_friction_gives_is_refused_with_what_there_is() -> None:
    with pytest.raises(PackingError, match=r"coordination = 4\.5 is above the .* without friction"):
        make_packing(100, 1, PackingOptions(coordination=4.5))
    with pytest.raises(PackingError, match=r"solid_fraction = 0\.6 is below the .* with friction 0\.3 during"):
        make_packing(100, 1, PackingOptions(solid_fraction=0.6, friction=0.3))


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({"preparation_friction": 0.6}, "above the friction of 0.5"),
        ({"preparation_friction": 0.1, "coordination": 3.5}, "are given; one of them"),
        ({"distribution": "given"}, "go together"),
        ({"grading": ((1.0, 0.0), (2.0, 1.0))}, "go together"),
        ({"distribution": "given", "grading": ((1.0, 0.0), (2.0, 0.9))}, "passing 0 to 1"),
        ({"distribution": "given", "grading": ((2.0, 0.0), (1.0, 1.0))}, "both ascending"),
        ({"distribution": "given", "grading": ((1.0, 0.0), (9.0, 1.0))}, "up to 5 times"),
        ({"size_deviation": 0.3}, "goes with distribution = 'lognormal'"),
        ({"counted": "some"}, "legal are 'included' and 'excluded'"),
        ({"coordination": 7.0}, "coordination is 7.0"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options: dict, part: str) -> None:
    with pytest.raises(SampleError, match=part):
        PackingOptions(**options).check()
    if set(options) <= {"preparation_friction", "coordination"} and len(options) == 1:
        with pytest.raises(SampleError):
            make_frictionless_packing(100, 1, PackingOptions(**options))


def test_the_recipe_without_friction_takes_no_preparation() -> None:
    with pytest.raises(SampleError, match="needs a compaction with friction"):
        make_frictionless_packing(100, 1, PackingOptions(coordination=3.5))


def test_the_shape_of_a_cut_lognormal_is_symmetric_in_the_logarithm() -> None:
    d = np.sort(random_diameters(1001, PackingOptions(distribution="lognormal", diameter_ratio=3.0), RANDOM))
    np.testing.assert_allclose(d * d[::-1], d[500] ** 2, rtol=1e-9)
    assert d[500] < 1.0 < d[500] * exp(0.2)

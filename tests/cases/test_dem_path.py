"""From the legs of a DEM scene to segments, and legs that are refused."""

from __future__ import annotations

from math import radians

import pytest
from pydantic import ValidationError

from granfabric.cases.scene.dem_path import PathError, leg_numbers, packing_options, run_options, segments
from granfabric.cases.scene.schema_dem import DemScene
from granfabric.cases.scene.validation_messages import messages
from granfabric.dem_ref.loading.path import Segment


def scene(*legs: dict, **tables: dict) -> DemScene:
    return DemScene.model_validate({"title": "disks", "kind": "dem", "path": list(legs), **tables})


def leg(loading: str, **keys: object) -> dict:
    return {"loading": loading, **keys}


def constant(ratio: float, **keys: object) -> dict:
    return leg("constant_pressure", stress_ratio=ratio, **keys)


def test_driven_legs_get_their_sense_from_the_stress_before() -> None:
    made = segments(scene(constant(0.2), constant(0.0), constant(-0.1), constant(0.2, largest_strain=0.003)))
    assert [segment.shear_strain for segment in made] == [0.02, -0.02, -0.02, 0.003]
    assert [segment.stress_ratio for segment in made] == [0.2, 0.0, -0.1, 0.2]
    assert all(segment.angle == radians(90) for segment in made)


def test_a_new_direction_sees_the_component_of_the_stress_along_it() -> None:
    # q/p = 0.2 along y is -0.2 along x: going to -0.1 along x is loading along x
    made = segments(scene(constant(0.2), constant(-0.1, direction_degrees=0.0)))
    assert made[1].shear_strain == 0.02 and made[1].angle == 0.0


def test_pressure_after_constant_lateral_stress_is_followed() -> None:
    """p (1 - q/p) is the lateral stress: from p0 at 0 to p0/(1 - 0.2) at 0.2."""
    made = segments(scene(leg("constant_lateral_stress", stress_ratio=0.2), leg("invariants", stress_ratio=0.1)))
    assert made[1].pressure == pytest.approx(1.25)
    assert made[1].stress_ratio == 0.1 and made[1].angle == pytest.approx(radians(90))


def test_isotropic_and_probe_legs() -> None:
    made = segments(scene(leg("isotropic", pressure_ratio=0.9), leg("invariants", stress_ratio=-0.1)))
    assert made[0] == Segment("invariants", pressure=0.9, stress_ratio=0.0, angle=radians(90))
    # a negative ratio presses across the direction
    assert made[1] == Segment("invariants", pressure=0.9, stress_ratio=0.1, angle=radians(180))


@pytest.mark.parametrize(("turn", "parts"), [(90.0, 2), (-30.0, 1), (400.0, 9)])
def test_a_rotation_is_cut_so_that_its_sense_is_unique(turn: float, parts: int) -> None:
    made = segments(scene(constant(0.2), leg("rotation", rotation_degrees=turn)))[1:]
    assert len(made) == parts
    assert made[-1].angle == pytest.approx(radians(90.0 + turn))
    assert all(segment.pressure == 1.0 and segment.stress_ratio == pytest.approx(0.2) for segment in made)


def test_a_leg_by_components_sets_the_stress_when_it_is_all_stress() -> None:
    stress = leg("components", control=["stress"] * 3, target=[-80e3, -120e3, 0.0])
    made = segments(scene(stress, constant(0.1)))
    assert made[0].control == ("stress", "stress", "stress") and made[1].shear_strain == -0.02
    assert made[1].angle == pytest.approx(radians(90.0))
    strain = leg("components", control=["strain", "stress", "strain"], target=[0.0, -120e3, 0.0])
    with pytest.raises(PathError, match=r"path 2: the stress .* is not known beforehand"):
        segments(scene(strain, constant(0.1)))
    # what says everything itself needs no knowledge
    assert len(segments(scene(strain, leg("isotropic", pressure_ratio=1.0), constant(0.1)))) == 3


@pytest.mark.parametrize(
    ("legs", "text"),
    [
        ([constant(0.2), constant(0.2)], r"path 2: stress_ratio = 0\.2 is where the leg begins"),
        ([leg("rotation", rotation_degrees=90.0)], r"path 1: there is no deviator to rotate"),
        ([leg("components", control=["stress"] * 3, target=[1.0, -3.0, 0.0])], r"path 1: .* compressive in every"),
    ],
)
def test_legs_that_do_not_follow_are_refused(legs: list[dict], text: str) -> None:
    with pytest.raises(PathError, match=text):
        segments(scene(*legs))


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        (leg("constant_pressure"), "needs stress_ratio"),
        (constant(0.2, pressure_ratio=1.1), "does not take pressure_ratio"),
        (leg("invariants"), "needs pressure_ratio, stress_ratio or direction_degrees"),
        (leg("rotation", rotation_degrees=0.0), "turns nothing"),
        (leg("constant_presure", stress_ratio=0.1), "the nearest is 'constant_pressure'"),
        (constant(1.0), "(-1, 1)"),
    ],
)
def test_illegal_keys_of_a_leg_are_told_in_one_sentence(bad: dict, text: str) -> None:
    with pytest.raises(ValidationError) as caught:
        scene(bad)
    [(_, told)] = messages(caught.value, DemScene, {})
    assert text in told and "\n" not in told


def test_options_of_packing_and_run_follow_the_scene() -> None:
    made = scene(
        constant(0.2),
        packing={"friction": 0.3, "distribution": "bidisperse"},
        rates={"inertial_number": 1e-4},
        output={"stress_step": 0.02},
    )
    assert packing_options(made).friction == 0.3 and packing_options(made).distribution == "bidisperse"
    options = run_options(made)
    assert options.limits.inertial_number == 1e-4 and options.record_stress_ratio == 0.02


def test_relative_targets_of_components() -> None:
    shear = leg("components", control=["strain"] * 3, target=[1e-4, -1e-4, 0.0], relative=True)
    made = segments(scene(leg("isotropic", pressure_ratio=2.0), shear))
    assert made[1] == Segment("mixed", control=("strain",) * 3, target=(1e-4, -1e-4, 0.0), relative=True)
    # known stresses stay known: from q/p = 0.2 along y at 100 kPa by -20 and +20 kPa to none
    back = leg("components", control=["stress"] * 3, target=[-20e3, 20e3, 0.0], relative=True)
    made = segments(scene(constant(0.2), back, constant(0.1)))
    assert made[2].shear_strain == 0.02
    # and unknown ones unknown
    with pytest.raises(PathError, match=r"path 3: the stress .* is not known beforehand"):
        segments(scene(shear, back, constant(0.1)))
    # a pull that only the run can tell: the leg before may end elsewhere than at its target
    pull = leg("components", control=["stress"] * 3, target=[90e3, 120e3, 0.0], relative=True)
    assert len(segments(scene(constant(0.2), pull))) == 2


def test_relative_goes_with_components_alone() -> None:
    for other in (constant(0.2), leg("isotropic", pressure_ratio=0.9), leg("rotation", rotation_degrees=90.0)):
        with pytest.raises(ValidationError) as caught:
            scene({**other, "relative": True})
        [(_, told)] = messages(caught.value, DemScene, {})
        assert "relative = true goes with loading = 'components'" in told and "\n" not in told
        scene({**other, "relative": False})


@pytest.mark.parametrize(("component", "axis"), [(0, "x"), (1, "y")])
def test_a_pull_along_one_axis_is_refused(component: int, axis: str) -> None:
    control, target = ["strain"] * 3, [0.0, 0.0, 0.0]
    control[component] = "stress"
    with pytest.raises(PathError, match=rf"path 1: a stress of 0 Pa along {axis} is not compressive"):
        segments(scene(leg("components", control=control, target=target)))
    # a shear stress of zero is none
    assert segments(scene(leg("components", control=["strain", "strain", "stress"], target=[0.0, 0.0, 0.0])))


def test_numbers_of_legs() -> None:
    turn = leg("rotation", rotation_degrees=100.0)
    assert leg_numbers(scene(constant(0.2), turn, constant(0.1))) == [1, 2, 2, 2, 3]

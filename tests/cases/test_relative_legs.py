"""Targets relative to the start of a leg in point scenes: undrained shear after consolidation."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.records import files
from granfabric.cases.scene.point_path import legs_of
from granfabric.cases.scene.reader import load
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material, ParameterError
from granfabric.constitutive.path import Leg, drive

QUIET = ("--set", "output.pictures=false")
STRAIN, STRESS = ("strain",) * 3, ("stress",) * 3
MATERIAL = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)
ELASTIC = Effects(contact_loss=False, contact_gain=False, stiffness_feedback=False, irreversible_spread=False)
CONSOLIDATION = Leg(control=STRESS, target=(-200e3, -200e3, 0.0), increments=4)


def history(folder: Path) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def test_undrained_shear_at_constant_stiffness_has_a_closed_form() -> None:
    """p stays to the last digit, q = G (eps_1 - eps_2); with absolute strains the consolidation is undone."""
    law = ContactLaw([MATERIAL], effects=ELASTIC)
    shear = Leg(control=STRAIN, target=(1e-5, -1e-5, 0.0), increments=4, relative=True)
    columns = drive(law, (-100e3, -100e3, 0.0), [CONSOLIDATION, shear]).columns
    modulus = 4.06 * 0.846 * 2e9 / (4 * math.pi)
    assert columns["p"][4:] == pytest.approx(200e3, rel=1e-12)
    assert columns["q"][4:] == pytest.approx(modulus * 2e-5 * np.linspace(0.0, 1.0, 5), rel=1e-9, abs=1e-6)
    volume = columns["strain_xx"] + columns["strain_yy"]
    assert volume[4:] == pytest.approx(volume[4], abs=1e-18)
    absolute = Leg(control=STRAIN, target=(1e-5, -1e-5, 0.0), increments=4)
    assert drive(law, (-100e3, -100e3, 0.0), [CONSOLIDATION, absolute]).columns["p"][-1] == pytest.approx(100e3)


def test_the_report_of_a_user_who_consolidates_first(granfabric: Callable, tmp_path: Path) -> None:
    scene = tmp_path / "undrained.toml"
    scene.write_text(
        'title = "t"\nkind = "point"\n[material]\ncoordination = 4.06\nsolid_fraction = 0.846\nnormal_stiffness = 1e9\n'
        "[initial]\nstress = [-100e3, -100e3, 0.0]\n"
        '[[path]]\ncontrol = ["stress", "stress", "stress"]\ntarget = [-200e3, -200e3, 0.0]\nincrements = 4\n'
        '[[path]]\ncontrol = ["strain", "strain", "strain"]\ntarget = [1e-4, -1e-4, 0.0]\nincrements = 4\n'
        "relative = true\n"
    )
    assert granfabric("point", scene, "-o", tmp_path / "out", *QUIET).code == 0
    h = history(tmp_path / "out")
    volume = h["strain_xx"] + h["strain_yy"]
    assert np.ptp(volume[4:]) < 1e-17 and volume[4] < -1e-4
    assert h["strain_xx"][-1] - h["strain_xx"][4] == pytest.approx(1e-4, rel=1e-12)
    assert np.all(h["p"][4:] > 199e3)
    # the scene as resolved is the same scene
    again = granfabric("point", tmp_path / "out" / "scene.toml", "-o", tmp_path / "again", *QUIET)
    assert again.code == 0
    assert (tmp_path / "again" / "history.csv").read_bytes() == (tmp_path / "out" / "history.csv").read_bytes()


def test_numbers_of_the_shipped_scene(granfabric: Callable, tmp_path: Path) -> None:
    assert granfabric("point", "undrained", "-o", tmp_path, *QUIET).code == 0
    h = history(tmp_path)
    assert h["q"][-1] / h["p"][-1] == pytest.approx(0.2101, abs=1e-4)
    assert h["p"][-1] == pytest.approx(201.16e3, abs=20.0)
    assert h["coordination"][-1] == pytest.approx(3.7918, abs=1e-4)
    assert h["fabric_anisotropy"][-1] == pytest.approx(0.1123, abs=1e-4)
    volume = h["strain_xx"] + h["strain_yy"]
    bulk = 4.06 * 0.846e9 / (2 * math.pi)
    assert np.ptp(volume[10:]) < 1e-17 and volume[10] == pytest.approx(-100e3 / bulk, rel=1e-3)


def test_each_component_counts_from_its_own_start() -> None:
    """Lateral stress kept as it is, axial strain by so much, no shear: whatever the stress and strain before."""
    law = ContactLaw([MATERIAL])
    before = [CONSOLIDATION, Leg(control=("strain", "stress", "stress"), target=(-1.5e-4, -210e3, 5e3))]
    start = drive(law, (-100e3, -100e3, 0.0), before)
    leg = Leg(control=("stress", "strain", "stress"), target=(0.0, -1e-5, -5e3), increments=3, relative=True)
    end = drive(law, (-100e3, -100e3, 0.0), [*before, leg])
    assert end.stress[0, 0] == start.stress[0, 0]
    assert end.strain[0, 1] - start.strain[0, 1] == pytest.approx(-1e-5, rel=1e-10)
    assert end.stress[0, 2] == pytest.approx(0.0, abs=1e-9)
    # halves of a straight leg end where the whole does
    half = Leg(control=STRESS, target=(5e3, -5e3, 0.0), increments=5, relative=True)
    whole = Leg(control=STRESS, target=(10e3, -10e3, 0.0), increments=10, relative=True)
    one, two = (drive(law, (-100e3, -100e3, 0.0), legs) for legs in ([half, half], [whole]))
    assert one.stress == pytest.approx(two.stress) and one.state == pytest.approx(two.state, rel=1e-6)


def test_at_the_start_both_kinds_are_the_same() -> None:
    law = ContactLaw([MATERIAL])
    legs = [Leg(control=STRAIN, target=(1e-5, -2e-5, 1e-5), increments=3, relative=kind) for kind in (False, True)]
    made = [drive(law, (-100e3, -100e3, 0.0), [leg]) for leg in legs]
    assert np.array_equal(made[0].stress, made[1].stress)


def test_every_reader_of_a_path_keeps_it(granfabric: Callable) -> None:
    """Legs as made, shortened for a trial and drawn finer for a reference: `effects` sees the path that is run."""
    legs = legs_of(load("undrained").scene)
    assert [leg.relative for leg in legs] == [False, True]
    result = granfabric("effects", "undrained")
    assert result.code == 0 and "q/p to 0.21" in result.out  # taken absolutely it would be 0.42 at half the pressure


def test_relative_rotations_are_refused(granfabric: Callable, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"path\.relative goes with a target"):
        Leg(rotation_degrees=10.0, relative=True)
    result = granfabric("point", "axes_rotation", "--set", "path.1.relative=true", "-o", tmp_path / "out")
    assert result.code == 2 and "relative = true goes with a target" in result.err and result.err.count("\n") == 1
    result = granfabric("point", "undrained", "--set", "path.1.relative=1", "-o", tmp_path / "out")
    assert result.code == 2 and "path 2: relative = 1 is not one of true, false" in result.err


def test_a_leg_of_strains_after_one_of_stress_says_from_where_it_counts(granfabric: Callable, tmp_path: Path) -> None:
    told = "path 2: strain targets count from the start of the path"
    assert told not in granfabric("point", "undrained", "-o", tmp_path / "relative").out
    total = granfabric("point", "undrained", "--set", "path.1.relative=false", "-o", tmp_path / "total")
    assert total.code == 0 and told in total.out
    assert "strain targets count" not in granfabric("point", "simple_shear", "-o", tmp_path / "strain").out

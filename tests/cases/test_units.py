"""Units of the columns of histories: every column of every kind of run has the one that its quantity has."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.field.prepare import prepare
from granfabric.cases.pictures.field import _named
from granfabric.cases.records.field_history import FieldHistory
from granfabric.cases.records.units import unit, units
from granfabric.cases.scene.reader import load
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.path import PORE_COLUMNS, SLIDING_COLUMNS
from granfabric.constitutive.state import state_variables
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS
from granfabric.dem_ref.specimen.history import COLUMNS

PASCAL = {f"stress_{axis}" for axis in ("xx", "yy", "xy")} | {"p", "q"}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("strain_yy", "-"), ("stress_ratio_largest", "-"), ("fabric_anisotropy_1", "-"), ("step", "-"),
        ("displacement_top_x", "m"), ("reaction_top_y", "N/m"), ("reaction_total_x", "N/m"), ("spring_wall_x", "N/m"),
        ("reaction_top_moment", "N m/m"), ("reaction_total_moment", "N m/m"),
        ("rigid_footing_displacement_y", "m"), ("rigid_footing_rotation", "rad"), ("rigid_footing_force_y", "N/m"),
        ("rigid_footing_moment", "N m/m"), ("load_factor", "-"),
        ("region_upper_stress_xx", "Pa"), ("region_upper_p", "Pa"), ("region_upper_coordination", "-"),
        ("region_upper_strain_xx", "-"), ("pore_pressure_smallest", "Pa"), ("effective_p", "Pa"),
        # names of boundaries and regions that sound like columns
        ("reaction_stress_xx_x", "N/m"), ("displacement_moment_x", "m"), ("region_displacement_x_coordination", "-"),
        ("region_rotation_q", "Pa"), ("rigid_p_rotation", "rad"), ("displacement_rigid_a_rotation_y", "m"),
    ],
)  # fmt: skip
def test_of_each_kind_of_column(name: str, said: str) -> None:
    assert unit(name) == said


@pytest.mark.parametrize("scene", ["tunnel", "rigid_footing", "undrained_biaxial"])
def test_no_column_of_a_field_with_a_unit_is_passed_over(scene: str) -> None:
    """What has none is a count, a ratio or a strain: told by the last words of its name."""
    ready = prepare(load(scene))
    problem = ready.problem
    names = FieldHistory(
        problem.space, problem.law.description, ready.boundaries, ready.supported, problem.program
    ).names
    bare = ("strain_xx", "strain_yy", "strain_xy", "coordination", "_smallest", "_largest", "fabric_anisotropy")
    counts = {"step", "stage", "fraction", "iterations", "factorisations", "cuts", "substeps", "limited_points"}
    for name, said in units(names).items():
        assert (said == "-") == ((name.endswith(bare) and not name.startswith("pore")) or name in counts), name


def test_of_points_and_disks() -> None:
    energies = {"elastic_energy", "work", "friction_heat", "drag_heat"}
    assert {name: said for name, said in units(HISTORY_COLUMNS).items() if said != "-"} == {
        **dict.fromkeys(PASCAL, "Pa"), **dict.fromkeys(energies, "J/m"),
    }  # fmt: skip
    assert set(units(PORE_COLUMNS).values()) == {"Pa"}
    assert units(SLIDING_COLUMNS) == {
        "plastic_shear_strain": "-", "plastic_volumetric_strain": "-", "plastic_dissipation": "Pa",
    }  # fmt: skip


def test_of_specimens() -> None:
    forces, energies = {"upper_force", "lower_force", "upper_shear", "lower_shear"}, {"friction_heat", "drag_heat"}
    energies |= {name for name in COLUMNS if name.endswith(("_energy", "_work", "_error"))}
    assert {name: said for name, said in units(COLUMNS).items() if said != "-"} == {
        "height": "m", "width": "m", "axial_stress": "Pa", **dict.fromkeys(forces, "N/m"),
        **dict.fromkeys(energies, "J/m"),
    }  # fmt: skip


def test_state_variables_have_the_unit_that_the_law_declares() -> None:
    everything = Effects(**dict.fromkeys(Effects.names(), True))
    declared = {variable.name: variable.unit for variable in state_variables(everything, True, True)}
    assert "Pa" in declared.values() and units(declared) == declared


def test_a_point_run_lists_them(granfabric: Callable, tmp_path: Path) -> None:
    arguments = ("--set", "path.0.increments=2", "--set", "output.pictures=false", "-o", tmp_path / "out")
    assert granfabric("point", "p_constant", *arguments).code == 0
    told = json.loads((tmp_path / "out" / "run.json").read_text())["columns"]
    heads = (tmp_path / "out" / "history.csv").read_text().split("\n")[0].split(",")
    assert list(told) == heads and {name for name, said in told.items() if said == "Pa"} == PASCAL


@pytest.mark.parametrize(
    ("name", "value", "label", "shown"),
    [
        ("reaction_top_moment", 2e3, "reaction of top moment [kN m/m]", 2.0),
        ("reaction_top_y", -2e3, "minus reaction of top y [kN/m]", 2.0),
        ("spring_wall_x", 2e3, "spring of wall x [kN/m]", 2.0),
        ("rigid_crest_force_x", -3e3, "minus force x of body crest [kN/m]", 3.0),
        ("rigid_crest_rotation", 1e-6, "rotation of body crest [$10^{-6}$ rad]", 1.0),
        ("region_upper_p", 5e3, "region upper p [kPa]", 5.0),
        ("region_upper_strain_xx", 1e-6, "region upper strain xx [$10^{-6}$]", 1.0),
        ("stress_ratio_largest", 0.3, "stress ratio largest [-]", 0.3),
        ("coordination", 4.0, "coordination [-]", 4.0),
        ("displacement_top_x", 1e-6, "displacement of top x [$10^{-6}$ m]", 1.0),
    ],
)
def test_labels_of_curves_have_the_handy_unit(name: str, value: float, label: str, shown: float) -> None:
    values, said = _named(name, np.array([0.0, value]))
    assert said == label and values[1] == pytest.approx(shown)

"""`granfabric measure`: from a packing of another code to a material file; preparation in DEM scenes."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.commands import measure as command
from granfabric.cases.records import files
from granfabric.cases.scene.measured import measure_inputs
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.exchange.files import save_packing
from granfabric.dem_ref.inputs.probes import ProbeError
from granfabric.dem_ref.measures.contacts import contacts_of, coordination_number
from granfabric.dem_ref.preparation.compaction import PackingOptions
from granfabric.dem_ref.preparation.compaction import make_packing as make_prepared_packing
from granfabric.dem_ref.sample.disks import Sample, load_sample

LAW = ("--normal-stiffness", "1e9", "--stiffness-ratio", "1", "--friction", "0.5")
SHEARED = Path(__file__).parents[1] / "dem_ref" / "packings" / "sheared.dump"


@pytest.fixture(scope="module")
def sample() -> Sample:
    return make_packing(300, 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, sample: Sample) -> Path:
    """`packing.data` and `packing.dump` as another code would leave them: stiffness and friction are not in there."""
    place = tmp_path_factory.mktemp("measure")
    save_packing(place / "packing.csv", sample, contacts=place / "contacts.csv")
    save_packing(place / "packing.dump", sample, contacts=place / "contacts.local")
    save_packing(place / "packing.data", sample)
    text = (place / "packing.data").read_text()
    (place / "packing.data").write_text("LAMMPS data file\n" + text.partition("\n")[2])
    return place


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())


@pytest.fixture(scope="module")
def measured(folder: Path, sample: Sample) -> dict[str, float]:
    return measure_inputs(sample).values


def test_the_material_of_a_data_file_is_that_of_the_packing(
    granfabric: Callable, folder: Path, tmp_path: Path, measured: dict[str, float], is_drawn: Callable
) -> None:
    out = tmp_path / "out"
    result = granfabric("measure", folder / "packing.data", *LAW, "-o", out)
    assert result.code == 0, result.err
    assert "tangential forces are unknown and taken as zero" in result.out
    assert f"--set material_file={out / 'material.toml'}" in result.out
    pictures = {"packing.png", "distributions.png"}
    assert {file.name for file in out.iterdir()} == {"run.json", "run.log", "packing.npz", "material.toml", *pictures}
    assert all(is_drawn(out / name) for name in pictures)
    tables = tomllib.loads((out / "material.toml").read_text())
    found = {**tables["material"], **tables["closure"]}
    for name, value in measured.items():
        assert found[name] == value, name  # every digit went through the file
    told = record(out)
    assert told["kind"] == "measure" and told["outcome"] == "finished" and told["packing"]["particles"] == 300
    assert told["measured"]["coordination"]["standard_error"] > 0.0
    # pictures once more, and the packing that was measured
    (out / "packing.png").unlink()
    assert granfabric("plot", out).code == 0 and is_drawn(out / "packing.png")
    assert load_sample(out / "packing.npz").count == 300
    # what was left is read by a point and by a field
    quick = ("--set", "output.pictures=false")
    given = ("--set", f"material_file={out / 'material.toml'}")
    assert granfabric("point", "p_constant", *given, *quick, "-o", tmp_path / "point").code == 0
    mesh = "mesh.rectangle={width=1.0,height=2.0,nx=3,ny=6}"
    coarse = ("--set", "mesh.element=P1", "--set", "stage.1.increments=1", "--set", mesh)
    result = granfabric("run", "biaxial_smooth", *given, *quick, *coarse, "-o", tmp_path / "field")
    assert result.code == 0, result.err
    assert record(tmp_path / "field")["scene"]["material"]["coordination"] == measured["coordination"]


@pytest.mark.slow
def test_the_material_works_in_the_main_example(granfabric: Callable, folder: Path, tmp_path: Path) -> None:
    assert granfabric("measure", folder / "packing.csv", "-o", tmp_path / "m").code == 0
    given = ("--set", f"material_file={tmp_path / 'm' / 'material.toml'}", "--set", "output.pictures=false")
    assert granfabric("run", "biaxial", *given, "-o", tmp_path / "out").code == 0


def test_contacts_with_forces_and_counting(granfabric: Callable, folder: Path, tmp_path: Path, sample: Sample) -> None:
    """A dump with its contacts: the stiffness follows from forces; rattlers are left out if asked for."""
    result = granfabric(
        *("measure", folder / "packing.dump", "--contacts", folder / "contacts.local", "--stiffness-ratio", "1"),
        *("--friction", "0.5", "--rattlers", "excluded", "-o", tmp_path / "out"),
    )
    assert result.code == 0, result.err
    assert "follows from forces and overlaps" in result.out and "tangential forces are unknown" not in result.out
    material = tomllib.loads((tmp_path / "out" / "material.toml").read_text())["material"]
    assert material["normal_stiffness"] == pytest.approx(1e9, rel=1e-9)
    assert material["coordination"] == coordination_number(sample).without_rattlers


def test_a_loose_packing_keeps_its_tangential_forces(granfabric: Callable, tmp_path: Path) -> None:
    """With its contacts it is at rest; without them it is settled first, and that is said."""
    loose = make_prepared_packing(150, 1, PackingOptions(preparation_friction=0.4))
    save_packing(tmp_path / "loose.csv", loose, contacts=tmp_path / "contacts.csv")
    undrawn = ("-o", tmp_path / "with")
    result = granfabric("measure", tmp_path / "loose.csv", "--contacts", tmp_path / "contacts.csv", *undrawn)
    assert result.code == 0, result.err
    assert "not at rest" not in result.out
    kept = load_sample(tmp_path / "with" / "packing.npz")
    np.testing.assert_array_equal(contacts_of(kept).tangential_force, contacts_of(loose).tangential_force)


BAD = [
    (("packing.data",), ["normal_stiffness, stiffness_ratio and friction", "cannot be read off disks"]),
    (("packing.data", "--friction", "0.5"), ["normal_stiffness and stiffness_ratio"]),
    (("packing.data", *LAW, "--stiffness-ratio", "2"), ["stiffness_ratio is 2.0", "0 < kt/kn <= 1"]),
    (("packing.data", *LAW, "--cell", "1 2 3"), ["--cell '1 2 3'", "a_x a_y b_x b_y"]),
    (("packing.data", *LAW, "--cell", "1500 1500"), ["no packing under pressure", "% of the cell", "cell too large"]),
    (("packing.data", *LAW, "--format", "vtk"), ["format = 'vtk'", "lammps_data"]),
    (("packing.data", *LAW, "--rattlers", "some"), ["--rattlers 'some'", "included and excluded"]),
    (("packing.data", *LAW, "--loop-stress-ratio", "0.7"), ["--loop-stress-ratio 0.7", "(0, 0.5]"]),
    (("none.data", *LAW), ["none.data: no such file"]),
    (("packing.dump", *LAW, "--step", "3"), ["no time step 3; it holds 0"]),
    (("packing.csv", "--contacts", "packing.csv"), ["no column id1 and id2"]),
]


@pytest.mark.parametrize(("arguments", "parts"), BAD, ids=[" ".join(bad[0])[-40:] for bad in BAD])
def test_bad_input_is_one_sentence_and_leaves_nothing(
    granfabric: Callable, folder: Path, tmp_path: Path, arguments: tuple[str, ...], parts: list[str]
) -> None:
    placed = [folder / word if Path(word).suffix in (".data", ".csv", ".dump") else word for word in arguments]
    result = granfabric("measure", *placed, "-o", tmp_path / "out")
    assert result.code == 2 and result.err.startswith("granfabric: ") and result.err.count("\n") == 1
    for part in parts:
        assert part in result.err
    assert not (tmp_path / "out").exists()


def test_a_packing_under_shear_is_refused(granfabric: Callable, tmp_path: Path) -> None:
    law = ("--normal-stiffness", "1e4", "--stiffness-ratio", "0.5", "--friction", "0.4")
    result = granfabric("measure", SHEARED, *law, "-o", tmp_path / "out")
    assert result.code == 2 and "isotropic packing" in result.err and "tangential forces were not given" in result.err
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_finished_is_exit_code_1(
    granfabric: Callable, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refusing(*arguments: object) -> object:
        raise ProbeError("the probe did not settle")

    monkeypatch.setattr(command, "measure_inputs", refusing)
    result = granfabric("measure", folder / "packing.csv", "-o", tmp_path / "out")
    assert result.code == 1 and "failed: the probe did not settle" in result.out
    told = record(tmp_path / "out")
    assert told["outcome"] == "failed" and (tmp_path / "out" / "packing.npz").is_file()


def test_results_of_another_packing_stay(granfabric: Callable, folder: Path, tmp_path: Path) -> None:
    """The folder of a packing is replaced by the same packing's, by another's only if asked for."""
    shutil_copy = tmp_path / "other.csv"
    shutil_copy.write_bytes((folder / "packing.csv").read_bytes())
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    result = granfabric("measure", folder / "packing.csv", "-o", out)
    assert result.code == 2 and "holds files that are not a result" in result.err
    (out / "notes.txt").unlink()
    earlier = {"kind": "measure", "name": "packing", "scene_file": str(folder / "packing.csv")}
    files.write_json(out / "run.json", {"program": "granfabric", **earlier})
    result = granfabric("measure", shutil_copy, "-o", out)
    assert result.code == 2 and "another scene" in result.err and "--overwrite" in result.err


# preparation in scenes

SCENE = """
title = "prepared"
[packing]
particles = 100
{packing}
[[path]]
loading = "constant_pressure"
stress_ratio = 0.02
[measure]
material = false
rattlers = "excluded"
[output]
pictures = false
every = 0
"""


def scene(folder: Path, packing: str) -> Path:
    file = folder / "prepared.toml"
    file.write_text(SCENE.format(packing=packing))
    return file


def test_a_scene_prepares_its_packing_and_tells_how(granfabric: Callable, tmp_path: Path) -> None:
    (tmp_path / "sizes.csv").write_text("size,passing_by_mass\n1e-3,0\n2e-3,100\n")
    keys = 'coordination = 3.7\ndistribution = "given"\ngrading_file = "sizes.csv"'
    result = granfabric("dem", scene(tmp_path, keys), "-o", tmp_path / "out")
    assert result.code == 0, result.err
    told = record(tmp_path / "out")
    made = told["preparation"]
    assert told["packing"]["coordination_without_rattlers"] == pytest.approx(3.7, abs=0.07)
    assert f"compacted with friction {made['friction']:.4g}, found in {len(made['trials'])} compactions" in result.out
    assert made["diameters"]["smallest"] >= 1e-3 and made["diameters"]["largest"] <= 2e-3
    assert made["grading_departure"] < 0.02 and "pass 10, 50 and 90 % of the area" in result.out
    assert Path(told["scene"]["packing"]["grading_file"]) == (tmp_path / "sizes.csv").resolve()
    # the scene as resolved is the same scene, from wherever it is run
    again = granfabric("dem", tmp_path / "out" / "scene.toml", "-o", tmp_path / "again")
    assert again.code == 0, again.err
    one, other = (load_sample(tmp_path / name / "packing.npz") for name in ("out", "again"))
    np.testing.assert_array_equal(one.position, other.position)
    resumed = granfabric("dem", scene(tmp_path, keys), "-o", tmp_path / "out", "--resume")
    assert resumed.code == 0 and record(tmp_path / "out")["preparation"] == made


@pytest.mark.parametrize(
    ("packing", "parts"),
    [
        ("preparation_friction = 0.7", ["preparation_friction = 0.7 is above friction = 0.5", "falls together"]),
        ("coordination = 3.5\nsolid_fraction = 0.82", ["coordination and solid_fraction are given"]),
        ("coordination = 9.0", ["packing.coordination = 9.0", "[2.5, 5]"]),
        ('distribution = "given"', ["needs grading_file"]),
        ('grading_file = "a.csv"', ["goes with distribution = 'given'"]),
        ('distribution = "given"\ngrading_file = "a.csv"\nmean_diameter = 0.01', ["mean_diameter follows from"]),
        ('distribution = "given"\ngrading_file = "none.csv"', ["none.csv: no such file"]),
        ('distribution = "log-normal"', ["'lognormal'"]),
        ("size_deviation = 0.3", ["goes with distribution = 'lognormal'"]),
    ],
)
def test_preparations_that_do_not_go_together(
    granfabric: Callable, tmp_path: Path, packing: str, parts: list[str]
) -> None:
    result = granfabric("dem", scene(tmp_path, packing), "-o", tmp_path / "out")
    assert result.code == 2 and result.err.count("\n") == 1
    for part in parts:
        assert part in result.err
    assert not (tmp_path / "out").exists()


def test_a_coordination_that_no_friction_gives_ends_the_run_with_what_there_is(
    granfabric: Callable, tmp_path: Path
) -> None:
    result = granfabric("dem", scene(tmp_path, "coordination = 4.9"), "-o", tmp_path / "out")
    assert result.code == 1 and "coordination = 4.9 is above" in result.out
    assert record(tmp_path / "out")["outcome"] == "failed"

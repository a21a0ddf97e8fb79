"""The DEM at its limits, as a user meets it: lost pressure, few disks, restless packings, legs from their start."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.commands import dem, verify
from granfabric.cases.cost.grains import GrainStore
from granfabric.cases.cost.study import StudyError
from granfabric.cases.records import files
from granfabric.cases.scene.material_file import material_text, read_material, refusal
from granfabric.cases.scene.measured import Inputs, as_data, bounds, from_data, mean_of, refused, remarks, warnings
from granfabric.cases.scene.reader import load
from granfabric.cases.terminal.screen import Screen
from granfabric.cases.verify import dem_side as verify_dem
from granfabric.cases.verify.dem_side import DemStore, RunGivenUpError
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Material
from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.inputs.material import measure_material
from granfabric.dem_ref.inputs.sliding import SLIDING_KEYS, measure_sliding_with_errors
from granfabric.dem_ref.loading.path import Segment
from granfabric.dem_ref.loading.run import RunOptions
from granfabric.dem_ref.loading.servo import RateLimits
from granfabric.dem_ref.measures.contacts import unbalanced_force
from granfabric.dem_ref.sample.disks import load_sample, save_sample

HEAD = 'title = "t"\nkind = "dem"\n[packing]\nparticles = 100\n'
QUIET = "[output]\npictures = false\nevery = 0\n[measure]\nmaterial = false\n"
FAST = "[rates]\ninertial_number = 1e-3\nunbalanced_force = 1e-2\n"
EXPANSION = (
    '[[path]]\nloading = "components"\ncontrol = ["strain", "strain", "strain"]\ntarget = [5e-4, 5e-4, 0.0]\n'
)


def written(folder: Path, *parts: str) -> Path:
    file = folder / "scene.toml"
    file.write_text("".join(parts))
    return file


def record(folder: Path) -> dict:
    return json.loads((folder / "run.json").read_text())


def columns(folder: Path) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def test_expansion_stops_with_a_sentence_and_keeps_what_was_reached(granfabric: Callable, tmp_path: Path) -> None:
    """At the usual rate; the leg after it is not begun, and is not what the sentence names."""
    scene = written(tmp_path, HEAD, QUIET, '[[path]]\nloading = "isotropic"\npressure_ratio = 1.1\n', EXPANSION * 2)
    out = tmp_path / "out"
    result = granfabric("dem", scene, "-o", out)
    assert result.code == 1
    assert "failed: leg 2: the sample has lost its pressure: p = " in result.out
    told = record(out)
    assert told["outcome"] == "failed" and told["message"].startswith("leg 2: the sample has lost its pressure")
    assert {"history.csv", "packing.npz", "checkpoint.npz"} <= {file.name for file in out.iterdir()}
    h = columns(out)
    assert len(h["p"]) > 50 and h["p"][-1] < 1e-3 * h["p"][0] <= h["p"][-2] * 2.0
    # going on with it says the same
    again = granfabric("dem", scene, "-o", out, "--resume")
    assert again.code == 1 and "leg 2: the sample has lost its pressure" in again.out
    assert np.array_equal(columns(out)["p"], h["p"])


def test_nothing_is_left_at_all_and_is_drawn(granfabric: Callable, tmp_path: Path, is_drawn: Callable) -> None:
    """So fast that no contact is left after the first chunk: q/p is no number, everything else is."""
    fast = "[rates]\ninertial_number = 0.1\nunbalanced_force = 1.0\n"
    scene = written(tmp_path, HEAD, EXPANSION, fast, "[measure]\nmaterial = false\n[output]\nevery = 1\n")
    out = tmp_path / "out"
    result = granfabric("dem", scene, "-o", out)
    assert result.code == 1 and "p = 0 Pa of" in result.out and not result.err
    h = columns(out)
    assert h["p"][-1] == 0.0 and h["coordination"][-1] == 0.0
    assert all(np.isfinite(column).all() for column in h.values())
    assert all(is_drawn(out / name) for name in ("packing.png", "overview.png", "distributions.png"))
    assert granfabric("dem", scene, "-o", out, "--resume").code == 1
    assert granfabric("plot", out).code == 0


@pytest.mark.parametrize(
    ("leg", "words"),
    [
        ('loading = "isotropic"\npressure_ratio = 1e-8\n', "has lost its pressure"),
        ('loading = "constant_lateral_stress"\nstress_ratio = -0.95\nlargest_strain = 0.005\n', "instead of -0.95"),
        ('loading = "invariants"\nstress_ratio = 0.9\n', "cannot carry"),
        (
            'loading = "components"\ncontrol = ["stress", "strain", "stress"]\ntarget = [-1e5, 0.0, 2e5]\n',
            "cannot carry",
        ),
    ],
)
def test_whatever_cannot_be_followed_ends_with_words(
    granfabric: Callable, tmp_path: Path, leg: str, words: str
) -> None:
    scene = written(tmp_path, HEAD, QUIET, FAST, "[[path]]\n", leg)
    result = granfabric("dem", scene, "-o", tmp_path / "out")
    told = record(tmp_path / "out")
    assert words in result.out and words in told["message"] + " ".join(told["not_reached"])
    # a leg that is driven by strain has its end there, and says what it has not reached
    assert result.code == (0 if "instead" in words else 1)


@pytest.mark.parametrize("value", ["0.0", "1e4"])
def test_a_stress_that_pulls_is_refused_beforehand(granfabric: Callable, tmp_path: Path, value: str) -> None:
    leg = f'[[path]]\nloading = "components"\ncontrol = ["stress", "strain", "strain"]\ntarget = [{value}, 0.0, 0.0]\n'
    result = granfabric("dem", written(tmp_path, HEAD, leg), "-o", tmp_path / "out")
    assert result.code == 2 and "would lose its pressure" in result.err and not (tmp_path / "out").exists()


def test_legs_are_counted_as_the_user_counts_them(granfabric: Callable, tmp_path: Path) -> None:
    """A rotation of 90 degrees has two segments."""
    legs = (
        '[[path]]\nloading = "invariants"\nstress_ratio = 0.1\n'
        '[[path]]\nloading = "rotation"\nrotation_degrees = 90.0\n'
    )
    result = granfabric("dem", written(tmp_path, HEAD, QUIET, FAST, legs, EXPANSION), "-o", tmp_path / "out")
    assert result.code == 1 and "failed: leg 3: the sample has lost its pressure" in result.out


TINY = ("weak_contact_ratio", "force_density_at_zero")
"""Inputs that come out negative on one packing of 50 disks in ten."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, float, Path]]:
    """For each of `TINY` the first seed on which it is negative, the value, and the folder of such a run."""
    folder = tmp_path_factory.mktemp("tiny")
    short = '[[path]]\nloading = "constant_pressure"\nstress_ratio = 0.02\n[output]\npictures = false\nevery = 0\n'
    scene = written(folder, HEAD, short)
    found = {}
    for name in TINY:
        for seed in range(1, 50):
            value = measure_material(make_packing(50, seed))[name]
            if value < 0.0:
                break
        loaded = load(str(scene), ["packing.particles=50", f"packing.seed={seed}"])
        assert dem.run_dem(loaded, folder / name, Screen()).outcome == "finished"
        found[name] = (seed, value, folder / name)
    return found


@pytest.mark.parametrize("key", ["closure.weak_contact_ratio", "material.force_density_at_zero"])
def test_values_out_of_bounds_are_marked_told_and_refused_by_name(
    tiny: dict[str, tuple[int, float, Path]], granfabric: Callable, tmp_path: Path, key: str
) -> None:
    section, name = key.split(".")
    _, measured, folder = tiny[name]
    file = folder / "material.toml"
    value = tomllib.loads(file.read_text())[section][name]
    assert value == pytest.approx(measured, rel=1e-6)
    (line,) = [line for line in file.read_text().splitlines() if line.startswith(name + " ")]
    assert "+-" in line and "outside the bounds [0, " in line and "its error is larger than itself" in line
    entry = record(folder)["measured"][name]
    assert entry["value"] == value and entry["standard_error"] > abs(value)
    assert any("outside the bounds" in remark for remark in entry["remarks"])
    result = granfabric("point", "p_constant", "--set", f"material_file={file}", "-o", tmp_path / "out")
    assert result.code == 2 and not (tmp_path / "out").exists()
    assert result.err.startswith(f"granfabric: {file}: ") and f"{key} = {value!r}" in result.err
    assert "p_constant.toml" not in result.err


def test_the_command_says_it_in_one_line_each_and_counts_them_in_its_last(
    tiny: dict[str, tuple[int, float, Path]], granfabric: Callable, tmp_path: Path
) -> None:
    small = ("--set", "packing.particles=50", "--set", f"packing.seed={tiny['weak_contact_ratio'][0]}")
    short = '[[path]]\nloading = "constant_pressure"\nstress_ratio = 0.02\n[output]\npictures = false\nevery = 0\n'
    result = granfabric("dem", written(tmp_path, HEAD, short), "-o", tmp_path, *small)
    assert result.code == 2  # the folder holds the scene: not ours
    result = granfabric("dem", tmp_path / "scene.toml", "-o", tmp_path / "out", *small)
    lines = result.out.splitlines()
    told = [line for line in lines if line.startswith("material.toml: ")]
    named = record(tmp_path / "out")["measured"]
    doubtful = [name for name, entry in named.items() if "remarks" in entry]
    assert len(told) == len(doubtful) > 2
    assert {line.split()[1] for line in told} == set(doubtful)
    # those that matter most are seen last
    illegal = [name for name in doubtful if any("outside the bounds" in remark for remark in named[name]["remarks"])]
    assert [line.split()[1] for line in told[-len(illegal) :]] == illegal and "weak_contact_ratio" in illegal
    assert lines[-1].endswith(f"; {len(told)} warnings on material.toml, the law will refuse {', '.join(illegal)}")


@pytest.mark.parametrize("name", sorted({variable.name for variable in Material.variables()} | set(CLOSURE_NUMBERS)))
@pytest.mark.parametrize("side", [0, 1])
def test_every_number_out_of_bounds_names_the_material_file(
    granfabric: Callable, tmp_path: Path, name: str, side: int
) -> None:
    """Whatever the number, at either end, one material or several."""
    low, high = bounds()[name]
    value = low - 1.0 - abs(low) if side == 0 else 2.0 * high + 1.0
    section = "closure" if name in CLOSURE_NUMBERS else "material"
    inputs = Inputs({"coordination": 4.0, "solid_fraction": 0.84, "normal_stiffness": 1e9, name: value}, {name: 0.1})
    assert refused(inputs) == [name] and "outside the bounds" in remarks(inputs)[name][0]
    file = tmp_path / "measured.toml"
    file.write_text(material_text(inputs.values, "nothing", inputs.errors))
    if not math.isfinite(value):
        return
    assert read_material(file)[section][name] == value
    result = granfabric("point", "p_constant", "--set", f"material_file={file}", "-o", tmp_path / "out")
    assert result.code == 2 and result.err.startswith(f"granfabric: {file}: {section}.{name} = ")


def test_values_that_do_not_go_together_name_the_material_file(granfabric: Callable, tmp_path: Path) -> None:
    file = tmp_path / "measured.toml"
    values = {
        "coordination": 4.0, "solid_fraction": 0.84, "normal_stiffness": 1e9, "isostatic_coordination": 4.5
    }  # fmt: skip
    file.write_text(material_text(values, "nothing"))
    words = ("--set", "closure.shear_stiffness=isostatic", "-o", tmp_path / "out")
    result = granfabric("point", "p_constant", "--set", f"material_file={file}", *words)
    assert result.code == 2
    assert result.err.startswith(f"granfabric: {file}: material.isostatic_coordination = 4.5 is not below")
    back = {"peak_stress_ratio": 0.4, "dilatancy": 3.0, "constant_volume_stress_ratio": 0.1}
    assert "give back work" in refusal(values | back) and refusal({**values, "peak_stress_ratio": 0.4}) == ""


def test_remarks_of_made_up_inputs() -> None:
    inputs = Inputs(
        {"coordination": 3.9, "slip": 0.2, "gap_density_at_zero": 0.0, "initial_fabric_xx": 0.01, "neighbours": 6.0,
         "fluctuation": 0.3, "isostatic_coordination": -0.06},
        {"coordination": 0.1, "slip": 0.3, "gap_density_at_zero": 2.0, "initial_fabric_xx": 0.03, "neighbours": 0.0,
         "fluctuation": math.nan, "isostatic_coordination": 0.01},
        ("weak_contact_ratio",),
    )  # fmt: skip
    said = remarks(inputs)
    assert set(said) == {"slip", "gap_density_at_zero", "fluctuation", "isostatic_coordination", "weak_contact_ratio"}
    assert said["isostatic_coordination"] == ["outside the bounds [0, 5] of the law, which will refuse it"]
    assert warnings(inputs)[0] == "slip = 0.2 +- 0.3: its error is larger than itself"
    assert warnings(inputs)[-1].startswith("isostatic_coordination = -0.06 +- 0.01: outside the bounds")
    assert from_data(json.loads(json.dumps(as_data(inputs)))).missing == inputs.missing
    read = from_data(as_data(inputs))
    assert read.values == inputs.values and read.errors["slip"] == 0.3 and math.isnan(read.errors["fluctuation"])
    text = material_text(inputs.values, "made up", inputs.errors, inputs.missing)
    assert "# weak_contact_ratio could not be measured on this packing" in text
    assert "slip = 0.2  # +- 0.3; its error is larger than itself" in text and "neighbours = 6.0\n" in text
    assert tomllib.loads(text)["closure"]["slip"] == 0.2
    assert from_data("damaged").values == {} and from_data({"slip": 3}).values == {}


def test_the_mean_of_packings_has_the_error_of_their_scatter() -> None:
    found = [
        Inputs({"slip": value, "fluctuation": 0.3}, {"slip": 0.5, "fluctuation": 0.1}) for value in (1.0, 2.0, 3.0)
    ]
    found[0] = Inputs({"slip": 1.0}, {"slip": 0.5}, ("fluctuation",))
    mean = mean_of(found)
    assert mean.values["slip"] == pytest.approx(2.0) and mean.errors["slip"] == pytest.approx(1.0 / math.sqrt(3))
    assert mean.values["fluctuation"] == pytest.approx(0.3) and mean.missing == ()
    assert mean_of(found[1:2]).errors["slip"] == 0.5


def loading_beyond_the_peak(noise: float) -> dict[str, np.ndarray]:
    """A history with known hardening and dilatancy, and stress drops on the plateau."""
    random = np.random.default_rng(1)
    gamma = np.concatenate([np.linspace(0.0, 1.0, 2001) ** 3 * 1e-3, np.linspace(1e-3, 1e-2, 2000)[1:]])
    grid = 1.0 - np.logspace(0, -6, 20000)
    ratio = 0.4 * np.interp(gamma / 5e-5, grid**2 / (1.0 - grid), grid)
    drops = np.repeat(random.normal(size=400), 10)[: len(gamma)]
    ratio = ratio * (1.0 + noise * np.where(gamma > 1e-3, drops, 0.0))
    p = np.full_like(ratio, 1e5)
    z = 3.9 - 0.85 * gamma / (gamma + 2e-4)
    dilation = np.concatenate([[0.0], np.cumsum(1.1 * (0.5 * (ratio[1:] + ratio[:-1]) - 0.15) * np.diff(gamma))])
    return {
        "strain_xx": 0.5 * (dilation + gamma), "strain_yy": 0.5 * (dilation - gamma), "strain_xy": 0.0 * gamma,
        "stress_xx": -p * (1 - ratio), "stress_yy": -p * (1 + ratio), "stress_xy": 0.0 * p, "p": p, "q": ratio * p,
        "coordination": z, "coordination_without_rattlers": z,
    }  # fmt: skip


def test_parameters_of_sliding_have_errors() -> None:
    """They grow with the scatter of the plateau, and what is chosen has none."""
    measured = {
        "solid_fraction": 0.846, "normal_stiffness": 1e15, "stiffness_ratio": 1.0, "bulk_reduction": 0.88,
        "shear_reduction": 0.69, "isostatic_coordination": 2.65,
    }  # fmt: skip
    calm, rough = (measure_sliding_with_errors(loading_beyond_the_peak(noise), measured)[0] for noise in (0.02, 0.2))
    assert tuple(calm) == SLIDING_KEYS
    assert calm["first_yield_stress_ratio"].error == calm["hardening_exponent"].error == 0.0
    # twenty independent values in each window; a window at the rise beside them
    assert calm["peak_stress_ratio"].error < 0.02 * 0.4
    assert 0.5 < rough["peak_stress_ratio"].error / (0.2 * 0.4 / math.sqrt(20)) < 2.0
    for name, wanted in (("dilatancy", 1.1), ("constant_volume_stress_ratio", 0.15)):
        for found in (calm, rough):
            assert abs(found[name].value - wanted) <= 3.0 * found[name].error + 1e-6, name


def test_a_restless_packing_is_settled_before_it_is_measured(granfabric: Callable, tmp_path: Path) -> None:
    """Measured as it is, an unbalanced force of 0.1 gives c_t = 1.2 instead of 0.77."""
    short = '[[path]]\nloading = "constant_pressure"\nstress_ratio = 0.02\n[output]\npictures = false\nevery = 0\n'
    scene = written(tmp_path, HEAD, short)
    out = tmp_path / "out"
    size = ("--set", "packing.particles=300")
    assert granfabric("dem", scene, "-o", out, *size).code == 0
    calm = read_material(out / "material.toml")
    assert "settled_from_unbalanced_force" not in record(out)
    packing = load_sample(out / "packing.npz")
    packing.position += 3e-6 * np.random.default_rng(3).normal(size=packing.position.shape)
    save_sample(out / "packing.npz", packing)
    assert unbalanced_force(packing) > 0.05
    for name in ("material.toml", "checkpoint.npz"):
        (out / name).unlink()
    result = granfabric("dem", scene, "-o", out, *size, "--resume")
    assert result.code == 0 and "the packing is not at rest (unbalanced force 0." in result.out
    told = record(out)
    assert told["settled_from_unbalanced_force"] == pytest.approx(unbalanced_force(packing))
    assert told["packing"]["unbalanced_force"] < 1e-5
    found = read_material(out / "material.toml")
    ratio = found["closure"]["tangential_force_ratio"]
    assert ratio == pytest.approx(calm["closure"]["tangential_force_ratio"], abs=0.02)
    # what is measured and what is loaded is the same packing
    assert columns(out)["coordination"][0] == found["material"]["coordination"]


def test_a_packing_that_fell_apart_is_refused(granfabric: Callable, tmp_path: Path) -> None:
    scene = written(tmp_path, HEAD, '[[path]]\nloading = "constant_pressure"\nstress_ratio = 0.02\n')
    out = tmp_path / "out"
    assert granfabric("dem", scene, "-o", out, "--set", "output.pictures=false").code == 0
    packing = load_sample(out / "packing.npz")
    packing.position *= 1.01
    packing.cell *= 1.01
    save_sample(out / "packing.npz", packing)
    (out / "material.toml").unlink()
    (out / "checkpoint.npz").unlink()
    result = granfabric("dem", scene, "-o", out, "--set", "output.pictures=false", "--resume")
    assert result.code == 1 and "has no pressure" in result.out
    assert not (out / "material.toml").exists()


def expanding(*_: object) -> RunOptions:
    strain = ("strain", "strain", "strain")
    return RunOptions((Segment("mixed", control=strain, target=(5e-4, 5e-4, 0.0)),), limits=RateLimits(1e-3, 1e-2))


def test_verify_tells_which_packing_lost_its_pressure(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verify_dem, "loading_options", expanding)
    result = granfabric("verify", "--particles", "200", "-o", tmp_path)
    assert result.code == 1
    assert "packing of 200 disks, seed 1, mean pressure constant: the sample has lost its pressure" in result.out
    assert record(tmp_path)["outcome"] == "failed"
    # what was reached is there, and asking again does not compute it again, nor hide it
    (history,) = (tmp_path / "dem").glob("*constant_pressure.csv")
    assert len(history.read_text().splitlines()) > 10
    with pytest.raises(RunGivenUpError, match="lost its pressure"):
        DemStore(tmp_path / "dem", 200).complete(1, lambda text, fraction: None, lambda: False)


def test_a_study_of_cost_tells_too(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="100 disks, seed 1, expansion: the sample has lost its pressure"):
        GrainStore(tmp_path).run(100, 1, "expansion", expanding(), lambda text: None)


def test_stored_packings_that_are_not_at_rest_are_made_anew(tmp_path: Path) -> None:
    store = GrainStore(tmp_path)
    first = store.packing(100, 1, lambda text: None)[0]
    (file,) = tmp_path.glob("*.npz")
    moved = first.copy()
    moved.position += 1e-6 * np.random.default_rng(1).normal(size=moved.position.shape)
    save_sample(file, moved)
    assert np.array_equal(store.packing(100, 1, lambda text: None)[0].position, first.position)
    kept = DemStore(tmp_path / "dem", 100)
    packing = kept._packing(1, {"seconds": {}}, lambda text, fraction: None, lambda: False)
    save_sample(kept.path(1, "packing.npz"), moved)
    again = kept._packing(1, {"seconds": {}}, lambda text, fraction: None, lambda: False)
    assert np.array_equal(again.position, packing.position)


def test_words_of_verify_are_about_errors_that_it_catches() -> None:
    """Whatever ends the DEM with a sentence ends `verify` with it."""
    assert RunGivenUpError in verify.DEM_ERRORS


def test_undrained_shear_of_disks_after_consolidation(granfabric: Callable, tmp_path: Path) -> None:
    first = '[[path]]\nloading = "isotropic"\npressure_ratio = 2.0\n'
    shear = (
        '[[path]]\nloading = "components"\ncontrol = ["strain", "strain", "strain"]\n'
        "target = [4e-5, -4e-5, 0.0]\nrelative = {}\n"
    )
    ends = {}
    for relative in ("true", "false"):
        scene = written(tmp_path, HEAD, QUIET, FAST, first, shear.format(relative))
        assert granfabric("dem", scene, "-o", tmp_path / relative).code == 0
        ends[relative] = columns(tmp_path / relative)
    for relative, kept in (("true", True), ("false", False)):
        h = ends[relative]
        volume = h["strain_xx"] + h["strain_yy"]
        start = int(np.flatnonzero(h["segment"] > 0)[0])
        assert volume[start] == pytest.approx(-2e-4, rel=0.2)
        # constant area from the state reached; or back to that of the packing, and the pressure with it
        assert volume[-1] == pytest.approx(volume[start] if kept else 0.0, abs=1e-9)
        assert (h["p"][-1] > 1.8e5) == kept and (h["p"][-1] < 1.2e5) != kept

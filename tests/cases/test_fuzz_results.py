"""Damaged result folders: pictures, `--resume` of field and DEM runs, stored packings from strangers."""

from __future__ import annotations

import json
import os
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mutations import Hang, mutated, one_sentence, within
from test_resume import SCENE

from granfabric.dem_ref.dynamics.packing import make_packing
from granfabric.dem_ref.sample.disks import SampleError, load_sample, sample_arrays, save_sample

SECONDS = 60
"""A command that takes longer hangs: here they take seconds at most."""
AMOUNTS = [
    pytest.param(1, id="few"),
    pytest.param(8, id="many", marks=pytest.mark.slow),
    pytest.param(80, id="most", marks=pytest.mark.long),
]
POINT_SET = ("--set", "path.0.increments=3", "--set", "path.1.increments=3", "--set", "output.pictures=false")
DEM_SET = (
    *("--set", "packing.particles=100", "--set", "path.0.stress_ratio=0.02", "--set", "measure.material=false"),
    *("--set", "output.pictures=false", "--set", "output.every=2", "--set", "output.checkpoint_seconds=0.0"),
)


class Killed(BaseException):
    """Nobody catches it."""


@pytest.fixture(scope="module")
def field_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("scene") / "small.toml"
    file.write_text(SCENE)
    return file


def content(folder: Path) -> dict[str, bytes]:
    """Every file but the record and the log, which tell the time, and the lock of a run that was killed."""
    other = ("run.json", "run.log", ".granfabric.lock")
    return {file.name: file.read_bytes() for file in folder.iterdir() if file.name not in other}


def ended(call: Callable, damage: str) -> tuple[int, str]:
    """Code and message of a command, which may neither stumble nor hang."""
    try:
        with within(SECONDS):
            result = call()
    except (Exception, Hang) as error:
        pytest.fail(f"{damage}: {type(error).__name__}: {error}")
    assert result.code in (0, 2), f"{damage}: exit code {result.code}, {result.err}"
    if result.code == 2:
        assert one_sentence(result.err), f"{damage}: {result.err}"
    return result.code, result.err


def damaged(folder: Path, target: Path, names: list[str], seed: list[int]) -> str:
    """Copy a folder with damage to one of the named files; says which."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(folder, target)
    rng = np.random.default_rng(seed)
    file = target / names[int(rng.integers(0, len(names)))]
    if rng.integers(0, 20) == 0:
        file.unlink()
        return f"{file.name} removed, seed {seed}"
    text = file.suffix not in (".vtu", ".npz")
    file.write_bytes(mutated(file.read_bytes(), rng, text))
    return f"{file.name} damaged, seed {seed}"


@pytest.fixture
def stopped_field(
    granfabric: Callable, field_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[Path, dict[str, bytes]]:
    """Folder of a run killed in its sixth step, and the files of a run in one go."""
    assert granfabric("run", field_scene, "-o", tmp_path / "whole").code == 0
    replace = os.replace

    def until(source: Path, target: Path) -> None:
        if Path(target).name == "checkpoint_000006.npz":
            raise Killed
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", until)
        with pytest.raises(Killed):
            granfabric("run", field_scene, "-o", tmp_path / "stopped")
    return tmp_path / "stopped", content(tmp_path / "whole")


@pytest.mark.parametrize("amount", AMOUNTS)
def test_resuming_a_damaged_field_run(
    amount: int, granfabric: Callable, field_scene: Path, tmp_path: Path, stopped_field: tuple
) -> None:
    """Refused and left alone, or gone on with to the same bits as in one go."""
    stopped, whole = stopped_field
    names = sorted(name for name in content(stopped) if not name.startswith("."))
    names = [name for name in names if name.endswith((".npz", ".csv", ".pvd"))] + ["run.json"]
    resumed = 0
    for seed in range(12 * amount):
        out = tmp_path / "out"
        damage = damaged(stopped, out, names, [seed, amount, 1])
        before = content(out), (out / "run.json").read_bytes() if (out / "run.json").exists() else b""
        code, _ = ended(lambda out=out: granfabric("run", field_scene, "-o", out, "--resume"), damage)
        if code == 0:
            resumed += 1
            for name, data in whole.items():
                # a digit changed in a row of the history, or a time stamp of the series, is a legal digit
                if not damage.startswith(name):
                    assert (out / name).read_bytes() == data, f"{damage}: {name}"
        else:
            assert (content(out), (out / "run.json").read_bytes() if before[1] else b"") == before, damage
    assert resumed > 0


@pytest.mark.parametrize("amount", AMOUNTS)
def test_resuming_a_damaged_dem_run(
    amount: int, granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    assert granfabric("dem", "dem_biaxial", *DEM_SET, "-o", whole).code == 0
    replace, calls = os.replace, 0

    def until(source: Path, target: Path) -> None:
        nonlocal calls
        calls += Path(target).name == "checkpoint.npz"
        if calls == 4:
            raise Killed
        replace(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", until)
        with pytest.raises(Killed):
            granfabric("dem", "dem_biaxial", *DEM_SET, "-o", stopped)
    names = ["packing.npz", "checkpoint.npz", "run.json", "history.csv"]
    compared = [name for name in content(whole) if name.endswith((".csv", ".vtu", ".pvd"))]
    for seed in range(3 * amount):
        out = tmp_path / "out"
        damage = damaged(stopped, out, names, [seed, amount, 2])
        before = content(out)
        code, _ = ended(lambda out=out: granfabric("dem", "dem_biaxial", *DEM_SET, "-o", out, "--resume"), damage)
        if code == 0:
            for name in compared:
                assert (out / name).read_bytes() == (whole / name).read_bytes(), f"{damage}: {name}"
        else:
            assert content(out) == before, damage


@pytest.mark.parametrize("amount", AMOUNTS)
def test_drawing_a_damaged_folder(amount: int, granfabric: Callable, field_scene: Path, tmp_path: Path) -> None:
    folders = {"point": tmp_path / "point", "field": tmp_path / "field", "dem": tmp_path / "dem"}
    if amount == 1:
        del folders["dem"]  # whose pictures take seconds
    assert granfabric("point", "unload_reload", *POINT_SET, "-o", folders["point"]).code == 0
    assert granfabric("run", field_scene, "-o", folders["field"]).code == 0
    if "dem" in folders:
        assert granfabric("dem", "dem_biaxial", *DEM_SET, "-o", folders["dem"]).code == 0
    for kind, folder in folders.items():
        names = sorted(name for name in content(folder) if name.endswith((".csv", ".pvd", ".npz", ".vtu")))
        last = [name for name in names if name.endswith(".vtu")][-1:] if kind == "field" else []
        names = [name for name in names if not name.endswith(".vtu")] + ["run.json"]
        if kind == "field":
            names += [name for name in content(folder) if name.startswith("result_")][-1:] + last
        for seed in range((3 if kind == "point" else 2) * amount):
            out = tmp_path / "out"
            damage = damaged(folder, out, names, [seed, amount, 3])
            ended(lambda out=out: granfabric("plot", out), f"{kind}: {damage}")


def test_a_series_names_no_file_elsewhere(
    granfabric: Callable, field_scene: Path, tmp_path: Path, stopped_field: tuple
) -> None:
    """Going on removes steps beyond the checkpoint: a series from a stranger must not choose what is removed."""
    stopped, _ = stopped_field
    victim = tmp_path / "victim_0099.vtu"
    victim.write_text("mine")
    series = stopped / "result.pvd"
    for name in ("../victim_0099.vtu", str(victim), "sub/result_0099.vtu"):
        text = series.read_text().replace("</Collection>", f'<DataSet timestep="9.0" file="{name}"/></Collection>')
        out = tmp_path / "out"
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(stopped, out)
        (out / "result.pvd").write_text(text)
        result = granfabric("run", field_scene, "-o", out, "--resume")
        assert result.code == 2 and "is damaged" in result.err
        assert granfabric("plot", out).code == 2
        assert victim.read_text() == "mine"


def packing_of_a_stranger(folder: Path) -> list[tuple[str, Path]]:
    """Packings that claim what they are not."""
    sample = make_packing(100, 1)
    good = sample_arrays(sample)
    made = []

    def put(name: str, **changes: np.ndarray) -> None:
        path = folder / f"{name}.npz"
        np.savez(path, **{**good, **changes})
        made.append((name, path))

    put("heap", position=np.zeros_like(good["position"]))
    put("far", position=good["position"] + 1e300)
    put("line", cell=good["cell"] * np.array([[1e9], [1e-9]]))
    put("contactless", **{name: good[name][:0] for name in ("first", "second", "image", "tangential")})
    put("images", image=good["image"] + np.int8(1))
    put("objects", spin=np.array([object()] * sample.count, dtype=object))
    put("beyond", second=good["second"] + np.uint32(10**6))
    path = folder / "compressed.npz"
    np.savez_compressed(path, **good)
    made.append(("compressed", path))
    path = folder / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in good:
            archive.writestr(f"{name}.npy", b"\0" * 5_000_000)
    made.append(("bomb", path))
    header = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 2), }"
    path = folder / "claim.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("position.npy", header.ljust(127) + b"\n" + bytes(64))
    made.append(("claim", path))
    return made


def test_a_strangers_packing_can_only_fail(tmp_path: Path) -> None:
    for name, path in packing_of_a_stranger(tmp_path):
        with within(SECONDS), pytest.raises(SampleError) as caught:
            load_sample(path)
        assert str(path) in str(caught.value) and "\n" not in str(caught.value), name


@pytest.mark.parametrize("amount", AMOUNTS)
def test_damaged_packings(amount: int, tmp_path: Path) -> None:
    """Refused, or the same sample: the checksums of the archive tell."""
    sample, path = make_packing(100, 1), tmp_path / "packing.npz"
    save_sample(path, sample)
    whole, good, refused = path.read_bytes(), sample_arrays(sample), 0
    for seed in range(60 * amount):
        path.write_bytes(mutated(whole, np.random.default_rng([seed, amount, 4]), text=False))
        try:
            with within(SECONDS):
                arrays = sample_arrays(load_sample(path))
        except SampleError as error:
            assert "\n" not in str(error)
            refused += 1
        else:
            assert all(np.array_equal(arrays[name], good[name]) for name in good), seed
    assert refused > 50 * amount


def test_a_record_from_a_stranger(granfabric: Callable, tmp_path: Path) -> None:
    """Whatever stands in run.json: a sentence."""
    assert granfabric("point", "p_constant", "--set", "output.pictures=false", "-o", tmp_path / "a").code == 0
    record = json.loads((tmp_path / "a/run.json").read_text())
    for change in (
        *({"kind": "verify"}, {"kind": []}, {"scene": {}}, {"scene": {"kind": "point"}}, {"outcome": 1}, {"kind": "x"}),
        *({"scene": {**record["scene"], "path": [{}]}}, {"program": None}, {"timing": []}),
    ):
        (tmp_path / "a/run.json").write_text(json.dumps({**record, **change}))
        result = granfabric("plot", tmp_path / "a")
        assert result.code == 2 and one_sentence(result.err), change

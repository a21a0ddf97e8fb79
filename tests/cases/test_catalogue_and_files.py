"""Finding and copying scenes; result folders that are whole or untouched."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from granfabric.cases.errors import InputError
from granfabric.cases.records import files
from granfabric.cases.scene import catalogue


def test_a_shipped_name_a_file_and_a_folder_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert catalogue.find("p_constant") == catalogue.HOME / "paths" / "p_constant.toml"
    own = tmp_path / "own.toml"
    own.write_text("kind = 'point'")
    assert catalogue.find(str(own)) == own
    assert catalogue.find(str(tmp_path)) == own
    monkeypatch.chdir(tmp_path)
    assert catalogue.find("own.toml") == Path("own.toml")
    (tmp_path / "p_constant").mkdir()
    assert catalogue.find("p_constant").parent == catalogue.HOME / "paths"
    with pytest.raises(InputError, match="holds 0 files"):
        catalogue.find("./p_constant")


def test_an_unknown_scene_names_the_nearest() -> None:
    with pytest.raises(InputError, match=r"'p_constnat' is unknown \(legal: .*nearest is 'p_constant'"):
        catalogue.find("p_constnat")
    with pytest.raises(InputError, match=r"'nowhere/own.toml' does not exist"):
        catalogue.find("nowhere/own.toml")


def test_a_copied_scene_is_complete_and_nothing_is_overwritten(tmp_path: Path) -> None:
    point = catalogue.copy("p_constant", tmp_path / "point")
    assert [file.name for file in point] == ["p_constant.toml", "schema.json"]
    assert point[0].read_text().splitlines()[0] == "#:schema schema.json"
    assert point[1].read_bytes() == catalogue.SCHEMA.read_bytes()
    assert [file.name for file in catalogue.copy("isotropic", tmp_path / "point")] == ["isotropic.toml"]
    (tmp_path / "point" / "isotropic.toml").unlink()
    assert catalogue.find(str(tmp_path / "point")) == point[0]
    with pytest.raises(InputError, match="not overwritten"):
        catalogue.copy("p_constant", tmp_path / "point")
    with pytest.raises(InputError, match="nearest is 'isotropic'"):
        catalogue.copy("isotopic", tmp_path)


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    files.write_text(target, "old")

    def half(path: Path) -> None:
        path.write_text("ne")
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        files.write_whole(target, half)
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_table_keeps_all_digits(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    files.write_text(path, files.csv_text(["x", "stage"], [[0.1 + 0.2, "a"], [1e-300, "b, c"]]))
    assert files.read_csv(path) == {"x": [0.1 + 0.2, 1e-300], "stage": ["a", "b, c"]}


def test_a_folder_with_other_files_is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    (tmp_path / "run.json").write_text(json.dumps({"program": "another"}))
    with pytest.raises(InputError, match="not a result of granfabric"):
        files.prepare_output(tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_an_earlier_result_is_replaced_and_other_files_stay(tmp_path: Path) -> None:
    files.write_json(tmp_path / "run.json", {"program": "granfabric"})
    for name in ("history.csv", "result_0001.vtu", "result.pvd", "overview.png", "notes.txt", "photo.png"):
        (tmp_path / name).write_text("x")
    files.prepare_output(tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["notes.txt", "photo.png"]


def test_an_output_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is a file"):
        files.check_output(tmp_path / "file")
    with pytest.raises(InputError, match=r"cannot be made: .* is a file"):
        files.prepare_output(tmp_path / "file" / "inside")
    with pytest.raises(InputError, match="cannot be written"):
        files.prepare_output(Path("/proc/nowhere"))
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write everywhere")
def test_a_write_protected_folder_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="write-protected"):
        files.check_output(tmp_path / "new")
    tmp_path.chmod(0o700)

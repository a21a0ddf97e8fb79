"""Texts as other programs save them, brackets, keys as users count them, all errors at once, paths, title and kind."""

from __future__ import annotations

import codecs
import json
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from mutations import one_sentence

from granfabric.cases.errors import MOST_LINES, InputError
from granfabric.cases.records import files
from granfabric.cases.scene import catalogue
from granfabric.cases.scene.keys import label, split
from granfabric.cases.scene.reader import check, load
from granfabric.cases.scene.text_file import decoded

POINT = """title = "a point, größer"
kind = "point"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[initial]
stress = [-100e3, -100e3, 0.0]
[output]
pictures = false
[[path]]
control = ["stress", "stress", "stress"]
target = [-99e3, -101e3, 0.0]
increments = 2
[[path]]
control = ["stress", "stress", "stress"]
target = [-98e3, -102e3, 0.0]
increments = 2
"""

FIELD = """
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[mesh]
rectangle = { width = 1.0, height = 1.0, nx = 1, ny = 1 }
element = "P1"
[initial]
stress = [-100e3, -100e3, 0.0]
[output]
pictures = false
[[stage]]
name = "initial"
increments = 1
fixed = [{ boundary = "bottom" }]
pressure = [{ boundary = "left", value = 100e3 }, { boundary = "right", value = 100e3 }]
displacement = [{ boundary = "top", component = "y", value = 0.0 }]
[[stage]]
name = "press"
increments = 1
displacement = [{ boundary = "top", component = "y", value = -1e-6 }]
"""

MATERIAL = "[material]\ncoordination = 3.9\nsolid_fraction = 0.84\nnormal_stiffness = 1e9\n"


def refused(granfabric: Callable, tmp_path: Path, content: str | bytes, *arguments: str) -> list[str]:
    """Lines with which a scene is refused; nothing is written."""
    file = tmp_path / "own.toml"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    command = arguments[0] if arguments and arguments[0] in ("run", "point", "dem") else "point"
    rest = arguments[1:] if arguments and arguments[0] == command else arguments
    result = granfabric(command, file, "-o", tmp_path / "refused", *rest)
    assert result.code == 2 and one_sentence(result.err), result.err
    assert not (tmp_path / "refused").exists()
    return [line.removeprefix("granfabric: ").replace(str(file), "own.toml") for line in result.err.splitlines()]


@pytest.mark.parametrize("ends", ["\n", "\r\n"], ids=["unix", "windows"])
def test_byte_order_marks_and_line_ends_of_every_text(granfabric: Callable, tmp_path: Path, ends: str) -> None:
    """Scene, material file, record and history, as Notepad and PowerShell save them."""

    def saved(file: Path, text: str) -> None:
        file.write_bytes(codecs.BOM_UTF8 + text.replace("\n", ends).encode("utf-8"))

    saved(tmp_path / "own.toml", 'material_file = "measured.toml"\n' + POINT)
    saved(tmp_path / "measured.toml", MATERIAL)
    out = tmp_path / "out"
    result = granfabric("point", tmp_path / "own.toml", "-o", out)
    assert result.code == 0, result.err
    assert json.loads((out / "run.json").read_text())["scene"]["title"] == "a point, größer"
    for name in ("run.json", "history.csv", "scene.toml"):
        saved(out / name, (out / name).read_text())
    before = files.read_csv(out / "history.csv")
    assert next(iter(before)) == "step" and before["step"] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert granfabric("plot", out).code == 0
    assert granfabric("point", out / "scene.toml", "-o", tmp_path / "again").code == 0
    assert files.read_csv(tmp_path / "again" / "history.csv") == before
    # the marked record still tells whose the folder is
    assert granfabric("point", tmp_path / "own.toml", "-o", out).code == 0


def test_a_stopped_field_run_goes_on_from_marked_texts(
    granfabric: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.toml").write_text(FIELD)
    out = tmp_path / "out"
    from granfabric.cases.terminal.interruption import InterruptRequest

    with monkeypatch.context() as patch:
        rows = out / "history.csv"
        patch.setattr(InterruptRequest, "__call__", lambda self: rows.is_file() and rows.read_text().count("\n") > 2)
        granfabric("run", tmp_path / "own.toml", "-o", out)
    assert json.loads((out / "run.json").read_text())["outcome"] != "finished"
    for name in ("run.json", "history.csv"):
        (out / name).write_bytes(codecs.BOM_UTF8 + (out / name).read_text().replace("\n", "\r\n").encode())
    assert granfabric("run", tmp_path / "own.toml", "-o", out, "--resume").code == 0


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
def test_utf_16_is_refused_with_what_to_do(granfabric: Callable, tmp_path: Path, encoding: str) -> None:
    [said] = refused(granfabric, tmp_path, POINT.encode(encoding))
    assert said.startswith("own.toml: ") and "save it as UTF-8" in said
    assert ("UTF-32" if "32" in encoding and encoding != "utf-32-be" else "UTF-16") in said
    (tmp_path / "measured.toml").write_bytes(MATERIAL.encode(encoding))
    result = granfabric("point", "p_constant", "--set", f"material_file={tmp_path / 'measured.toml'}")
    assert result.code == 2 and "measured.toml: " in result.err and "save it as UTF-8" in result.err


def test_other_encodings_are_refused_with_the_line(granfabric: Callable, tmp_path: Path) -> None:
    [said] = refused(granfabric, tmp_path, POINT.encode("latin-1"))
    assert "not a text in UTF-8 (line 1, byte 20)" in said and "save it as UTF-8" in said
    [said] = refused(granfabric, tmp_path, ("kind = 'point'\n\n# " + "ü").encode("cp1252"))
    assert "(line 3, byte 18)" in said


@pytest.mark.parametrize("name", ["run.json", "history.csv"])
def test_results_in_utf_16_are_refused_for_that_reason(granfabric: Callable, tmp_path: Path, name: str) -> None:
    (tmp_path / "own.toml").write_text(POINT)
    out = tmp_path / "out"
    assert granfabric("point", tmp_path / "own.toml", "-o", out).code == 0
    (out / name).write_text((out / name).read_text(), encoding="utf-16")
    result = granfabric("plot", out)
    assert result.code == 2 and one_sentence(result.err)
    assert f"{name}: saved as UTF-16" in result.err and "save it as UTF-8" in result.err


def test_decoding() -> None:
    assert decoded(b"", Path("a")) == "" and decoded(codecs.BOM_UTF8, Path("a")) == ""
    assert decoded("\ufeffa\r\nb\rc".encode(), Path("a")) == "a\nb\rc"


SINGLE = [
    (POINT.replace("[[path]]", "[path]", 1).split("[[path]]")[0], "point", "[path]", "[[path]]"),
    (POINT.replace("[[path]]", "[path]"), "point", "[path]", "[[path]]"),
    (POINT.replace("[[path]]", "[path]", 1), "point", "[path]", "[[path]]"),
    (POINT[::-1].replace("]]htap[[", "]htap[", 1)[::-1], "point", "[path]", "[[path]]"),
    (FIELD.replace("[[stage]]", "[stage]"), "run", "[stage]", "[[stage]]"),
    (FIELD.replace("[[stage]]", "[ stage ]  # first", 1).split("[[stage]]")[0], "run", "[stage]", "[[stage]]"),
    (POINT.replace("[material]", "[[material]]"), "point", "[[material]]", "[material]"),
    (POINT.replace("[initial]", "[[initial]]"), "point", "[[initial]]", "[initial]"),
    (FIELD.replace("[mesh]", "[[mesh]]"), "run", "[[mesh]]", "[mesh]"),
    (FIELD.replace("[material]", "[[materials]]\nregion = 'all'"), "run", "[[materials]]", "[materials.NAME]"),
    (FIELD.replace("[material]", "[materials]\nregion = 'all'"), "run", "[materials]", "[materials.NAME]"),
    (FIELD + "[stage.fixed]\nboundary = 'left'\n", "run", "[stage.fixed]", "[[stage.fixed]]"),
]


@pytest.mark.parametrize(("text", "command", "found", "wanted"), SINGLE, ids=range(len(SINGLE)))
def test_brackets(
    granfabric: Callable, tmp_path: Path, text: str, command: str, found: str, wanted: str
) -> None:
    said = refused(granfabric, tmp_path, text, command)
    assert f"{found} " in said[0] and f"{wanted} " in f"{said[0]} ", said
    assert len(said) == 1, said


def test_brackets_of_a_material_file(granfabric: Callable, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MATERIAL.replace("[material]", "[[material]]"))
    result = granfabric("point", "p_constant", "--set", f"material_file={tmp_path / 'm.toml'}", "-o", tmp_path / "out")
    assert result.code == 2 and "[[material]] is there only once: write [material]" in result.err


def test_keys_that_are_given_twice_are_named(granfabric: Callable, tmp_path: Path) -> None:
    twice = POINT.replace("coordination = 4.06", "coordination = 4.06\ncoordination = 4")
    [said] = refused(granfabric, tmp_path, twice)
    assert said == "own.toml: not valid TOML: line 5: coordination is given twice"
    [said] = refused(granfabric, tmp_path, POINT + "[material]\n")
    assert said.endswith("line 19: the table [material] is there already")


WRONG = (
    POINT.replace("coordination = 4.06", "cordination = 4.06")
    .replace("0.846", "8.46")
    .replace("-100e3, 0.0]", "'a', 0.0]")
    .replace("increments = 2", "increments = 0")
    .replace('"stress", "stress"]\ntarget = [-98e3', '"strain", "stres"]\ntarget = [-98e3')
)


def test_all_errors_are_told_one_a_line(granfabric: Callable, tmp_path: Path) -> None:
    said = refused(granfabric, tmp_path, WRONG, "--set", "output.every=0", "--set", "path.1.increments=2.5")
    beginnings = [
        "own.toml: the key 'material.cordination' is unknown (legal: coordination,",
        "own.toml: material.solid_fraction = 8.46 is outside its bounds [0.001, 1]",
        "own.toml: entry 2 of initial.stress = 'a' is not a number",
        "own.toml: path 1: increments = 0 is outside its bounds",
        "own.toml: path 2: entry 3 of control = 'stres' is not one of stress, strain; the nearest is 'stress'",
        "--set path.1.increments: path 2: increments = 2.5 is not an integer",
        "--set: output.every = 0 is outside its bounds",
    ]
    assert len(said) == len(beginnings)
    for beginning in beginnings:
        assert any(line.startswith(beginning) for line in said), (beginning, said)
    # that 'coordination' is missing is no error of its own
    assert not any("is missing" in line for line in said)


def test_endless_errors_are_counted(granfabric: Callable, tmp_path: Path) -> None:
    said = refused(granfabric, tmp_path, POINT + "[[path]]\nincrements = 0\n" * 100)
    assert len(said) == MOST_LINES + 1 and said[-1] == f"and {100 - MOST_LINES} more errors of this input"


def test_all_names_that_the_mesh_lacks_are_told(granfabric: Callable, tmp_path: Path) -> None:
    text = FIELD.replace('"left"', '"lft"')[::-1].replace('"pot"', '"opt"', 1)[::-1]
    said = refused(granfabric, tmp_path, text, "run", "--set", 'stage.press.fixed=[{boundary="botom"}]')
    assert [line.split(" is unknown")[0] for line in said] == [
        "own.toml: stage 1 \"initial\": pressure 1: the boundary 'lft'",
        "--set stage.1.fixed: stage 2 \"press\": fixed 1: the boundary 'botom'",
        "own.toml: stage 2 \"press\": displacement 1: the boundary 'tpo'",
    ]


def test_long_values_and_names_are_shown_short(granfabric: Callable, tmp_path: Path) -> None:
    long = "x" * 100_000
    texts = [
        POINT.replace("coordination = 4.06", f'coordination = "{long}"'),
        POINT.replace("coordination = 4.06", f"{long} = 4.06"),
        POINT.replace('"a point', f'"\\u0007{long}'),
        POINT.replace('kind = "point"', f'kind = "{long}"'),
        POINT.replace("[output]", f"[{long}]"),
    ]
    for text in texts:
        for line in refused(granfabric, tmp_path, text):
            assert len(line) < 1000
    for assignment in (long, f"material.coordination={long[:50000]}!", f"path.{long}=3", f"{long[:5000]}.{long[:9]}=3"):
        said = refused(granfabric, tmp_path, POINT, "--set", assignment[:100_000])
        assert all(len(line) < 1000 for line in said), [len(line) for line in said]


def test_labels() -> None:
    data = {
        "stage": [{"name": "a"}, {"name": "b", "pressure": [{"value": 1}]}],
        "mesh": {"part": [{"name": "left wall"}]},
        "initial": {"stress": [1, 2]},
        "closed_form": {"line": [[0, 1], [2, 3]]},
    }
    assert label(["stage", 1, "pressure", 0, "value"], data) == 'stage 2 "b": pressure 1: value'
    assert label(["mesh", "part", 0], data) == 'mesh.part 1 "left wall"'
    assert label(["initial", "stress", 1], data) == "entry 2 of initial.stress"
    assert label(["closed_form", "line", 1, 0], data) == "entry 1 of entry 2 of closed_form.line"
    assert split(["stage", 0], data) == ('stage 1 "a"', "")
    assert label(["material", "coordination"], data) == "material.coordination"
    assert label(["stage", 7, "x"], data) == "entry 8 of stage.x"  # nothing is there


# paths


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A scene with its mesh in one folder; the working folder is another."""
    shutil.copytree(catalogue.HOME / "biaxial", tmp_path / "scene")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path


def test_paths_by_set_are_relative_to_the_working_folder_and_those_in_a_file_to_it(elsewhere: Path) -> None:
    scene, here = elsewhere / "scene" / "biaxial.toml", elsewhere / "here"
    (here / "sub").mkdir()
    for assignment in ("mesh.file=sub/my.msh", "mesh.file=./sub/my.msh", 'mesh={file="sub/my.msh"}'):
        assert load(str(scene), [assignment]).scene.mesh.file == str(here / "sub" / "my.msh")
    assert load(str(scene), [f"mesh.file={elsewhere}/a.msh"]).scene.mesh.file == str(elsewhere / "a.msh")
    assert load(str(scene)).scene.mesh.file == "biaxial.msh"
    (here / "measured.toml").write_text(MATERIAL)
    (elsewhere / "scene" / "measured.toml").write_text(MATERIAL.replace("3.9", "3.8"))
    assert load(str(scene), ["material_file=measured.toml"]).scene.material.coordination == 3.9
    assert load(str(scene), [f"material_file={elsewhere}/scene/measured.toml"]).scene.material.coordination == 3.8
    text = scene.read_text()
    inside = 'material_file = "measured.toml"\n' + text.replace("coordination = 4.06", "")
    scene.write_text(inside)
    assert load(str(scene)).scene.material.coordination == 3.8
    assert load("../scene/biaxial.toml").scene.material.coordination == 3.8


def test_a_mesh_by_set_is_read_from_the_working_folder(granfabric: Callable, elsewhere: Path) -> None:
    """Also for a shipped scene, beside whose file nobody has meshes."""
    result = granfabric("run", "biaxial", "--set", "mesh.file=mine.msh", "-o", elsewhere / "out")
    assert result.code == 2 and f"{elsewhere / 'here' / 'mine.msh'}" in result.err
    shutil.copy(elsewhere / "scene" / "biaxial.msh", "mine.msh")
    loaded = load("biaxial", ["mesh.file=mine.msh"])
    from granfabric.cases.field.prepare import read_or_make_mesh

    assert read_or_make_mesh(loaded).boundaries


SEVERAL = ["biaxial_inclusion", "layered_oedometer"]


@pytest.mark.parametrize("name", SEVERAL)
def test_a_material_file_by_set_fills_what_each_of_several_materials_leaves_open(name: str, tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(MATERIAL + "isostatic_coordination = 2.5\n[closure]\nslip = 0.77\n")
    before, after = load(name).scene, load(name, [f"material_file={tmp_path}/m.toml"]).scene
    own = tomllib.loads(load(name).file.read_text())["materials"]
    given = tomllib.loads((tmp_path / "m.toml").read_text())["material"]
    assert after.material is None and list(after.materials) == list(before.materials)
    for key, section in own.items():
        for entry, value in section.items():
            assert getattr(after.materials[key], entry) == value
        for entry, value in given.items():
            assert getattr(after.materials[key], entry) == section.get(entry, value)
        # nothing is left of the file that the scene names itself
        assert "shear_reduction" not in after.materials[key].model_fields_set or "shear_reduction" in section
    assert after.closure.slip == 0.77 and before.closure.slip != 0.77
    assert load(name, [f"material_file={tmp_path}/m.toml", "closure.slip=0.5"]).scene.closure.slip == 0.5
    with pytest.raises(InputError, match=r"m\.toml: materials\.\w+\.solid_fraction = 1\.84"):
        (tmp_path / "m.toml").write_text(MATERIAL.replace("0.84", "1.84"))
        load(name, [f"material_file={tmp_path}/m.toml"])


def test_of_a_material_file_by_set_nothing_of_the_scenes_own_is_left(tmp_path: Path) -> None:
    """The numbers of one packing are not mixed with those of another, in whatever order things are given."""
    (tmp_path / "first.toml").write_text(MATERIAL + "shear_reduction = 0.5\n[closure]\nslip = 0.77\n")
    (tmp_path / "second.toml").write_text(MATERIAL.replace("3.9", "3.7"))
    (tmp_path / "own.toml").write_text('material_file = "first.toml"\n' + POINT.replace("coordination = 4.06", ""))
    scene = load(str(tmp_path / "own.toml")).scene
    assert (scene.material.coordination, scene.material.shear_reduction, scene.closure.slip) == (3.9, 0.5, 0.77)
    second = f"material_file={tmp_path}/second.toml"
    scene = load(str(tmp_path / "own.toml"), [second]).scene
    assert scene.material.coordination == 3.7
    assert "shear_reduction" not in scene.material.model_fields_set and "slip" not in scene.closure.model_fields_set
    for order in ([second, "material.coordination=3.5"], ["material.coordination=3.5", second]):
        assert load(str(tmp_path / "own.toml"), order).scene.material.coordination == 3.5


def test_a_refusal_names_the_file_that_gave_the_value(granfabric: Callable, tmp_path: Path) -> None:
    """Also where only several values together are refused, or the check of a whole table says so."""
    for line, word in (
        ("[closure]\nweak_contact_ratio = -1.9\n", "closure.weak_contact_ratio = -1.9"),
        ("force_density_at_zero = -0.09\n", "material.force_density_at_zero = -0.09"),
    ):
        (tmp_path / "measured.toml").write_text(MATERIAL + line)
        result = granfabric("point", "p_constant", "--set", f"material_file={tmp_path / 'measured.toml'}")
        assert result.code == 2 and result.err.startswith(f"granfabric: {tmp_path / 'measured.toml'}: {word}")


# assignments


def test_assignments_by_name() -> None:
    scene = load("biaxial", ["stage.compression.increments=7", "stage.0.increments=3"]).scene
    assert [stage.increments for stage in scene.stage] == [3, 7]
    with pytest.raises(InputError, match=r"'stage' has 2 entries, numbered from 0 or named initial, compression; 'x'"):
        load("biaxial", ["stage.x.increments=7"])


@pytest.mark.parametrize(
    ("assignment", "part"),
    [
        ("material.coordination", "is not of the form key=value"),
        ("=3", "is not of the form key=value"),
        ("material.cordination=3", "the nearest is 'coordination'"),
        ("materail.coordination=3", "the nearest is 'material'"),
        ("material.coordination=", "is not a TOML value"),
        ("material.coordination=3\nx=4", "more than one line"),
    ],
)
def test_bad_assignments(granfabric: Callable, tmp_path: Path, assignment: str, part: str) -> None:
    said = refused(granfabric, tmp_path, POINT, "--set", assignment)
    assert said[0].startswith("--set") and part in said[0]


# title and kind


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (POINT, "point"),
        (FIELD, "field"),
        ("[[path]]\nloading = 'isotropic'\npressure_ratio = 2.0\n", "dem"),
        ("[packing]\nparticles = 60\n[[path]]\nloading = 'isotropic'\npressure_ratio = 2.0\n", "dem"),
        (POINT.split("[[path]]")[0] + "[[path]]\nrotation_degrees = 30.0\n", "point"),
    ],
)
def test_title_and_kind_need_not_be_given(tmp_path: Path, text: str, kind: str) -> None:
    file = tmp_path / "my first scene.toml"
    bare = "\n".join(line for line in text.splitlines() if not line.startswith(("title", "kind")))
    file.write_text(bare)
    loaded = load(str(file))
    assert loaded.scene.kind == kind and loaded.scene.title == "my first scene"
    assert check(loaded.scene.model_dump(exclude_none=True), file) == loaded.scene
    file.write_text("title = 'A name'\n" + bare)
    assert load(str(file)).scene.title == "A name"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["'kind' is missing (legal: point, field, dem, specimen)", "[mesh]", "[[path]]", "[packing]"]),
        ("[initial]\nstress = [-1.0, -1.0, 0.0]\n", ["'kind' is missing", "none of these is there"]),
        (FIELD + "[packing]\n", ["[mesh] belongs to 'field' and [packing] belongs to 'dem'"]),
        (FIELD + "[[path]]\ncontrol = []\n", ["[mesh] belongs to 'field'", "[[path]] with control belongs to 'point'"]),
        (MATERIAL, ["looks like a material file", "material_file = 'own.toml'"]),
        ("[path]\ntarget = [0.0, 0.0, 0.0]\n", ["write [[path]]"]),
    ],
)
def test_a_kind_that_cannot_be_told(granfabric: Callable, tmp_path: Path, text: str, parts: list[str]) -> None:
    said = "\n".join(refused(granfabric, tmp_path, text))
    for part in parts:
        assert part in said


def test_a_scene_without_kind_is_referred_to_its_command(granfabric: Callable, tmp_path: Path) -> None:
    [said] = refused(granfabric, tmp_path, FIELD)
    assert "granfabric run" in said
    (tmp_path / "own.toml").write_text(FIELD)
    assert granfabric("run", tmp_path / "own.toml", "-o", tmp_path / "out").code == 0
    assert json.loads((tmp_path / "out" / "run.json").read_text())["scene"]["title"] == "own"
    assert granfabric("run", tmp_path / "out" / "scene.toml", "-o", tmp_path / "out").code == 0


def test_what_is_no_scene_file(granfabric: Callable, tmp_path: Path) -> None:
    (tmp_path / "folder.toml").mkdir()
    for scene, part in (
        (tmp_path / "folder.toml", "holds 0 files with the ending .toml"),
        (tmp_path, "holds 0 files"),
        (tmp_path / "none.toml", "does not exist"),
        ("/dev/null", "cannot be read: it is a folder, a device or a pipe"),
    ):
        result = granfabric("point", scene, "-o", tmp_path / "out")
        assert result.code == 2 and part in result.err and one_sentence(result.err)


def test_a_scene_of_ones_own_is_referred_to_by_its_file(granfabric: Callable, tmp_path: Path) -> None:
    """`granfabric point NAME` finds shipped scenes alone."""
    file = tmp_path / "mine.toml"
    file.write_text(POINT)
    result = granfabric("run", file, "-o", tmp_path / "out")
    assert result.code == 2 and f"use `granfabric point {file}`" in result.err
    assert granfabric("point", file, "-q", "-o", tmp_path / "out").code == 0


def test_a_mesh_for_a_scene_is_told(granfabric: Callable, tmp_path: Path) -> None:
    mesh = tmp_path / "plate.msh"
    mesh.write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n")
    result = granfabric("run", mesh, "-o", tmp_path / "out")
    assert result.code == 2 and f"{str(mesh)!r} is a mesh and no scene: `granfabric mesh {mesh}` shows it" in result.err


def test_lengths_of_texts_are_counted_in_characters(granfabric: Callable, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(POINT)
    result = granfabric("point", file, "-o", tmp_path / "out", "--set", f"title={'x' * 300}")
    assert result.code == 2 and "has 300 characters, it needs at most 200" in result.err
    result = granfabric("point", file, "-o", tmp_path / "out", "--set", "path.0.target=[1.0]")
    assert result.code == 2 and "has 1 entries, it needs exactly 3" in result.err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            'pressure=[{boundary="left",value=1.0},{boundary="left",value=2.0}]',
            "stage 2 \"it's\" prescribes the pressure on 'left' twice",
        ),
        (
            'displacement=[{boundary="top",component="x",value=1e-6}]',
            "stage 2 \"it's\": the node at (0, 1) is told two displacements",
        ),
    ],
)
def test_a_contradiction_names_the_stage_as_users_count_it(
    granfabric: Callable, tmp_path: Path, change: str, said: str
) -> None:
    file = tmp_path / "mine.toml"
    text = FIELD[: FIELD.rindex("[[stage]]")]
    file.write_text(f'{text}[[stage]]\nname = "it\'s"\nfixed = [{{ boundary = "left", components = ["x"] }}]\n')
    result = granfabric("run", file, "-o", tmp_path / "out", "--set", f"stage.1.{change}")
    assert result.code == 2 and f"mine.toml: {said}" in result.err and "stage: " not in result.err


def test_keys_and_values_of_a_material_file_are_told_together(granfabric: Callable, tmp_path: Path) -> None:
    scene, material = tmp_path / "mine.toml", tmp_path / "sand.toml"
    scene.write_text(POINT)
    text = 'title = "sand"\n[material]\ncoordination = -4.06\nsoild_fraction = 0.8\n[closure]\nslip = nan\n'
    material.write_text(text)
    result = granfabric("point", scene, "-o", tmp_path / "out", "--set", f"material_file={material}")
    assert result.code == 2
    assert "the key 'title' is unknown (legal: material, closure)" in result.err
    assert "the nearest is 'solid_fraction'" in result.err
    assert "material.coordination = -4.06 is outside its bounds [0.001, 6]" in result.err
    assert "closure.slip = nan is outside its bounds" in result.err
    assert len(result.err.splitlines()) == 4


@pytest.mark.parametrize("place", ["before", "after"])
def test_a_quiet_look_is_a_look(granfabric: Callable, tmp_path: Path, place: str) -> None:
    """`mesh` and `effects` take -q as all commands do; what they say is what they are for."""
    file = tmp_path / "mine.toml"
    file.write_text(FIELD)
    for command, *more in (("mesh", "-o", tmp_path / "mine.png"), ("effects",)):
        words = ["-q", command, file, *more] if place == "before" else [command, file, *more, "-q"]
        result = granfabric(*words)
        assert result.code == 0 and result.out

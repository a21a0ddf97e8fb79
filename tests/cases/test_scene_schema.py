"""Bad input: one sentence that names file, key, value, what is legal and the nearest legal name."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from granfabric.cases.errors import InputError, nearest
from granfabric.cases.scene.catalogue import MATERIALS, SCHEMA, shipped
from granfabric.cases.scene.material_file import read_material
from granfabric.cases.scene.reader import assign, check, load, parse_assignment
from granfabric.cases.scene.schema import MODELS, json_schema, schema_text
from granfabric.cases.scene.schema_law import EffectsSection, MaterialSection
from granfabric.cases.scene.schema_stage import DisplacementLoad, StageSection
from granfabric.cases.scene.toml_text import to_toml
from granfabric.cases.scene.validation_messages import COUNTERPARTS
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import Material

POINT = """
title = "a point"
kind = "point"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[initial]
stress = [-100e3, -100e3, 0.0]
[[path]]
control = ["stress", "stress", "stress"]
target = [-90e3, -110e3, 0.0]
increments = 4
"""

FIELD = """
title = "a field"
kind = "field"
[material]
coordination = 4.06
solid_fraction = 0.846
normal_stiffness = 1e9
[mesh]
rectangle = { width = 1.0, height = 1.0, nx = 2, ny = 2 }
[initial]
stress = [-100e3, -100e3, 0.0]
[[stage]]
name = "press"
fixed = [{ boundary = "bottom" }]
"""


def refused(text: str, *assignments: str) -> str:
    """The sentence with which a scene is refused."""
    table = tomllib.loads(text)
    assigned = []
    for assignment in assignments:
        path, value = parse_assignment(assignment)
        assign(table, path, value)
        assigned.append(path)
    with pytest.raises(InputError) as caught:
        check(table, Path("own.toml"), assigned)
    return str(caught.value)


BAD = [
    (POINT, "material.cordination=4.0", ["--set", "material.cordination", "legal: coordination", "'coordination'"]),
    (POINT, "material.friction_angle=30", ["legal: ", "'peak_stress_ratio' (the sine of the friction angle)"]),
    (POINT, "material.void_ratio=0.6", ["the nearest is 'solid_fraction' (1/(1 + e))"]),
    (POINT, "initial.stress=-100e3", ["initial.stress = -100000.0 is not a list in brackets (xx, yy, xy [Pa], "]),
    (POINT, "material.coordination=9", ["--set", "material.coordination = 9", "[0.001, 6]", "coordination number"]),
    (POINT, "material.solid_fraction=-0.1", ["material.solid_fraction = -0.1", "[0.001, 1]"]),
    (POINT, 'material.coordination="4"', ["material.coordination = '4' is not a number"]),
    (POINT, "material.coordination=true", ["material.coordination = true is not a number"]),
    (POINT, "material.coordination=nan", ["material.coordination = nan is not a finite number"]),
    (POINT, "material.coordination=inf", ["material.coordination = inf is not a finite number"]),
    (POINT, "materail.coordination=4.0", ["'materail' is unknown", "nearest is 'material'"]),
    (POINT, "closure.distribution=harmonics", ["closure.distribution", "harmonic, maximum_entropy", "'harmonic'"]),
    (POINT, "effects.contact_los=false", ["'effects.contact_los' is unknown", "'contact_loss'"]),
    (POINT, "effects.contact_loss=automatic", ["effects.contact_loss = 'automatic'", "true, false, auto", "'auto'"]),
    (POINT, "integration.tolerance=0.0", ["integration.tolerance = 0.0", "[1e-14, 1]"]),
    (POINT, "integration.integrator=dormand", ["integration.integrator = 'dormand'", "'dormand_prince'"]),
    (POINT, "initial.stress=[100e3, 100e3, 0.0]", ["initial", "tension is positive", "-100000"]),
    (POINT, "initial.stress=[-1.0, -1.0]", ["initial.stress", "2 entries", "exactly 3"]),
    (
        POINT,
        'path.0.control=["stress", "stres", "strain"]',
        ["--set path.0.control: path 1: entry 2 of control = 'stres'", "'stress'"],
    ),
    (POINT, "path.0.increments=0", ["--set path.0.increments: path 1: increments = 0", "[1, 1e+07]"]),
    (POINT, "path.0.increments=2.5", ["path 1: increments = 2.5 is not an integer"]),
    (POINT, "path.0.rotation_degrees=90.0", ["path 1: a leg", "neither control nor target"]),
    (POINT, "path=[]", ["path = [] has 0 entries", "at least 1"]),
    (POINT, "kind=pont", ["'pont'", "point, field, dem", "nearest is 'point'"]),
    (POINT, "title=3", ["title = 3 is not a text"]),
    (FIELD, "mesh.file=a.msh", ["mesh", "either file or one of"]),
    (FIELD, "mesh.element=P3", ["mesh.element = 'P3'", "P1, P2, Q1, Q2"]),
    (FIELD, "mesh.element=Q2", ["element Q2 does not fit triangle cells", "P2"]),
    (FIELD, "mesh.rectangle.width=0.0", ["mesh.rectangle.width = 0.0", "(0, inf)"]),
    (
        FIELD,
        'stage.0.fixed=[{boundry="left"}]',
        ['stage 1 "press": fixed 1: the key', "'boundry' is unknown", "nearest is 'boundary'"],
    ),
    (
        FIELD,
        'stage.0.fixed=[{boundary="left", components=["z"]}]',
        ['stage 1 "press": fixed 1: entry 1 of components = \'z\'', "x, y"],
    ),
    (FIELD, 'stage.0.pressure=[{boundary="left"}]', ["stage 1 \"press\": pressure 1: 'value' is missing", "[Pa]"]),
    (FIELD, "stage.0.pressure=3", ['stage 1 "press": pressure = 3 is not a list']),
    (FIELD, "solver.linear_solver=cholmd", ["solver.linear_solver = 'cholmd'", "'cholmod'"]),
    (FIELD, "solver.first_factor=2.0", ["solver: first_factor = 2 is not between"]),
    (FIELD, "initial.balanced=true", ["'initial.balanced' is unknown", "'balance'"]),
    (FIELD, "materials.a.coordination=4.0", ["materials.a.solid_fraction", "missing"]),
]


@pytest.mark.parametrize(("text", "assignment", "parts"), BAD, ids=[bad[1][:40] for bad in BAD])
def test_the_sentence_names_key_value_and_what_is_legal(text: str, assignment: str, parts: list[str]) -> None:
    sentence = refused(text, assignment)
    # one error each, but for tables with several keys that must be there
    assert "\n" not in sentence or "is missing" in sentence
    for part in parts:
        assert part in sentence


@pytest.mark.parametrize("name", [variable.name for variable in Material.variables() if variable.default is None])
def test_a_missing_parameter_is_named_with_its_meaning(name: str) -> None:
    lines = [line for line in POINT.splitlines() if not line.startswith(f"{name} =")]
    sentence = refused("\n".join(lines))
    assert sentence.startswith("own.toml: 'material.")
    assert f"'material.{name}' is missing" in sentence


def test_sections_follow_the_declarations_of_the_law() -> None:
    assert list(MaterialSection.model_fields) == [variable.name for variable in Material.variables()]
    assert tuple(EffectsSection.model_fields) == (*Effects.names(), "tolerance")


@pytest.mark.parametrize("name", sorted(shipped()))
def test_shipped_scenes_are_legal_and_tell_their_story(name: str) -> None:
    loaded = load(name)
    text = loaded.scene.description
    assert "Question:" in text and "Set-up:" in text and "Expected" in text
    assert loaded.name == name


@pytest.mark.parametrize("name", sorted(shipped()))
def test_writing_a_scene_and_reading_it_changes_nothing(name: str) -> None:
    table = load(name).scene.model_dump(exclude_none=True)
    assert tomllib.loads(to_toml(table)) == table


SCALARS = st.one_of(
    st.booleans(),
    st.integers(-(10**18), 10**18),
    st.floats(allow_nan=False),
    st.text(max_size=12),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=8,
)


@given(table=st.dictionaries(st.text(max_size=6), VALUES, max_size=5))
@settings(max_examples=100, deadline=None)
def test_any_table_survives_writing(table: dict[str, object]) -> None:
    assert tomllib.loads(to_toml(table)) == table


@st.composite
def _keys(draw: st.DrawFn) -> tuple[str, str]:
    """A base scene and a key in it, legal or nearly so."""
    base, model = draw(st.sampled_from([(POINT, MODELS["point"]), (FIELD, MODELS["field"])]))
    sections = [*model.model_fields, "other"]
    entries = ["coordination", "stress", "0.increments", "0.target", "0.fixed.0.boundary", "file", "rectangle.nx", "x"]
    key = draw(st.sampled_from(sections))
    return base, key + draw(st.sampled_from([""] + [f".{entry}" for entry in entries]))


@given(where=_keys(), value=VALUES)
@settings(max_examples=150, deadline=None)
def test_any_value_at_any_key_is_accepted_or_refused_in_one_sentence(where: tuple[str, str], value: object) -> None:
    base, key = where
    table = tomllib.loads(base)
    path = tuple(key.split("."))
    try:
        assign(table, path, value)
        check(table, Path("own.toml"), [path])
    except InputError as error:
        assert all(line and line.isprintable() for line in str(error).split("\n"))


@given(text=st.text(max_size=60))
@settings(max_examples=100, deadline=None)
def test_any_assignment_is_parsed_or_refused_in_one_sentence(text: str) -> None:
    try:
        path, _ = parse_assignment(text)
    except InputError as error:
        assert str(error).count("\n") == 0
    else:
        assert all(path) and text.partition("=")[0].split(".")[0].strip() == path[0]


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"title = ", "not valid TOML"),
        (b"title = \xff", "not a text in UTF-8"),
        (b"a = " + b"[" * 100_000, "own.toml"),
        (b"a = " + b"9" * 10_000, "not valid TOML"),
        (b"title = 'a'", "'kind' is missing (legal: point, field, dem, specimen)"),
        (b"kind = ['point']", "unknown"),
        (b"kind = 'point'\nkind = 'point'", "not valid TOML"),
    ],
    ids=["cut", "bytes", "deep", "digits", "no kind", "list kind", "twice"],
)
def test_a_malformed_file_is_refused_in_one_sentence(tmp_path: Path, content: bytes, part: str) -> None:
    file = tmp_path / "own.toml"
    file.write_bytes(content)
    with pytest.raises(InputError) as caught:
        load(str(file))
    assert part in str(caught.value) and "own.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_assignments_reach_lists_and_make_missing_tables() -> None:
    table = tomllib.loads(POINT)
    assign(table, ("path", "0", "increments"), 9)
    assign(table, ("closure", "tangential"), "self_consistent")
    scene = check(table, Path("own.toml"))
    assert scene.path[0].increments == 9  # type: ignore[attr-defined]
    assert scene.closure.tangential == "self_consistent"
    for path in (("path", "1", "increments"), ("path", "x"), ("path", "-1"), ("title", "a")):
        with pytest.raises(InputError, match=r"--set"):
            assign(tomllib.loads(POINT), path, 1)


def test_nearest_name() -> None:
    assert nearest("cordination", [variable.name for variable in Material.variables()]) == "coordination"
    assert nearest("x", []) is None


def test_json_schema_covers_both_kinds() -> None:
    schema = json_schema()
    assert set(schema["discriminator"]["mapping"]) == set(MODELS)
    assert schema["$defs"]["MaterialSection"]["properties"]["coordination"]["maximum"] == 6.0
    assert schema["$defs"]["MaterialSection"]["additionalProperties"] is False


def test_what_a_material_file_gives_is_not_required_by_the_json_schema() -> None:
    """Editors see the scene alone: what its tables must have is there in each shipped one as it is written."""
    required = {name: json_schema()["$defs"][name]["required"] for name in ("MaterialSection", "NamedMaterialSection")}
    assert required == {"MaterialSection": [], "NamedMaterialSection": ["region"]}
    for entry in shipped().values():
        table = tomllib.loads(entry.file.read_text(encoding="utf-8"))
        for section in table.get("materials", {}).values():
            assert set(required["NamedMaterialSection"]) <= set(section)
        for key in json_schema()["$defs"][MODELS[table["kind"]].__name__]["required"]:
            assert key in table, entry.file


TWO = FIELD.replace("[material]\ncoordination = 4.06\nsolid_fraction = 0.846\nnormal_stiffness = 1e9\n", "").replace(
    "[mesh]", "[materials.a]\nregion = 'a'\n[materials.b]\nregion = 'b'\ncoordination = 3.3\n[mesh]"
)


def test_several_materials_take_from_the_file_what_they_leave_open(tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text('material_file = "measured.toml"\n' + TWO)
    measured = "[material]\ncoordination = 3.9\nsolid_fraction = 0.84\nnormal_stiffness = 1e9\n"
    (tmp_path / "measured.toml").write_text(measured + "[closure]\nslip = 1.1\n")
    scene = load(str(tmp_path / "own.toml"), ["materials.a.solid_fraction=0.8"]).scene
    assert scene.material is None and scene.closure.slip == 1.1
    assert [scene.materials[name].coordination for name in "ab"] == [3.9, 3.3]
    assert [scene.materials[name].solid_fraction for name in "ab"] == [0.8, 0.84]
    # another file takes the place of the scene's own; what each material says itself stays
    other = load(str(tmp_path / "own.toml"), ["material_file=dense_disks", "materials.a.solid_fraction=0.8"]).scene
    assert other.material is None and other.closure.slip != 1.1
    dense = read_material(MATERIALS / "dense_disks.toml")["material"]
    assert [other.materials[name].coordination for name in "ab"] == [dense["coordination"], 3.3]
    assert [other.materials[name].solid_fraction for name in "ab"] == [0.8, dense["solid_fraction"]]
    (tmp_path / "measured.toml").write_text(measured.replace("0.84", "1.84"))
    with pytest.raises(InputError, match=r"measured\.toml: materials\.a\.solid_fraction = 1\.84"):
        load(str(tmp_path / "own.toml"))


def test_every_table_and_key_is_described() -> None:
    schema = json_schema()
    bare = [name for name, table in schema["$defs"].items() if not table.get("description")]
    bare += [
        f"{name}.{key}"
        for name, table in schema["$defs"].items()
        for key, entry in table.get("properties", {}).items()
        if not entry.get("description")
    ]
    assert not bare


def test_the_shipped_schema_is_current() -> None:
    message = "renew it with: granfabric schema > cases/scenes/schema.json"
    assert SCHEMA.read_text(encoding="utf-8") == schema_text(), message


@pytest.mark.parametrize(
    ("assignment", "parts"),
    [
        ("mesh.refine=0", ["mesh.refine", "[1, 64]"]),
        (
            "mesh.ring={inner_radius=2.0, outer_radius=1.0, n_radial=2, n_around=2}",
            ["outer_radius = 1", "inner_radius"],
        ),
        ("stage.0.closed_form=[{boundary='top'}]", ["no [closed_form]"]),
        ("closed_form.hole_in_plate={radius=-1.0}", ["closed_form.hole_in_plate.radius", "(0, inf)"]),
        ("closed_form.line=[[0.0, 0.0], [1.0, 0.0]]", ["exactly one of", "hole_in_plate"]),
        ("random_state={seed=1, standard_deviation=0.1}", ["random_state.correlation_length", "is missing"]),
        ("output.maps=['pressure']", ["mean_pressure"]),
    ],
)
def test_field_sections_are_refused_with_a_sentence(assignment: str, parts: list[str]) -> None:
    sentence = refused(FIELD, assignment)
    assert "\n" not in sentence
    for part in parts:
        assert part in sentence, sentence


def test_a_key_of_another_program_is_told_once() -> None:
    """The key that takes its place is missing because of it."""
    said = refused(FIELD, "stage.0.displacement=[{boundary='top', direction='y', value=-1e-6}]")
    assert "'direction' is unknown" in said and said.endswith("the nearest is 'component' (x or y)")


def test_counterparts_exist() -> None:
    keys = {*MaterialSection.model_fields, *StageSection.model_fields, *DisplacementLoad.model_fields}
    assert {key for key, _ in COUNTERPARTS.values()} <= keys and not keys & set(COUNTERPARTS)

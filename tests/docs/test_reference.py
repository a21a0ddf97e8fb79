"""The reference leaves nothing out: keys, commands, files, columns, state variables, modules."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from granfabric.cases.scene.catalogue import shipped
from granfabric.cases.scene.schema import MODELS, json_schema
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Material, ParameterError
from pages import api, catalogue, commands, files, scene_keys, state
from pages.sources import HOME, ROOMS, things


def text_of(pages: dict[str, str]) -> str:
    return "\n".join(pages.values())


def keys_of(model: Any) -> set[str]:
    """Names of all keys of a model and of the models below it, found by pydantic and not by the schema."""
    from pydantic import BaseModel

    found: set[str] = set()

    def inner(annotation: Any) -> None:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            found.update(keys_of(annotation))
        for part in getattr(annotation, "__args__", ()):
            inner(part)

    for name, entry in model.model_fields.items():
        found.add(name)
        inner(entry.annotation)
    return found


@pytest.mark.parametrize("kind", sorted(MODELS))
def test_every_key_of_a_scene_has_a_row(kind: str) -> None:
    text = text_of(scene_keys.pages())
    assert {name.rsplit(".", 1)[-1] for name in scene_keys.keys(kind)} == keys_of(MODELS[kind])
    for name in scene_keys.keys(kind):
        assert f"| `{name.rsplit('.', 1)[-1]}` |" in text


def real(entry: dict[str, Any]) -> bool:
    if entry.get("type") == "array":
        return real(entry.get("items", {}))
    return entry.get("type") == "number" or any(real(option) for option in entry.get("anyOf", ()))


def test_every_real_number_of_a_scene_has_a_unit_and_every_key_a_meaning() -> None:
    for name, definition in json_schema()["$defs"].items():
        for key, entry in definition.get("properties", {}).items():
            assert not real(entry) or entry.get("unit"), f"{name}.{key} has no unit"
            assert entry.get("description"), f"{name}.{key} has no meaning"


def test_bounds_that_the_schema_tells_are_those_that_are_held() -> None:
    definitions = json_schema()["$defs"]
    for section, declaration in (("ClosureSection", Closure), ("IntegrationSection", Integration)):
        for key, entry in definitions[section]["properties"].items():
            if entry.get("type") not in ("number", "integer"):
                continue
            for bound, beyond in (("minimum", -1), ("maximum", 1)):
                declaration(**{key: entry[bound]})
                with pytest.raises(ParameterError):
                    declaration(**{key: entry[bound] + beyond * (1 if entry["type"] == "integer" else 1e-3)})


def test_a_row_has_type_unit_bounds_default_and_meaning() -> None:
    text = scene_keys.pages()["generated/reference/scene_law"]
    (row,) = [line for line in text.splitlines() if line.startswith("| `force_density_at_zero`")]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[:5] == ["`force_density_at_zero`", "number", "-", "≥ 0, ≤ 10", "`0.5`"]
    assert "P0" in cells[5]


def test_every_command_and_option_is_listed() -> None:
    from typer.testing import CliRunner

    from granfabric.cases.commands.cli import app

    text = text_of(commands.pages())
    assert {"run", "point", "dem", "verify", "cost", "scenes", "plot"} <= set(commands.names())
    for name in commands.names():
        assert f"## granfabric {name}" in text
        shown = CliRunner().invoke(app, [*name.split(), "--help"]).stdout
        for word in shown.split():
            if word.startswith("--") and word not in ("--help", "--"):
                assert word.strip(",.") in text, f"{name} {word}"


def test_every_file_of_a_run_is_told() -> None:
    text = text_of(files.pages())
    for name in files.own_files():
        assert name in files.meanings(), f"{name}: add what it is to docs/_extensions/pages/files.toml"
        assert f"| `{name}` |" in text


def test_every_state_variable_is_told_with_what_it_is_carried_for() -> None:
    text = text_of(state.pages())
    law = ContactLaw(
        [Material(coordination=4.0, solid_fraction=0.85, normal_stiffness=1e9)],
        Closure(force_change="shifted_distribution"),
        Effects(**dict.fromkeys(Effects.names(), True)),
    )
    for variable in law.description.state:
        assert f"| `{variable.name}` |" in text
    assert state.carried_for("coordination") == "always"
    assert state.carried_for("plastic_shear_strain") == "`effects.sliding`"
    assert "shifted_distribution" in state.carried_for("force_shift")


def test_every_scene_is_in_the_gallery_with_its_text_and_a_picture() -> None:
    pages = catalogue.pages()
    for name, entry in shipped().items():
        if entry.file.parent.name.startswith("effects"):
            continue
        assert entry.file.read_text(encoding="utf-8").rstrip() in pages[f"generated/catalogue/{name}"]
        assert catalogue.pictures(name), f"python docs/scene_figures.py results/scenes {name}"
        assert f":link: {name}\n" in pages["generated/catalogue/index"]


def test_every_module_and_public_name_has_a_page() -> None:
    pages = api.pages()
    text = text_of(pages)
    for package, folder in ROOMS.items():
        sources = [file for file in (HOME / folder).rglob("*.py") if file.stem not in ("__main__", "__init__")]
        names = {thing.name for thing in things(package) if thing.kind == "module"}
        assert len(names & {_module_name(file, package, folder) for file in sources}) == len(sources)
        for name in names - {package}:
            assert f"`{name}`" in text
        for thing in things(package):
            if thing.kind in ("class", "function") and package != "granfabric.cases":
                assert f":: {thing.name}\n" in text


def _module_name(file: Path, package: str, folder: str) -> str:
    return ".".join([package, *file.relative_to(HOME / folder).with_suffix("").parts])

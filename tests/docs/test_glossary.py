"""One table of names: nothing that the code or a file calls by a name is missing, and nothing in it is made up."""

from __future__ import annotations

import fnmatch

import pytest

from granfabric.constitutive.contract import Variable
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, Material
from granfabric.fem.output.fields import point_fields
from pages import glossary
from pages.sources import things


@pytest.mark.parametrize("kind", ["point", "field", "dem", "specimen"])
def test_every_column_of_a_history_is_in_the_glossary(kind: str) -> None:
    missing = set(glossary.columns()[kind]) - glossary.file_names()
    assert not missing, f"add {sorted(missing)} to docs/_extensions/pages/glossary.toml"


def test_every_state_variable_and_parameter_is_in_the_glossary() -> None:
    names = {
        *(variable.name for variable in glossary.all_state_variables()),
        *(variable.name for variable in Material.variables()),
        *CLOSURE_NUMBERS,
    }
    assert not names - glossary.code_names()


def test_state_variables_are_arrays_of_their_name_in_files() -> None:
    names = {variable.name for variable in glossary.all_state_variables()}
    assert names <= glossary.file_names()
    assert callable(point_fields)


def test_no_name_in_the_glossary_is_made_up() -> None:
    functions = {thing.name.removeprefix("granfabric.constitutive.") for thing in things("granfabric.constitutive")}
    assert not glossary.code_names() - glossary.legal_code_names() - functions
    columns = {name for kind in glossary.columns().values() for name in kind}
    arrays = {
        *(variable.name for variable in glossary.all_state_variables()),
        *("stress", "strain", "displacement", "status", "effective_stress", "radius", "contacts"),
        *("bears_force", "pressure"),
        *("normal_force", "tangential_force", "mobilisation"),
        "load_factor",  # of runs with a control
    }
    for name in glossary.file_names():
        pattern = name.endswith("*")
        assert pattern or name in columns | arrays, name
        assert not pattern or name in ("displacement_*", "reaction_*", "rigid_*", "spring_*")


def test_every_entry_has_a_meaning_and_every_quantity_a_unit() -> None:
    for section in glossary.sections():
        for entry in section["quantity"]:
            assert entry["meaning"], entry
            assert entry["unit"] or section["title"] == "Counters of a run" or entry["files"] == ["dem_steps"], entry


def test_units_are_those_of_the_declarations() -> None:
    known: dict[str, Variable] = glossary.declared()
    for section in glossary.sections():
        for entry in section["quantity"]:
            for name in entry["code"]:
                if name in known:
                    assert entry["unit"] == known[name].unit, name


def test_field_columns_of_boundaries_are_covered() -> None:
    assert any(fnmatch.fnmatch("displacement_top_y", name) for name in glossary.file_names())
    assert any(fnmatch.fnmatch("reaction_top_y", name) for name in glossary.file_names())

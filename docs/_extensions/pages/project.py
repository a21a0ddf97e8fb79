"""Everything the pages take from the program, imported in one place."""

from __future__ import annotations

import typer.main

from granfabric.cases.commands.cli import app
from granfabric.cases.commands.convergence import COLUMNS as CONVERGENCE_COLUMNS
from granfabric.cases.fit.report import ROW_COLUMNS as DATA_COLUMNS
from granfabric.cases.records import files
from granfabric.cases.records.field_history import COUNTS, LEADING, MEANS
from granfabric.cases.records.pore_columns import PORE
from granfabric.cases.scene.catalogue import shipped
from granfabric.cases.scene.schema import json_schema
from granfabric.cases.verify.map.compare import CURVE_COLUMNS, MAP_COLUMNS
from granfabric.cases.verify.table import COLUMNS as VERIFY_COLUMNS
from granfabric.constitutive.contract import LawDescription, Variable
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.parameters import CLOSURE_NUMBERS, INTEGRATION_NUMBERS, Closure, Material
from granfabric.constitutive.path import POINT_COLUMNS, PORE_COLUMNS, SLIDING_COLUMNS
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial
from granfabric.constitutive.state import state_variables
from granfabric.dem_ref.loading.run import HISTORY_COLUMNS as DEM_COLUMNS
from granfabric.dem_ref.specimen.history import COLUMNS as SPECIMEN_COLUMNS

__all__ = [
    "CLOSURE_NUMBERS",
    "CONVERGENCE_COLUMNS",
    "COUNTS",
    "CURVE_COLUMNS",
    "DATA_COLUMNS",
    "DEM_COLUMNS",
    "INTEGRATION_NUMBERS",
    "LEADING",
    "MAP_COLUMNS",
    "MEANS",
    "POINT_COLUMNS",
    "PORE",
    "PORE_COLUMNS",
    "SLIDING_COLUMNS",
    "SPECIMEN_COLUMNS",
    "VERIFY_COLUMNS",
    "Closure",
    "Effects",
    "ElasticMaterial",
    "LawDescription",
    "LinearElasticLaw",
    "Material",
    "Variable",
    "VonMisesLaw",
    "VonMisesMaterial",
    "command_group",
    "files",
    "json_schema",
    "shipped",
    "state_variables",
]


def command_group():
    """The command line as click knows it."""
    return typer.main.get_command(app)

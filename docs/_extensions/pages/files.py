"""Files of a result folder, and the columns of those that are tables."""

from __future__ import annotations

import tomllib
from pathlib import Path

from . import glossary
from .markdown import code, page, table
from .project import (
    CONVERGENCE_COLUMNS,
    CURVE_COLUMNS,
    DATA_COLUMNS,
    MAP_COLUMNS,
    VERIFY_COLUMNS,
    files,
)

DATA = Path(__file__).with_name("files.toml")
TEMPORARY = (".part",)
"""Endings of files that exist only while another is written."""


def own_files() -> list[str]:
    """Names of all files that the program knows as its own, as it knows them."""
    patterns = [name for name in (*files.CHECKPOINTS, *files.OF_MAP) if not name.startswith(".")]
    return [name for name in (*files.OWN_FILES, *patterns) if not name.endswith(TEMPORARY)]


def meanings() -> dict[str, dict[str, str]]:
    """What each file is."""
    return tomllib.loads(DATA.read_text(encoding="utf-8"))["files"]


def _columns(names: tuple[str, ...]) -> str:
    return table(("column", "unit", "meaning"), [(code(name), *reversed(glossary.meaning_of(name))) for name in names])


def pages() -> dict[str, str]:
    """One page."""
    known, own = meanings(), own_files()
    rows = [(code(name), known[name]["from"], known[name]["meaning"]) for name in known if name in own]
    columns = glossary.columns()
    arrays = [(code(entry.name), entry.unit, entry.meaning) for entry in glossary.all_state_variables()]
    return {
        "generated/reference/files": page(
            "# Files and columns",
            "A result folder belongs to one run. Files are written under another name and put in place in one step, so "
            "that what is there under its final name is whole.",
            table(("file", "written by", "what it is"), rows),
            "## history.csv of a point",
            "One row an increment, the start included. The last columns are there with `effects.sliding`.",
            _columns(columns["point"]),
            "## history.csv of a field",
            "One row a load step, the initial state included. Stresses and strains are volume averages; p and q belong "
            "to the mean stress. For each boundary that carries loads or supports two columns "
            "`displacement_NAME_x`, `displacement_NAME_y` [m] hold the mean displacement of its nodes, and for each "
            "that is supported `reaction_NAME_x`, `reaction_NAME_y` [N/m] the force of the supports on the body.",
            _columns(columns["field"]),
            "## history.csv of a DEM run",
            "One row a record. Gained, lost and persisting parts are added up over the records.",
            _columns(columns["dem"]),
            "## Arrays of `result_*.vtu` and `points_*.vtu`",
            "`displacement`, `stress` and `strain`, and every state variable that the law carries ({doc}`state`): at "
            "the nodes, projected, in `result_*.vtu`; at the integration points in `points_*.vtu`, with `status`. "
            "Vectors have three components and tensors nine, so that ParaView draws them; shear strains are tensor "
            "components. Of a run on several ranks `result_STEP.pvtu` names pieces `result_STEP_RANK.vtu`, whose array "
            "`node` holds numbers of nodes in the whole mesh; points alike.",
            table(("array", "unit", "meaning"), arrays),
            "## Arrays of `particles_*.vtu` and `contacts_*.vtu`",
            "`radius`, `contacts`, `bears_force`, `pressure` and `displacement` of each particle; `normal_force`, "
            "`tangential_force` and `mobilisation` of each contact: {doc}`glossary`.",
            "## Tables of verify, convergence and fit",
            "Columns of `verify.csv`: " + ", ".join(code(name) for name in VERIFY_COLUMNS) + ".",
            "Columns of `map.csv` ({py:class}`~granfabric.cases.verify.map.compare.MapRow`): "
            + ", ".join(code(name) for name in MAP_COLUMNS)
            + ".",
            "Columns of `map_curves.csv`: " + ", ".join(code(name) for name in CURVE_COLUMNS) + ", and one a closure.",
            "Columns of the table of `granfabric convergence`: "
            + ", ".join(code(name) for name in CONVERGENCE_COLUMNS)
            + ", and the order of the displacement.",
            "Columns of `fit.csv` and `data.csv`: " + ", ".join(code(name) for name in DATA_COLUMNS) + ".",
        )
    }

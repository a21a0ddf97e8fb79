"""`accuracy` in a scene: one number, or a word, instead of integrator, tolerances and directions.

The settings were read off the fronts that `granfabric cost` measures (studies `integrators` and `arcs`: 512 points,
strain paths of 1e-4 at kn/p = 1e4 in a single increment; largest error over all points of stress over p, z relative
and a_c, mean field and shifted distribution, whichever has the larger error). Bogacki-Shampine 3(2) lies on or next to
the front everywhere and keeps its word: its largest error was at most 2.6 times its tolerance, and 12 times with the
memory of tangential forces, whose slip classes close one after the other. Dormand-Prince takes fewer evaluations on
smooth paths, but where an arc of loss closes within a substep its error is up to 300 times the tolerance; the
implicit pair takes about three times as many for the same error. Newton's residual adds less than itself to the means
(study `tangents`); it gets a hundredth. Load steps are chosen where a stage does not say its `increments`: their
error falls with the square of their number, from 4e-6 with a single one in the biaxial test (study `load_steps`). A
stage that turns within itself needs more, which the estimate of the run shows. A leg of a point's path that turns the
principal axes is a circle in stress space followed by its chords, and gets `turning_increments`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

from granfabric.cases.errors import nearest
from granfabric.constitutive.parameters import Integrator

FINEST, COARSEST = 1e-8, 1e-2
NAMED = {"quick": 1e-3, "standard": 1e-5, "reference": 1e-8}


def _check(value: Any) -> Any:
    if isinstance(value, str) and value not in NAMED:
        raise ValueError(
            f"{value!r} is not one of {', '.join(NAMED)}, nor a number in [{FINEST:g}, {COARSEST:g}]; the nearest is "
            f"{nearest(value, NAMED)!r}"
        )
    if not isinstance(value, str) and not (isinstance(value, float) and FINEST <= value <= COARSEST):
        raise ValueError(f"{value!r} is neither a number in [{FINEST:g}, {COARSEST:g}] nor one of {', '.join(NAMED)}")
    return value


Accuracy = Annotated[float | Literal["quick", "standard", "reference"], BeforeValidator(_check)]
"""What a scene may say."""


@dataclass(frozen=True)
class Settings:
    """Numerics that meet an accuracy, with the error that was measured with them.

    Parameters
    ----------
    accuracy : float
        Largest error that they are meant for.
    integrator : str
    tolerance : float
    directions : int
        On each arc, for closures without closed form; see `directions_for`.
    solver_tolerance : float
        Residual of Newton's method over nodal forces.
    load_steps : int
        Increments of a stage that leaves them open.
    measured : float
        Largest error of the point law on the paths of the studies, by the integrator or by the directions, whichever
        has the larger error.
    """

    accuracy: float
    integrator: Integrator
    tolerance: float
    directions: int
    solver_tolerance: float
    load_steps: int
    measured: float

    def directions_for(self, force_change: Any) -> int:
        """`integration.directions` of a closure: twice as many for one that takes half of them around the circle."""
        return self.directions if force_change in ("mean_field", "fluctuating") else 2 * self.directions


TABLE = (
    Settings(1e-2, "bogacki_shampine", 1e-2, 8, 1e-4, 2, 3.8e-4),
    Settings(1e-3, "bogacki_shampine", 1e-3, 8, 1e-5, 2, 3.8e-4),
    Settings(1e-4, "bogacki_shampine", 1e-5, 16, 1e-6, 4, 2.5e-5),
    Settings(1e-5, "bogacki_shampine", 1e-6, 16, 1e-7, 8, 9.2e-7),
    Settings(1e-6, "bogacki_shampine", 1e-8, 16, 1e-8, 16, 6.6e-8),
    Settings(1e-8, "bogacki_shampine", 1e-9, 32, 1e-10, 64, 1.2e-9),
)
"""Cheapest settings on the measured fronts, coarsest first."""


@dataclass(frozen=True)
class Choice:
    """What `accuracy` made of a scene.

    Parameters
    ----------
    wanted : float
    settings : Settings
    chosen : dict of str to value
        Keys that were filled in.
    kept : dict of str to value
        Keys that the scene set itself, otherwise than `accuracy` would have done; these won.
    """

    wanted: float
    settings: Settings
    chosen: dict[str, Any]
    kept: dict[str, Any]

    def text(self) -> str:
        """What was chosen, in one line."""
        parts = [f"{_counted(key)} = {value}" for key, value in self.chosen.items()]
        said = f"accuracy {self.wanted:g}: " + (", ".join(parts) or "nothing left to choose")
        if self.kept:
            kept = ", ".join(f"{_counted(key)} = {value}" for key, value in self.kept.items())
            said += f"; kept as the scene sets it: {kept}"
        return said


def _counted(key: str) -> str:
    """A key with its entries counted from 1: ``stage 2: increments``."""
    return re.sub(r"^(\w+)\.(\d+)\.", lambda found: f"{found[1]} {int(found[2]) + 1}: ", key)


def settings_for(wanted: float) -> Settings:
    """The coarsest row of the table that is at least as accurate as wanted."""
    fitting = [row for row in TABLE if row.accuracy <= wanted * (1.0 + 1e-12)]
    return fitting[0] if fitting else TABLE[-1]


TURN_ERROR = 0.04
"""Error of a whole circle followed in chords, over the square of the angle of one in the double-angle plane.

Measured on `axes_rotation` (q/p = 0.2): 0.019 with the mean field, 0.0026 with the shifted distribution, for 6 to 96
chords alike; doubled for larger stress ratios.
"""


def turning_increments(degrees: float, accuracy: float) -> int:
    """Increments of a leg that turns the principal axes, for half of the accuracy; the other half is the integrator's.

    The error of an arc is in proportion to its length and to the square of its chords.
    """
    angle = 2.0 * math.radians(abs(degrees))
    return max(1, math.ceil(angle * math.sqrt(TURN_ERROR * angle / (2.0 * math.pi) / (0.5 * accuracy))))


def apply(table: dict[str, Any]) -> Choice | None:
    """Fill the keys of a scene's table that `accuracy` decides and the scene leaves open.

    Returns
    -------
    Choice or None
        None if the scene does not ask for an accuracy, or asks for something that the check of the scene refuses.
    """
    said = table.get("accuracy")
    wanted = NAMED.get(said) if isinstance(said, str) else said
    if not isinstance(wanted, float) or not FINEST <= wanted <= COARSEST or table.get("kind") not in ("point", "field"):
        return None
    row = settings_for(wanted)
    closure = table.get("closure", {})
    force_change = closure.get("force_change") if isinstance(closure, Mapping) else None
    decided: list[tuple[str, str, Any]] = [
        ("integration", "integrator", row.integrator),
        ("integration", "tolerance", row.tolerance),
        ("integration", "directions", row.directions_for(force_change)),
    ]
    if table["kind"] == "field":
        decided.append(("solver", "tolerance", row.solver_tolerance))
    integration = table.get("integration", {})
    if isinstance(integration, Mapping) and integration.get("substeps"):
        # a fixed number of substeps is a choice of its own, which has no tolerance
        decided = [
            entry for entry in decided if entry[1] not in ("integrator", "tolerance") or entry[0] != "integration"
        ]
    chosen: dict[str, Any] = {}
    kept: dict[str, Any] = {}
    chosen |= _choose_increments(table, row)
    if isinstance(integration, Mapping) and integration.get("substeps"):
        kept["integration.substeps"] = integration["substeps"]
    for section, key, value in decided:
        own = table.setdefault(section, {})
        if not isinstance(own, dict):
            return None
        if key not in own:
            own[key] = value
            chosen[f"{section}.{key}"] = value
        elif own[key] != value:
            kept[f"{section}.{key}"] = own[key]
    return Choice(wanted, row, chosen, kept)


def _choose_increments(table: dict[str, Any], row: Settings) -> dict[str, int]:
    """Fill in the increments that stages, or turning legs of a path, leave open."""
    chosen: dict[str, int] = {}
    section = "stage" if table["kind"] == "field" else "path"
    parts = table.get(section, [])
    for place, part in enumerate(parts if isinstance(parts, list) else []):
        if not isinstance(part, dict) or "increments" in part:
            continue
        turn = part.get("rotation_degrees")
        if section == "path":
            # a straight leg needs none: the integrator takes what substeps it needs
            if not isinstance(turn, (int, float)) or isinstance(turn, bool) or not math.isfinite(turn):
                continue
            part["increments"] = turning_increments(turn, row.accuracy)
        elif place == 0 and part.get("name") == "initial":
            continue  # in balance at once
        else:
            part["increments"] = row.load_steps
        chosen[f"{section}.{place}.increments"] = part["increments"]
    return chosen

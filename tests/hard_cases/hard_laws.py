"""Every law that can be asked for, as the declarations name it at run time, and many points along paths at once."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields, replace
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Integrator, Material, ParameterError

PRESSURE = 1e5
"""[Pa]; kn/p = 1e4 as in the source."""


def material(**changes: float) -> Material:
    """The source's packing."""
    return Material(**{"coordination": 4.06, "solid_fraction": 0.846, "normal_stiffness": 1e9, **changes})


def _choices(declaration: type) -> dict[str, tuple]:
    """Choices of a declaration by name: what is a `Literal` there."""
    hints = get_type_hints(declaration)
    return {entry.name: get_args(hints[entry.name]) for entry in fields(declaration) if get_args(hints[entry.name])}


def closures() -> list[Closure]:
    """All combinations of choices."""
    found = _choices(Closure)
    made = []
    for values in itertools.product(*found.values()):
        try:
            made.append(Closure(**dict(zip(found, values, strict=True))))
        except ParameterError:
            continue  # a combination that is refused by name
    plain = Closure()

    def same_law(closure: Closure) -> tuple:
        """The shifted distribution has a directional density of its own, and its own rule where a_t is left open."""
        closure = replace(closure, tangential=closure.tangential_rule)
        if closure.force_change == "shifted_distribution":
            closure = replace(closure, distribution=plain.distribution)
        return tuple(getattr(closure, name) for name in found)

    return list({same_law(closure): closure for closure in reversed(made)}.values())[::-1]


def integrations(tolerance: float = 1e-6, substeps: int = 64, most: int = 2000) -> list[Integration]:
    """One for each integrator: with error control, or with fixed substeps where it has none."""
    made = []
    for name in get_args(Integrator):
        try:
            made.append(Integration(integrator=name, tolerance=tolerance, maximum_substeps=most))
        except ParameterError:
            made.append(Integration(integrator=name, substeps=substeps))
    return made


def each_closure() -> list:
    """Parameters of a test: every closure."""
    return [pytest.param(closure, id=name_of(closure)) for closure in closures()]


def each_integration() -> list:
    """Parameters of a test: every integrator, those that are not the default in the slow run."""
    default = Integration().integrator
    return [
        pytest.param(each, id=name_of(each), marks=() if each.integrator == default else pytest.mark.slow)
        for each in integrations()
    ]


def effect_sets() -> list[Effects]:
    """All subsets of the effects."""
    names = Effects.names()
    return [Effects(**dict(zip(names, on, strict=True))) for on in itertools.product((True, False), repeat=len(names))]


def make_law(
    closure: Closure | None = None,
    integration: Integration | None = None,
    effects: Effects | None = None,
    materials: list[Material] | None = None,
) -> ContactLaw | None:
    """The law, None where it is refused by name."""
    try:
        return ContactLaw(materials or [material()], closure, effects, integration)
    except ParameterError:
        return None


def name_of(thing: Any) -> str:
    """Test id: the values that are choices, and what is on."""
    if isinstance(thing, Effects):
        return "+".join(name for name in Effects.names() if getattr(thing, name)) or "none"
    if isinstance(thing, Integration):
        return thing.integrator
    return "-".join(str(getattr(thing, name)) for name in _choices(type(thing)))


@dataclass
class Trail:
    """Points along their paths: arrays with one row an increment, the start included.

    A point that fails stays where it was, and its status stays.
    """

    law: ContactLaw
    stress: np.ndarray
    state: np.ndarray
    strain: np.ndarray
    status: np.ndarray
    substeps: np.ndarray
    every: int = 1

    def get(self, name: str) -> np.ndarray:
        """A state variable, (steps, npt) or (steps, npt, components)."""
        values = self.state[:, :, self.law.description.columns(name)]
        return values[:, :, 0] if values.shape[2] == 1 else values

    @property
    def pressure(self) -> np.ndarray:
        """Mean pressure, compression positive."""
        return -0.5 * (self.stress[..., 0] + self.stress[..., 1])

    @property
    def ratio(self) -> np.ndarray:
        """q/p."""
        half = 0.5 * (self.stress[..., 0] - self.stress[..., 1])
        return np.hypot(half, self.stress[..., 2]) / self.pressure


def follow(
    law: ContactLaw,
    start: np.ndarray,
    increments: np.ndarray,
    control: Any = (1, 1, 1),
    state: np.ndarray | None = None,
    material_index: np.ndarray | None = None,
    every: int = 1,
) -> Trail:
    """Drive points along increments of stress (control 1) or strain (control 0).

    Parameters
    ----------
    start : ndarray, shape (npt, 3)
    increments : ndarray, shape (steps, npt, 3)
    control : array_like, shape (3,) or (npt, 3)
    every : int
        Rows kept: each so many increments.
    """
    stress = np.ascontiguousarray(np.broadcast_to(start, increments.shape[1:]), dtype=float).copy()
    now = law.initial_state(stress, material_index) if state is None else state.copy()
    control = np.broadcast_to(np.array(control, dtype=np.uint8), stress.shape).copy()
    strain, status = np.zeros_like(stress), np.zeros(len(stress), dtype=np.int8)
    substeps = np.zeros(len(stress), dtype=np.int64)
    rows: list[tuple] = [(stress.copy(), now.copy(), strain.copy(), status.copy(), substeps.copy())]
    ends = [np.empty_like(stress), np.empty_like(now), np.empty_like(stress)]
    for number, increment in enumerate(increments, start=1):
        given = np.ascontiguousarray(np.where((status > Status.LIMITED)[:, None], 0.0, increment))
        report = law.update_mixed(control, given, stress, now, *ends[:2], ends[2], material_index)
        stress, ends[0] = ends[0], stress
        now, ends[1] = ends[1], now
        strain = strain + ends[2]
        status = np.maximum(status, report.status)
        substeps = substeps + report.substeps
        if number % every == 0 or number == len(increments):
            rows.append((stress.copy(), now.copy(), strain.copy(), status.copy(), substeps.copy()))
    return Trail(law, *(np.array(column) for column in zip(*rows, strict=True)), every=every)


def assert_sound(trail: Trail) -> None:
    """What holds on every path: finite, admissible, and a refused point is where it was before."""
    for array in (trail.stress, trail.state, trail.strain):
        assert np.isfinite(array).all()
    assert set(np.unique(trail.status)) <= {int(status) for status in Status}
    assert (trail.pressure[1:] > 0).all() or (trail.status[-1][trail.pressure[-1] <= 0] > Status.LIMITED).all()
    assert (trail.get("coordination") > 0).all()
    fabric = trail.state[:, :, trail.law.description.columns("fabric_anisotropy")]
    assert (np.linalg.norm(fabric, axis=2) < 2.0).all()
    failed = trail.status > Status.LIMITED
    stopped = failed[1:] if trail.every == 1 else failed[:-1]
    for array in (trail.stress, trail.state, trail.strain):
        assert np.array_equal(array[1:][stopped], array[:-1][stopped])


def stress_of(p: Any, s1: Any = 0.0, s2: Any = 0.0) -> np.ndarray:
    """Stress (..., 3) [Pa], tension positive, of pressure and stress-ratio vector."""
    p, s1, s2 = np.broadcast_arrays(np.asarray(p, dtype=float), s1, s2)
    return np.stack([-p * (1 + s1), -p * (1 - s1), -p * s2], axis=-1)


def steps_to(targets: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Increments that pass through the targets (steps, npt, 3), beginning at `start`."""
    return np.diff(np.concatenate([np.broadcast_to(start, targets.shape[1:])[None], targets]), axis=0)

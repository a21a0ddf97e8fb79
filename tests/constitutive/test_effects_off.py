"""An effect that is off costs nothing: no column, no parameter, no call; the bits are those of a law without it.

Counted, not timed. Parameters and closure numbers of what is off are poisoned with NaN, which any operation would
spread. In an interpreter without compilation the kernels of what is off are replaced by functions that raise.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material

ROOT = Path(__file__).resolve().parents[2]
PACKING = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9, shear_reduction=0.69)
OWN_PARAMETERS = {
    "contact_loss": ("force_density_at_zero", "force_density_slope"),
    "contact_gain": ("gap_density_at_zero", "neighbours"),
    "pore_fluid": ("fluid_bulk_stiffness", "fluid_porosity"),
    "sliding": (
        *("peak_stress_ratio", "first_yield_stress_ratio", "reference_plastic_strain", "dilatancy"),
        *("constant_volume_stress_ratio", "apparent_cohesion"),
    ),
}
"""Parameters of a material that nothing but the effect needs."""
OWN_COLUMNS = {
    "contact_loss": ("coordination_lost", "fabric_lost"),
    "contact_gain": ("coordination_gained", "fabric_gained"),
    "irreversible_spread": ("force_spread",),
    "sliding": ("plastic_shear_strain",),
    "pore_fluid": ("pore_pressure",),
}
MEMORY_COLUMNS = ("force_shift", "force_shift_anisotropy")
OFF = [name for name in OWN_PARAMETERS if name in Effects.names()]
CLOSURES = {"mean_field": Closure(), "shifted": Closure(force_change="shifted_distribution")}


def went(law: ContactLaw) -> tuple[bytes, bytes, bytes]:
    """Stress, state and tangent after a few increments that load, turn and unload, as bits."""
    npt = 5
    rng = np.random.default_rng(3)
    stress = np.repeat([[-1e5, -1.1e5, 0.0]], npt, axis=0)
    state = law.initial_state(stress)
    tangent = np.zeros((npt, 3, 3))
    for sign in (1.0, 1.0, -0.6):
        increment = sign * (np.array([4e-6, -1.2e-5, 5e-6]) + rng.uniform(-2e-6, 2e-6, (npt, 3)))
        stress_end, state_end = np.empty_like(stress), np.empty_like(state)
        report = law.update(increment, stress, state, stress_end, state_end, tangent)
        assert not report.failed, report.message
        stress, state = stress_end, state_end
    assert np.isfinite(stress).all() and np.isfinite(tangent).all()
    return stress.tobytes(), state.tobytes(), tangent.tobytes()


def poisoned(law: ContactLaw, names: tuple[str, ...]) -> ContactLaw:
    """The law with NaN in place of some of its materials' parameters; the table is what kernels see."""
    columns = [variable.name for variable in Material.variables()]
    for name in names:
        law._table[:, columns.index(name)] = np.nan
    return law


@pytest.mark.parametrize("closure", CLOSURES)
@pytest.mark.parametrize("name", OFF)
def test_no_parameter_is_read(name: str, closure: str) -> None:
    effects = replace(Effects(), **{name: False})
    if name == "contact_loss" and closure == "shifted":
        effects = replace(effects, contact_gain=True)
    clean = ContactLaw([PACKING], CLOSURES[closure], effects)
    dirty = poisoned(ContactLaw([PACKING], CLOSURES[closure], effects), OWN_PARAMETERS[name])
    assert went(clean) == went(dirty)


def test_poison_is_noticed_where_the_effect_is_on() -> None:
    """The test above can fail."""
    dirty = poisoned(ContactLaw([PACKING]), ("gap_density_at_zero",))
    with pytest.raises(AssertionError):
        assert went(ContactLaw([PACKING])) == went(dirty)


def test_a_network_at_rest_needs_neither_parameters_nor_closure_numbers() -> None:
    effects = Effects(contact_loss=False, contact_gain=False)
    for closure in CLOSURES.values():
        clean = ContactLaw([PACKING], closure, effects)
        dirty = poisoned(ContactLaw([PACKING], closure, effects), OWN_PARAMETERS["contact_loss"])
        dirty = poisoned(dirty, OWN_PARAMETERS["contact_gain"])
        dirty._kernel_closure = dirty._kernel_closure._replace(chi=np.nan, c_w=np.nan)
        assert went(clean) == went(dirty)


def test_without_memory_no_number_of_the_weak_forces_is_read() -> None:
    clean, dirty = ContactLaw([PACKING]), ContactLaw([PACKING])
    dirty._kernel_closure = dirty._kernel_closure._replace(chi=np.nan, c_w=np.nan)
    assert went(clean) == went(dirty)


@pytest.mark.parametrize("name", [name for name in OWN_COLUMNS if name in Effects.names()])
def test_no_column_is_carried(name: str) -> None:
    for closure in CLOSURES.values():
        law = ContactLaw([PACKING], closure, replace(Effects(), **{name: False}))
        assert not any(law.description.has_state(column) for column in OWN_COLUMNS[name])


def test_no_column_of_memory_or_rotation_is_carried() -> None:
    law = ContactLaw([PACKING], Closure())
    assert not any(law.description.has_state(column) for column in MEMORY_COLUMNS)
    flat = ContactLaw([PACKING], Closure(), Effects(principal_rotation=False))
    assert all(variable.components == 1 for variable in flat.description.state)


PROGRAM = """
import importlib, json, sys
import numpy as np
from dataclasses import replace
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Material

off, change, stubs = json.loads(sys.argv[1])

def outcome():
    packing = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9, shear_reduction=0.69)
    effects = replace(Effects(), **{name: False for name in off})
    numerics = Integration(integrator="modified_euler", substeps=1, directions=4)
    law = ContactLaw([packing], Closure(force_change=change), effects, numerics)
    stress = np.array([[-1e5, -1.1e5, 0.0]])
    state = law.initial_state(stress)
    stress_end, state_end, tangent = np.empty_like(stress), np.empty_like(state), np.zeros((1, 3, 3))
    report = law.update(np.array([[4e-6, -1.2e-5, 5e-6]]), stress, state, stress_end, state_end, tangent)
    assert not report.failed, report.message
    return [values.tobytes().hex() for values in (stress_end, state_end, tangent)]

called = set()
def note(frame, event, argument):
    if event == "call" and "constitutive" in frame.f_code.co_filename:
        called.add(frame.f_globals["__name__"].removeprefix("granfabric.constitutive.") + " " + frame.f_code.co_name)
sys.setprofile(note)
free = outcome()
sys.setprofile(None)

def refuse(*arguments):
    raise RuntimeError("code of an effect that is off was executed")

replaced = []
for module, name in stubs:
    home = importlib.import_module("granfabric.constitutive." + module)
    original = getattr(home, name)
    for other in list(sys.modules.values()):
        if other.__name__.startswith("granfabric.constitutive") and getattr(other, name, None) is original:
            setattr(other, name, refuse)
    replaced.append(module + " " + name)
print(json.dumps({"same": outcome() == free, "replaced": replaced, "called": sorted(called)}))
"""
CHANGES = [("network.contact_change", "closed_form_change"), ("network.quadrature_change", "quadrature_change")]
MEAN_FIELD_ONLY = [("network.rates", "rates"), ("network.rates", "rate_changes"), *CHANGES]
WEAK_FORCES = [
    *(("network.weak_force_state", name) for name in ("network_at", "rates", "rate_changes", "remember")),
    *(("network.weak_force_state", "leave"), ("network.weak_force_state", "split")),
    *(("network.weak_forces", "negative_part"), ("network.weak_forces", "positive_part")),
    *(("network.shifted_distribution", "network_of"), ("network.shifted_distribution", "split_change")),
]
GAIN = [("network.contact_change", "gain_of")]
LOSS = [("network.contact_change", "loss_of"), ("network.contact_change", "loss_by_force_anisotropy")]
CASES = {
    "no gain": (["contact_gain"], "mean_field", GAIN + WEAK_FORCES),
    "no loss": (["contact_loss"], "mean_field", LOSS + WEAK_FORCES),
    "no network": (
        ["contact_loss", "contact_gain"],
        "shifted_distribution",
        CHANGES + WEAK_FORCES + GAIN + LOSS,
    ),
    "memory": ([], "shifted_distribution", MEAN_FIELD_ONLY + GAIN + LOSS),
}


@pytest.mark.parametrize("case", CASES)
def test_no_code_is_executed(case: str) -> None:
    off, change, stubs = CASES[case]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, json.dumps([off, change, stubs])],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout)
    assert told["same"]
    assert len(told["replaced"]) == len(stubs)
    assert not set(told["called"]) & set(told["replaced"])
    assert "integration.stage stage" in told["called"]

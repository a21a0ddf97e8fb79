"""Random wrong arrays at every entry of the laws: ValueError, or the right result; no second compilation ever."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wrong_arrays import (
    CODES_COPIED,
    CODES_REFUSED,
    COPIED,
    INDEX_COPIED,
    INDEX_REFUSED,
    OUTPUT_REFUSED,
    OUTPUT_TAKEN,
    REFUSED,
    SAME,
)

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.integration import points as integrate
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.network import force_fabric
from granfabric.constitutive.parameters import Closure, Integration, Material
from granfabric.constitutive.plain_laws import linear_elastic, von_mises
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial

FEW = settings(max_examples=150, deadline=None, database=None, derandomize=True)
PACKINGS = [
    Material(coordination=z, solid_fraction=0.846, normal_stiffness=1e9, initial_fabric_xx=a)
    for z, a in ((4.06, 0.0), (3.8, 0.1))
]
LAWS = {
    "mean field": ContactLaw(PACKINGS),
    "implicit": ContactLaw(PACKINGS, integration=Integration(integrator="kennedy_carpenter")),
    "shifted, sliding": ContactLaw(PACKINGS, Closure(force_change="shifted_distribution"), Effects(sliding=True)),
    "frozen stiffness": ContactLaw(PACKINGS, effects=Effects(stiffness_feedback=False, contact_gain=False)),
    "linear elastic": LinearElasticLaw([ElasticMaterial(1e9, 0.3), ElasticMaterial(2e9, 0.2)]),
    "von Mises": VonMisesLaw([VonMisesMaterial(1e9, 0.3, 2e5, 1e7), VonMisesMaterial(1e9, 0.2, 3e5)]),
}
CONTACT = [name for name in LAWS if isinstance(LAWS[name], ContactLaw)]
KERNELS = (
    integrate.update_points,
    integrate.smallest_step_factor,
    force_fabric.initial_force_fabric,
    linear_elastic._update,
    von_mises._update,
)
ENTRIES = ("update", "update_mixed", "update_stress_driven")
INPUTS = ("strain_increment", "increment", "stress_increment", "stress_start", "state_start")


def arguments_of(law, entry, npt):
    """Good arguments by name. Numbers are whole in their unit, so that other kinds of numbers hold them, too."""
    stress = np.tile([-131072.0, -98304.0, 4096.0], (npt, 1)) + 1024.0 * np.arange(npt)[:, None]
    index = np.arange(npt, dtype=np.int32) % 2
    state = law.initial_state(stress, index)
    ends = {"stress_end": np.full_like(stress, 9.0), "state_end": np.full_like(state, 9.0)}
    small = np.tile([1.0, -3.0, 2.0], (npt, 1))
    given = {"stress_start": stress, "state_start": state, **ends, "material_index": index}
    if entry == "update":
        return {"strain_increment": small * 2.0**-20, **given, "tangent": np.full((npt, 3, 3), 9.0)}
    name = "increment" if entry == "update_mixed" else "stress_increment"
    given = {name: small * 1024.0, **given, "strain_increment": np.full((npt, 3), 9.0)}
    if entry == "update_mixed":
        control = np.tile(np.array([1, 1, 0], dtype=np.uint8), (npt, 1))
        given = {"control": control, **given}
        given["increment"][:, 2] = 2.0**-20
    return given


def outputs_of(entry):
    return ("stress_end", "state_end", "tangent" if entry == "update" else "strain_increment")


def variants(name, entry):
    """Taken and refused variants of an argument."""
    if name == "material_index":
        return INDEX_COPIED, INDEX_REFUSED
    if name == "control":
        return CODES_COPIED, CODES_REFUSED
    if name in outputs_of(entry):
        optional = name == "tangent"
        return OUTPUT_TAKEN, {n: v for n, v in OUTPUT_REFUSED.items() if not (optional and n == "None")}
    return COPIED, REFUSED


def converted(value, like):
    """What the law should make of it, in the test's own words; ends are made anew."""
    return np.array(np.asarray(value).tolist(), dtype=like.dtype).reshape(like.shape)


def signatures():
    return [len(kernel.signatures) for kernel in KERNELS]


def entries():
    return [(name, entry) for name in LAWS for entry in (ENTRIES if name in CONTACT else ENTRIES[:1])]


@pytest.fixture(scope="module", autouse=True)
def compiled():
    """Every kernel once, as good arrays compile it."""
    for name, entry in entries():
        getattr(LAWS[name], entry)(**arguments_of(LAWS[name], entry, 2))
    return signatures()


@pytest.mark.parametrize(("law_name", "entry"), entries())
@FEW
@given(data=st.data())
def test_one_argument_of_another_kind(law_name, entry, data, compiled):
    law = LAWS[law_name]
    npt = data.draw(st.integers(0, 4), label="points")
    good = arguments_of(law, entry, npt)
    name = data.draw(st.sampled_from([n for n in good if good[n].size or n != "state_start"]), label="argument")
    taken, refused = variants(name, entry)
    variant = data.draw(st.sampled_from([*taken, *refused]), label="variant")
    value = (taken if variant in taken else refused)[variant](good[name])
    if value is SAME or (law_name == "linear elastic" and name.startswith("state")):
        return
    arguments = {**good, name: value}
    if variant not in taken:
        before = {n: a.copy() for n, a in good.items()}
        with pytest.raises(ValueError, match=name):
            getattr(law, entry)(**arguments)
        for n in good:
            assert np.array_equal(good[n], before[n]), n
        assert signatures() == compiled
        return
    reference = {n: np.full_like(a, 9.0) if n in outputs_of(entry) else a.copy() for n, a in good.items()}
    if name not in outputs_of(entry):
        reference[name] = converted(value, good[name])
    kept = converted(value, good[name])
    wanted = getattr(law, entry)(**reference)
    report = getattr(law, entry)(**arguments)
    assert np.array_equal(report.status, wanted.status)
    for n in outputs_of(entry):
        assert np.array_equal(np.asarray(arguments[n]), reference[n])
    if name not in outputs_of(entry):
        assert np.array_equal(converted(value, good[name]), kept), "an array that is only read was written"
    assert signatures() == compiled


@pytest.mark.parametrize(("law_name", "entry"), entries())
@FEW
@given(data=st.data())
def test_values_that_are_no_state_of_grains(law_name, entry, data):
    """NaN, infinity and enormous numbers anywhere: a status, start values, and nothing infinite with status OK."""
    law = LAWS[law_name]
    arguments = arguments_of(law, entry, 3)
    names = [n for n in INPUTS if n in arguments and n not in outputs_of(entry) and arguments[n].size]
    for _ in range(data.draw(st.integers(1, 3))):
        array = arguments[data.draw(st.sampled_from(names))]
        place = data.draw(st.integers(0, array.size - 1))
        array.flat[place] = data.draw(
            st.sampled_from([np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, -1e160, 1e30, -1e20, 0.0, -0.0, 1e-320])
        )
    if entry == "update":
        arguments["tangent_kind"] = data.draw(st.sampled_from(["propagated", "continuum", "elastic"]))
    with np.errstate(all="ignore"):
        report = getattr(law, entry)(**arguments)
    for point in range(3):
        ends = [np.atleast_1d(arguments[n][point]) for n in outputs_of(entry)]
        starts = [arguments["stress_start"][point], arguments["state_start"][point]]
        if report.status[point] <= Status.LIMITED:
            assert all(np.isfinite(end).all() for end in ends), (report.status[point], ends)
        else:
            for end, start in zip(ends, starts):
                assert np.array_equal(end, start, equal_nan=True)
            assert np.isfinite(ends[2]).all()


@pytest.mark.parametrize(("law_name", "entry"), entries())
@FEW
@given(data=st.data())
def test_arrays_that_share_memory_are_refused(law_name, entry, data, compiled):
    """An output that lies on an input, or on another output, wholly or in part, whatever it is a view of."""
    law = LAWS[law_name]
    npt = data.draw(st.integers(1, 4))
    arguments = arguments_of(law, entry, npt)
    output = data.draw(st.sampled_from(outputs_of(entry)))
    other = data.draw(st.sampled_from([n for n in arguments if n != output]))
    if not arguments[output].size or not arguments[other].size:
        return
    size, other_size = arguments[output].nbytes, arguments[other].nbytes
    unit = 8
    shift = data.draw(st.integers(-other_size // unit + 1, size // unit - 1)) * unit
    room = np.zeros(size + 2 * other_size + 64, dtype=np.uint8)
    room = room[-room.ctypes.data % 8 :]
    start = other_size // unit * unit + unit
    on = room[start : start + size].view(np.float64).reshape(arguments[output].shape)
    under = room[start + shift : start + shift + other_size].view(arguments[other].dtype)
    under = under.reshape(arguments[other].shape)
    if not np.shares_memory(on, under):
        return
    under[...] = arguments[other]
    arguments |= {output: on, other: under}
    with pytest.raises(ValueError, match=r"shares memory|material_index|control"):
        getattr(law, entry)(**arguments)
    assert signatures() == compiled


@pytest.mark.parametrize("law_name", LAWS)
@FEW
@given(data=st.data())
def test_initial_states(law_name, data, compiled):
    law = LAWS[law_name]
    npt = data.draw(st.integers(0, 4))
    good = {
        "stress": np.tile([-131072.0, -98304.0, 4096.0], (npt, 1)) + 1024.0 * np.arange(npt)[:, None],
        "material_index": np.arange(npt, dtype=np.int32) % 2,
    }
    if law_name in CONTACT:
        good |= {"coordination": np.full(npt, 4.0), "fabric_anisotropy": np.tile([0.25, -0.125], (npt, 1))}
    name = data.draw(st.sampled_from(list(good)))
    taken, refused = (INDEX_COPIED, INDEX_REFUSED) if name == "material_index" else (COPIED, REFUSED)
    variant = data.draw(st.sampled_from([*taken, *refused, "NaN", "infinity"]))
    if variant in ("NaN", "infinity"):
        if name == "material_index" or npt == 0:
            return
        value = good[name].copy()
        value.flat[data.draw(st.integers(0, value.size - 1))] = np.nan if variant == "NaN" else np.inf
    else:
        value = (taken | refused)[variant](good[name])
    if value is SAME or (name == "stress" and variant in ("one row more", "one row less", "one row", "nothing")):
        return  # the stress says how many points there are
    if name in ("coordination", "fabric_anisotropy", "material_index") and variant == "None":
        return
    if name == "fabric_anisotropy" and variant == "int64":
        value = np.zeros((npt, 2), dtype=int)
    if variant not in taken:
        with pytest.raises(ValueError, match=f"{name}|stress"):
            law.initial_state(**{**good, name: value})
    else:
        state = law.initial_state(**{**good, name: value})
        assert state.shape == (npt, law.description.nstate)
        assert np.array_equal(state, law.initial_state(**{**good, name: converted(value, good[name])}))
        assert np.isfinite(state).all()
    assert signatures() == compiled

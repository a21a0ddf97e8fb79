"""Random wrong arrays at the entries of the host that lead to compiled kernels: ValueError, or the right result."""

from __future__ import annotations

import numpy as np
import pytest
from fem_meshes import ELASTIC, PLASTIC, distorted
from hypothesis import given, settings
from hypothesis import strategies as st
from wrong_arrays import COPIED, INDEX_COPIED, INDEX_REFUSED, OUTPUT_REFUSED, OUTPUT_TAKEN, REFUSED, SAME

from granfabric.fem.accounting import Accounting
from granfabric.fem.discretisation import kernels
from granfabric.fem.discretisation.assembly import ForceAssembler, TangentAssembler
from granfabric.fem.discretisation.quadrature_material import QuadratureMaterial
from granfabric.fem.discretisation.space import Space
from granfabric.fem.loads.kinds import LoadError, Stage
from granfabric.fem.loads.problem import Problem

FEW = settings(max_examples=100, deadline=None, database=None, derandomize=True)
SPACE = Space(distorted("P2", 2), "P2")
FORCES = ForceAssembler(SPACE)
MATRIX = TangentAssembler(SPACE, np.arange(3, SPACE.ndofs))
NPT, NDOFS = SPACE.npoints, SPACE.ndofs
COMPILED = [
    getattr(kernels, f"{name}_kernel")
    for name in ("strain", "element_force", "gather_force", "element_tangent", "gather_tangent", "element_action")
]


def whole(*shape):
    """Whole numbers, which other kinds of numbers hold as well."""
    return np.random.default_rng(1).integers(-9, 9, shape).astype(float)


ENTRIES = {
    "strain": (FORCES.strain, {"displacement": whole(NDOFS), "out": np.full((NPT, 3), 9.0)}),
    "internal_force": (FORCES.internal_force, {"stress": whole(NPT, 3), "out": np.full(NDOFS, 9.0)}),
    "tangent_times": (
        FORCES.tangent_times,
        {"tangent": whole(NPT, 3, 3), "displacement": whole(NDOFS), "out": np.full(NDOFS, 9.0)},
    ),
    "assemble": (MATRIX.assemble, {"tangent": whole(NPT, 3, 3)}),
}


def signatures():
    return [len(kernel.signatures) for kernel in COMPILED]


def result_of(entry, arguments):
    call, _ = ENTRIES[entry]
    result = call(**arguments)
    return result.data.copy() if entry == "assemble" else np.array(result)


@pytest.fixture(scope="module", autouse=True)
def compiled():
    for entry, (_, good) in ENTRIES.items():
        result_of(entry, {name: array.copy() for name, array in good.items()})
    return signatures()


@pytest.mark.parametrize("entry", ENTRIES)
@FEW
@given(data=st.data())
def test_assembly(entry, data, compiled):
    good = {name: array.copy() for name, array in ENTRIES[entry][1].items()}
    wanted = result_of(entry, {name: array.copy() for name, array in good.items()})
    name = data.draw(st.sampled_from(list(good)))
    taken, refused = (OUTPUT_TAKEN, OUTPUT_REFUSED) if name == "out" else (COPIED, REFUSED)
    variant = data.draw(st.sampled_from([*taken, *refused]))
    value = (taken if variant in taken else refused)[variant](good[name])
    if value is SAME:
        return
    if variant not in taken:
        with pytest.raises(ValueError, match=name):
            result_of(entry, {**good, name: value})
    elif variant == "broadcast":
        assert np.array_equal(
            result_of(entry, {**good, name: value}), result_of(entry, {**good, name: np.array(value)})
        )
    else:
        assert np.array_equal(result_of(entry, {**good, name: value}), wanted)
    assert signatures() == compiled


def test_an_output_that_is_an_input():
    both = np.zeros(NDOFS)
    with pytest.raises(ValueError, match=r"out .* shares memory with displacement"):
        FORCES.tangent_times(np.zeros((NPT, 3, 3)), both, both)
    with pytest.raises(ValueError, match=r"magnitude .* shares memory with out"):
        FORCES.internal_force(np.zeros((NPT, 3)), FORCES.magnitude)
    room = np.zeros(NPT * 9)
    with pytest.raises(ValueError, match="shares memory"):
        FORCES.strain(room[:NDOFS], room[: 3 * NPT].reshape(NPT, 3))
    matrix = TangentAssembler(SPACE, np.arange(NDOFS))
    values = matrix.matrix.data
    if values.size >= NPT * 9:
        with pytest.raises(ValueError, match="shares memory with tangent"):
            matrix.assemble(values[: NPT * 9].reshape(NPT, 3, 3))


def test_the_space_and_the_matrix_cannot_be_pulled_away():
    """What the kernels index with is out of reach of whoever changes the space, or the pattern of the matrix."""
    space = Space(distorted("P2", 2), "P2")
    forces, stress = ForceAssembler(space), whole(NPT, 3)
    wanted = forces.internal_force(stress, np.empty(NDOFS))
    space.element_nodes[:] = 10**6
    strains = [one.strain(whole(NDOFS), np.empty((NPT, 3))) for one in (forces, FORCES)]
    assert np.array_equal(*strains)
    assert np.array_equal(forces.internal_force(stress, np.empty(NDOFS)), wanted)
    with pytest.raises(ValueError, match=r"element_nodes must be .* holds 1000000"):
        ForceAssembler(space)
    forces.magnitude = np.zeros(3)
    with pytest.raises(ValueError, match="magnitude"):
        forces.internal_force(stress, np.empty(NDOFS))
    matrix = TangentAssembler(SPACE, np.arange(NDOFS))
    matrix.assemble(np.zeros((NPT, 3, 3))).eliminate_zeros()
    with pytest.raises(ValueError, match="values of the matrix"):
        matrix.assemble(whole(NPT, 3, 3))


@pytest.mark.parametrize("variant", [*INDEX_COPIED, *INDEX_REFUSED, "unsorted", "twice", "beyond"])
def test_free_degrees_of_freedom(variant):
    free = np.arange(2, NDOFS, 3, dtype=np.int32)
    made = {**INDEX_COPIED, **INDEX_REFUSED, "unsorted": lambda a: a[::-1].copy(), "twice": lambda a: np.repeat(a, 2)}
    if variant == "one for all":
        return  # one degree of freedom
    if variant in INDEX_COPIED:
        assert TangentAssembler(SPACE, made[variant](free)).matrix.shape == (len(free), len(free))
        return
    value = free + NDOFS if variant in ("beyond", "too large") else made[variant](free)
    with pytest.raises(ValueError, match="free"):
        TangentAssembler(SPACE, value)


@pytest.mark.parametrize("name", ["initial_stress", "material_index", "initial_state"])
@pytest.mark.parametrize("variant", [*REFUSED, "NaN"])
def test_problems(name, variant):
    """Refused as a load that cannot be applied; nothing of a wrong kind reaches the law."""
    index = name == "material_index"
    good = {"initial_stress": -np.ones((NPT, 3)), "initial_state": np.ones((NPT, 2))}.get(name, np.zeros(NPT, int))
    make = {**REFUSED, **(INDEX_REFUSED if index else {}), "NaN": lambda a: np.full(a.shape, np.nan)}[variant]
    value = make(good)
    right = {"initial_stress": "one row for all", "material_index": "bool"}.get(name)
    if value is SAME or variant in ("None", right):
        return
    with pytest.raises(LoadError, match=name.replace("_", " ")):
        Problem(SPACE, PLASTIC, [Stage("a", [])], **{name: value})


def test_an_index_that_the_law_does_not_have():
    for wrong in (1, 2**32, -1):
        with pytest.raises(LoadError, match="index"):
            Problem(SPACE, ELASTIC, [Stage("a", [])], material_index=np.full(NPT, wrong))


def test_quadrature_material_and_interpolation():
    good = {"stress": -np.ones((NPT, 3)), "state": np.ones((NPT, 2)), "strain": np.zeros((NPT, 3))}
    material = QuadratureMaterial(PLASTIC, FORCES, **good, accounting=Accounting())
    for name, array in good.items():
        for variant in ("one row", "transposed", "text", "masked", "complex"):
            with pytest.raises(ValueError, match=name):
                QuadratureMaterial(PLASTIC, FORCES, **{**good, name: REFUSED[variant](array)}, accounting=Accounting())
    zero = np.zeros(NDOFS)
    for wrong in (np.zeros(1), 0.0, zero[:-1], zero.astype(complex)):
        with pytest.raises(ValueError, match="displacement"):
            material.update(wrong, zero, "propagated")
        with pytest.raises(ValueError, match="committed"):
            material.update(zero, wrong, "propagated")
    with pytest.raises(ValueError, match="increment"):
        material.follow(np.zeros(3))
    for wrong in (np.zeros(SPACE.nnodes), np.zeros((SPACE.nnodes + 1, 2)), "nodal"):
        with pytest.raises(ValueError, match="nodal"):
            SPACE.interpolate(wrong)

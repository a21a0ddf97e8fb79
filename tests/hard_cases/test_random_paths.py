"""Random paths, parameters, effect sets, closures and integrators, by the batch.

Hypothesis chooses the law and the seed of a batch; materials, starts and paths of its points follow from the seed.
Some hundred paths in the default run, 100,000 and more with ``-m long``.
"""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np
import pytest
from hard_laws import PRESSURE, Trail, closures, effect_sets, follow, integrations, make_law
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from granfabric.constitutive.contract import Status
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.integration.runge_kutta import TABLEAUS
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration, Material

STEPS = 6
POINTS = {"mean_field": 200}
"""Points of a batch by the force change of the closure; where a substep takes much longer, fewer."""
FEWER = 24
MATERIALS = 10


PATHS = {"followed": 0}
"""How many paths the tests of this module have followed in this process."""


@pytest.fixture(autouse=True)
def paths_followed() -> Iterator[None]:
    """Say after each test how many there were."""
    before = PATHS["followed"]
    yield
    print("paths followed:", PATHS["followed"] - before)


def amounts(few: int, most: int) -> list:
    """Examples in the default, the slow and the long run."""
    return [
        pytest.param(few, id="few"),
        pytest.param(4 * few, id="many", marks=pytest.mark.slow),
        pytest.param(most, id="most", marks=pytest.mark.long),
    ]


def search(examples: int) -> settings:
    return settings(max_examples=examples, deadline=None, derandomize=True, database=None,
                    suppress_health_check=list(HealthCheck))  # fmt: skip


LAWS = {
    "closure": st.sampled_from(closures()),
    "effects": st.sampled_from(effect_sets()),
    "seed": st.integers(0, 2**32 - 1),
}


def random_materials(rng: np.random.Generator, number: int) -> list[Material]:
    """Within bounds that packings have, and somewhat beyond."""
    made = []
    for _ in range(number):
        fabric, angle = rng.uniform(0, 0.5), rng.uniform(0, 2 * np.pi)
        made.append(
            Material(
                coordination=rng.uniform(3.2, 5.5),
                solid_fraction=rng.uniform(0.7, 0.9),
                normal_stiffness=PRESSURE * 10 ** rng.uniform(2.5, 6),
                stiffness_ratio=rng.uniform(0.0, 1.0),
                force_density_at_zero=rng.uniform(0.0, 0.95),
                gap_density_at_zero=rng.choice([0.0, 3.0, 300.0]),
                force_anisotropy_ratio=rng.uniform(0.0, 1.3),
                bulk_reduction=rng.uniform(0.5, 1.0),
                shear_reduction=rng.uniform(0.3, 1.0),
                isostatic_coordination=rng.uniform(2.0, 3.1),
                initial_fabric_xx=fabric * np.cos(angle),
                initial_fabric_xy=fabric * np.sin(angle),
            )
        )
    return made


class Batch:
    """A law and points with random materials, starts and paths of strain (control 0), stress (1) or both."""

    def __init__(
        self, closure: Closure, effects: Effects, integration: Integration, seed: int, size: float = 0.3
    ) -> None:
        rng = np.random.default_rng(seed)
        self.points = points = POINTS.get(closure.force_change, FEWER)
        self.materials = random_materials(rng, MATERIALS)
        self.closure, self.effects, self.integration = closure, effects, integration
        self.index = rng.integers(0, MATERIALS, points).astype(np.int32)
        p, q, angle = (rng.uniform(a, b, points) for a, b in ((0.3, 3.0), (0.0, 0.4), (0, 2 * np.pi)))
        q, p = q * p * PRESSURE, p * PRESSURE
        self.start = np.stack([-p - q * np.cos(angle), -p + q * np.cos(angle), -q * np.sin(angle)], axis=1)
        self.control = rng.integers(0, 2, (points, 3)).astype(np.uint8)
        kind = rng.integers(0, 3, points)
        self.control[kind == 0], self.control[kind == 1] = 0, 1
        # sizes over decades, relative to p for stress and to p/K for strain; legs reverse, repeat, stand still
        step = rng.uniform(-1, 1, (STEPS, points, 3)) * size * 10 ** rng.uniform(-3, 0, (STEPS, points, 1))
        step[:, rng.random(points) < 0.2] *= np.where(np.arange(STEPS) % 2, -1.0, 1.0)[:, None, None]
        step[rng.random((STEPS, points)) < 0.05] = 0.0
        stiffness = np.array([m.coordination * m.solid_fraction * m.normal_stiffness for m in self.materials]) / (
            2 * np.pi
        )
        self.strain_size = (p / stiffness[self.index])[:, None]
        self.increments = step * np.where(self.control == 1, p[:, None], self.strain_size)

    def law(self, **changes: object) -> ContactLaw | None:
        values = {name: getattr(self.integration, name) for name in Integration.__dataclass_fields__}
        return make_law(self.closure, Integration(**{**values, **changes}), self.effects, self.materials)  # type: ignore[arg-type]

    def trail(self, law: ContactLaw, points: np.ndarray | slice = slice(None)) -> Trail:
        """Follow some of the points, all by default."""
        index = np.ascontiguousarray(self.index[points])
        start = np.ascontiguousarray(self.start[points])
        increments, control = self.increments[:, points], self.control[points]
        return follow(law, start, increments, control, law.initial_state(start, index), index)


INTEGRATION = st.sampled_from(integrations(tolerance=1e-5, substeps=8, most=150))


@pytest.mark.parametrize("examples", amounts(4, 2000))
def test_finite_admissible_and_the_same_in_any_order(examples: int) -> None:
    """All numbers finite, z > 0, |a_c| < 2, refused points where they were; bit-equal in another order and by halves,
    and on one thread or two.
    """

    @search(examples)
    @given(integration=INTEGRATION, **LAWS)
    def look(closure: Closure, effects: Effects, seed: int, integration: Integration) -> None:
        batch = Batch(closure, effects, integration, seed)
        law = batch.law()
        if law is None:
            return
        PATHS["followed"] += batch.points
        whole = batch.trail(law)
        # a start of a material that the fabric or the isostatic number excludes is refused from the beginning
        assert np.isfinite(whole.state).all() and np.isfinite(whole.stress).all() and np.isfinite(whole.strain).all()
        alive = whole.status[-1] <= Status.LIMITED
        assert (whole.get("coordination")[-1] > 0).all() and (whole.pressure[-1][alive] > 0).all()
        fabric = whole.state[-1][:, law.description.columns("fabric_anisotropy")]
        assert (np.linalg.norm(fabric, axis=1) < 2).all()
        failed = whole.status[1:] > Status.LIMITED
        assert np.array_equal(whole.state[1:][failed], whole.state[:-1][failed])
        if effects.contact_loss:
            lost = np.diff(whole.get("coordination_lost"), axis=0)
            # negative weights of a scheme make a sum of losses negative by its error at most
            exact = (TABLEAUS[integration.integrator].b >= 0).all()
            error = 0.0 if exact else 10 * integration.tolerance * np.diff(whole.substeps, axis=0)
            assert (lost >= -1e-12 - error * whole.get("coordination")[:-1]).all()
        order = np.random.default_rng(seed).permutation(batch.points)
        shuffled = batch.trail(law, order)
        assert np.array_equal(shuffled.state, whole.state[:, order])
        assert np.array_equal(shuffled.stress, whole.stress[:, order])
        assert np.array_equal(shuffled.status, whole.status[:, order])
        threads = numba.get_num_threads()
        try:
            numba.set_num_threads(1)
            one = batch.trail(law, slice(0, 7))
        finally:
            numba.set_num_threads(threads)
        assert np.array_equal(one.state, whole.state[:, :7]) and np.array_equal(one.strain, whole.strain[:, :7])

    look()


HONEST = 30.0
"""Allowed error over tolerance times substeps. Each substep may add its tolerance, errors made are carried on and grow
with the rates' slopes, exp(2) to exp(3) over a path of this length at most."""


@pytest.mark.parametrize("examples", amounts(12, 600))
def test_the_error_estimate_is_honest(examples: int) -> None:
    """The end of every path against that with a thousandth of the tolerance."""

    worst: dict[str, float] = {}

    @search(examples)
    @given(integration=INTEGRATION, **LAWS)
    def look(closure: Closure, effects: Effects, seed: int, integration: Integration) -> None:
        if integration.substeps:
            return
        batch = Batch(closure, effects, integration, seed)
        law, fine = batch.law(), batch.law(tolerance=1e-8, integrator="bogacki_shampine", maximum_substeps=100_000)
        if law is None or fine is None:
            return
        PATHS["followed"] += batch.points
        trail, exact = batch.trail(law), batch.trail(fine)
        both = (trail.status[-1] == Status.OK) & (exact.status[-1] == Status.OK)
        # close to the end of the pressure everything that is relative to it grows without bound
        both &= (exact.pressure.min(axis=0) > 0.05 * exact.pressure[0]) & (exact.ratio.max(axis=0) < 0.8)
        error = np.abs(trail.get("coordination")[-1] / exact.get("coordination")[-1] - 1)
        p = exact.pressure[-1][:, None]
        error = np.maximum(error, np.abs((trail.stress[-1] - exact.stress[-1]) / p).max(axis=1))
        # a wrong strain counts as the stress that belongs to it: near the isostatic number strains go to infinity
        tangent = np.zeros((batch.points, 3, 3))
        stress, now = exact.stress[-1], exact.state[-1]
        fine.update(np.zeros_like(stress), stress, now, stress.copy(), now.copy(), tangent, "elastic", batch.index)
        wrong = np.einsum("nij,nj->ni", tangent, trail.strain[-1] - exact.strain[-1])
        if effects.sliding:  # the hardening strain is right relative to itself and to gamma_r
            reference = np.array([m.reference_plastic_strain for m in batch.materials])[batch.index]
            bulk = 0.5 * (tangent[:, 0, 0] + tangent[:, 0, 1])
            p = p + (2 * bulk * (reference + exact.get("hardening_strain")[-1]))[:, None]
        error = np.maximum(error, np.abs(wrong / p).max(axis=1))
        share = error / (integration.tolerance * np.maximum(trail.substeps[-1], 1))
        largest = float(share[both].max(initial=0.0))
        name = integration.integrator
        worst[name] = max(worst.get(name, 0.0), largest)
        assert largest <= HONEST, (name, largest)

    look()
    print("largest error over tolerance times substeps:", worst)


def tangent_errors(batch: Batch, law: ContactLaw, seed: int) -> tuple[np.ndarray, int]:
    """Tangent of one increment against central differences of the same discrete update, over the stiffness, for the
    points where differences over h and 2 h agree to 1e-6 (no kink between); and how many points there were. Twins of a
    kink on both sides may agree: the better of h and h/100 counts.
    """
    state = law.initial_state(batch.start, batch.index)
    increment = batch.strain_size * np.random.default_rng(seed).uniform(-0.1, 0.1, (batch.points, 3))
    ends, tangent = (np.empty((batch.points, 3)), np.empty_like(state)), np.empty((batch.points, 3, 3))
    report = law.update(increment, batch.start, state, *ends, tangent, "propagated", batch.index)
    fine = report.status == Status.OK
    scale = np.abs(tangent).max(axis=(1, 2))
    differences = []
    for h in (1e-5, 2e-5, 1e-7):
        columns = []
        for j in range(3):
            moved = []
            for sign in (1.0, -1.0):
                other = increment.copy()
                other[:, [j]] += sign * h * batch.strain_size
                status = law.update(other, batch.start, state, *ends, None, "propagated", batch.index).status
                fine &= status == Status.OK
                moved.append(ends[0].copy())
            columns.append((moved[0] - moved[1]) / (2 * h * batch.strain_size))
        differences.append(np.stack(columns, axis=2))
    smooth = fine & (np.abs(differences[0] - differences[1]).max(axis=(1, 2)) < 1e-6 * scale)
    off = np.minimum(*(np.abs(tangent - differences[k]).max(axis=(1, 2)) for k in (0, 2)))
    return off[smooth] / scale[smooth], int(fine.sum())


@pytest.mark.parametrize("examples", amounts(5, 3000))
def test_tangent_against_differences(examples: int) -> None:
    """Where there is no kink between, the tangent is that of the differences to ten times their own disagreement; and
    that is so for most.
    """
    agreeing = [0, 0]

    @search(examples)
    @given(integration=INTEGRATION, **LAWS)
    def look(closure: Closure, effects: Effects, seed: int, integration: Integration) -> None:
        batch = Batch(closure, effects, integration, seed, size=0.1)
        law = batch.law(substeps=3)
        if law is None:
            return
        PATHS["followed"] += batch.points
        off, number = tangent_errors(batch, law, seed)
        assert (off < 1e-5).all(), off.max()
        agreeing[0] += len(off)
        agreeing[1] += number

    look()
    assert agreeing[0] > 0.7 * agreeing[1] > 0


@pytest.mark.parametrize("examples", amounts(6, 500))
def test_energy_of_closed_strain_cycles(examples: int) -> None:
    """Work over a closed path of strain. With stored energy psi = s:C^-1:s/2 and ds = C de,

        W = psi_end - psi_start - 1/2 int s:dC^-1:s,

    exactly: opening contacts soften the network at fixed stress and fill its springs without work. What a cycle gives
    back is therefore bounded by psi_start and the softening: W >= -psi_start - int psi dv, dv being the largest growth
    of C^-1 relative to itself. A frozen stiffness gives W = 0. Sliding, where it is on, only adds work.
    """
    lowest = [0.0]

    @search(examples)
    @given(**LAWS)
    def look(closure: Closure, effects: Effects, seed: int) -> None:
        integration = Integration(tolerance=1e-7)
        batch = Batch(closure, effects, integration, seed)
        law = batch.law()
        if law is None:
            return
        PATHS["followed"] += batch.points
        corners = np.random.default_rng(seed).uniform(-0.1, 0.1, (4, batch.points, 3)) * batch.strain_size
        corners = np.concatenate([np.zeros((1, batch.points, 3)), corners, np.zeros((1, batch.points, 3))])
        parts = 20 if closure.force_change == "mean_field" else 8
        increments = np.repeat(np.diff(corners, axis=0), parts, axis=0) / parts
        state = law.initial_state(batch.start, batch.index)
        trail = follow(law, batch.start, increments, (0, 0, 0), state, batch.index)
        fine = trail.status[-1] == Status.OK
        compliance = []
        for stress, now in zip(trail.stress, trail.state, strict=True):
            tangent = np.empty((batch.points, 3, 3))
            law.update(
                np.zeros((batch.points, 3)), stress, now, stress.copy(), now.copy(), tangent, "elastic", batch.index
            )
            compliance.append(np.linalg.inv(np.where(fine[:, None, None], tangent, np.eye(3))))
        soft = np.array(compliance)
        middle = 0.5 * (trail.stress[1:] + trail.stress[:-1])
        work = np.einsum("kni,kni->n", middle, increments)
        psi = 0.5 * np.einsum("kni,knij,knj->kn", trail.stress, soft, trail.stress)
        filled = 0.5 * np.einsum("kni,knij,knj->kn", middle, np.diff(soft, axis=0), middle)
        balance = psi[-1] - psi[0] - filled.sum(axis=0)
        # the trapezoidal rule errs by the square of the increment's relative change of stress: 0.3/20 or 0.3/8
        allowed = (
            2 * (0.3 / parts) ** 2 * psi.max(axis=0) * np.maximum(1.0, np.abs(np.diff(np.log(psi), axis=0)).sum(axis=0))
        )
        sliding = bool(getattr(effects, "sliding", False))
        off = (work - balance)[fine]
        assert (off >= -allowed[fine]).all()
        assert sliding or (off <= allowed[fine]).all()
        if not sliding and (effects.stiffness_feedback is False or not effects.network_changes):
            assert (np.abs(work[fine]) <= allowed[fine]).all()
        growth = np.linalg.eigvals(np.linalg.solve(soft[:-1], np.diff(soft, axis=0))).real.max(axis=2)
        bound = psi[0] + (psi[:-1] * np.maximum(growth, 0.0)).sum(axis=0)
        assert (work[fine] >= -bound[fine] - allowed[fine]).all()
        lowest[0] = min(lowest[0], float((work / psi[0])[fine].min(initial=0.0)))

    look()
    print("lowest work of a closed cycle over the energy stored at its start:", lowest[0])


def test_sliding_in_another_order() -> None:
    """Crossings of the cone are searched for lane by lane; found by the search above."""
    batch = Batch(Closure(), Effects(sliding=True), Integration(integrator="forward_euler", substeps=8), 0)
    law = batch.law()
    assert law is not None
    order = np.random.default_rng(0).permutation(batch.points)
    assert np.array_equal(batch.trail(law, order).state, batch.trail(law).state[:, order])


def test_tangent_where_sliding_ends_soon_after_it_began() -> None:
    """The substep after a crossing is halved, and passes on half of the crossing's time; found by the search above."""
    batch = Batch(Closure(), Effects(sliding=True), Integration(integrator="dormand_prince"), 100_000, size=0.1)
    law = batch.law(substeps=3)
    assert law is not None
    off, number = tangent_errors(batch, law, 100_000)
    assert len(off) > 0.7 * number and off.max() < 1e-5

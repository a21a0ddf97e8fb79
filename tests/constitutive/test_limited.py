"""The flag of clipped rates: raised beyond |a_c| = 1 of the harmonic density and |a_n| = 0.98, kept, and counted."""

from __future__ import annotations

import numpy as np
import pytest
from contact_law_cases import PRESSURE, Points, law, material

from granfabric.constitutive.contract import STATUS_TEXT, Status, UpdateReport
from granfabric.constitutive.effects import Effects
from granfabric.constitutive.network.contact_change import LARGEST_FORCE_ANISOTROPY
from granfabric.constitutive.network.force_fabric import initial_force_fabric
from granfabric.constitutive.network.shifted_distribution import network_of
from granfabric.constitutive.network.weak_force_state import ShiftedDistribution, WeakState
from granfabric.constitutive.parameters import Closure, Material
from granfabric.constitutive.path import Leg, drive

ISOTROPIC = (-PRESSURE, -PRESSURE, 0.0)
SMALL = np.array([1e-8, -1e-8, 0.5e-8])
STRESS = (1, 1, 1)
HARMONIC = [
    Closure(),
    Closure(tangential="self_consistent"),
    Closure(force_change="fluctuating", tangential="self_consistent"),
]
UNBOUNDED = [
    Closure(distribution="maximum_entropy"),
    Closure(distribution="maximum_entropy", tangential="self_consistent"),
    Closure(force_change="shifted_distribution", tangential="self_consistent"),
]


def with_fabric(closure, *vectors, **numerics):
    """Points under isotropic stress with the given fabric anisotropies, also such as only loading leads to."""
    contact_law = law(closure=closure, **numerics)
    stress, fabric = np.tile(ISOTROPIC, (len(vectors), 1)), np.array(vectors, dtype=float)
    state = contact_law.initial_state(stress)
    for name in ("fabric_anisotropy", "reference_fabric"):
        if contact_law.description.has_state(name):
            state[:, contact_law.description.columns(name)] = fabric
    # a_t closes the stress-force-fabric relation, as in an initial state: s = (a_c + a_n + a_t)/2
    state[:, contact_law.description.columns("tangential_force_anisotropy")] = -fabric
    return Points(contact_law, stress, state)


@pytest.mark.parametrize("closure", HARMONIC, ids=lambda closure: f"{closure.force_change}-{closure.tangential}")
def test_fabric_beyond_one_is_flagged_in_any_direction_and_fabric_below_is_not(closure):
    inside = [(0.0, 0.0), (0.99, 0.0), (-0.7, 0.69), (0.0, -0.98)]
    outside = [(1.01, 0.0), (-1.05, 0.0), (0.75, 0.75), (0.0, -1.02)]
    for increment in (SMALL, -SMALL):
        points = with_fabric(closure, *inside, *outside)
        for report in (points.update(np.tile(increment, (8, 1)))[3], points.mixed(STRESS, np.tile(-SMALL, (8, 1)))[3]):
            assert report.status.tolist() == [Status.OK] * 4 + [Status.LIMITED] * 4
            assert report.limited == 4 and report.failed == 0
            assert report.worst_point == 4
            assert report.message == f"point 4: {STATUS_TEXT[Status.LIMITED]}"


@pytest.mark.parametrize("closure", UNBOUNDED, ids=lambda closure: f"{closure.force_change}-{closure.tangential}")
def test_densities_that_stay_positive_are_never_flagged(closure):
    """|a_c| up to 1.2 is admissible as it is, and nothing is clipped."""
    points = with_fabric(closure, (1.05, 0.0), (0.0, -1.2), (0.8, 0.8))
    report = points.update(np.tile(SMALL, (3, 1)))[3]
    assert report.status.tolist() == [Status.OK] * 3 and report.limited == 0


@pytest.mark.parametrize("closure", HARMONIC[:2], ids=lambda closure: closure.tangential)
def test_force_anisotropy_beyond_its_limit_is_flagged(closure):
    """a_n = c_n s from the start: with c_n = 2 the limit is met at q/p = 0.49, on any axes."""
    c_n, ratio = 2.0, LARGEST_FORCE_ANISOTROPY / 2.0
    contact_law = law(closure=closure, materials=[material(force_anisotropy_ratio=c_n)])
    stresses = []
    for angle in (0.0, 0.4, 1.1):
        for size in (0.99 * ratio, 1.01 * ratio):
            q = size * PRESSURE
            stresses.append((-PRESSURE - q * np.cos(angle), -PRESSURE + q * np.cos(angle), -q * np.sin(angle)))
    points = Points(contact_law, stresses)
    # from here on at constant stress ratio: p alone changes
    report = points.mixed(STRESS, 1e-6 * points.stress)[3]
    assert report.status.tolist() == [Status.OK, Status.LIMITED] * 3
    # shifted weak forces divide by no mean force
    shifted = Points(law(closure=UNBOUNDED[2], materials=[material(force_anisotropy_ratio=c_n)]), stresses)
    assert shifted.mixed(STRESS, 1e-6 * shifted.stress)[3].limited == 0


@pytest.mark.parametrize(
    "numerics",
    [
        {"substeps": 8},
        {"substeps": 8, "integrator": "forward_euler"},
        {"substeps": 8, "integrator": "kennedy_carpenter"},
        {},
    ],
    ids=["fixed", "euler", "implicit", "controlled"],
)
@pytest.mark.parametrize("outwards", [True, False])
def test_a_flag_of_some_substeps_is_that_of_the_increment(numerics, outwards):
    """The fabric crosses |a_c| = 1 half-way: the flag of the first or of the last substeps is that of the increment."""
    closure = Closure()
    start = 0.985 if outwards else 1.04
    # at constant p a_c moves by about P0 = 0.5 times s; towards or away from the present anisotropy
    step = np.array([-1.0, 1.0, 0.0]) * 0.2 * PRESSURE * (1.0 if outwards else -1.0)
    points = with_fabric(closure, (start, 0.0), **numerics)
    _, state, _, report = points.mixed(STRESS, step)
    end = float(points.get(state, "fabric_anisotropy")[0, 0])
    assert (start - 1.0) * (end - 1.0) < 0.0 and abs(end - 1.0) > 0.003, "the path has to cross"
    assert report.substeps[0] >= 2
    assert report.status[0] == Status.LIMITED
    # the half that does not cross is not flagged
    half = with_fabric(closure, (min(start, 0.985), 0.0), **numerics).mixed(STRESS, 0.01 * step)[3]
    assert half.status[0] == Status.OK


@pytest.mark.parametrize("integrator", ["bogacki_shampine", "dormand_prince", "kennedy_carpenter"])
def test_a_stage_beyond_one_flags_its_substep(integrator):
    """One substep from just above |a_c| = 1 to well below: only its first stage is clipped."""
    points = with_fabric(Closure(), (1.0005, 0.0), substeps=1, integrator=integrator)
    _, state, _, report = points.mixed(STRESS, np.array([1.0, -1.0, 0.0]) * 0.1 * PRESSURE)
    assert points.get(state, "fabric_anisotropy")[0, 0] < 0.99 and report.substeps[0] == 1
    assert report.status[0] == Status.LIMITED
    # and one that only ends above it: the stage at the end is the last of the pair
    points = with_fabric(Closure(), (0.999, 0.0), substeps=1, integrator=integrator)
    _, state, _, report = points.mixed(STRESS, np.array([-1.0, 1.0, 0.0]) * 0.02 * PRESSURE)
    assert points.get(state, "fabric_anisotropy")[0, 0] > 1.001
    assert report.status[0] == Status.LIMITED


def test_neighbours_in_other_lanes_keep_their_own_flags():
    """Forty points, more than there are lanes, every third one beyond the limit."""
    fabric = [(1.1, 0.0) if i % 3 == 0 else (0.1, 0.0) for i in range(40)]
    report = with_fabric(Closure(), *fabric).update(np.tile(SMALL, (40, 1)))[3]
    assert report.status.tolist() == [Status.LIMITED if i % 3 == 0 else Status.OK for i in range(40)]
    assert report.limited == 14


def test_a_network_at_rest_clips_nothing_but_says_where_it_is():
    """Without loss and gain there are no rates of the network to be clipped by a_n; a_c beyond one is still told."""
    contact_law = law(Effects(contact_loss=False, contact_gain=False), materials=[material(force_anisotropy_ratio=2.0)])
    stress = (-1.5 * PRESSURE, -0.5 * PRESSURE, 0.0)
    assert Points(contact_law, stress).update(SMALL)[3].status[0] == Status.OK


def test_counts_of_a_report():
    status = np.array([0, 1, 1, 5, 2, 1, 8, 0], dtype=np.int8)
    report = UpdateReport(status, np.ones(8, np.int32), np.zeros(8, np.int32), 0.25)
    assert (report.limited, report.failed, report.worst_point) == (3, 3, 6)
    assert report.message == f"point 6: {STATUS_TEXT[Status.BEYOND_PEAK]}"
    nothing = UpdateReport(np.zeros(0, np.int8), np.zeros(0, np.int32), np.zeros(0, np.int32))
    assert (nothing.limited, nothing.failed, nothing.worst_point, nothing.message) == (0, 0, -1, "no points")


def test_every_status_has_a_sentence_of_its_own():
    """Each sentence speaks of what its status means, so that two of them cannot be exchanged."""
    words = {
        Status.OK: "updated",
        Status.LIMITED: "rates clipped",
        Status.NO_PRESSURE: "mean pressure falls",
        Status.NOT_ADMISSIBLE: "coordination number or the fabric anisotropy would leave",
        Status.STIFFNESS_LOST: "stiffness is no longer positive definite",
        Status.TOO_MANY_SUBSTEPS: "within the allowed number of substeps",
        Status.NOT_FINITE: "not finite",
        Status.NOT_CONVERGED: "local equations did not converge",
        Status.BEYOND_PEAK: "outside the cone of sliding",
    }
    assert set(words) == set(Status) == set(STATUS_TEXT)
    for status, part in words.items():
        assert part in STATUS_TEXT[status]
        assert [other for other in Status if part in STATUS_TEXT[other]] in ([status], [Status.OK, Status.LIMITED])


def test_the_history_of_a_point_tells_which_increments_were_limited():
    """Loading at constant p until a_n = 2 q/p passes its limit, and back: flagged between, not before and not after."""
    contact_law = law(materials=[material(force_anisotropy_ratio=2.0, force_density_at_zero=0.1)])
    top, steps = 0.6, 20

    def leg(ratio):
        return Leg(target=(-PRESSURE * (1 - ratio), -PRESSURE * (1 + ratio), 0.0), increments=steps)

    history = drive(contact_law, ISOTROPIC, [leg(top), leg(0.0)])
    assert history.finished, history.message
    ratio = np.round(np.concatenate([np.linspace(0, top, steps + 1), np.linspace(top, 0, steps + 1)[1:]]), 12)
    largest = np.concatenate([[0.0], np.maximum(ratio[1:], ratio[:-1])])
    limited = history.columns["limited"]
    assert limited.dtype == np.int64
    np.testing.assert_array_equal(limited, largest > LARGEST_FORCE_ANISOTROPY / 2.0)
    assert 0 < limited.sum() < len(limited) / 2


def test_a_mean_force_never_pulls():
    """Expansion takes the pressure: a point fails before the mean force of its contacts turns negative."""
    grains = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)
    contact_law = law(materials=[grains], closure=Closure(force_change="shifted_distribution", tangential="frictional"))
    columns = contact_law.description.columns("mean_normal_force")
    strain = np.array([[2.955, 1.865, -0.746], [2.780, 2.615, 1.256], [3.285, 2.259, 0.196], [-2.0, -1.0, 0.5]])
    stress = np.tile([-1e5, -1e5, 0.0], (len(strain), 1))
    state, alive = contact_law.initial_state(stress), np.ones(len(strain), dtype=bool)
    for _ in range(12):
        stress_end, state_end = np.empty_like(stress), np.empty_like(state)
        report = contact_law.update(1e-5 * strain * alive[:, None], stress, state, stress_end, state_end, None)
        alive &= np.asarray(report.status) <= Status.LIMITED
        assert (state_end[alive][:, columns] > 0.0).all()
        stress, state = np.where(alive[:, None], stress_end, stress), np.where(alive[:, None], state_end, state)
    assert alive.tolist() == [False, False, False, True]  # three are let go, one is compressed


@pytest.mark.parametrize("fabric", [1.2, 1.39, 1.42, 1.9])
def test_force_fabrics_that_would_pull_have_no_solution(fabric):
    """Without deviator the mean force goes with 1 - a_c^2/2, at the start and along the way."""
    normal, tangential, mu = np.zeros((1, 2)), np.zeros((1, 2)), np.zeros(1)
    initial_force_fabric(np.zeros((1, 2)), np.array([[fabric, 0.0]]), 0.8, 1.0, normal, tangential, mu)
    pushes = fabric < np.sqrt(2.0)
    assert (mu[0] > 0.0) == pushes and np.isnan(mu[0]) != pushes
    if pushes:
        assert mu[0] == pytest.approx(1.0 - 0.5 * fabric**2)
    # the same fabric, X_1 = 0 and no deviator: N keeps the initial distribution of contacts
    closure = ShiftedDistribution(True, False, True, 0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.0, 0.8, 1.5, 1.0, 0.6)
    rule = (np.zeros(0),) * 4 + (np.cos(np.pi * (np.arange(16) + 0.5) / 16), np.zeros((0, 2)))
    origin, zero = (4.0, fabric, 0.0), (0.0, 0.0)
    at_rest = dict.fromkeys(WeakState._fields, 0.0)
    weak = WeakState(**{**at_rest, "ratio": 1.0, "stretch": 1.0, "growth": 0.5, "shift_by_p": 0.5})
    found, network, _, force = network_of(
        weak, 0.0, zero, zero, (fabric, 0.0), origin, (0.5, 0.0), zero, 1.0, closure, (0.0, 0.0, 1.0), rule, None, None
    )
    assert network[1] == pytest.approx(fabric) and force[2] == pytest.approx(1.0 - 0.5 * fabric**2)
    assert found == pushes

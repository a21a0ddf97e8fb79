"""A led displacement: the load factor is what a displacement-driven run says, past a peak as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fem_meshes import ELASTIC, PLASTIC, distorted, nodal, run

from granfabric.constitutive.contract import LawDescription, UpdateReport, Variable
from granfabric.constitutive.plain_laws.linear_elastic import ElasticMaterial, LinearElasticLaw
from granfabric.constitutive.plain_laws.von_mises import VonMisesLaw, VonMisesMaterial
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.control import StepControl
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import (
    BodyForce,
    Displacement,
    Fixed,
    LoadControl,
    LoadError,
    Pressure,
    RigidBody,
    Spring,
    Stage,
    Traction,
)
from granfabric.fem.loads.problem import Problem
from granfabric.fem.mesh.host_mesh import rectangle

TIGHT = StepControl(tolerance=1e-11)
ROLLERS = [Fixed("bottom", ("y",)), Fixed("left", ("x",))]


class SofteningLaw:
    """One-dimensional softening in yy, elastic otherwise: E' e up to the peak, then down to a residual by a hyperbola.

    sigma_yy = E e / (1 + (e/e_0)^2): peak E e_0 / 2 at e = e_0, no history. The rest: sigma_xx = E eps_xx, no coupling.
    """

    def __init__(self, modulus: float = 1000.0, at_peak: float = 1e-2) -> None:
        self.modulus, self.at_peak = modulus, at_peak
        state = (Variable("strain_yy", "strain so far", default=0.0),)
        parameters = (Variable("modulus", "of the start", "Pa"),)
        self.description = LawDescription("softening", state, parameters)

    def initial_state(self, stress, material_index=None):
        return np.zeros((len(stress), 1))

    def update(self, strain, stress, state, stress_end, state_end, tangent, kind, material_index=None):
        end = state[:, 0] + strain[:, 1]
        ratio = (end / self.at_peak) ** 2
        state_end[:, 0] = end
        stress_end[:, 0] = stress[:, 0] + self.modulus * strain[:, 0]
        stress_end[:, 1] = self.modulus * end / (1 + ratio)
        stress_end[:, 2] = stress[:, 2] + 0.5 * self.modulus * strain[:, 2]
        if tangent is not None:
            tangent[:] = np.diag([self.modulus, 0.0, 0.5 * self.modulus])
            tangent[:, 1, 1] = self.modulus * (1 - ratio) / (1 + ratio) ** 2
        ok = np.zeros(len(strain), dtype=np.int8)
        whole = np.ones(len(strain), dtype=np.int32)
        return UpdateReport(ok, whole, 0 * whole)


@pytest.mark.parametrize("follows", ["pressure", "traction", "rigid", "body force"])
def test_past_the_peak_of_a_softening_bar(follows):
    """The load rises to E e_0/2 at e_0 and falls: led through it, the load factor is the closed form at each step."""
    law = SofteningLaw()
    space = Space(rectangle(1.0, 1.0, 2, 1, "quad"), "Q1")
    loads = {
        "pressure": Pressure("top", 1.0),
        "traction": Traction("top", (0.0, -1.0)),
        "rigid": RigidBody("top", force=(0.0, -1.0), rotation="fixed"),
        "body force": BodyForce((0.0, -1.0)),
    }
    lead = {"rigid": "top"} if follows == "rigid" else {"point": (1.0, 1.0)}
    stage = Stage(
        "push",
        [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Fixed("right", ("x",)), loads[follows]],
        10,
        control=LoadControl(-3e-2, **lead),
    )
    if follows == "body force":  # strains are not uniform there: only that it turns
        steps, summary = run(space, law, [stage], TIGHT)
        factors = np.array([step.load_factor for step in steps])
        assert summary.finished and 0 < factors.argmax() < len(factors) - 1 and factors[-1] < 0.7 * factors.max()
        return
    steps, summary = run(space, law, [stage], TIGHT)
    assert summary.finished, summary.message
    settled = np.array([-nodal(step)[space.boundary_nodes("top"), 1].mean() for step in steps])
    np.testing.assert_allclose(settled, 3e-2 * np.arange(1, 11) / 10, rtol=1e-9)
    np.testing.assert_allclose(
        [step.load_factor for step in steps], 1000 * settled / (1 + (settled / 1e-2) ** 2), rtol=1e-8
    )
    assert summary.counters["lu_fallbacks"] <= (0 if follows == "rigid" else 10)
    if follows == "rigid":
        np.testing.assert_allclose(
            [-step.rigid["top"][4] for step in steps], [step.load_factor for step in steps], rtol=1e-8
        )
    # a prescribed force does not get past the peak, and stops before it
    pushed = replace(
        stage,
        loads=[*stage.loads[:3], {**loads, "rigid": RigidBody("top", force=(0.0, -6.0), rotation="fixed")}["rigid"]],
        control=None,
    )
    _, failed = run(space, law, [pushed], TIGHT)
    assert not failed.finished and 0.7 < failed.fraction < 5.0 / 6.0 + 1e-3


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
@pytest.mark.parametrize("lead", ["point", "body"])
def test_the_curve_is_that_of_a_displacement_driven_run(law, lead):
    host = rectangle(4.0, 2.0, 8, 4)
    host.boundaries["footing"] = host.facets_between("top", (1.0, 2.0))
    space = Space(host, "P2")
    hold = [Fixed("bottom"), Fixed("left", ("x",)), Fixed("right", ("x",))]
    body = RigidBody("footing", force=(0.0, -1.0), rotation="fixed")
    pushed = Stage("push", [*hold, body], 5, control=LoadControl(-3e-3, rigid="footing"))
    if lead == "point":
        # a point of the ground beside the footing leads: what the footing does then, the other run does
        driven, _ = run(space, law, [replace(pushed, control=LoadControl(-3e-3, rigid="footing"))], TIGHT)
        away = int(np.argmin(np.hypot(*(space.nodes - (2.5, 1.0)).T)))
        target = nodal(driven[-1])[away, 1]
        # the path between is another (the point does not move in proportion), the end is the same where elastic
        pushed = replace(pushed, control=LoadControl(target, point=(2.51, 1.0)))
        steps, summary = run(space, law, [pushed], TIGHT)
        assert summary.finished
        assert steps[-1].load_factor == pytest.approx(driven[-1].load_factor, rel=1e-9 if law is ELASTIC else 2e-2)
        assert nodal(steps[-1])[away, 1] == pytest.approx(target, rel=1e-12)
        return
    steps, summary = run(space, law, [pushed], TIGHT)
    assert summary.finished
    driven_body = RigidBody("footing", displacement=(None, -3e-3), rotation="fixed")
    driven, _ = run(space, law, [Stage("push", [*hold, driven_body], 5)], TIGHT)
    np.testing.assert_allclose(
        [step.load_factor for step in steps], [-step.reactions["footing"][1] for step in driven], rtol=1e-8
    )
    np.testing.assert_allclose(steps[-1].displacement, driven[-1].displacement, atol=1e-12)


@pytest.mark.parametrize("law", [ELASTIC, PLASTIC], ids=["uncoupled", "coupled"])
def test_the_next_stage_starts_from_the_loads_that_were_reached(law):
    space = Space(distorted("P2"), "P2")
    stages = [
        Stage("dead", [*ROLLERS, Fixed("right", ("x",)), Pressure("top", 0.1), BodyForce((0.0, -0.1))]),
        Stage("led", [Pressure("top", 0.2)], 3, control=LoadControl(-3e-4, point=(1.0, 1.0))),
        Stage("wait", [Spring("left", 1.0)]),
        Stage("off", [Pressure("top", 0.0)], 2),
    ]
    steps, summary = run(space, law, stages, TIGHT)
    assert summary.finished
    named = {step.stage: step for step in steps}
    pressure = 0.1 + 0.1 * named["led"].load_factor
    below = -named["led"].stress[:, 1] - 0.1 * (1 - space.points[:, 1])
    np.testing.assert_allclose(below, pressure, rtol=1e-7)
    assert nodal(named["led"])[np.argmin(np.hypot(*(space.nodes - (1.0, 1.0)).T)), 1] == pytest.approx(-3e-4)
    np.testing.assert_allclose(named["wait"].displacement, named["led"].displacement, atol=1e-12)
    middle = steps[-2]
    np.testing.assert_allclose(-middle.stress[:, 1] - 0.1 * (1 - space.points[:, 1]), pressure / 2, rtol=1e-7)


def test_two_controls_one_after_the_other_and_a_checkpoint():
    space = Space(distorted("P2"), "P2")
    stages = [
        Stage("one", [*ROLLERS, Pressure("top", 0.3)], 3, control=LoadControl(-8e-3, point=(1.0, 1.0))),
        Stage("back", [Pressure("top", 0.0)], 2, control=LoadControl(-7.5e-3, point=(1.0, 1.0))),
        Stage("on", [Traction("right", (0.1, 0.0))], 2),
    ]
    problem = Problem(space, PLASTIC, stages)
    whole: list = []
    kept: list = []

    def keep(checkpoint):
        memory = checkpoint.memory
        last = None if memory.last_correction is None else memory.last_correction.copy()
        kept.append(replace(checkpoint, memory=replace(memory, tangent=memory.tangent.copy(), last_correction=last)))

    assert solve(problem, on_step=whole.append, on_checkpoint=keep).finished
    assert [step.stage for step in whole] == ["one"] * 3 + ["back"] * 2 + ["on"] * 2
    for number in (1, 3, 4, 5, 6):
        rest: list = []
        assert solve(problem, on_step=rest.append, resume=kept[number - 1]).finished
        np.testing.assert_array_equal(rest[-1].displacement, whole[-1].displacement)
    # back by elastic unloading: less than the whole pressure has gone
    assert 0.0 < whole[4].load_factor < 1.0


@pytest.mark.parametrize(
    ("loads", "control", "sentence"),
    [
        ([Pressure("top", 1.0)], LoadControl(0.1, rigid="top"), "there is none"),
        ([Pressure("top", 1.0)], LoadControl(0.1, point=(0.0, 0.0)), "which is prescribed"),
        ([RigidBody("top", force=(0, -1))], LoadControl(0.1, point=(1.0, 1.0)), "lead that one: rigid = 'top'"),
        (
            [RigidBody("top", rotation="fixed"), Pressure("right", 1.0)],
            LoadControl(0.1, "rotation", rigid="top"),
            "is prescribed or held",
        ),
    ],
)
def test_what_cannot_lead_is_refused(loads, control, sentence):
    space = Space(distorted("P2"), "P2")
    with pytest.raises(LoadError) as error:
        Problem(space, ELASTIC, [Stage("a", [Fixed("bottom"), *loads], control=control)])
    assert sentence in str(error.value) and str(error.value).startswith("stage 'a'")


def test_controls_that_make_no_sense_are_refused():
    lead = LoadControl(0.1, point=(1.0, 1.0))
    for given, sentence in (
        ({"target": 0.1}, "either a point or"),
        ({"target": 0.1, "point": (0, 0), "rigid": "top"}, "either a point or"),
        ({"target": 0.1, "point": (0, 0), "component": "rotation"}, "not one of 'x', 'y'"),
        ({"target": np.nan, "rigid": "top"}, "not a finite number"),
    ):
        with pytest.raises(LoadError, match=sentence):
            LoadControl(**given)
    for loads, sentence in (
        ([Fixed("bottom")], "needs loads in the same stage"),
        ([Displacement("top", "y", 0.1)], "is displaced too"),
        ([RigidBody("top", rotation=0.1)], "is displaced too"),
        ([Pressure("top", 1.0, "sine")], "have no amplitude"),
    ):
        with pytest.raises(LoadError, match=sentence):
            Stage("a", loads, control=lead)
    with pytest.raises(LoadError, match="neither an amplitude nor a control"):
        Stage("initial", [Pressure("top", 1.0)], control=lead)


def test_loads_that_do_not_move_what_leads_end_the_run():
    """Two columns side by side: what presses one does not move the other; the sentence says so."""
    space = Space(rectangle(1.0, 1.0, 2, 2, "quad"), "Q1")
    plain = LinearElasticLaw(ElasticMaterial(1000.0, 0.0))
    stages = [
        Stage(
            "a",
            [Fixed("bottom", ("y",)), Fixed("left", ("x",)), Pressure("right", 1.0)],
            control=LoadControl(-0.1, "y", point=(1.0, 1.0)),
        )
    ]
    for law in (plain, VonMisesLaw(VonMisesMaterial(1000.0, 0.0, 1e6))):
        _, summary = run(space, law, stages)
        assert not summary.finished and "do not move what the control leads" in summary.message

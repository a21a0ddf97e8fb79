"""Scenes of laboratory specimens, run coarsely: each number has a closed form, a bound or a conservation law."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from granfabric.cases.commands.convergence import CONSTANT_STIFFNESS
from granfabric.cases.field.comparison import moduli
from granfabric.cases.field.random_field import random_field
from granfabric.cases.records.field_history import invariants
from granfabric.cases.scene import build
from granfabric.cases.scene.reader import load
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Integration
from granfabric.constitutive.path import Leg, drive


def point_law(name: str) -> ContactLaw:
    scene = load(name).scene
    materials = [material for material, _ in build.materials(scene)]
    closure, integration = Closure(**scene.closure.model_dump()), Integration(**scene.integration.model_dump())
    return ContactLaw(materials, closure=closure, integration=integration)


def mean(problem, values: np.ndarray) -> np.ndarray:
    return problem.space.weights @ values / problem.space.weights.sum()


def test_smooth_platens_give_the_point_response(solve_scene: Callable) -> None:
    """Between smooth platens the specimen is homogeneous: every point follows the path of a point driven alone. The
    increments differ a little in kind; both keep to the law's tolerance of 1e-5."""
    _, steps = solve_scene("biaxial_smooth", "mesh.rectangle.nx=1", "mesh.rectangle.ny=2", "stage.1.increments=8")
    law = point_law("biaxial_smooth")
    leg = Leg(control=("stress", "strain", "stress"), target=(-100e3, -8e-5, 0.0), increments=8)
    alone = drive(law, (-100e3, -100e3, 0.0), [leg]).columns
    last = steps[-1]
    z = last.state[:, law.description.columns("coordination")][:, 0]
    np.testing.assert_allclose(z, alone["coordination"][-1], rtol=1e-4)
    np.testing.assert_allclose(last.stress[:, 1], alone["stress_yy"][-1], rtol=1e-4)
    np.testing.assert_allclose(last.strain[:, 0], alone["strain_xx"][-1], rtol=1e-3)


def test_layers_in_series(solve_scene: Callable) -> None:
    """With constant stiffness each layer of thickness h shortens by h dq/(K + G); P2 elements hold that exactly."""
    problem, steps = solve_scene("layered_oedometer", *CONSTANT_STIFFNESS, "stage.1.increments=1")
    scene = load("layered_oedometer").scene
    stiff = {name: sum(moduli(material)) for name, material in scene.materials.items()}
    shortening = 60e3 * (0.04 / stiff["dense"] + 0.02 / stiff["loose"])
    top = problem.space.boundary_nodes("top")
    np.testing.assert_allclose(steps[-1].displacement.reshape(-1, 2)[top, 1], -shortening, rtol=1e-6)
    assert stiff["loose"] < 0.8 * stiff["dense"]


def test_stress_in_a_weak_inclusion(solve_scene: Callable) -> None:
    """In a plate without end the stress in a circular inclusion is uniform [Eshelby 1957]: of the mean stress it takes
    K_i/K (K + G)/(K_i + G), of the deviator G_i/G (G + G*)/(G_i + G*), G* = K G/(K + 2 G). The specimen is three times
    as wide as the inclusion: the mean stress of the specimen includes it (area fraction c), and its sides reflect
    about (8/25)^2 of what the inclusion takes away, some 3 %."""
    problem, steps = solve_scene("biaxial_inclusion", *CONSTANT_STIFFNESS, "stage.1.increments=1")
    scene = load("biaxial_inclusion").scene
    (k, g), (ki, gi) = (moduli(scene.materials[name]) for name in ("dense", "weak"))
    change = steps[-1].stress - problem.initial_stress
    far = mean(problem, change)
    inside = np.isin(problem.space.point_cell, problem.space.host_mesh.cells("inclusion"))
    weights = problem.space.weights[inside]
    within = weights @ change[inside] / weights.sum()
    stiffening = k * g / (k + 2 * g)
    pressure = ki / k * (k + g) / (ki + g)
    deviator = gi / g * (g + stiffening) / (gi + stiffening)
    assert pressure < 0.95 and deviator < 0.8
    fraction = weights.sum() / problem.space.weights.sum()
    for expected, found in (
        (pressure, (within[0] + within[1]) / (far[0] + far[1])),
        (deviator, (within[0] - within[1]) / (far[0] - far[1])),
    ):
        assert found == pytest.approx(expected / (1 - fraction + fraction * expected), abs=0.03)
    # What the sides reflect varies over the inclusion by a like fraction of itself: (8/25)^2 of 3 %.
    assert change[inside, 1].std() < 0.003 * abs(far[1])
    assert problem.space.host_mesh.curved is not None


def test_simple_shear_keeps_equilibrium_and_turns_the_axes(solve_scene: Callable) -> None:
    """Gauss: with nothing but pressure on the sides the mean shear stress is the platen's force over its length."""
    problem, steps = solve_scene(
        "simple_shear_specimen", "mesh.rectangle.nx=8", "mesh.rectangle.ny=4", "stage.1.increments=5"
    )
    shear = [mean(problem, step.stress)[2] for step in steps]
    force = [step.reactions["top"][0] for step in steps]
    # Equilibrium of the sides is held to the solver's tolerance of 1e-8 of all forces.
    np.testing.assert_allclose(shear, np.array(force) / 0.1, atol=1e-6 * 120e3)
    assert shear[-1] > 10e3
    middle = np.argmin(np.sum((problem.space.points - [0.05, 0.025]) ** 2, axis=1))
    xx, yy, xy = steps[-1].stress[middle]
    fabric = steps[-1].state[middle, problem.law.description.columns("fabric_anisotropy")]
    axis = 0.5 * np.degrees(np.arctan2(-xy, -(xx - yy) / 2))  # of the major compression
    assert 15.0 < abs(90.0 - abs(axis)) < 25.0  # it began upright
    # Contacts are lost across the growing compression: the fabric follows the change of stress, not the stress.
    fabric_axis = 0.5 * np.degrees(np.arctan2(fabric[1], fabric[0]))
    assert abs(90.0 - abs(fabric_axis)) > abs(90.0 - abs(axis))


def test_simple_shear_with_driven_sides_is_a_point(solve_scene: Callable) -> None:
    """Sides that move with the platen in proportion to height make it homogeneous, as the point driver has it."""
    sides = ["left", "right"]
    moved = ", ".join(
        f"{{boundary='{side}', component='x', value=0.0, gradient=[0.0, 5e-5]}}, "
        f"{{boundary='{side}', component='y', value=0.0}}"
        for side in sides
    )
    _, steps = solve_scene(
        "simple_shear_specimen",
        *("mesh.rectangle.nx=2", "mesh.rectangle.ny=2", "stage.1.increments=10", "stage.0.pressure=[]"),
        "stage.0.fixed=[{boundary='bottom'}, {boundary='top'}, {boundary='left'}, {boundary='right'}]",
        f"stage.1.displacement=[{{boundary='top', component='x', value=2.5e-6}}, {moved}]",
    )
    leg = Leg(control=("strain", "strain", "strain"), target=(0.0, 0.0, 5e-5), increments=10)
    alone = drive(point_law("simple_shear_specimen"), (-80e3, -120e3, 0.0), [leg]).columns
    for place, name in enumerate(("stress_xx", "stress_yy", "stress_xy")):
        np.testing.assert_allclose(steps[-1].stress[:, place], alone[name][-1], rtol=1e-4)


def test_cycles_retrace_with_memory_and_ratchet_without(solve_scene: Callable) -> None:
    """Between unloaded states the second loop adds next to nothing where weak forces are followed; it goes on losing
    where every fall of the mean force opens contacts for good [the source's closure]."""
    coarse = ("mesh.rectangle.nx=2", "mesh.rectangle.ny=3")

    def losses(*assignments: str) -> tuple[float, float]:
        problem, steps = solve_scene("cyclic_biaxial", *coarse, *assignments)
        column = problem.law.description.columns("coordination")
        ends = {step.stage: mean(problem, step.state[:, column])[0] for step in steps}  # last of each stage
        return ends["initial"] - ends["unload 1"], ends["unload 1"] - ends["unload 2"]

    first, second = losses()
    assert first > 0 and abs(second) < 0.1 * first
    first, second = losses("closure.force_change=mean_field")
    assert second > 0.3 * first > 0


def test_random_specimen_is_a_function_of_place(solve_scene: Callable) -> None:
    coarse = ("mesh.rectangle.nx=4", "mesh.rectangle.ny=8", *CONSTANT_STIFFNESS, "stage.1.increments=1")
    problem, steps = solve_scene("random_specimen", *coarse)
    z = problem.initial_state[:, problem.law.description.columns("coordination")][:, 0]
    wanted = 3.896 + 0.08 * random_field(problem.space.points, 1, (0.02, 0.006), "gaussian")
    np.testing.assert_allclose(z, wanted, rtol=1e-12)
    # Bounds of Reuss and Voigt for smooth platens at constant lateral stress: K goes with z, G with z (z - z_iso), the
    # uniaxial modulus in the plane is 4 K G/(K + G). Means over the integration points, as the element has them.
    material = load("random_specimen").scene.material
    bulk, shear = moduli(material)
    distance = (z - material.isostatic_coordination) / (material.coordination - material.isostatic_coordination)
    distance *= z / material.coordination
    k, g = bulk * z / material.coordination, shear * distance
    lower = 1 / mean(problem, (k + g) / (4 * k * g))
    upper = 4 * mean(problem, k) * mean(problem, g) / (mean(problem, k) + mean(problem, g))
    pressed = mean(problem, steps[-1].stress - problem.initial_stress)[1]
    measured = pressed / mean(problem, steps[-1].strain)[1]
    assert lower * (1 - 1e-9) <= measured <= upper * (1 + 1e-9)
    assert lower < upper < 1.05 * lower


def test_another_seed_is_another_specimen(solve_scene: Callable) -> None:
    coarse = ("mesh.rectangle.nx=3", "mesh.rectangle.ny=6", "stage.1.increments=2")
    pressures = []
    for seed in (1, 1, 2):
        _, steps = solve_scene("random_specimen", *coarse, f"random_state.seed={seed}")
        p, q = invariants(steps[-1].stress)
        pressures.append(q / p)
    np.testing.assert_array_equal(pressures[0], pressures[1])
    assert np.abs(pressures[0] - pressures[2]).max() > 1e-3

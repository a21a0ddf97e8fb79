"""Checkpoints: the same bits follow, damaged files are told from whole ones, other input is refused."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from fem_meshes import PLASTIC, distorted

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure, Material
from granfabric.fem.discretisation.space import Space
from granfabric.fem.equilibrium.checkpoint import KEPT, CheckpointError, CheckpointFolder
from granfabric.fem.equilibrium.control import ControlError, StepControl
from granfabric.fem.equilibrium.initial import initial_result
from granfabric.fem.equilibrium.results import StageStart
from granfabric.fem.equilibrium.stepping import solve
from granfabric.fem.loads.kinds import Displacement, Fixed, Pressure, Stage
from granfabric.fem.loads.problem import Problem

GRAINS = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
HELD = [Fixed("bottom"), Fixed("top")]
SIDES = [Pressure("left", 1e5), Pressure("right", 1e5)]
PROGRAMMES = {
    "plastic": (PLASTIC, [Stage("press", [Fixed("bottom"), Displacement("top", "y", -0.02)], 4)], None),
    "grains": (
        GRAINS,
        [
            Stage("initial", [*HELD, *SIDES], 2),
            Stage("press", [Displacement("top", "y", -4e-5)], 4),
            Stage("shear", [Displacement("top", "x", 4e-5)], 3),
        ],
        [-1e5, -1e5, 0.0],
    ),
}
PACKING = Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9, peak_stress_ratio=0.35)
REVERSALS = [
    Stage("initial", [*HELD, *SIDES], 1),
    Stage("press", [Displacement("top", "y", -5e-5)], 3),
    # forces fall within a stage, and with them the residual that counts as zero
    Stage("unload", [Displacement("top", "y", -1e-5), Pressure("left", 0.3e5), Pressure("right", 0.3e5)], 5),
    Stage("turn", [Displacement("top", "x", 4e-5)], 2),
    Stage("turn back", [Displacement("top", "x", -2e-5), Displacement("top", "y", 0.0)], 3),
    # the top is let go sideways and the pressures are not named: reactions and forces fade
    Stage("release", [Fixed("bottom"), Displacement("top", "y", -1e-5)], 3, keep=False),
]
AWAY_AND_BACK = {
    "plastic": (
        PLASTIC,
        [
            Stage("press", [Fixed("bottom"), Displacement("top", "y", -0.02)], 3),
            Stage("unload", [Displacement("top", "y", -0.016)], 4),
            Stage("pull", [Displacement("top", "y", 0.0), Displacement("top", "x", 0.01)], 3),
            Stage("release", [Fixed("bottom"), Fixed("top", ("y",))], 3, keep=False),
        ],
        None,
    ),
    "grains": (GRAINS, REVERSALS[:-1], [-1e5, -1e5, 0.0]),
    "grains released": (GRAINS, [*REVERSALS[:3], REVERSALS[-1]], [-1e5, -1e5, 0.0]),
    "shifted": (
        ContactLaw([PACKING], Closure(force_change="shifted_distribution")), REVERSALS[:-1], [-1e5, -1e5, 0.0],
    ),
    "sliding": (ContactLaw([PACKING], effects=Effects(sliding=True)), REVERSALS[:-1], [-1e5, -1e5, 0.0]),
    "uncoupled": (
        ContactLaw([PACKING], effects=Effects(stiffness_feedback=False)), REVERSALS, [-1e5, -1e5, 0.0],
    ),
    # stress that no load balances: forces of reference take part in every stage
    "balanced": (GRAINS, [Stage("initial", [*HELD]), *REVERSALS[1:4]], [-1e5, -0.8e5, 0.1e5]),
    "uncoupled, balanced": (
        ContactLaw([PACKING], effects=Effects(stiffness_feedback=False)),
        [Stage("initial", [*HELD]), *REVERSALS[1:4]], [-1e5, -0.8e5, 0.1e5],
    ),
}  # fmt: skip


def problem(name: str, n: int = 4, programmes: dict = PROGRAMMES) -> Problem:
    law, stages, stress = programmes[name]
    space = Space(distorted("P2", n), "P2")
    return Problem(space, law, stages, stress, balance_initial_stress="balanced" in name)


def same(first, second) -> None:
    """Equal to the last bit in every entry."""
    for entry in fields(first):
        ours, theirs = getattr(first, entry.name), getattr(second, entry.name)
        if isinstance(ours, StageStart):
            same(ours, theirs)
        elif isinstance(ours, np.ndarray):
            assert ours.dtype == theirs.dtype and ours.tobytes() == theirs.tobytes(), entry.name
        else:
            assert ours == theirs, entry.name


@pytest.mark.parametrize("solver", ["auto", "superlu"])
@pytest.mark.parametrize("name", PROGRAMMES)
def test_the_same_bits_follow_from_every_checkpoint(name, solver, tmp_path):
    control = StepControl(linear_solver=solver, first_factor=0.5, easy_iterations=3)
    store = CheckpointFolder(tmp_path, "mine")
    whole, loaded = [], []

    def save(checkpoint) -> None:
        store.save(checkpoint)
        loaded.append(store.read(store.files()[-1]))

    summary = solve(problem(name), control, on_step=whole.append, on_checkpoint=save)
    assert summary.finished and len(loaded) == len(whole) > 4
    assert len(store.files()) == KEPT
    for number, checkpoint in enumerate(loaded):
        same(checkpoint.result, whole[number])
        again: list = []
        end = solve(problem(name), control, on_step=again.append, resume=checkpoint)
        assert end.finished and end.counters == summary.counters
        assert len(again) == len(whole) - number - 1
        for ours, theirs in zip(again, whole[number + 1 :]):
            same(ours, theirs)


@pytest.mark.parametrize("name", AWAY_AND_BACK)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_the_same_bits_follow_while_forces_fall_turn_and_fade(name, tolerance, tmp_path):
    """Unloading, turned loads, released boundaries; loose tolerances, so that every number of the memory decides."""
    control = StepControl(tolerance=tolerance, first_factor=0.5, easy_iterations=3)
    store = CheckpointFolder(tmp_path, "mine")
    whole, loaded = [], []

    def save(checkpoint) -> None:
        store.save(checkpoint)
        loaded.append(store.read(store.files()[-1]))
        remembered(loaded[-1].memory, checkpoint.memory)

    summary = solve(problem(name, 2, AWAY_AND_BACK), control, on_step=whole.append, on_checkpoint=save)
    assert summary.finished, summary.message
    assert len(loaded) == len(whole) >= 9
    for number, checkpoint in enumerate(loaded):
        same(checkpoint.result, whole[number])
        again: list = []
        later = iter(loaded[number + 1 :])
        end = solve(
            problem(name, 2, AWAY_AND_BACK), control, on_step=again.append, resume=checkpoint,
            on_checkpoint=lambda made, later=later: remembered(made.memory, next(later).memory),
        )  # fmt: skip
        assert end.finished and end.counters == summary.counters
        assert len(again) == len(whole) - number - 1
        for ours, theirs in zip(again, whole[number + 1 :]):
            same(ours, theirs)


def remembered(ours, theirs) -> None:
    """What solvers remember is the same to the last bit; times are not."""
    assert ours.tangent.tobytes() == theirs.tangent.tobytes()
    assert (ours.last_increment, ours.force_scale) == (theirs.last_increment, theirs.force_scale)
    assert (ours.last_correction is None) == (theirs.last_correction is None)
    if ours.last_correction is not None:
        assert ours.last_correction.tobytes() == theirs.last_correction.tobytes()
    assert ours.counters == theirs.counters


@pytest.fixture(scope="module")
def checkpoint():
    found: list = []
    solve(problem("plastic", 2), on_checkpoint=lambda made: found.append(made), stop=lambda: bool(found))
    assert len(found) == 1
    return found[0]


def test_a_cut_file_never_looks_whole(checkpoint, tmp_path):
    store = CheckpointFolder(tmp_path, "mine")
    store.save(checkpoint)
    (file,) = store.files()
    content = file.read_bytes()
    for length in np.linspace(0, len(content) - 1, 60).astype(int).tolist():
        file.write_bytes(content[:length])
        with pytest.raises(CheckpointError, match="is damaged"):
            store.read(file)


def test_a_flipped_bit_is_noticed_or_harmless(checkpoint, tmp_path):
    store = CheckpointFolder(tmp_path, "mine")
    store.save(checkpoint)
    (file,) = store.files()
    content = file.read_bytes()
    noticed = 0
    for place in np.random.default_rng(3).integers(0, 8 * len(content), 300).tolist():
        damaged = bytearray(content)
        damaged[place // 8] ^= 1 << place % 8
        file.write_bytes(damaged)
        try:
            read = store.read(file)
        except CheckpointError:
            noticed += 1
        else:  # a time stamp or padding of the archive
            same(read.result, checkpoint.result)
            assert read.memory.tangent.tobytes() == checkpoint.memory.tangent.tobytes()
    assert noticed > 250


def test_the_one_before_serves_if_the_last_is_damaged(checkpoint, tmp_path):
    store = CheckpointFolder(tmp_path, "mine")
    assert store.load() == (None, [])
    for step in (1, 2, 3):
        store.save(replace(checkpoint, result=replace(checkpoint.result, step=step)))
    first, second = store.files()
    assert [file.name for file in (first, second)] == ["checkpoint_000002.npz", "checkpoint_000003.npz"]
    assert store.load()[0].result.step == 3
    second.write_bytes(b"")
    found, damages = store.load()
    assert found.result.step == 2 and len(damages) == 1 and "checkpoint_000003.npz is damaged" in damages[0]
    first.write_bytes(first.read_bytes()[:1000])
    with pytest.raises(CheckpointError, match=r"000003.*000002"):
        store.load()
    store.remove()
    assert not list(tmp_path.iterdir())


def test_other_input_and_other_numbers_are_refused(checkpoint, tmp_path):
    CheckpointFolder(tmp_path, "mine").save(checkpoint)
    with pytest.raises(CheckpointError, match="another input"):
        CheckpointFolder(tmp_path, "yours").load()
    nan = replace(checkpoint, memory=replace(checkpoint.memory, tangent=checkpoint.memory.tangent * np.nan))
    store = CheckpointFolder(tmp_path, "mine")
    store.save(nan)
    with pytest.raises(CheckpointError, match=r"memory.tangent holds a value that is not finite"):
        store.read(store.files()[-1])
    with pytest.raises(ControlError, match="shape"):
        solve(problem("plastic", 4), resume=checkpoint)
    wrong = replace(checkpoint, memory=replace(checkpoint.memory, last_correction=np.zeros(3)))
    with pytest.raises(ControlError, match=r"correction of shape \(3,\)"):
        solve(problem("plastic", 2), resume=wrong)


def test_initial_reactions_balance_the_stress_that_is_there(checkpoint):
    start = initial_result(problem("grains"))
    assert (start.step, start.fraction, start.stage) == (0, 0.0, "initial")
    # Platens of length 2 under 100 kPa; what presses on the sides is balanced by the stress itself.
    np.testing.assert_allclose(start.reactions["top"], (0.0, -2e5), atol=1e-9 * 2e5)
    np.testing.assert_allclose(start.reactions["bottom"], (0.0, 2e5), atol=1e-9 * 2e5)
    assert initial_result(problem("plastic")).reactions["top"] == (0.0, 0.0)


def test_initial_arrays_are_in_the_order_of_the_kernels():
    # Another memory layout would compile every kernel that reads them a second time.
    for name in PROGRAMMES:
        made = problem(name)
        assert made.initial_stress.flags.c_contiguous and made.initial_state.flags.c_contiguous

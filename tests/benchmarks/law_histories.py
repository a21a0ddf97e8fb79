"""Random histories of the contact law under every option, to compare two builds of it.

    python tests/benchmarks/law_histories.py record FILE.npz      with one build
    python tests/benchmarks/law_histories.py compare FILE.npz     with the other

Each build runs in its own process; `record` also runs where the rooms lie directly on the path, as they once did. Fixed
substeps of Dormand and Prince and many directions, so that both builds integrate the same equations to rounding and
what is left is how they are written. Prints the largest difference of stress over p, of z, a_c and further columns of
the state, and of the tangent over its largest entry.
"""

import importlib
import itertools
import sys

import numpy as np

PRESSURE = 1e5


def room(name):
    """A module of the law, by the name it has in this build."""
    try:
        return importlib.import_module(f"granfabric.constitutive.{name}")
    except ModuleNotFoundError:
        return importlib.import_module(f"constitutive.{name}")


Closure, Integration, Material = (getattr(room("parameters"), name) for name in ("Closure", "Integration", "Material"))
Effects, ContactLaw = room("effects").Effects, room("law").ContactLaw
SOURCE = {"coordination": 4.06, "solid_fraction": 0.846, "normal_stiffness": 1e9, "gap_density_at_zero": 100.0}
PACKINGS = [
    Material(**SOURCE, initial_fabric_xx=0.1, initial_fabric_xy=-0.05),
    Material(**SOURCE, force_density_at_zero=0.65, force_anisotropy_ratio=0.94, shear_reduction=0.7),
]
EXACT = {"integrator": "dormand_prince", "substeps": 6, "directions": 64}


def cases():
    """Name, closure, effects, numerics, control."""
    strain, stress, mixed = (0, 0, 0), (1, 1, 1), (1, 0, 1)
    closures = {}
    for change, rule, density in itertools.product(
        ("mean_field", "fluctuating", "shifted_distribution"),
        ("neglected", "self_consistent"),
        ("harmonic", "maximum_entropy"),
    ):
        if change == "shifted_distribution" and density == "maximum_entropy":
            continue
        closures[f"{change} {rule} {density}"] = Closure(force_change=change, tangential=rule, distribution=density)
    iso = Closure(force_change="shifted_distribution", shear_stiffness="isostatic", elastic_scatter=0.3, slip=1.4)
    closures["shifted isostatic"] = iso
    for name, closure in closures.items():
        for control in (strain, stress, mixed):
            yield f"{name} {control}", closure, Effects(), EXACT, control
        yield f"{name} sliding", closure, Effects(sliding=True), {**EXACT, "substeps": 8}, strain
    slides = Effects(sliding=True)
    yield "mean_field sliding stress", Closure(), slides, EXACT, stress
    yield "shifted sliding mixed", iso, slides, EXACT, mixed
    for off in itertools.product((True, False), repeat=4):
        names = ("contact_loss", "contact_gain", "principal_rotation", "stiffness_feedback")
        effects = Effects(**dict(zip(names, off)))
        for closure in (Closure(), iso):
            yield f"{closure.force_change} effects {off}", closure, effects, EXACT, strain
    yield "no irreversible spread", iso, Effects(irreversible_spread=False), EXACT, strain
    gauss = {**EXACT, "arc_integration": "gauss", "directions": 128}
    yield "gauss", Closure(), Effects(), gauss, strain
    for closure in (Closure(), iso):
        implicit = {"integrator": "kennedy_carpenter", "substeps": 4, "directions": 64}
        yield f"implicit {closure.force_change}", closure, Effects(), implicit, strain
    for integrator in ("forward_euler", "modified_euler", "bogacki_shampine"):
        yield integrator, Closure(), Effects(), {"integrator": integrator, "substeps": 5}, strain


def history(closure, effects, numerics, control, number=24, increments=14):
    """End stresses, states, strains and tangents of all increments; NaN once a point has failed."""
    law = ContactLaw(PACKINGS, closure, effects, Integration(**numerics))
    rng = np.random.default_rng(7)
    material = rng.integers(0, 2, number).astype(np.int32)
    p, ratio, turn = rng.uniform(0.7, 1.4, number), rng.uniform(0, 0.25, number), rng.uniform(0, 6.3, number)
    t1, t2 = ratio * np.cos(turn), ratio * np.sin(turn) * float(effects.principal_rotation)
    stress = PRESSURE * np.stack([-p * (1 + t1), -p * (1 - t1), -p * t2], axis=1)
    state = law.initial_state(stress, material)
    main = rng.uniform(-1.0, 1.0, (number, 3)) * [1.0, 1.0, float(effects.principal_rotation)]
    out, dead = [], np.zeros(number, dtype=bool)
    for step in range(increments):
        sign = 1.0 if step % 7 < 4 else -0.8
        given = sign * main + 0.6 * rng.uniform(-1, 1, (number, 3)) * [1.0, 1.0, float(effects.principal_rotation)]
        given = given * np.where(np.array(control) == 1, 2e3, 8e-6)
        end, after, tangent = np.zeros_like(stress), np.zeros_like(state), np.zeros((number, 3, 3))
        strain = np.array(given)
        if any(control):
            which = np.tile(np.array(control, dtype=np.uint8), (number, 1))
            report = law.update_mixed(which, given, stress, state, end, after, strain, material)
        else:
            report = law.update(given, stress, state, end, after, tangent, "propagated", material)
        dead |= report.status > 1
        p_end = -0.5 * (end[:, :1] + end[:, 1:2])
        scale = np.abs(tangent).max(axis=(1, 2), keepdims=True)
        row = [end / p_end, after, strain * 1e4, (tangent / np.where(scale > 0, scale, 1.0)).reshape(number, 9)]
        out.append(np.where(dead[:, None], np.nan, np.concatenate(row, axis=1)))
        stress, state = end, after
    return np.array(out), [variable.name for variable in law.description.state for _ in range(variable.components)]


def main():
    """Record, or compare."""
    action, file = sys.argv[1:3]
    kept = None if action == "record" else np.load(file)
    found = {}
    for name, closure, effects, numerics, control in cases():
        found[name], columns = history(closure, effects, numerics, control)
        if kept is None:
            print(name, int(np.isnan(found[name][-1, :, 0]).sum()), "failed", flush=True)
            continue
        one, other = found[name], kept[name]
        n = len(columns)
        split = [i for i, column in enumerate(columns) if column.endswith(("gained", "lost"))]
        dissipation = [i for i, column in enumerate(columns) if column == "plastic_dissipation"]
        other_columns = [i for i in range(n) if i not in split and i not in dissipation and i > 2]
        differ = np.abs(one - other)
        failures = (np.isnan(one[..., 0]) != np.isnan(other[..., 0])).sum()

        def largest(columns, differ=differ):
            part = differ[..., columns]
            return np.nanmax(part) if part.size and not np.isnan(part).all() else 0.0

        print(
            f"{name:52s} stress {largest(slice(0, 3)):.1e}  z {largest([3]):.1e}  a_c {largest([4, 5]):.1e}  "
            f"others {largest([3 + i for i in other_columns]):.1e}  split {largest([3 + i for i in split]):.1e}  "
            f"strain {largest(slice(3 + n, 6 + n)):.1e}  tangent {largest(slice(6 + n, 15 + n)):.1e}"
            + (f"  {failures} fail in one build only" if failures else ""),
            flush=True,
        )
    if kept is None:
        np.savez(file, **found)


if __name__ == "__main__":
    main()

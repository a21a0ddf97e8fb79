"""Figures of the documentation: made-up findings through the scripts that draw them."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from drawn import check_curves, check_legend, curves, heading, same, unnamed, words

from granfabric.constitutive.contract import Status
from granfabric.dem_ref.measures.contacts import Contacts

HOME = Path(__file__).resolve().parents[2]


def script(path: str) -> ModuleType:
    """A script that is no part of a package."""
    name = f"script_{Path(path).stem}"
    spec = importlib.util.spec_from_file_location(name, HOME / path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where a dataclass looks for its annotations
    spec.loader.exec_module(module)
    return module


def test_findings_on_closures(pictures: dict[str, Any], tmp_path: Path) -> None:
    module = script("docs/closure_findings.py")
    random = np.random.default_rng(1)
    levels = np.linspace(0, 0.3, 31)
    loops, grains = random.uniform(1, 2, (4, 2)), random.normal(size=(3, 31))
    a_t, x1, spread = random.normal(size=(3, 31))
    module.draw(tmp_path / "f.png", module.Findings(loops, levels, grains, 0.78, a_t, x1, spread), "Made up")
    assert heading(pictures["f.png"]) == "Made up"
    left, middle, right = pictures["f.png"].axes
    check_curves(left, [0.0125, 0.025, 0.05, 0.1], {
        "slip $k = -2 a_t/s^2$": loops[:, 0], "scatter $c_i = S_i/s^2$": loops[:, 1],
    })  # fmt: skip
    check_curves(middle, levels, {
        "DEM": grains[0], "elastic, $c_t s$": 0.78 * levels, "$c_t s - k s^2$, then constant": a_t,
    })  # fmt: skip
    check_curves(right, levels, {
        "DEM, shift $X_1$": grains[1] / 1.15, "DEM, standard deviation $S$": grains[2], "closure, shift": x1,
        "closure, standard deviation": spread,
    })  # fmt: skip
    assert words(middle)[:2] == ("Tangential-force anisotropy $a_t$ [-]", "stress ratio $q/p$ [-]")
    assert words(right)[:2] == ("Shift and standard deviation of weak forces [$f$]", "stress ratio $q/p$ [-]")
    for axes in (left, middle, right):
        check_legend(axes)


def test_shift_and_spread_of_a_class_of_contacts() -> None:
    """Contacts of 0.3 to 0.5 of the mean force: the harmonic along y, the deviation about it; lost ones at zero."""
    module = script("docs/closure_findings.py")
    theta = np.repeat(np.arange(60) * np.pi / 60, 2)
    sign = np.tile([1.0, -1.0], 60)

    def contacts(force: np.ndarray, keep: Any = slice(None)) -> Contacts:
        key = np.arange(120)[keep]
        normal = np.column_stack([np.cos(theta), np.sin(theta)])[keep]
        return Contacts(key, key + 1, np.zeros((len(key), 2), np.int8), normal, np.ones(len(key)), force[keep],
                        np.zeros(len(key)), key)  # fmt: skip

    scale = 5.0
    along = -np.cos(2 * theta)  # positive along y
    after = 0.4 + 0.01 + 0.06 * along + 0.02 * sign
    x1, spread = module.shift_and_deviation(contacts(np.full(120, 0.4 * scale)), contacts(after * scale), scale)
    assert (x1, spread) == (pytest.approx(0.06), pytest.approx(0.02))
    lost = np.ones(120, dtype=bool)
    lost[:2] = False
    after[:2] = 0.0
    some = module.shift_and_deviation(contacts(np.full(120, 0.4 * scale)), contacts(after * scale, lost), scale)
    whole = module.shift_and_deviation(contacts(np.full(120, 0.4 * scale)), contacts(after * scale), scale)
    assert some == pytest.approx(whole)
    # contacts outside the class have no part in it
    inside = np.arange(120) % 4 < 2
    after = 0.4 + 0.01 + 0.06 * along + 0.02 * sign
    start, other = np.where(inside, 0.4, 0.9) * scale, np.where(inside, after, 0.0) * scale
    assert module.shift_and_deviation(contacts(start), contacts(other), scale) == pytest.approx((0.06, 0.02))


def test_sliding_curves() -> None:
    """Shear strain and dilation in per cent; grains grey, the law over them; the inset in 1e-4."""
    module = script("tests/benchmarks/sliding_curve.py")
    random = np.random.default_rng(4)

    def made(last: float) -> dict[str, np.ndarray]:
        shear = np.linspace(0, last, 12)
        return {"shear": shear, "ratio": random.uniform(size=12), "dilation": random.normal(size=12) * 1e-3,
                "z": 3 + random.uniform(size=12)}  # fmt: skip

    grains, laws, elastic = [made(0.02), made(0.02)], [made(0.01), made(0.01)], made(0.01)
    figure = module.draw(grains, laws, elastic)
    for axes, name, label, scale in zip(
        figure.axes, ("ratio", "dilation", "z"), ("q/p", "dilation [%]", "coordination number"), (1.0, 100.0, 1.0)
    ):
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("shear strain [%]", label)
        found = curves(axes)
        reach = grains[0]["shear"] <= 0.0101
        same(found["disks, each packing"], 100 * grains[0]["shear"][reach], scale * grains[0][name][reach])
        same(found["law, parameters of each"], 100 * laws[0]["shear"], scale * laws[0][name])
        rest = unnamed(axes)
        same(rest[0], 100 * grains[1]["shear"][reach], scale * grains[1][name][reach])
        same(rest[1], 100 * laws[1]["shear"], scale * laws[1][name])
    same(curves(figure.axes[0])["without sliding"], 100 * elastic["shear"], elastic["ratio"])
    same(unnamed(figure.axes[2])[2], 100 * elastic["shear"], elastic["z"])
    (inset,) = figure.axes[0].child_axes
    assert inset.get_xlabel() == r"$10^{-4}$"
    expected = [*(pair for dem, law in zip(grains, laws) for pair in (dem, law)), elastic]
    for line, data in zip(unnamed(inset), expected, strict=True):
        same(line, 1e4 * data["shear"], data["ratio"])


def test_hard_cases_of_the_law(pictures: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Six panels: each closure's own curve under its name, a cross where it was refused."""
    module = script("tests/hard_cases/draw.py")
    monkeypatch.setattr(module, "make_law", lambda closure, numerics: closure.force_change)
    made: dict[tuple[str, str], tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
    random = np.random.default_rng(5)

    def curve(panel: str) -> Any:
        def of(law: str) -> Any:
            status = np.zeros(8, dtype=int)
            status[-2:] = Status.NO_PRESSURE
            made[panel, law] = np.arange(1.0, 9.0), random.uniform(0.1, 1.0, 8), status
            return made[panel, law]

        return of

    panels = ("unloading", "extension", "cycles", "rotation", "beyond_one", "reversals")
    for panel in panels:
        monkeypatch.setattr(module, panel, curve(panel))
    module.law_picture()
    axes = pictures["hard_cases_law.png"].axes
    for one, panel, letter in zip(axes, panels, "abcdef", strict=True):
        assert one.get_title("left").startswith(f"({letter}) ")
        found = curves(one)
        for name in module.shown():
            law = module.shown()[name].force_change
            x, y, _ = made[panel, law]
            same(found[name], x[:6], y[:6])
        crosses = [line for line in one.get_lines() if line.get_marker() == "x"]
        assert len(crosses) == len(module.shown())
        assert all(line.get_xdata()[0] == 6.0 for line in crosses)
    assert [axes_.get_xlabel() for axes_ in axes] == [
        "$p/p_0$ [-]", "volume strain [$10^{-6}$]", "cycle", "turn [degrees]", "$q/p$ [-]", "$s$ [-]"
    ]  # fmt: skip
    x, y = curves(axes[0])["$z_0 (p/p_0)^{P_0}$"]
    np.testing.assert_allclose(y, 4.06 * np.sqrt(x))

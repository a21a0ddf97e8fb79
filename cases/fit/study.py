"""From curves to fitted parameters, and from curves to the deviations of a given law."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from granfabric.cases.errors import InputError, RunError

from . import identification, settings
from .columns import STRAIN
from .deviations import Deviations, StoppedError
from .following import Followed, follow
from .law_side import Answer, LawSide, first_row
from .parameters import Free, candidates, free_parameter, named, values_of
from .reading import Curve
from .settings import Base, Given
from .solving import Search, search, start
from .uncertainty import FromRows, Uncertainty, uncertainty

Array = NDArray[np.float64]

Advance = Callable[[float, str], None]
STEPS_SHOWN = 30
"""Trials of a usual fit, for the bar."""
MOST_WEIGHINGS = 6
SETTLED = 0.05
"""Relative change of the weight of a column that asks for no further search."""
LARGE_ERROR = 0.5
"""Standard error over the value from which a parameter counts as hardly told."""
MISSED = 1.5
"""Misfit of a column, in scales, that is told."""
CORRELATED = 0.95
NUMERICAL = 1e-3
"""Deviations, in scales, below which nobody asks whether they are scatter."""
DIFFERENT_STARTS = 3.0
"""Scales by which first rows of several curves differ from their mean before this is said."""


@dataclass(frozen=True)
class Compared:
    """A law along curves.

    Attributes
    ----------
    base : Base
    values : dict of str to float
        Every number of material and closure.
    curves : list of Followed
    answers : list of Answer
    deviations : Deviations
    vector : ndarray
        Deviations in their scales; NaN where the law refused.
    """

    base: Base
    values: dict[str, float]
    curves: list[Followed]
    answers: list[Answer]
    deviations: Deviations
    vector: Array

    @property
    def refusals(self) -> list[str]:
        """A sentence on each curve that the law did not follow to its end."""
        return [
            _refused(curve, answer)
            for curve, answer in zip(self.curves, self.answers)
            if answer.reached < curve.curve.rows
        ]


@dataclass(frozen=True)
class Fitted(Compared):
    """Fitted parameters.

    Attributes
    ----------
    free : list of Free
    errors : dict of str to float
        Standard errors; NaN of a parameter on a bound.
    on_bound : dict of str to str
        "lower" or "upper", of parameters that stopped there.
    uncertainty : Uncertainty
        Of the parameters in `inner`.
    inner : list of str
        Free parameters that are not on a bound.
    steps : int
    converged, stopped : bool
    message : str
    remarks : list of str
        What is to be said, a line each.
    """

    free: list[Free] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    on_bound: dict[str, str] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None
    inner: list[str] = field(default_factory=list)
    steps: int = 0
    converged: bool = False
    stopped: bool = False
    message: str = ""
    remarks: list[str] = field(default_factory=list)


def _refused(curve: Followed, answer: Answer) -> str:
    line = curve.curve.lines[min(answer.reached, curve.curve.rows - 1)]
    return f"{curve.curve.place}: the law does not get to line {line}: {answer.message}"


def prepare(curves: Sequence[Curve], found: Given, free: Sequence[str]) -> tuple[Base, list[Followed]]:
    """Base and followed curves.

    Raises
    ------
    InputError
    """
    early = settings.first_settings(found)
    initial = settings.initial_stress(early)
    followed = [follow(curve, early.control, initial, early.scale) for curve in curves]
    rows = [first_row(curve) for curve in followed]
    names = dict.fromkeys(name for row in rows for name in row)
    means = {name: float(np.mean([row[name] for row in rows if name in row])) for name in names}
    pressure = float(np.mean([-0.5 * (curve.initial_stress[0] + curve.initial_stress[1]) for curve in followed]))
    tells = (*STRAIN, "volumetric_strain", "shear_strain", "p", "q", "stress_xx", "stress_yy", "stress_xy")
    stiffness = any(name in tells for curve in followed for name in curve.compared)
    place = followed[0].curve.place
    base = settings.complete(found, means, pressure, stiffness, free, place)
    if early.start == "row":
        for curve, row in zip(followed, rows):
            if "coordination" not in row and "initial_fabric_xx" not in row:
                raise InputError(
                    f"{curve.curve.place}: start = 'row' takes z and a_c from the first row, which has neither"
                )
    return base, followed


def compare(curves: Sequence[Curve], found: Given, advance: Advance, stop: Callable[[], bool]) -> Compared:
    """The law with given parameters along curves, without fitting.

    Raises
    ------
    InputError
    StoppedError
    """
    base, followed = prepare(curves, found, ())
    side = LawSide(base, followed, base.settings.start)
    deviations = Deviations(side, stop)
    answers = side.answers(base.values, stop)
    if stop():
        raise StoppedError
    advance(1.0, "")
    return Compared(base, dict(base.values), followed, answers, deviations, deviations.of_answers(answers))


def fit(
    curves: Sequence[Curve], found: Given, free: Sequence[str], advance: Advance, stop: Callable[[], bool]
) -> Fitted:
    """Fit parameters to curves.

    Parameters
    ----------
    curves : sequence of Curve
    found : Given
        What `settings.given` read.
    free : sequence of str
        Names as `--free` takes them; none for those that the curves tell.
    advance : callable
        ``advance(fraction, text)``.
    stop : callable
        True ends the search with the best so far.

    Raises
    ------
    InputError
        If something given is not legal, or a parameter that was named cannot be identified.
    RunError
        If the law follows the curves from no start.
    StoppedError
        If it was stopped before the law had followed the curves once.
    """
    wanted = named(free) if free else []
    base, followed = prepare(curves, found, wanted)
    by_row = base.settings.start == "row"
    if by_row and (bad := [name for name in wanted if name == "coordination" or name.startswith("initial_fabric")]):
        raise InputError(f"--free {bad[0]}: with start = 'row' it is that of the first row of each curve")
    side = LawSide(base, followed, base.settings.start)
    deviations = Deviations(side, stop)
    pressure = float(np.mean([-0.5 * curve.initial_stress[:2].sum() for curve in followed]))
    columns = dict.fromkeys(name for curve in followed for name in curve.compared)
    names = wanted or candidates(base, by_row, columns)
    if not names:
        raise InputError(f"{followed[0].curve.place}: nothing is left to fit: every parameter is held")
    trial = [free_parameter(name, base.values[name], pressure) for name in names]
    held = dict(base.values)
    advance(0.0, "looking for a start")
    begin = start(deviations, trial, held)
    if begin is None:
        refused = [
            _refused(curve, answer)
            for curve, answer in zip(followed, side.answers(held))
            if answer.reached < curve.curve.rows
        ]
        raise RunError(
            f"{refused[0]} (tried with other values of the free parameters as well); give values from which it does "
            "by --material-file or --set, or leave out the rows beyond"
        )
    held |= values_of(trial, begin, {})
    advance(0.02, "looking at which parameters the curves tell")
    here = deviations.of(held)
    jacobian = identification.weighted(deviations, deviations.derivative(trial, begin, held, here))
    if wanted:
        chosen = trial
        error = identification.refusal(trial, jacobian)
        if error is not None:
            raise error
    else:
        places = identification.choose(trial, jacobian)
        chosen, begin = [trial[place] for place in places], begin[places]
        if not chosen:
            raise InputError(
                f"{followed[0].curve.place}: these columns ({', '.join(followed[0].compared)}) tell none of the "
                "parameters that are not held"
            )
    if deviations.count <= len(chosen):
        raise InputError(f"{deviations.count} values to compare with do not tell {len(chosen)} parameters")

    def on_step(trials: int, misfit: float) -> None:
        advance(min(0.1 + 0.9 * trials / STEPS_SHOWN, 0.99), f"trial {trials}, misfit {misfit:.4g}")

    result = _weighted_search(deviations, chosen, held, begin, on_step)
    return _finished(base, followed, deviations, chosen, held, result)


def _weighted_search(
    deviations: Deviations,
    chosen: list[Free],
    held: dict[str, float],
    begin: Array,
    on_step: Callable[[int, float], None],
) -> Search:
    """Search again with less weight on the columns that the law misses by more than their scale, until that is settled.

    A column counts over its scale, or over the root mean square by which it is missed if that is more: what the law
    cannot do in one column shall not spoil what the others say.
    """
    result = search(deviations, chosen, held, begin, on_step)
    steps = result.steps
    for _ in range(MOST_WEIGHINGS):
        if result.stopped or not result.converged:
            break
        before = {name: deviations.factors.get(name, 1.0) for name in deviations.rms(result.deviations)}
        after = {name: max(1.0, before[name] * rms) for name, rms in deviations.rms(result.deviations).items()}
        if all(abs(after[name] / before[name] - 1.0) < SETTLED for name in after):
            break
        deviations.factors = after
        first = steps
        result = search(deviations, chosen, held, result.sought, lambda trials, rms: on_step(first + trials, rms))  # noqa: B023
        steps += result.steps
    return replace(result, steps=steps)


def _finished(
    base: Base,
    followed: list[Followed],
    deviations: Deviations,
    chosen: list[Free],
    held: dict[str, float],
    result: Search,
) -> Fitted:
    """The fit with errors, after a search that may have been stopped."""
    values = values_of(chosen, result.sought, held)
    on_bound = {entry.name: side for entry in chosen if (side := entry.bound(values[entry.name]))}
    inner = [entry for entry in chosen if entry.name not in on_bound]
    sought = np.array([entry.inside(values[entry.name]) for entry in inner])
    calm = Deviations(deviations.side, lambda: False)
    calm.factors = deviations.factors
    jacobian = calm.derivative(inner, sought, values, result.deviations)
    found = uncertainty(calm, result.deviations, jacobian, _of_rows(calm, values, base, chosen, result.deviations))
    errors = {entry.name: float("nan") for entry in chosen}
    for entry, error in zip(inner, found.errors):
        errors[entry.name] = entry.error(values[entry.name], float(error))
    fitted = Fitted(
        base, values, followed, deviations.side.answers(values), calm, result.deviations, chosen, errors, on_bound,
        found, [entry.name for entry in inner], result.steps, result.converged, result.stopped, result.message,
    )  # fmt: skip
    fitted.remarks.extend(remarks(fitted))
    return fitted


def _of_rows(
    deviations: Deviations, values: dict[str, float], base: Base, free: list[Free], here: Array
) -> list[FromRows]:
    """Parameters that are held at what the first rows say, which is as uncertain as these are."""
    found = []
    by_row = base.settings.start == "row"
    for name, column in (
        ("coordination", "coordination"),
        ("initial_fabric_xx", "fabric_anisotropy"),
        ("initial_fabric_xy", "fabric_anisotropy_2"),
    ):
        told = [curve for curve in deviations.side.curves if column in curve.compared]
        if by_row or base.origins[name] != "rows" or any(entry.name == name for entry in free) or not told:
            continue
        entry = free_parameter(name, values[name], 1.0)
        derivative = deviations.derivative([entry], np.array([entry.inside(values[name])]), values, here)[:, 0]
        sizes = np.array([curve.scales[column][0] for curve in told])
        root = float(np.sqrt((sizes**2).sum()) / len(told))
        found.append(FromRows(column, derivative / entry.size, root))
    return found


def remarks(fitted: Fitted) -> list[str]:
    """What is doubtful about a fit, a line each."""
    said = [note for curve in fitted.curves for note in curve.curve.notes]
    for name, side in fitted.on_bound.items():
        bound = next(getattr(entry, side) for entry in fitted.free if entry.name == name)
        said.append(
            f"{name} is on its {side} bound {bound:g}: the curves ask for a value beyond; it has no standard error, "
            "and those of the others hold with it held"
        )
    for entry in fitted.free:
        error, value = fitted.errors[entry.name], fitted.values[entry.name]
        if error > LARGE_ERROR * max(abs(value), entry.size if value == 0.0 else 0.0) and error > 0.1 * entry.size:
            said.append(f"{entry.name}: its standard error is {error / abs(value):.1g} times its value: hardly told")
    found = fitted.uncertainty
    if found is not None:
        for row, one in enumerate(fitted.inner):
            for column, other in enumerate(fitted.inner[:row]):
                if abs(found.correlation[row, column]) > CORRELATED:
                    said.append(
                        f"{other} and {one} are told apart badly: correlation {found.correlation[row, column]:+.3f}"
                    )
        for name, factor in fitted.deviations.factors.items():
            if factor > MISSED:
                strain = name.endswith("_strain") or name.startswith("strain_")
                elastic = strain and not fitted.base.effects.sliding
                said.append(
                    f"{name}: the law misses this column by {factor:.2g} scales (root mean square) with any of these "
                    "parameters; it was given the weight that this leaves it"
                    + ("; strain is elastic here: give peak_stress_ratio for sliding" if elastic else "")
                )
        telling = [name for name in found.connected if found.scatter[name] > NUMERICAL]
        if telling:
            said.append(
                f"{', '.join(telling)}: the law departs from the curve by more than scatter (neighbouring deviations "
                f"are alike); standard errors are widened for it, by up to {max(found.connected.values()):.1f}"
            )
    return said + _starts(fitted.curves, fitted.base)


def _starts(curves: list[Followed], base: Base) -> list[str]:
    """Whether several curves start from different coordination numbers."""
    first = [(curve, row["coordination"]) for curve in curves if "coordination" in (row := first_row(curve))]
    if base.settings.start == "row" or len(first) < 2:
        return []
    mean = float(np.mean([z for _, z in first]))
    off = max(abs(z - mean) / float(curve.scales["coordination"][0]) for curve, z in first)
    if off <= DIFFERENT_STARTS:
        return []
    low, high = min(z for _, z in first), max(z for _, z in first)
    return [
        f"first rows have z from {low:.4g} to {high:.4g}: with --set start=row each curve starts from its own instead "
        "of a common one"
    ]


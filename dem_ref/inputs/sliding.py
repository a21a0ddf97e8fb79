"""What a loading beyond the peak tells of sliding: strength, hardening, dilatancy.

Compression positive. The elastic strain is taken off with the measured moduli, which follow the coordination number:
``dgamma_e = dq/G``, ``dv_e = dp/K`` with G proportional to z - z_iso and K to z. What is left is told by

    q/p = M,    gamma_p = gamma_r h^m/(1 - h),    h = M/M_peak,    d(dilation)/dgamma_p = D (q/p - M_cv)

m = 1 is the usual hyperbola. Packings of disks follow m = 2 within one to two per cent from q/p = 0.05 to nine tenths
of the peak, with two numbers: the fraction of sliding contacts, and with it the plastic compliance, grows in proportion
to q/p. The hyperbola misses by ten per cent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.measures.uncertainty import Measured
from granfabric.dem_ref.sample.disks import SampleError

Array = NDArray[np.float64]

EXPONENT = 2.0
SLIDING_KEYS = (
    "peak_stress_ratio", "first_yield_stress_ratio", "reference_plastic_strain", "hardening_exponent", "dilatancy",
    "constant_volume_stress_ratio",
)  # fmt: skip
SMALLEST_LEVEL = 0.05
LARGEST_LEVEL = 0.9
"""Fit and misfit from this q/p to this fraction of the peak."""
SOFTEST = 0.2
"""The shear modulus is taken to fall to this fraction at most; beyond, q hardly changes any more."""
WINDOW = 0.1
"""The peak is the largest mean over this fraction of the whole strain, which evens out single stress drops."""
LEVELS = 60
PARTS = 8
"""Parts of a loading whose differences tell how far its parameters may be off."""
LEAST_STRAIN = 50.0
"""A loading that is shorter than so many reference strains has not come to within 2 % of the peak that it tends to."""


@dataclass(frozen=True)
class PlasticPart:
    """Strains of a loading without their elastic part, compression positive but the dilation.

    Attributes
    ----------
    stress_ratio : (n,)
        q/p.
    shear, plastic_shear : (n,)
        eps_1 - eps_2 along the stress, all of it and its plastic part.
    dilation, plastic_dilation : (n,)
        Increase of area per area, all of it and its plastic part.
    """

    stress_ratio: Array
    shear: Array
    plastic_shear: Array
    dilation: Array
    plastic_dilation: Array


@dataclass(frozen=True)
class Hardening:
    """A fit of hardening.

    Attributes
    ----------
    peak, reference : float
        M_peak and gamma_r.
    exponent, first : float
        m and the first yield M_first: h = (M - M_first)/(M_peak - M_first).
    misfit : float
        Largest relative error of q/p at a given shear strain, between `SMALLEST_LEVEL` and `LARGEST_LEVEL`.
    """

    peak: float
    reference: float
    exponent: float
    first: float
    misfit: float


def plastic_part(
    history: Mapping[str, Array], measured: Mapping[str, float], rattlers: str = "included"
) -> PlasticPart:
    """Take the elastic strain off a history.

    Parameters
    ----------
    history : mapping of str to ndarray
        Columns of a run that starts isotropic; strain and stress tension positive.
    measured : mapping of str to float
        As measured on the packing: `solid_fraction`, `normal_stiffness`, `stiffness_ratio`, `bulk_reduction`,
        `shear_reduction`, `isostatic_coordination`.
    rattlers : str
        ``"included"`` or ``"excluded"`` in the coordination number, as the measured values count them.
    """
    z_all = history["coordination"]
    z = z_all if rattlers == "included" else history["coordination_without_rattlers"]
    kn, ratio = measured["normal_stiffness"], measured["stiffness_ratio"]
    unit = measured["solid_fraction"] * kn / (4.0 * pi)
    isostatic = measured["isostatic_coordination"]
    softening = np.maximum(z / z[0] * (z - isostatic) / (z[0] - isostatic), SOFTEST)
    shear_modulus = unit * (1.0 + ratio) * z_all[0] * measured["shear_reduction"] * softening
    bulk_modulus = 2.0 * unit * z_all * measured["bulk_reduction"]
    t = np.stack([-0.5 * (history["stress_xx"] - history["stress_yy"]), -history["stress_xy"]])
    last = t[:, int(np.argmax(np.hypot(*t)))]
    axis = last / np.hypot(*last)
    shear = -(axis[0] * (history["strain_xx"] - history["strain_yy"]) + axis[1] * history["strain_xy"])
    dilation = history["strain_xx"] + history["strain_yy"]
    elastic_shear = _integral(1.0 / shear_modulus, axis @ t)
    elastic_dilation = -_integral(1.0 / bulk_modulus, history["p"])
    return PlasticPart(
        history["q"] / history["p"], shear, shear - elastic_shear, dilation, dilation - elastic_dilation
    )


def _integral(values: Array, over: Array) -> Array:
    """Integral of `values` d`over` from the start, trapezoidal."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(over))])


def peak_stress_ratio(part: PlasticPart) -> float:
    """Largest mean of q/p over `WINDOW` of the whole strain."""
    strain, ratio = part.shear, part.stress_ratio
    grid = np.linspace(strain[0], strain[-1], 401)
    even = np.interp(grid, strain, ratio)
    width = max(1, round(WINDOW * len(grid)))
    return float(np.convolve(even, np.ones(width) / width, "valid").max())


@dataclass(frozen=True)
class _Passages:
    """Levels of q/p with the strain and the plastic strain at their first passage, and their weight in a fit."""

    levels: Array
    shear: Array
    plastic: Array
    weight: Array


def _passages(part: PlasticPart, peak: float) -> _Passages:
    levels = np.linspace(SMALLEST_LEVEL, LARGEST_LEVEL * peak, LEVELS)
    # the first passage of each level
    rising = np.maximum.accumulate(part.stress_ratio)
    keep = np.concatenate([[True], np.diff(rising) > 0.0])
    if rising[-1] < levels[-1] or np.count_nonzero(keep) < 8:
        raise SampleError("too few records on the way to the peak for a fit of hardening")
    shear = np.interp(levels, rising[keep], part.shear[keep])
    plastic = np.interp(levels, rising[keep], part.plastic_shear[keep])
    # an error of strain is one of q/p over the slope of the strain
    return _Passages(levels, shear, plastic, 1.0 / (np.gradient(shear, levels) * levels))


def _reference(at: _Passages, peak: float, exponent: float, first: float, kept: Array | None = None) -> float:
    h = np.maximum((at.levels - first) / (peak - first), 0.0)
    shape = h**exponent / (1.0 - h)
    weight = at.weight if kept is None else at.weight * kept
    return float(np.sum(weight**2 * shape * at.plastic) / np.sum(weight**2 * shape**2))


def fit_hardening(part: PlasticPart, peak: float, exponent: float = EXPONENT, first: float = 0.0) -> Hardening:
    """Reference strain of a given peak, with the least error of q/p at given strain (mean square, relative)."""
    at = _passages(part, peak)
    reference = _reference(at, peak, exponent, first)
    h = np.maximum((at.levels - first) / (peak - first), 0.0)
    predicted = at.shear - at.plastic + reference * (h**exponent / (1.0 - h))
    misfit = np.interp(at.shear, predicted, at.levels) / at.levels - 1.0
    inside = at.shear <= predicted[-1]
    return Hardening(peak, reference, exponent, first, float(np.abs(misfit[inside]).max()))


def fit_dilatancy(part: PlasticPart, peak: float) -> tuple[float, float]:
    """D and M_cv from the mean dilation per plastic shear strain before and after `LARGEST_LEVEL` of the peak.

    Each is D (mean q/p - M_cv) with the mean over the plastic shear strain. A fit of single rates would hang on the
    stress drops at the peak.
    """
    first = int(np.argmax(part.stress_ratio >= LARGEST_LEVEL * peak))
    work = _integral(part.stress_ratio, part.plastic_shear)
    means, rates = [], []
    for start, end in ((0, first), (first, len(work) - 1)):
        sheared = part.plastic_shear[end] - part.plastic_shear[start]
        if not sheared > 0.0:
            raise SampleError("too few records on the way to the peak for the dilatancy")
        means.append((work[end] - work[start]) / sheared)
        rates.append((part.plastic_dilation[end] - part.plastic_dilation[start]) / sheared)
    return _line(means, rates)


def _line(means: Sequence[float], rates: Sequence[float]) -> tuple[float, float]:
    slope = (rates[1] - rates[0]) / (means[1] - means[0])
    return float(slope), float(means[1] - rates[1] / slope)


def sliding_errors(part: PlasticPart, hardening: Hardening) -> dict[str, float]:
    """Standard errors of the parameters of sliding, from parts of the loading; keys `SLIDING_KEYS`.

    The peak: scatter of the means over windows like its own, from where q/p first comes near it. The reference strain:
    fits without each eighth of the levels, and what it owes to the error of the peak. Dilatancy: fits without each
    eighth of the strain before and after. Exponent and first yield are chosen.
    """
    peak = hardening.peak
    first = int(np.argmax(part.stress_ratio >= LARGEST_LEVEL * peak))
    edges = np.arange(part.shear[first], part.shear[-1], WINDOW * (part.shear[-1] - part.shear[0]))
    grid = np.linspace(edges[0], part.shear[-1], 401)
    even = np.interp(grid, part.shear, part.stress_ratio)
    windows = [even[(grid >= low) & (grid < high)].mean() for low, high in pairwise(edges)]
    peak_error = float(np.std(windows, ddof=1)) if len(windows) > 1 else float("nan")

    at = _passages(part, peak)
    eighth = np.arange(LEVELS) * PARTS // LEVELS
    without = [_reference(at, peak, hardening.exponent, hardening.first, eighth != k) for k in range(PARTS)]
    moved = _reference(at, peak + peak_error, hardening.exponent, hardening.first) - hardening.reference

    pieces = []
    for start, end in ((0, first), (first, len(part.shear) - 1)):
        places = np.linspace(part.plastic_shear[start], part.plastic_shear[end], PARTS + 1)
        ends = start + np.searchsorted(np.maximum.accumulate(part.plastic_shear[start : end + 1]), places)
        ends[0], ends[-1] = start, end
        columns = (part.plastic_shear, _integral(part.stress_ratio, part.plastic_shear), part.plastic_dilation)
        pieces.append(np.array([np.diff(column[ends]) for column in columns]))
    fits = []
    for k in range(PARTS):
        for leave in ((k, None), (None, k)):
            sums = [np.delete(piece, gone, axis=1).sum(axis=1) if gone is not None else piece.sum(axis=1)
                    for piece, gone in zip(pieces, leave)]  # fmt: skip
            fits.append(_line([s[1] / s[0] for s in sums], [s[2] / s[0] for s in sums]))
    before, after = np.array(fits[0::2]), np.array(fits[1::2])
    dilatancy = np.hypot(_spread(before), _spread(after))
    values = (peak_error, 0.0, float(np.hypot(_spread(np.array(without)), moved)), 0.0, *dilatancy.tolist())
    return dict(zip(SLIDING_KEYS, values, strict=True))


def _spread(values: Array) -> Array:
    """Standard error of a fit from the fits without each of its parts."""
    return np.asarray(np.sqrt((PARTS - 1) / PARTS * np.sum((values - values.mean(axis=0)) ** 2, axis=0)))


def measure_sliding(
    history: Mapping[str, Array], measured: Mapping[str, float], rattlers: str = "included"
) -> tuple[dict[str, float], float]:
    """The values of `measure_sliding_with_errors`, and what the fit leaves."""
    found, misfit = measure_sliding_with_errors(history, measured, rattlers)
    return {name: entry.value for name, entry in found.items()}, misfit


def measure_sliding_with_errors(
    history: Mapping[str, Array], measured: Mapping[str, float], rattlers: str = "included"
) -> tuple[dict[str, Measured], float]:
    """Parameters of sliding from a loading at constant pressure beyond the peak.

    Returns
    -------
    dict of str to Measured
        Keys `SLIDING_KEYS` of the scene's table ``[material]``, with standard errors from parts of the loading.
    float
        Largest relative error of q/p at a given shear strain that the fit leaves, see `Hardening`.

    Raises
    ------
    SampleError
        If the loading has not come to a peak, or a value does not follow from it.
    """
    part = plastic_part(history, measured, rattlers)
    peak = peak_stress_ratio(part)
    hardening = fit_hardening(part, peak)
    if part.shear[-1] < LEAST_STRAIN * hardening.reference:
        raise SampleError(
            f"the loading ends at a shear strain of {part.shear[-1]:.3g}, where q/p may still grow: the peak needs "
            f"{LEAST_STRAIN:g} times the reference strain of {hardening.reference:.3g}"
        )
    slope, constant = fit_dilatancy(part, peak)
    values = (peak, 0.0, hardening.reference, hardening.exponent, slope, constant)
    errors = sliding_errors(part, hardening)
    named = zip(SLIDING_KEYS, values, strict=True)
    return {name: Measured(value, errors[name]) for name, value in named}, hardening.misfit

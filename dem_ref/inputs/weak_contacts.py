"""What contacts with small forces do in probes: the inputs of the closures of the point law.

Everything here needs an isotropic packing and probes that go no further than q/p = 0.05. Forces are in units of the
mean normal force f.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import Contacts, contacts_of, force_harmonics, love_weber_stress
from granfabric.dem_ref.measures.distribution import FORCE_WINDOW
from granfabric.dem_ref.measures.events import match_contacts
from granfabric.dem_ref.measures.uncertainty import blocks_of_contacts, jackknife
from granfabric.dem_ref.sample.disks import Sample

from .probes import ELASTIC_LIMITS, Probe, ProbeError, settled, stress_probe

Array = NDArray[np.float64]

WEAK_FORCE = 0.15
"""Contacts up to this fraction of the mean normal force are near opening."""
FEWEST_WEAK = 2
"""A straight line goes through two; its scatter is then zero, as its error tells."""
SCATTER_FORCES = (0.1, 0.5)
"""Contacts whose residual change after a loop is taken: weak, but so that few are lost in the loop."""
LOOP_STRESS_RATIO = 0.05
ANGLES = (0.5 * np.pi, 0.25 * np.pi)


@dataclass(frozen=True)
class WeakContacts:
    """What contacts with small forces feel of the mean change of force in their direction (elastic probes).

    Attributes
    ----------
    ratio : float
        chi: their change over the mean change of their direction, in the limit of zero force; shear probes.
    gradient : float
        a: slope of the same ratio with the force, for isotropic probes, over forces up to half of the mean.
    scatter, scatter_isotropic : float
        c_e, c_p: standard deviation about that, over the amplitude ``chi |w|`` of the shifted harmonic and over the
        isotropic shift of weak forces.
    fluctuation : float
        c_w: the standard deviation in shear over ``|dgamma| kn r/f``.
    tangential_ratio : float
        c_t: |a_t| over q/p, all contacts.
    tangential_response : float
        Root mean square of the tangential force of weak contacts over q/p, in the direction where it is largest.
    """

    ratio: float
    gradient: float
    scatter: float
    scatter_isotropic: float
    fluctuation: float
    tangential_ratio: float
    tangential_response: float


@dataclass(frozen=True)
class _Response:
    """Changes of the persisting contacts in a probe."""

    normal: Array
    tangential: Array
    force: Array
    double_angle: Array

    def subset(self, chosen: NDArray[np.bool_]) -> _Response:
        """The contacts selected by a mask."""
        return _Response(
            self.normal[chosen], self.tangential[chosen], self.force[chosen], self.double_angle[chosen]
        )


def _response(before: Contacts, after: Contacts) -> _Response:
    match = match_contacts(before, after)
    old, new = match.persisting_before, match.persisting_after
    f = force_harmonics(before).mean
    return _Response(
        (after.normal_force[new] - before.normal_force[old]) / f,
        (after.tangential_force[new] - before.tangential_force[old]) / f,
        before.normal_force[old] / f,
        before.double_angle[old],
    )


def _isotropic_row(response: _Response) -> Array:
    """a and c_p."""
    change = response.normal / response.normal.mean()
    ratio, scatter = _ratio_at_zero(change, np.ones(len(change)), response.force)
    window = response.force < FORCE_WINDOW
    apart = response.force[window] - response.force[window].mean() if window.any() else np.zeros(1)
    square = float(apart @ apart)
    # a line needs forces that differ
    gradient = float(apart @ change[window]) / square if square > 0.0 else float("nan")
    return np.array([gradient, scatter / abs(ratio)])


def _shear_row(response: _Response, strain_unit: float, stress_ratio: float) -> Array:
    """chi, c_e, c_w, c_t and the response of weak tangential forces."""
    basis = np.column_stack([np.ones(len(response.normal)), response.double_angle])
    mean = basis @ np.linalg.lstsq(basis, response.normal, rcond=None)[0]
    everything = np.ones(len(response.force), bool)
    all_ratio, _ = _tangential(response, everything)
    weak = response.force < WEAK_FORCE
    if np.count_nonzero(weak) < FEWEST_WEAK:
        return np.array([np.nan, np.nan, np.nan, all_ratio / stress_ratio, np.nan])
    ratio, scatter = _ratio_at_zero(response.normal, mean, response.force)
    amplitude = abs(ratio) * np.sqrt(2.0 * np.mean(mean[weak] ** 2))
    weak_ratio, weak_scatter = _tangential(response, weak)
    return np.array(
        [
            ratio, scatter / amplitude, scatter / strain_unit, all_ratio / stress_ratio,
            np.hypot(weak_ratio, weak_scatter) / stress_ratio,
        ]
    )  # fmt: skip


@dataclass(frozen=True)
class _ShearProbe:
    """Response in a shear probe, with the unit of its strain and its stress ratio."""

    response: _Response
    strain_unit: float
    stress_ratio: float


def _shear_probe(sample: Sample, probe: Probe) -> _ShearProbe:
    kn, radius = sample.normal_stiffness, 0.5 * sample.mean_diameter
    strain = np.hypot(probe.strain_change[0] - probe.strain_change[1], 2.0 * probe.strain_change[2])
    unit = strain * kn * radius / force_harmonics(probe.before).mean
    p, stress = stress_invariants(love_weber_stress(sample))[0], probe.stress_change
    stress_ratio = float(np.hypot(0.5 * (stress[0] - stress[1]), stress[2]) / p)
    return _ShearProbe(_response(probe.before, probe.after), unit, stress_ratio)


def measure_weak_contacts(sample: Sample, isotropic: list[Probe], shear: list[Probe]) -> WeakContacts:
    """Response of weak contacts in elastic probes of the sample.

    The mean change of normal force over direction is fitted by harmonics ``m0 + m . e`` over all contacts. The ratio of
    a contact's change to that mean grows with its force; a straight line in the force over the contacts below
    `WEAK_FORCE` gives its limit at zero force.
    """
    probes = [_shear_probe(sample, probe) for probe in shear]
    rows = [_shear_row(probe.response, probe.strain_unit, probe.stress_ratio) for probe in probes]
    rows_isotropic = [_isotropic_row(_response(probe.before, probe.after)) for probe in isotropic]
    return _weak_contacts(np.mean(rows, axis=0), np.mean(rows_isotropic, axis=0))


def weak_contact_errors(sample: Sample, isotropic: list[Probe], shear: list[Probe]) -> WeakContacts:
    """Standard errors of `measure_weak_contacts`, from blocks of the packing."""
    probes = [_shear_probe(sample, probe) for probe in shear]
    blocks = [_blocks(sample, probe) for probe in shear]
    responses = [_response(probe.before, probe.after) for probe in isotropic]
    blocks_isotropic = [_blocks(sample, probe) for probe in isotropic]

    def rows(without: int) -> Array:
        kept = [
            _shear_row(probe.response.subset(block != without), probe.strain_unit, probe.stress_ratio)
            for probe, block in zip(probes, blocks)
        ]
        kept_isotropic = [
            _isotropic_row(response.subset(block != without)) for response, block in zip(responses, blocks_isotropic)
        ]
        return np.concatenate([np.mean(kept, axis=0), np.mean(kept_isotropic, axis=0)])

    errors = jackknife(rows)
    return _weak_contacts(errors[:5], errors[5:])


def _weak_contacts(shear: Array, isotropic: Array) -> WeakContacts:
    ratio, scatter, fluctuation, tangential, tangential_response = (float(value) for value in shear)
    return WeakContacts(
        ratio, float(isotropic[0]), scatter, float(isotropic[1]), fluctuation, tangential, tangential_response
    )


def _blocks(sample: Sample, probe: Probe) -> NDArray[np.int64]:
    """Block of each contact that a probe keeps."""
    kept = match_contacts(probe.before, probe.after).persisting_before
    return blocks_of_contacts(sample, probe.before)[kept]


def _ratio_at_zero(change: Array, mean: Array, force: Array) -> tuple[float, float]:
    """Ratio change/mean in the limit of zero force, and the standard deviation about the line."""
    weak = force < WEAK_FORCE
    if np.count_nonzero(weak) < FEWEST_WEAK:
        return float("nan"), float("nan")
    m = mean[weak]
    basis = np.column_stack([m, m * force[weak]])
    coefficients = np.linalg.lstsq(basis, change[weak], rcond=None)[0]
    return float(coefficients[0]), float(np.std(change[weak] - basis @ coefficients))


def _tangential(response: _Response, chosen: NDArray[np.bool_]) -> tuple[float, float]:
    """|a_t| of the chosen contacts and the standard deviation about the harmonic."""
    e, change = response.double_angle[chosen], response.tangential[chosen]
    basis = np.column_stack([e[:, 1], e[:, 0]])
    harmonic = np.linalg.lstsq(basis, change, rcond=None)[0]
    return float(np.hypot(*harmonic)), float(np.std(change - basis @ harmonic))


@dataclass(frozen=True)
class SlipLoop:
    """What small loops of the stress ratio at constant p leave behind; means over two directions of loading.

    Attributes
    ----------
    force_anisotropy_ratio : float
        c_n: change of a_n over q/p at the top.
    slip : float
        k: a loop to q/p = s leaves ``a_t = -k s^2/2``, as contacts do that slip at thresholds spread evenly above zero:
        on the way up they fail to carry ``k s^2``, on the way down half of it.
    irreversible_scatter : float
        c_i: standard deviation of the changes of weak normal forces that the loop leaves, over s^2.
    """

    force_anisotropy_ratio: float
    slip: float
    irreversible_scatter: float


@dataclass(frozen=True)
class _Loop:
    """Contacts at the top of a loop along an axis, and what it left of changes in those of the start."""

    axis: Array
    top: Contacts
    left: _Response
    top_blocks: NDArray[np.int64]
    left_blocks: NDArray[np.int64]


def _loops(rest: Sample, stress_ratio: float, angles: tuple[float, ...]) -> list[_Loop]:
    start = contacts_of(rest)
    p = stress_invariants(love_weber_stress(rest))[0]
    made = []
    for angle in angles:
        up = stress_probe(rest, 0.0, stress_ratio * p, angle, limits=ELASTIC_LIMITS)
        down = stress_probe(up.sample, 0.0, -stress_ratio * p, angle, limits=ELASTIC_LIMITS)
        top, end = contacts_of(up.sample), contacts_of(down.sample)
        made.append(
            _Loop(
                np.array([np.cos(2.0 * angle), np.sin(2.0 * angle)]), top, _response(start, end),
                blocks_of_contacts(up.sample, top),
                blocks_of_contacts(rest, start)[match_contacts(start, end).persisting_before],
            )
        )  # fmt: skip
    return made


def _loop_row(start: Contacts, top: Contacts, left: _Response, axis: Array, stress_ratio: float) -> Array:
    """c_n, k and c_i of one loop."""
    harmonics = force_harmonics(top).normal - force_harmonics(start).normal
    along = left.double_angle @ axis
    across = left.double_angle[:, 1] * axis[0] - left.double_angle[:, 0] * axis[1]
    tangential = -float(left.tangential @ across / (across @ across))
    weak = (left.force > SCATTER_FORCES[0]) & (left.force < SCATTER_FORCES[1])
    basis = np.column_stack([np.ones(len(along)), along])[weak]
    change = left.normal[weak]
    scatter = float("nan")
    if len(change) >= FEWEST_WEAK:
        scatter = float(np.std(change - basis @ np.linalg.lstsq(basis, change, rcond=None)[0]))
    return np.array([harmonics @ axis / stress_ratio, -2.0 * tangential / stress_ratio**2, scatter / stress_ratio**2])


def measure_slip(sample: Sample, stress_ratio: float = LOOP_STRESS_RATIO) -> SlipLoop:
    """Load the sample at constant p to `stress_ratio` and back, along two axes; it is not changed."""
    rest = settled(sample)
    start = contacts_of(rest)
    loops = _loops(rest, stress_ratio, ANGLES)
    rows = [_loop_row(start, loop.top, loop.left, loop.axis, stress_ratio) for loop in loops]
    return SlipLoop(*(float(value) for value in np.mean(rows, axis=0)))


def measure_slip_with_errors(sample: Sample, stress_ratio: float = LOOP_STRESS_RATIO) -> tuple[SlipLoop, SlipLoop]:
    """`measure_slip` and its standard errors.

    The larger of two: from blocks of the packing, and from the scatter over both axes and both signs (the latter only
    if the sample carries loops of the other sign too).
    """
    rest = settled(sample)
    start = contacts_of(rest)
    blocks = blocks_of_contacts(rest, start)
    loops = _loops(rest, stress_ratio, ANGLES)
    rows = [_loop_row(start, loop.top, loop.left, loop.axis, stress_ratio) for loop in loops]

    def without(block: int) -> Array:
        kept = start.subset(blocks != block)
        return np.mean(
            [
                _loop_row(
                    kept, loop.top.subset(loop.top_blocks != block), loop.left.subset(loop.left_blocks != block),
                    loop.axis, stress_ratio,
                )
                for loop in loops
            ],
            axis=0,
        )  # fmt: skip

    errors = jackknife(without)
    with suppress(ProbeError):
        for loop in _loops(rest, stress_ratio, tuple(angle + 0.5 * np.pi for angle in ANGLES)):
            rows.append(_loop_row(start, loop.top, loop.left, loop.axis, stress_ratio))
        errors = np.fmax(errors, np.std(rows, axis=0, ddof=1) / np.sqrt(len(ANGLES)))
    values = np.mean(rows[: len(ANGLES)], axis=0)
    return SlipLoop(*(float(value) for value in values)), SlipLoop(*(float(value) for value in errors))

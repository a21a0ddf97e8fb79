"""Memory of tangential forces: contacts that have slipped hold what they held when the stress turns back.

`tangential_force` gives a_t as a function of the present stress, which is what a first loading does. The contacts of a
direction theta are sheared by ``tau = s.e(theta)`` and slip where their tangential force, over c_t f, comes to a
threshold r. Thresholds are uniformly distributed (weak forces are, near zero): a class of contacts is an elastoplastic
element, elastic within [-r, r]. Summed up over thresholds this is Masing's rule [Masing 1926; Iwan, J. Appl. Mech. 33
(1966) 893]; over directions, contacts that still hold lead a turning stress, and those that slip do so one direction
after the other.

With e the part of tau that a class holds, and v what it would hold if it had been loaded straight to the present
stress,

    a_t = a_t(s, P) + c_t(P) sum over classes i and directions j of  w_i (2/3) e_j (e_ij - v_ij),    j at 0, 60, 120 deg
    e_ij = tau_j + (e_ij - tau_j)(start) max(P(start), 1)/max(P, 1),  within [-r_i, r_i]

so that a first loading is exactly what it is without memory. Averaged over directions thresholds of the density
``2 k'/c_t`` from 0 to ``c_t/(2 k')`` make ``c_t s - k s^2`` with ``k' = (3 pi/8) k``. Three classes stand for them;
those beyond `LARGEST_THRESHOLD` hold at every stress ratio that grains carry.

Where the pressure grows thresholds do as well, ``r (r + L)`` for ``r^2``, and the slip that there is stays what it is
as a force: over the mean force it fades. Where it falls below the initial one thresholds stay, so that a first loading
remains a function of the state whether the pressure falls before, with or after the deviator.

An increment goes straight in s: what turns within one is not seen. Between, elements depend on the ends alone, so that
the number of substeps does not matter and the tangent is exact.
"""

import math

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, read, write
from granfabric.constitutive.lanes.elementary import larger, smaller
from granfabric.constitutive.material_table import M_HELD, MICRO
from granfabric.constitutive.stiffness import invariants

CLASSES = 3
DIRECTIONS = (0, 60, 120)
"""Of the double-angle plane [degrees]; the opposite ones hold the opposite."""
LARGEST_THRESHOLD = 0.4
SPACING = 1.5
"""Classes are narrower towards zero, by this power: the smallest loops need them."""


def slip_classes(c_t: float, k: float) -> NDArray[np.float64]:
    """Threshold [stress ratio] and share of c_t of each class, shape (CLASSES, 2); no class if nothing slips."""
    if not (c_t > 0.0 and k > 0.0):
        return np.zeros((0, 2))
    density = 2.0 * (3.0 * np.pi / 8.0) * k / c_t
    edges = min(1.0 / density, LARGEST_THRESHOLD) * (np.arange(CLASSES + 1) / CLASSES) ** SPACING
    return np.stack([0.5 * (edges[1:] + edges[:-1]), density * np.diff(edges)], axis=1)


def slip_directions(rotation: bool) -> NDArray[np.float64]:
    """Cosine, sine and weight of each direction, shape (3, 3).

    Without rotation of principal axes s has one component, and the directions at 60 and 120 degrees hold the opposite
    of each other: one of them, with the weight of both; shape (2, 3).
    """
    if not rotation:
        return np.array([[1.0, 0.0, 2.0 / 3.0], [0.5, 0.0, 4.0 / 3.0]])
    angles = np.radians(DIRECTIONS)
    return np.stack([np.cos(angles), np.sin(angles), np.full(3, 2.0 / 3.0)], axis=1)


def initially_held(s: NDArray[np.float64], c_t: float, k: float, rotation: bool) -> dict[str, NDArray[np.float64]]:
    """What classes hold that have been loaded straight to the stress ratios s, shape (npt, 2), by state variable."""
    directions = slip_directions(rotation)
    tau = s @ directions[:, :2].T
    return {
        name_of(number, DIRECTIONS[j]): np.clip(tau[:, j], -threshold, threshold)
        for number, (threshold, _) in enumerate(slip_classes(c_t, k))
        for j in range(len(directions))
    }


def name_of(number: int, direction: int) -> str:
    """State variable of a class (from 0) and a direction [degrees]."""
    return f"held_stress_ratio_{number + 1}_{direction}"


@formula
def fading(before, ratio):
    """Factor on slip where the pressure grows, and its derivative by ln p; `before` and `ratio` are p/p_0."""
    fade = larger(before, 1.0) / larger(ratio, 1.0)
    return fade, choose(ratio > 1.0, -fade, 0.0)


@formula
def within(value, limit):
    """The value, cut to [-limit, limit]."""
    return smaller(larger(value, -limit), limit)


@formula
def with_memory(weak, s1, s2, first, numbers, numbers_by_p, start, rule, inputs, lanes):
    """a_t and its derivatives with what contacts hold from before.

    Parameters
    ----------
    weak : WeakState
    s1, s2 : float
        Stress ratio.
    first : tuple
        a_t on first loading, its derivatives by s (11, 12, 22) and by ln p, see `force_fabric.tangential_force`.
    numbers, numbers_by_p : tuples of 3
        See `tangential_force.slip_numbers`.
    start : tuple of 3
        s and p/p_0 at the start of the increment.
    rule : tuple
        Its entries 5 and 6 are those of `slip_directions` and `slip_classes`.
    inputs : ndarray
        Rows of the lanes; what is held at the start among them.

    Returns
    -------
    a_t, by_s, by_p : tuples of 2, 3, 2 floats
    """
    directions, classes = rule[5], rule[6]
    (t1, t2), (t11, t12, t22), (p1, p2) = first
    c_t, _, delay = numbers
    fade, fade_by_p = fading(start[2], weak.ratio)
    for i in range(classes.shape[0]):
        r, share = classes[i, 0], classes[i, 1]
        limit = math.sqrt(r * (r + delay))
        limit_by_p = 0.5 * r * numbers_by_p[2] / larger(limit, 1e-300)
        for j in range(directions.shape[0]):
            c, d, weight = directions[j, 0], directions[j, 1], directions[j, 2] * share
            tau, before = c * s1 + d * s2, c * start[0] + d * start[1]
            slipped = read(inputs, M_HELD + 3 * i + j, lanes) - before
            free = tau + slipped * fade
            holds, would = abs(free) < limit, abs(tau) < limit
            more = weight * (within(free, limit) - within(tau, limit))
            by_tau = (weight * c_t) * (choose(holds, 1.0, 0.0) - choose(would, 1.0, 0.0))
            by_p = choose(holds, slipped * fade_by_p, choose(free > 0.0, limit_by_p, -limit_by_p))
            by_p = by_p - choose(would, 0.0, choose(tau > 0.0, limit_by_p, -limit_by_p))
            by_p = (weight * c_t) * by_p + more * numbers_by_p[0]
            more = more * c_t
            t1, t2 = t1 + c * more, t2 + d * more
            t11, t12, t22 = t11 + c * c * by_tau, t12 + c * d * by_tau, t22 + d * d * by_tau
            p1, p2 = p1 + c * by_p, p2 + d * by_p
    return (t1, t2), (t11, t12, t22), (p1, p2)


@formula
def keep_held(weak, start, delay, rule, inputs, ends, lanes):
    """What classes hold at the end of an increment, into the rows of `ends`, whose stress is there already."""
    directions, classes = rule[5], rule[6]
    p, t_1, t_2 = invariants(read(ends, MICRO, lanes), read(ends, MICRO + 1, lanes), read(ends, MICRO + 2, lanes))
    s1, s2 = t_1 / p, t_2 / p
    fade, _ = fading(start[2], weak.ratio)
    for i in range(classes.shape[0]):
        r = classes[i, 0]
        limit = math.sqrt(r * (r + delay))
        for j in range(directions.shape[0]):
            c, d = directions[j, 0], directions[j, 1]
            row = M_HELD + 3 * i + j
            slipped = read(inputs, row, lanes) - (c * start[0] + d * start[1])
            write(ends, row, within(c * s1 + d * s2 + slipped * fade, limit), lanes)

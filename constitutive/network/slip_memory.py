"""Memory of tangential forces: contacts that have slipped hold what they held when the stress turns back.

`tangential_force` gives a_t as a function of the present stress, which is what a first loading does. A contact slips
where its tangential force, over c_t f, comes to a threshold r. Thresholds are uniformly distributed (weak forces are,
near zero): a class of contacts is an elastoplastic element that follows the stress ratio s within the disc of radius r.
Summed up over thresholds this is Masing's rule [Masing 1926; Iwan, J. Appl. Mech. 33 (1966) 893].

With e the part of s that a class holds, and v what it would hold had it been loaded straight to the present stress,

    a_t = a_t(s, P) + c_t(P) sum over classes of  w_i (e_i - v_i),    w = 2 k dr/c_t  for r up to c_t/(2 k)
    de_i = ds + (s - e_i) d ln max(P, 1) - what is normal to the disc where e_i is on its edge,    |e_i| <= r_i

so that a first loading is what it is without memory. Four classes stand for all; those beyond `LARGEST_THRESHOLD` hold
at every stress ratio that grains carry.

Where the pressure grows thresholds do as well, ``r (r + L)`` for ``r^2``, and the slip that there is stays what it is
as a force: over the mean force it fades. Where it falls below the initial one thresholds stay, so that a first loading
remains a function of the state whether the pressure falls before, with or after the deviator.

An increment goes straight in s, which has a closed form: e goes straight on to the edge of the disc and then along it,
where its angle psi to the way falls as ``tan(psi/2) ~ exp(-way/r)``. Elements depend on the ends of an increment alone,
so that the number of substeps does not matter and the tangent is exact. What turns within an increment is not seen.
"""

import math

import numpy as np
from numpy.typing import NDArray

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, read, write
from granfabric.constitutive.lanes.elementary import exponential, larger
from granfabric.constitutive.material_table import M_HELD, MICRO
from granfabric.constitutive.stiffness import invariants

CLASSES = 4
LARGEST_THRESHOLD = 0.4
SPACING = 1.3
"""Classes are narrower towards zero, by this power: the smallest loops need them."""
NAMES = tuple(f"held_stress_ratio_{number + 1}" for number in range(CLASSES))
"""State variables."""


def slip_classes(c_t: float, k: float) -> NDArray[np.float64]:
    """Threshold [stress ratio] and share of c_t of each class, shape (CLASSES, 2); no class if nothing slips."""
    if not (c_t > 0.0 and k > 0.0):
        return np.zeros((0, 2))
    density = 2.0 * k / c_t
    edges = min(1.0 / density, LARGEST_THRESHOLD) * (np.arange(CLASSES + 1) / CLASSES) ** SPACING
    return np.stack([0.5 * (edges[1:] + edges[:-1]), density * np.diff(edges)], axis=1)


def initially_held(s: NDArray[np.float64], c_t: float, k: float) -> dict[str, NDArray[np.float64]]:
    """What classes hold that have been loaded straight to the stress ratios s, shape (npt, 2), by state variable."""
    size = np.maximum(np.hypot(s[:, 0], s[:, 1]), 1e-300)
    thresholds = slip_classes(c_t, k)[:, 0]
    return {name: s * np.minimum(1.0, r / size)[:, None] for name, r in zip(NAMES, thresholds)}


@formula
def fading(before, ratio):
    """Factor on slip where the pressure grows, and its derivative by ln p; `before` and `ratio` are p/p_0."""
    fade = larger(before, 1.0) / larger(ratio, 1.0)
    return fade, choose(ratio > 1.0, -fade, 0.0)


@formula
def straight_on(s1, s2, limit):
    """v on a first loading to s, its derivatives by s (11, 12, 22) and by the threshold (2)."""
    m = math.sqrt(s1 * s1 + s2 * s2)
    slips = m > limit
    inverse = 1.0 / choose(slips, m, 1.0)
    u1, u2 = s1 * inverse, s2 * inverse
    part = choose(slips, limit * inverse, 1.0)
    gone = choose(slips, part, 0.0)
    by_limit = choose(slips, u1, 0.0), choose(slips, u2, 0.0)
    return (part * s1, part * s2), (part - gone * u1 * u1, -gone * u1 * u2, part - gone * u2 * u2), by_limit


@formula
def swept(e1, e2, d1, d2, limit):
    """What a class holds after a straight way.

    Parameters
    ----------
    e1, e2 : float
        What it held; outside the disc, it is brought to its edge first.
    d1, d2 : float
        The way.
    limit : float
        Radius of the disc.

    Returns
    -------
    e : tuple of 2
    by_way : tuple of 4
        Derivatives 11, 12, 21, 22.
    by_limit : tuple of 2
    """
    size = math.sqrt(e1 * e1 + e2 * e2)
    outside = size > limit
    part = choose(outside, limit / choose(outside, size, 1.0), 1.0)
    e1, e2 = part * e1, part * e2
    way = math.sqrt(d1 * d1 + d2 * d2)
    inverse = 1.0 / choose(way > 0.0, way, 1.0)
    # along the way and across
    u1, u2 = choose(way > 0.0, d1 * inverse, 1.0), d2 * inverse
    a, b = e1 * u1 + e2 * u2, e2 * u1 - e1 * u2
    c = math.sqrt(larger(limit * limit - b * b, 0.0))
    free = larger(c - a, 0.0)
    slides = way > free
    # the edge is reached at (c, b); from there tan(psi/2) falls
    radius = 1.0 / larger(limit, 1e-300)
    x = choose(slides, way - free, 0.0) * radius
    fallen = exponential(-x)
    t0 = b / larger(limit + c, 1e-300)
    t = t0 * fallen
    scale = 1.0 / (1.0 + t * t)
    cosine, sine = (1.0 - t * t) * scale, 2.0 * t * scale
    f1, f2 = u1 * cosine - u2 * sine, u2 * cosine + u1 * sine
    # (1 - exp(-x))/x
    small = x < 0.01
    fall = choose(
        small,
        1.0 - 0.5 * x * (1.0 - x / 3.0 * (1.0 - 0.25 * x * (1.0 - 0.2 * x))),
        (1.0 - fallen) / choose(small, 1.0, x),
    )
    inside = choose(c > 0.0, free / choose(c > 0.0, c, 1.0), 0.0)
    turned = inside * inverse * (1.0 - b * radius * sine)
    turned = turned + (1.0 - inside) * fall * (x * inverse) * (1.0 - fallen * t0 * t0) * scale
    # derivative: along the edge, by the way's length and by its direction
    along, across = -sine, limit * turned
    w1, w2 = along * u1 - across * u2, along * u2 + across * u1
    j11, j12 = choose(slides, -f2 * w1, 1.0), choose(slides, -f2 * w2, 0.0)
    j21, j22 = choose(slides, f1 * w1, 0.0), choose(slides, f1 * w2, 1.0)
    e1, e2 = choose(slides, limit * f1, e1 + d1), choose(slides, limit * f2, e2 + d2)
    grown = sine * x
    l1, l2 = choose(slides, f1 - grown * f2, 0.0), choose(slides, f2 + grown * f1, 0.0)
    # brought to the edge, everything scales with the disc
    l1 = choose(outside, (e1 - j11 * d1 - j12 * d2) * radius, l1)
    l2 = choose(outside, (e2 - j21 * d1 - j22 * d2) * radius, l2)
    return (e1, e2), (j11, j12, j21, j22), (l1, l2)


@formula
def with_memory(weak, s1, s2, first, numbers, numbers_by_p, start, classes, inputs, lanes):
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
    classes : ndarray
        Of `slip_classes`.
    inputs : ndarray
        Rows of the lanes; what is held at the start among them.

    Returns
    -------
    a_t : tuple of 2
    by_s : tuple of 3
        Symmetric part of its derivatives.
    skew : float
        Half of derivative 12 less 21.
    by_p : tuple of 2
    """
    (t1, t2), (t11, t12, t22), (p1, p2) = first
    c_t, _, delay = numbers
    skew = 0.0 * s1
    fade, fade_by_p = fading(start[2], weak.ratio)
    for i in range(classes.shape[0]):
        r, weight = classes[i, 0], classes[i, 1]
        limit = math.sqrt(r * (r + delay))
        limit_by_p = 0.5 * r * numbers_by_p[2] / larger(limit, 1e-300)
        h1, h2 = read(inputs, M_HELD + 2 * i, lanes), read(inputs, M_HELD + 2 * i + 1, lanes)
        slip1, slip2 = h1 - start[0], h2 - start[1]
        (e1, e2), j, e_l = swept(h1, h2, s1 + slip1 * fade - h1, s2 + slip2 * fade - h2, limit)
        (v1, v2), v, v_l = straight_on(s1, s2, limit)
        share = weight * c_t
        x1, x2 = weight * (e1 - v1), weight * (e2 - v2)
        t1, t2 = t1 + c_t * x1, t2 + c_t * x2
        t11, t22 = t11 + share * (j[0] - v[0]), t22 + share * (j[3] - v[2])
        t12 = t12 + share * (0.5 * (j[1] + j[2]) - v[1])
        skew = skew + share * (0.5 * (j[1] - j[2]))
        y1 = (j[0] * slip1 + j[1] * slip2) * fade_by_p + (e_l[0] - v_l[0]) * limit_by_p
        y2 = (j[2] * slip1 + j[3] * slip2) * fade_by_p + (e_l[1] - v_l[1]) * limit_by_p
        p1, p2 = p1 + share * y1 + x1 * numbers_by_p[0], p2 + share * y2 + x2 * numbers_by_p[0]
    return (t1, t2), (t11, t12, t22), skew, (p1, p2)


@formula
def keep_held(weak, start, delay, turns, classes, inputs, ends, lanes):
    """What classes hold at the end of an increment, into the rows of `ends`, whose stress is there already.

    `turns` is 0 where s has one component only.
    """
    p, t_1, t_2 = invariants(read(ends, MICRO, lanes), read(ends, MICRO + 1, lanes), read(ends, MICRO + 2, lanes))
    s1, s2 = t_1 / p, turns * t_2 / p
    fade, _ = fading(start[2], weak.ratio)
    for i in range(classes.shape[0]):
        r, row = classes[i, 0], M_HELD + 2 * i
        h1, h2 = read(inputs, row, lanes), read(inputs, row + 1, lanes)
        way1, way2 = s1 + (h1 - start[0]) * fade - h1, s2 + (h2 - start[1]) * fade - h2
        (e1, e2), _, _ = swept(h1, h2, way1, way2, math.sqrt(r * (r + delay)))
        write(ends, row, e1, lanes)
        write(ends, row + 1, e2, lanes)

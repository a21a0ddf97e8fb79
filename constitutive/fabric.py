"""Directional density of contacts for a given fabric anisotropy: second harmonic or maximum entropy.

``E(theta) = W(e)/(2 pi)`` with ``e = (cos 2 theta, sin 2 theta)`` and ``<W> = 1``, ``2 <W e> = a_c``
[Pouragha & Wan 2017, eqs 1, 2]:

* harmonic: ``W = 1 + a_c.e``, non-negative for |a_c| <= 1;
* maximum entropy (von Mises): ``W = exp(k.e)/I0(|k|)`` with ``2 I1(|k|)/I0(|k|) = |a_c| < 2``.
"""

import math

from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import exponential, larger

from .compilation import formula


@formula
def scaled_bessel_zero(k):
    """exp(-k) I0(k) for k >= 0, to rounding: power series up to k = 18, asymptotic series beyond."""
    near = k <= 18.0
    quarter = choose(near, 0.25 * k * k, 0.0)
    term, total = 1.0 + 0.0 * quarter, 1.0 + 0.0 * quarter
    j = 1.0
    while True:
        going = term > 1e-17 * total
        if not somewhere(going):
            break
        term = choose(going, term * (quarter / (j * j)), term)
        total = choose(going, total + term, total)
        j += 1.0
    series = total * exponential(-choose(near, k, 0.0))
    if not somewhere(k > 18.0):
        return series
    far = choose(near, 18.0, k)
    term, total = 1.0 + 0.0 * far, 1.0 + 0.0 * far
    going = far > 0.0
    for j in range(1, 40):
        factor = (2.0 * j - 1.0) * (2.0 * j - 1.0) / (8.0 * j) / far
        going = going & (factor < 1.0) & (term >= 1e-17)
        if not somewhere(going):
            break
        term = choose(going, term * factor, term)
        total = choose(going, total + term, total)
    return choose(near, series, total / (math.sqrt(2.0 * math.pi) * math.sqrt(far)))


@formula
def bessel_ratio(k):
    """I1(k)/I0(k) for k >= 0: by its continued fraction evaluated backwards, by an asymptotic series from 400 on."""
    near = k < 400.0
    small = choose(near, larger(k, 1e-300), 1.0)
    depth = 24.0 + 6.0 * math.sqrt(small)
    # the tail starts at its own limit, so that large k needs no more terms than stated
    n = depth + 1.0
    ratio = small / (n + math.sqrt(n * n + small * small))
    twice = 2.0 / small
    for j in range(144, 0, -1):
        going = depth >= j
        if somewhere(going):
            ratio = choose(going, 1.0 / (twice * float(j) + ratio), ratio)
    x = 1.0 / choose(near, 400.0, k)
    series = 1.0 - x * (0.5 + x * (0.125 + x * (0.125 + x * (25.0 / 128.0 + x * (13.0 / 32.0)))))
    return choose(near, ratio, series)


@formula
def concentration(anisotropy):
    """Concentration k with 2 I1(k)/I0(k) = |a_c|.

    Parameters
    ----------
    anisotropy : float
        |a_c|, 0 <= |a_c| < 2.

    Returns
    -------
    k : float
    slope : float
        d k/d |a_c|.
    """
    r = 0.5 * anisotropy
    tiny = r < 1e-8
    target = choose(tiny, 0.1, r)
    k = target * (2.0 - target * target) / (1.0 - target * target)
    slope = 1.0 + 0.0 * k
    going = k > 0.0
    for _ in range(50):
        ratio = bessel_ratio(k)
        # 1 - A/k - A^2 cancels for large k; its expansion does not
        now = choose(k > 1e4, 0.5 / (k * k) * (1.0 + 0.5 / k), 1.0 - ratio / k - ratio * ratio)
        slope = choose(going, now, slope)
        step = (ratio - target) / slope
        # stay positive whatever the start
        k = choose(going, larger(k - step, 0.1 * k), k)
        going = going & (abs(step) > 4e-16 * k)
        if not somewhere(going):
            break
    return choose(tiny, 2.0 * r, k), choose(tiny, 1.0, 0.5 / slope)

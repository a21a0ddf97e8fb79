"""Directional density of contacts for a given fabric anisotropy: second harmonic or maximum entropy.

``E(theta) = W(e)/(2 pi)`` with ``e = (cos 2 theta, sin 2 theta)`` and ``<W> = 1``, ``2 <W e> = a_c``
[Pouragha & Wan 2017, eqs 1, 2]:

* harmonic: ``W = 1 + a_c.e``, non-negative for |a_c| <= 1;
* maximum entropy (von Mises): ``W = exp(k.e)/I0(|k|)`` with ``2 I1(|k|)/I0(|k|) = |a_c| < 2``.
"""

import math

from .compilation import compiled


@compiled()
def scaled_bessel_zero(k):
    """exp(-k) I0(k) for k >= 0, to rounding: power series up to k = 18, asymptotic series beyond."""
    if k <= 18.0:
        quarter = 0.25 * k * k
        term, total = 1.0, 1.0
        j = 1
        while term > 1e-17 * total:
            term *= quarter / (j * j)
            total += term
            j += 1
        return total * math.exp(-k)
    term, total = 1.0, 1.0
    for j in range(1, 40):
        factor = (2.0 * j - 1.0) ** 2 / (8.0 * k * j)
        if factor >= 1.0 or term < 1e-17:
            break
        term *= factor
        total += term
    return total / math.sqrt(2.0 * math.pi * k)


@compiled()
def bessel_ratio(k):
    """I1(k)/I0(k) for k >= 0, by its continued fraction evaluated backwards."""
    if k > 1e8:
        return 1.0 - 0.5 / k
    depth = 24 + int(6.0 * math.sqrt(k)) if k < 400.0 else 0
    if depth > 0:
        # the tail starts at its own limit, so that large k needs no more terms than stated
        n = depth + 1
        ratio = k / (n + math.sqrt(n * n + k * k))
        for j in range(depth, 0, -1):
            ratio = 1.0 / (2.0 * j / k + ratio) if k > 0.0 else 0.0
        return ratio
    x = 1.0 / k
    return 1.0 - x * (0.5 + x * (0.125 + x * (0.125 + x * (25.0 / 128.0 + x * (13.0 / 32.0)))))


@compiled()
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
    if r < 1e-8:
        return 2.0 * r, 1.0
    k = r * (2.0 - r * r) / (1.0 - r * r)
    slope = 1.0
    for _ in range(50):
        ratio = bessel_ratio(k)
        slope = 1.0 - ratio / k - ratio * ratio
        if k > 1e4:
            # 1 - A/k - A^2 cancels; its expansion does not
            slope = 0.5 / (k * k) * (1.0 + 0.5 / k)
        step = (ratio - r) / slope
        # stay positive whatever the start
        k = k - step if k - step > 0.1 * k else 0.1 * k
        if abs(step) <= 4e-16 * k:
            break
    return k, 0.5 / slope

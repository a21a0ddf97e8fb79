"""Inverse tangent functions without branches or library calls, so that loops over lanes become vector code.

The polynomials interpolate atan(x)/x and artanh(x)/x in x^2 at Chebyshev points (computed in 40 digits).
"""

import math

from granfabric.constitutive.compilation import compiled

from .layout import KERNEL_OPTIONS

TAN_PI_8 = math.sqrt(2.0) - 1.0


@compiled(**KERNEL_OPTIONS)
def angle(y, x):
    """Angle in [0, pi] of the point (x, y), y >= 0; 0 for the origin. Absolute error below 1e-15."""
    r = math.sqrt(x * x + y * y) + abs(x)
    # tangent of half the angle to the nearer half-axis, in [0, 1]
    t = y / (r if r > 0.0 else 1.0)
    steep = t > TAN_PI_8
    u = (t - 1.0) / (t + 1.0) if steep else t
    q = u * u
    s = 0.015113763707864531
    s = s * q - 0.03338782312896797
    s = s * q + 0.044995006697646826
    s = s * q - 0.052173125594086316
    s = s * q + 0.05876834002319731
    s = s * q - 0.06666205259739774
    s = s * q + 0.07692281099921489
    s = s * q - 0.09090908059030459
    s = s * q + 0.11111111085322088
    s = s * q - 0.14285714285329706
    s = s * q + 0.19999999999997015
    s = s * q - 0.33333333333333326
    half = u + u * q * s
    full = 2.0 * half + (0.5 * math.pi if steep else 0.0)
    return math.pi - full if x < 0.0 else full


@compiled(**KERNEL_OPTIONS)
def artanh(x):
    """Inverse hyperbolic tangent for |x| <= 0.98, odd, relative error below 2e-15.

    artanh(x) = 2 artanh(x/(1 + sqrt(1 - x^2))) three times brings |x| below 0.28.
    """
    x = x / (1.0 + math.sqrt((1.0 - x) * (1.0 + x)))
    x = x / (1.0 + math.sqrt((1.0 - x) * (1.0 + x)))
    x = x / (1.0 + math.sqrt((1.0 - x) * (1.0 + x)))
    q = x * x
    s = 0.07203921633123167
    s = s * q + 0.04762938103510126
    s = s * q + 0.05938076704544049
    s = s * q + 0.06662870396799757
    s = s * q + 0.07692472551854418
    s = s * q + 0.09090904514027609
    s = s * q + 0.11111111190088997
    s = s * q + 0.14285714284920953
    s = s * q + 0.2000000000000408
    s = s * q + 0.33333333333333326
    return 8.0 * (x + x * q * s)

"""Elementary functions without branches or library calls: the same few dozen instructions for one number or for eight.

The polynomials interpolate at Chebyshev points, the rational function at points that are denser near zero; all of them
were computed in 50 digits.
"""

import math

from granfabric.constitutive.compilation import formula

from .eight import choose, exponent, two_to_the

TAN_PI_8 = math.sqrt(2.0) - 1.0
NO_FRACTIONS = 6755399441055744.0
"""1.5 times 2^52: adding and subtracting it rounds to the nearest integer."""
FARTHEST = 8.5
"""Standard deviations beyond which a normal tail is taken for what it is there, 1e-17: physically nothing."""
ROOT_TWO_PI = math.sqrt(2.0 * math.pi)


@formula
def larger(a, b):
    """The larger of two; the second if one of them is not a number."""
    return choose(a > b, a, b)


@formula
def smaller(a, b):
    """The smaller of two; the second if one of them is not a number."""
    return choose(a < b, a, b)


@formula
def exponential(x):
    """exp(x), relative error below 4e-16; x is cut at -700 and 700."""
    x = smaller(larger(x, -700.0), 700.0)
    n = (x * 1.4426950408889634 + NO_FRACTIONS) - NO_FRACTIONS
    # ln 2 in two parts: the first has few enough digits for an exact product
    r = x - n * 0.6931471803691238 - n * 1.908214929270588e-10
    s = 2.511015364692893e-08
    s = s * r + 2.7632790542117181e-07
    s = s * r + 2.7557240604663896e-06
    s = s * r + 2.4801485074105117e-05
    s = s * r + 0.00019841269890340665
    s = s * r + 0.0013888888952696516
    s = s * r + 0.00833333333331949
    s = s * r + 0.04166666666648666
    s = s * r + 0.16666666666666681
    s = s * r + 0.5000000000000019
    return two_to_the(n) * ((s * r + 1.0) * r + 1.0)


@formula
def power(x, y):
    """x^y for a positive x."""
    return exponential(y * log_of_ratio(larger(x, 1e-300), 1.0))


@formula
def normal_tail(u):
    """Tail Phi(-u), expected excess phi(u) - u Phi(-u) and density phi(u) of the normal distribution, for u >= 0.

    Absolute errors below 2e-16; that of the tail is so relative to it as well. Beyond `FARTHEST`, as there.
    """
    u = smaller(u, FARTHEST)
    above = 4.461705440169261e-06
    above = above * u + 0.00011368636255471508
    above = above * u + 0.0013868440652039368
    above = above * u + 0.010474489871693757
    above = above * u + 0.05334578347455374
    above = above * u + 0.18763883980588394
    above = above * u + 0.4475442958499451
    above = above * u + 0.6704145413666432
    above = above * u + 0.5
    below = 1.1183836894293857e-05
    below = below * u + 0.00028496946106520544
    below = below * u + 0.0034874859477069165
    below = below * u + 0.026540633722975743
    below = below * u + 0.13717175530899686
    below = below * u + 0.4960299172650731
    below = below * u + 1.248664858486704
    below = below * u + 2.101535187855765
    below = below * u + 2.1387136435361525
    below = below * u + 1.0
    peak = exponential(-0.5 * u * u)
    density = peak * (1.0 / ROOT_TWO_PI)
    tail = peak * (above / below)
    return tail, larger(density - u * tail, 0.0), density


@formula
def cosine_sine(x):
    """cos(x), sin(x) for |x| <= pi, absolute error below 8e-16, by doubling half the angle."""
    half = 0.5 * x
    q = half * half
    c = -1.511977866001610e-16
    c = c * q + 4.776871733415368e-14
    c = c * q - 1.1470670142864075e-11
    c = c * q + 2.087675566605353e-09
    c = c * q - 2.7557319209647339e-07
    c = c * q + 2.4801587301492585e-05
    c = c * q - 0.001388888888888853
    c = c * q + 0.04166666666666666
    c = c * q - 0.5
    c = c * q + 1.0
    s = -7.982495482720203e-18
    s = s * q + 2.810214288760064e-15
    s = s * q - 7.647127729243047e-13
    s = s * q + 1.6059043206050104e-10
    s = s * q - 2.5052108378598792e-08
    s = s * q + 2.7557319223940686e-06
    s = s * q - 0.0001984126984126967
    s = s * q + 0.008333333333333333
    s = s * q - 0.16666666666666666
    s = half + half * q * s
    return 1.0 - 2.0 * s * s, 2.0 * s * c


@formula
def angle(y, x):
    """Angle in [0, pi] of the point (x, y), y >= 0; 0 for the origin. Absolute error below 1e-15."""
    return angle_at_distance(y, x, math.sqrt(x * x + y * y))


@formula
def angle_at_distance(y, x, r):
    """`angle` of a point whose distance r from the origin is known."""
    r = r + abs(x)
    # y/r is the tangent of half the angle to the nearer half-axis, in [0, 1]
    steep = y > TAN_PI_8 * r
    below = choose(steep, y + r, r)
    u = choose(steep, y - r, y) / choose(below > 0.0, below, 1.0)
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
    full = 2.0 * half + choose(steep, 0.5 * math.pi, 0.0)
    return choose(x < 0.0, math.pi - full, full)


@formula
def log_of_ratio(a, b):
    """ln(a/b) for positive a and b, relative error below 1e-15 but where they are nearly equal: 0 if they are equal."""
    n, m = exponent(a), exponent(b)
    a, b, n = a * two_to_the(-n), b * two_to_the(-m), n - m
    # a/b between the inverse of the root of two and itself
    high, low = a > 1.4142135623730951 * b, b > 1.4142135623730951 * a
    b, n = choose(high, 2.0 * b, b), choose(high, n + 1.0, n)
    a, n = choose(low, 2.0 * a, a), choose(low, n - 1.0, n)
    x = (a - b) / (a + b)
    q = x * x
    s = 0.07404920465425907
    s = s * q + 0.07656257831239007
    s = s * q + 0.09091816073237518
    s = s * q + 0.1111109852407682
    s = s * q + 0.14285714380360954
    s = s * q + 0.19999999999650992
    s = s * q + 0.33333333333333823
    return n * 0.6931471805599453 + 2.0 * (x + x * q * s)

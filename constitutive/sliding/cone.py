"""Sliding at contacts: plastic strain on a hardening cone in p and the stress ratio [model, section 7].

Compression positive, t = p s the deviator (t_1 = (s_xx - s_yy)/2, t_2 = s_xy), q = |t|, conjugate to the strains
v = e_xx + e_yy and e = (e_xx - e_yy, gamma_xy) in the sense that the work is p dv + t.de. With kappa the hardening
strain and gamma_p the accumulated plastic shear strain:

    cone           q = M (p + c),      M = M_first + (M_peak - M_first) h,      h = kappa/(gamma_r + kappa)
    hardening      gamma_p = kappa h^(m - 1),      dgamma_p = W dkappa,      W = h^(m - 1) (m - (m - 1) h)
    flow           de_p = dgamma_p t/q,         dv_p = dgamma_p D (M_cv - M)            (dilation above M_cv)
    stress         (dp, dt) = C (dv - dv_p, de - de_p)
    consistency    dkappa = max(0, t/q.dt_e - M dp_e)/A,      (dp_e, dt_e) the rates without plastic strain,
                   A = W (t/q.t_r - M p_r) + M' (p + c),      (p_r, t_r) = C (D (M_cv - M), t/q)

With m = 1 hardening is the hyperbola M = M_first + (M_peak - M_first) gamma_p/(gamma_r + gamma_p). Grains do not slide
all at once: the fraction of contacts that slide grows in proportion to the stress ratio, and with it the plastic
compliance. That is m = 2 and M_first = 0: gamma_p = gamma_r h^2/(1 - h). For m > 1 the modulus dM/dgamma_p is infinite
at first; kappa, in which M is always a hyperbola, keeps the equations regular.

The stress ratio of the dilatancy is q/(p + c), which on the cone is M. The work of plastic strain is dissipated:

    dW = p dv_p + t.de_p = dgamma_p [M c + p (M + D (M_cv - M))]

It cannot be negative at any p > 0 exactly if M + D (M_cv - M) >= 0 for every M that is reached, which is linear in M:
at M_first it needs nothing that the bounds do not give (D M_cv >= 0) unless D > 1, at M_peak
``(D - 1) M_peak <= D M_cv``. Parameters that break this are refused.

M is a one-to-one function of kappa, so that on the cone kappa can be had from the stress:
``kappa = gamma_r (M - M_first)/(M_peak - M)``.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose
from granfabric.constitutive.lanes.elementary import larger, power

CONE_TOLERANCE = 1e-12
"""Distance q - M (p + c) over p + c that counts as on the cone."""
LOAD_TOLERANCE = 1e-9
"""Distance outside the cone, likewise, above which a start stress is refused; below, it is rounding."""
AXIS_TOLERANCE = 1e-9
"""q/(p + c) below which a cone that has not yet opened is taken for its axis, where the flow has no direction yet."""


@formula
def strength(kappa, first, peak, reference):
    """M and its first and second derivative by kappa."""
    # a Runge-Kutta stage may look back beyond zero
    denominator = reference + larger(kappa, -0.5 * reference)
    share = (peak - first) / denominator
    by_kappa = share * reference / denominator
    return peak - share * reference, by_kappa, -2.0 * by_kappa / denominator


@formula
def hardening_strain_at(ratio, first, peak, reference):
    """kappa at which the strength is `ratio`; 0 below the first yield, infinite at the peak and beyond."""
    below = ratio < peak
    kappa = reference * (ratio - first) / choose(below, peak - ratio, 1.0)
    return choose(below, larger(kappa, 0.0), math.inf)


@formula
def plastic_share(kappa, reference, exponent):
    """W = dgamma_p/dkappa and its derivative by kappa."""
    hyperbola, opened = exponent == 1.0, kappa > 0.0
    total = reference + choose(opened, kappa, reference)
    h = choose(opened, kappa, reference) / total
    below = power(h, exponent - 2.0)
    by_h = exponent * (exponent - 1.0) * below * (1.0 - h)
    share, slope = below * h * (exponent - (exponent - 1.0) * h), by_h * reference / (total * total)
    share, slope = choose(opened, share, 0.0), choose(opened, slope, 0.0)
    return choose(hyperbola, 1.0, share), choose(hyperbola, 0.0, slope)


@formula
def plastic_shear_strain(kappa, reference, exponent):
    """gamma_p of a hardening strain."""
    return kappa * (kappa / (reference + kappa)) ** (exponent - 1.0)


@formula
def dissipated(gamma_rate, m, cohesion, p, expansion):
    """Rate of plastic work [Pa]; `expansion` is dv_p/dgamma_p, compression positive."""
    return gamma_rate * (m * cohesion + p * (m + expansion))

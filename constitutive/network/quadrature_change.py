"""Contacts lost and gained by Gauss-Legendre quadrature over the arcs on which they are, with derivatives.

Used where the integrals of `contact_change` have no closed form: for the maximum-entropy density, for the harmonic
density once |a_c| > 1, where it is clipped at zero, and where weak contacts feel a random change of force [model,
section 5.2]. Then the change of a contact about to open is normal with mean ``mu = chi dF/(1 + a_n.e)`` and standard
deviation ``sigma = c_w |dgamma| kn r/f``, that of a gap about to close with mean ``chi dF`` and the same deviation, so
that

    loss_i = < W E[max(-g, 0)] phi_i >        gain_i = < W E[max(g, 0)] phi_i >        i = 0, 1, 2

take the places of the averages in `contact_change`; with chi = 1 and sigma = 0 they are the same. |dgamma| is the
magnitude of the deviatoric strain increment (e_xx - e_yy, gamma_xy).

The circle is cut where the mean change of force changes sign, so that a vanishing scatter is integrated as exactly as
none, and where contacts end.
"""

import math

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, somewhere
from granfabric.constitutive.lanes.elementary import angle, cosine_sine, larger, smaller

from .arcs import arc_of_loss
from .direction_density import density_at, shape_of
from .weak_forces import negative_part, positive_part

_AVERAGE = 1.0 / (2.0 * math.pi)


@formula
def quadrature_change(d, w1, w2, a1, a2, n1, n2, g, p0, loss, gain, sigma, chi, scattered, entropy, nodes, weights):
    """Change (see `contact_change`) by quadrature.

    Parameters
    ----------
    d, w1, w2, a1, a2, n1, n2, g, p0, loss, gain :
        As in `contact_change.closed_form_change`.
    sigma, chi : float
        Of the random change of force, if `scattered`.
    scattered, entropy : bool
    nodes, weights : ndarray, shape (directions,)
        Gauss-Legendre rule on [-1, 1], used on each arc.
    """
    zero = 0.0 * d
    nothing = (zero, zero, zero)
    lost, won, by_sigma = nothing, nothing, nothing
    nowhere = (zero, zero, zero, zero, zero, zero)
    by_v, by_a, by_n = nowhere, nowhere, nowhere
    shape = shape_of(entropy, a1, a2)
    reach = shape[7]
    kappa, sine, cf, sf = arc_of_loss(d, w1, w2)
    # angles from the middle of the arc of loss: itself up to `half`, then the arc of gain about pi
    half = angle(sine, kappa)
    along, across = shape[1] * cf + shape[2] * sf, shape[2] * cf - shape[1] * sf
    dense = angle(abs(across), along)
    dense = choose(across < 0.0, -dense, dense)
    for arc in range(2):
        if not (scattered or (loss if arc == 0 else gain)):
            continue
        middle = 0.0 if arc == 0 else math.pi
        width = half if arc == 0 else math.pi - half
        # the arc where contacts are, brought next to this one, may meet it in two pieces
        for shift in range(-1, 2):
            low, high = middle - width, middle + width
            about = dense + 2.0 * math.pi * (shift if arc == 0 else shift + 1)
            whole = reach >= math.pi
            low = choose(whole, choose(shift == 0, low, high), larger(low, about - reach))
            high = choose(whole, high, smaller(high, about + reach))
            here = high > low
            if not somewhere(here):
                continue
            mean, scale = 0.5 * (low + high), choose(here, 0.5 * (high - low), 0.0)
            # from the middle of its arc every piece spans less than pi
            for i in range(nodes.shape[0]):
                y = mean + scale * nodes[i] - middle
                cy, sy = cosine_sine(y)
                if arc == 1:
                    cy, sy = -cy, -sy
                c, s = cf * cy - sf * sy, sf * cy + cf * sy
                measure = weights[i] * _AVERAGE * scale
                density, by_a1, by_a2 = density_at(entropy, shape, c, s)
                change = chi * (d + w1 * c + w2 * s)
                inverse = 1.0 / (1.0 + n1 * c + n2 * s)
                less, less_by, less_by_sigma, more, more_by, more_by_sigma = zero, zero, zero, zero, zero, zero
                if scattered:
                    if loss:
                        less, less_by, less_by_sigma = negative_part(change * inverse, sigma)
                    if gain:
                        more, more_by, more_by_sigma = positive_part(change, sigma)
                elif arc == 0:
                    less, less_by = -change * inverse, -1.0 + zero
                else:
                    more, more_by = change, 1.0 + zero
                there = measure * density
                lost = _add_vector(lost, there * less, c, s)
                won = _add_vector(won, there * more, c, s)
                net = g * more - p0 * less
                by_mean = there * chi * (g * more_by - p0 * less_by * inverse)
                by_v = _add_matrix(by_v, by_mean, c, s)
                x, y = measure * net * by_a1, measure * net * by_a2
                by_a = _add_products(by_a, x, y, c, s)
                turn = there * p0 * less_by * change * inverse * inverse
                by_n = _add_products(by_n, turn * c, turn * s, c, s)
                by_sigma = _add_vector(by_sigma, there * (g * more_by_sigma - p0 * less_by_sigma), c, s)
    return lost, won, by_v, by_a, by_n, by_sigma


@formula
def _add_vector(total, value, c, s):
    return total[0] + value, total[1] + value * c, total[2] + value * s


@formula
def _add_matrix(total, value, c, s):
    x, y = value * c, value * s
    return total[0] + value, total[1] + x, total[2] + y, total[3] + x * c, total[4] + x * s, total[5] + y * s


@formula
def _add_products(total, x, y, c, s):
    """(x, y) and its products with c and with s."""
    return total[0] + x, total[1] + y, total[2] + x * c, total[3] + y * c, total[4] + x * s, total[5] + y * s

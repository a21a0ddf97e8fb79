"""Rates of contact loss and gain by Gauss-Legendre quadrature over exactly the arcs on which they happen.

Used where the integrals have no closed form: for the maximum-entropy density, and for the harmonic density once
|a_c| > 1, where it is clipped at zero. Then the arcs of loss and gain are first cut down to where there are contacts.
Same quantities, rows and derivatives as `contact_change.closed_form_change`, one lane at a time.
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import BY_A, BY_N, BY_V, N1, N2, TRIAL_A1, TRIAL_A2, V1, V2, VALUE, D, L

from .arcs import arc_of_loss
from .direction_density import density_at, shape_of

_AVERAGE = 1.0 / (2.0 * math.pi)


@compiled()
def quadrature_change(w, lane, density, loss, gain, derivatives, nodes, weights):
    """Loss and gain in one lane by quadrature; rows as in `contact_change.closed_form_change`.

    Parameters
    ----------
    w : ndarray
        Workspace.
    lane : int
    density : int
        `lanes.HARMONIC` or `lanes.MAXIMUM_ENTROPY`.
    nodes, weights : ndarray, shape (directions,)
        Gauss-Legendre rule on [-1, 1], used on each arc.
    """
    v0, v1, v2 = w[D + lane], w[V1 + lane], w[V2 + lane]
    q1, q2, n1, n2 = w[TRIAL_A1 + lane], w[TRIAL_A2 + lane], w[N1 + lane], w[N2 + lane]
    for i in range(6):
        w[VALUE + i * L + lane] = 0.0
    if derivatives:
        for i in range(18):
            w[BY_V + i * L + lane] = 0.0
        for i in range(12):
            w[BY_A + i * L + lane] = 0.0
        for i in range(6):
            w[BY_N + i * L + lane] = 0.0
    shape = shape_of(density, q1, q2)
    dense, reach = math.atan2(shape[3], shape[2]), shape[8]
    kappa, sine, cf, sf = arc_of_loss(v0, v1, v2)
    half = math.atan2(sine, kappa)
    centre = math.atan2(sf, cf)
    for row in range(2):
        if (row == 0 and not loss) or (row == 1 and not gain):
            continue
        middle = centre if row == 0 else centre + math.pi
        width = half if row == 0 else math.pi - half
        value, by_v, by_a = VALUE + row * 3 * L + lane, BY_V + row * 9 * L + lane, BY_A + row * 6 * L + lane
        # the arc where contacts are, shifted to lie next to this arc, may meet it in two pieces
        nearest = dense + 2.0 * math.pi * math.floor((middle - dense) / (2.0 * math.pi) + 0.5)
        for shift in range(-1, 2):
            low, high = middle - width, middle + width
            if reach < math.pi:
                about = nearest + 2.0 * math.pi * shift
                low, high = max(low, about - reach), min(high, about + reach)
            elif shift != 0:
                continue
            if high <= low:
                continue
            mean, scale = 0.5 * (low + high), 0.5 * (high - low)
            for g in range(nodes.shape[0]):
                y = mean + scale * nodes[g]
                c, s = math.cos(y), math.sin(y)
                density_here, by_a1, by_a2 = density_at(shape, c, s)
                change = v0 + v1 * c + v2 * s
                measure = weights[g] * scale * _AVERAGE
                inverse = 1.0
                if row == 0:
                    inverse = 1.0 / (1.0 + n1 * c + n2 * s)
                    measure = -measure * inverse
                r = measure * density_here * change
                w[value] += r
                w[value + L] += r * c
                w[value + 2 * L] += r * s
                if derivatives:
                    f = measure * density_here
                    w[by_v] += f
                    w[by_v + L] += f * c
                    w[by_v + 2 * L] += f * s
                    w[by_v + 4 * L] += f * c * c
                    w[by_v + 5 * L] += f * c * s
                    w[by_v + 8 * L] += f * s * s
                    x, z = measure * change * by_a1, measure * change * by_a2
                    w[by_a] += x
                    w[by_a + L] += z
                    w[by_a + 2 * L] += x * c
                    w[by_a + 3 * L] += z * c
                    w[by_a + 4 * L] += x * s
                    w[by_a + 5 * L] += z * s
                    if row == 0:
                        x = -r * inverse
                        w[BY_N + lane] += x * c
                        w[BY_N + L + lane] += x * s
                        w[BY_N + 2 * L + lane] += x * c * c
                        w[BY_N + 3 * L + lane] += x * c * s
                        w[BY_N + 4 * L + lane] += x * c * s
                        w[BY_N + 5 * L + lane] += x * s * s
        if derivatives:
            w[by_v + 3 * L] = w[by_v + L]
            w[by_v + 6 * L] = w[by_v + 2 * L]
            w[by_v + 7 * L] = w[by_v + 5 * L]

"""Rates of contact loss and gain when weak contacts feel a random change of force [model, section 5.2].

The change of a contact about to open is normal with mean ``mu = chi dF/(1 + a_n.e)`` and standard deviation
``sigma = c_w |dgamma| kn r/f``, that of a gap about to close with mean ``chi dF`` and the same deviation, so that

    loss_i = < W E[max(-g, 0)] phi_i >        gain_i = < W E[max(g, 0)] phi_i >        i = 0, 1, 2

take the places of the averages of `contact_change`; with chi = 1 and sigma -> 0 they are the same. |dgamma| is the
magnitude of the deviatoric strain increment (e_xx - e_yy, gamma_xy).
"""

import math

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import (
    BY_A,
    BY_N,
    BY_SIGMA,
    BY_V,
    C_W,
    CHI,
    COLUMNS,
    DENSITY,
    FORCE,
    GAIN,
    GAIN_FACTOR,
    GIVEN,
    I11,
    I12,
    I21,
    I22,
    IN_F,
    INPUTS,
    JACOBIAN,
    LANES,
    LOSS,
    N1,
    N2,
    P_ZERO,
    SELF_CONSISTENT,
    SIGMA,
    SIGMA_JACOBIAN,
    SLOPE,
    STRAIN,
    TANGENTIAL,
    TRIAL_A1,
    TRIAL_A2,
    TRIAL_Z,
    UNKNOWNS,
    V1,
    V2,
    VALUE,
    D,
    L,
)

from .arcs import arc_of_loss
from .direction_density import density_at, shape_of
from .weak_forces import negative_part, positive_part

_AVERAGE = 1.0 / (2.0 * math.pi)


@compiled()
def prepare_scatter(w, numbers):
    """sigma of every lane."""
    for lane in range(LANES):
        deviator, shear = w[STRAIN + lane] - w[STRAIN + L + lane], w[STRAIN + 2 * L + lane]
        w[SIGMA + lane] = numbers[C_W] * math.sqrt(deviator * deviator + shear * shear) / w[FORCE + lane]


@compiled()
def fluctuating_change(w, options, numbers, derivatives, nodes, weights):
    """Loss and gain in every lane; rows as in `contact_change.closed_form_change`, and BY_SIGMA.

    The circle is cut where the mean change of force changes sign, so that a vanishing scatter is integrated as exactly
    as none.
    """
    for lane in range(LANES):
        _clear(w, lane, derivatives)
        shape = shape_of(options[DENSITY], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane])
        kappa, sine, cf, sf = arc_of_loss(w[D + lane], w[V1 + lane], w[V2 + lane])
        half, centre = math.atan2(sine, kappa), math.atan2(sf, cf)
        for arc in range(2):
            middle = centre if arc == 0 else centre + math.pi
            width = half if arc == 0 else math.pi - half
            for g in range(nodes.shape[0]):
                y = middle + width * nodes[g]
                c, s = math.cos(y), math.sin(y)
                if width > 0.0:
                    _add_direction(
                        w, lane, c, s, weights[g] * width * _AVERAGE, shape, options, numbers[CHI], derivatives
                    )
        if derivatives:
            for row in range(2):
                by_v = BY_V + row * 9 * L + lane
                w[by_v + 3 * L] = w[by_v + L]
                w[by_v + 6 * L] = w[by_v + 2 * L]
                w[by_v + 7 * L] = w[by_v + 5 * L]


@compiled()
def _clear(w, lane, derivatives):
    for i in range(6):
        w[VALUE + i * L + lane] = 0.0
        w[BY_SIGMA + i * L + lane] = 0.0
        w[BY_N + i * L + lane] = 0.0
    if derivatives:
        for i in range(18):
            w[BY_V + i * L + lane] = 0.0
        for i in range(12):
            w[BY_A + i * L + lane] = 0.0


@compiled()
def _add_direction(w, lane, c, s, measure, shape, options, chi, derivatives):
    """Add what one direction loses and gains."""
    density, by_a1, by_a2 = density_at(shape, c, s)
    change = chi * (w[D + lane] + w[V1 + lane] * c + w[V2 + lane] * s)
    for row in range(2):
        if options[LOSS if row == 0 else GAIN] == 0:
            continue
        inverse = 1.0
        if row == 0:
            inverse = 1.0 / (1.0 + w[N1 + lane] * c + w[N2 + lane] * s)
            part, by_mean, by_sigma = negative_part(change * inverse, w[SIGMA + lane])
        else:
            part, by_mean, by_sigma = positive_part(change, w[SIGMA + lane])
        value = VALUE + row * 3 * L + lane
        r = measure * density * part
        w[value] += r
        w[value + L] += r * c
        w[value + 2 * L] += r * s
        if not derivatives:
            continue
        f = measure * density * by_mean * chi * inverse
        by = BY_V + row * 9 * L + lane
        w[by] += f
        w[by + L] += f * c
        w[by + 2 * L] += f * s
        w[by + 4 * L] += f * c * c
        w[by + 5 * L] += f * c * s
        w[by + 8 * L] += f * s * s
        x, y = measure * part * by_a1, measure * part * by_a2
        by = BY_A + row * 6 * L + lane
        w[by] += x
        w[by + L] += y
        w[by + 2 * L] += x * c
        w[by + 3 * L] += y * c
        w[by + 4 * L] += x * s
        w[by + 5 * L] += y * s
        f = measure * density * by_sigma
        by = BY_SIGMA + row * 3 * L + lane
        w[by] += f
        w[by + L] += f * c
        w[by + 2 * L] += f * s
        if row == 0:
            x = -measure * density * by_mean * change * inverse * inverse
            w[BY_N + lane] += x * c
            w[BY_N + L + lane] += x * s
            w[BY_N + 2 * L + lane] += x * c * c
            w[BY_N + 3 * L + lane] += x * c * s
            w[BY_N + 4 * L + lane] += x * c * s
            w[BY_N + 5 * L + lane] += x * s * s


@compiled()
def differentiate_scatter(w, options):
    """Derivatives of the rates of z, a_c by sigma into SIGMA_JACOBIAN; sigma's dependence on f into JACOBIAN."""
    for lane in range(LANES):
        g, p0 = w[GAIN_FACTOR + lane], w[P_ZERO + lane]
        z, a1, a2 = w[TRIAL_Z + lane], w[TRIAL_A1 + lane], w[TRIAL_A2 + lane]
        x0 = g * w[BY_SIGMA + 3 * L + lane] - p0 * w[BY_SIGMA + lane]
        x1 = g * w[BY_SIGMA + 4 * L + lane] - p0 * w[BY_SIGMA + L + lane]
        x2 = g * w[BY_SIGMA + 5 * L + lane] - p0 * w[BY_SIGMA + 2 * L + lane]
        dz, da1, da2 = z * x0, 2.0 * x1 - a1 * x0, 2.0 * x2 - a2 * x0
        if options[TANGENTIAL] == SELF_CONSISTENT:
            da1, da2 = (
                w[I11 + lane] * da1 + w[I12 + lane] * da2,
                w[I21 + lane] * da1 + w[I22 + lane] * da2,
            )
            by1 = g * w[BY_V + (9 + 1) * L + lane] - p0 * w[BY_V + L + lane]
            by2 = g * w[BY_V + (9 + 2) * L + lane] - p0 * w[BY_V + 2 * L + lane]
            dz += z * (by1 * da1 + by2 * da2)
        by_force = -w[SIGMA + lane] / w[FORCE + lane]
        w[SIGMA_JACOBIAN + lane] = dz
        w[SIGMA_JACOBIAN + L + lane] = da1
        w[SIGMA_JACOBIAN + 2 * L + lane] = da2
        for i in range(3):
            w[JACOBIAN + (i * INPUTS + IN_F) * L + lane] += by_force * w[SIGMA_JACOBIAN + i * L + lane]


@compiled()
def scatter_slopes(w, numbers):
    """Add the change of sigma with the strain rate itself (strain control)."""
    for lane in range(LANES):
        deviator, shear = w[GIVEN + lane] - w[GIVEN + L + lane], w[GIVEN + 2 * L + lane]
        strain = math.sqrt(deviator * deviator + shear * shear)
        factor = numbers[C_W] / (w[FORCE + lane] * strain) if strain > 0.0 else 0.0
        for column in range(COLUMNS):
            own = deviator if column == 0 else (-deviator if column == 1 else shear)
            row = SLOPE + (column * UNKNOWNS + 3) * L + lane
            for i in range(3):
                w[row + i * L] += factor * own * w[SIGMA_JACOBIAN + i * L + lane]

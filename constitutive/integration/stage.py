"""One Runge-Kutta stage: rates of stress, of the closure's unknowns and of strain, and their derivatives.

The increment is followed in a pseudo-time from 0 to 1 with constant rates of the given components. The unknowns are
p, t = p s (compression positive) and three of the closure; derivatives are by the strain increment (v, e_1, e_2).
"""

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.contract import Status
from granfabric.constitutive.lanes.eight import choose, read, write
from granfabric.constitutive.mixed_control import rates_with_given
from granfabric.constitutive.network.closures import network_at, network_change, rate_changes, rates
from granfabric.constitutive.network.point import LARGEST_COORDINATION, SMALLEST_COORDINATION
from granfabric.constitutive.sliding.flow import sliding_changes, sliding_rates
from granfabric.constitutive.stiffness import stress_rate, stress_rate_change

UNKNOWNS = 6
"""p, t_1, t_2 and the closure's three."""
COLUMNS = 3
"""Strain components by which is differentiated: v, e_1, e_2."""
ADVANCED = UNKNOWNS + UNKNOWNS * COLUMNS
"""Rows that a substep advances together: the unknowns, then their derivatives, column by column."""
GAINED, LOST, STRAIN = ADVANCED, ADVANCED + 3, ADVANCED + 6
"""Rows of rates of z, a_c gained and lost and of strain (xx, yy, xy): integrated along, nothing depends on them."""
RATES = ADVANCED + 9

_LIMITED = float(Status.LIMITED)
_NO_PRESSURE = float(Status.NO_PRESSURE)
_NOT_ADMISSIBLE = float(Status.NOT_ADMISSIBLE)
_STIFFNESS_LOST = float(Status.STIFFNESS_LOST)
_NOT_CONVERGED = float(Status.NOT_CONVERGED)


@formula
def stiffness_at(point, network, feedback):
    """K, G, B and a_c of the stiffness, and whether it is positive definite."""
    z = network.z if feedback else point.reference_z
    a1 = network.a1 if feedback else point.reference_a1
    a2 = network.a2 if feedback else point.reference_a2
    k, g, b = point.bulk * z, z * (point.shear + point.stiffening * z), point.coupling * z
    definite = (g > 0.0) & (b * b * (a1 * a1 + a2 * a2) < k * g)
    return (k, g, b, a1, a2), definite


@formula
def stage(
    number, trial, k, inputs, point, given, stressed, largest, guess, known, here,
    closure, options, differentiate, deciding, slide, rule, lanes,
):  # fmt: skip
    """Rates at the state in `trial`, written into the rows of stage `number` of `k`.

    Parameters
    ----------
    number : int
    trial : ndarray, shape (ADVANCED, lanes)
        Unknowns and, with derivatives, their derivatives.
    k : ndarray, shape (stages RATES, lanes)
    inputs : ndarray
        See `network.point`.
    point : Point
    given : tuple of 3
        Strain increment v, e_1, e_2, compression positive; where stress is given as well, xx, yy, xy, tension positive.
    stressed : tuple of 3
        Which of the components given are stresses.
    largest : float
        Largest |s| so far.
    guess : tuple of 2
        See the closure.
    known : bool
        The network is `here`, and nothing has been differentiated yet.
    here : Network
    closure : named tuple
        See `network.closures`.
    options : Options
    differentiate : bool
        Whether derivatives are wanted.
    deciding : bool
        The stage is the first of its substep.
    slide : record
        See `sliding.slide`; read if points may slide.
    rule : tuple
        Gauss-Legendre nodes and weights, cosines and sines of the circle, cosines of half of it.
    lanes : tuple

    Returns
    -------
    outcome : float
        Status of the stage.
    network : Network
    stiffness : tuple of 5
        K, G, B, a_c.
    guess : tuple of 2
        For the next stage.
    """
    first = number * RATES
    p, t1, t2 = read(trial, 0, lanes), read(trial, 1, lanes), read(trial, 2, lanes)
    unknown = (read(trial, 3, lanes), read(trial, 4, lanes), read(trial, 5, lanes))
    pressure = p > point.floor
    inverse = 1.0 / choose(pressure, p, 1.0)
    p = choose(pressure, p, 1.0)
    s1, s2 = t1 * inverse, t2 * inverse
    turns = 1.0 if options.rotation else 0.0
    stress = (p, inverse, s1, turns * s2, largest)
    solved, network, partials = network_at(closure, point, stress, unknown, guess, known, here, rule, inputs, lanes)
    stiffness, definite = stiffness_at(point, network, options.feedback)
    fabric = network.a1 * network.a1 + network.a2 * network.a2
    most = 1.0 if options.limited else 4.0
    outcome = choose(fabric > most, _LIMITED, 0.0 * p)
    outcome = choose(definite, outcome, _STIFFNESS_LOST)
    outcome = choose(solved, outcome, _NOT_CONVERGED)
    outcome = choose(pressure, outcome, _NO_PRESSURE)
    admissible = (network.z > SMALLEST_COORDINATION) & (network.z < LARGEST_COORDINATION) & (fabric < 4.0)
    outcome = choose(admissible, outcome, choose(solved, _NOT_ADMISSIBLE, outcome))
    usable = outcome <= _LIMITED
    # what has failed computes on with harmless numbers
    zero = 0.0 * choose(usable, p, 0.0)
    one = 1.0 + zero
    stiffness = choose(usable, stiffness, (one, one, zero, zero, zero))
    network = choose(usable, network, here)
    s1, s2 = choose(usable, s1, 0.0), choose(usable, s2, 0.0)
    rate, strain = stress_rate(stiffness, given[0], given[1], given[2]), given
    if options.mixed:
        rate, tension = rates_with_given(stiffness, given, stressed)
        strain = (-(tension[0] + tension[1]), tension[1] - tension[0], -tension[2])
        write(k, first + STRAIN, tension[0], lanes)
        write(k, first + STRAIN + 1, tension[1], lanes)
        write(k, first + STRAIN + 2, tension[2], lanes)
    if options.sliding:
        row = first + STRAIN
        rate, outcome = sliding_rates(
            number, deciding, (p, t1, t2), rate, stiffness, stressed, options.mixed, outcome, slide, k, row, lanes
        )
    dp, dt1, dt2 = rate
    d = dp * inverse
    # s as the closure sees it has a second component only if principal axes may turn
    ratio = (p, inverse, s1, turns * s2)
    change = (dp, d, dt1 * inverse - s1 * d, turns * (dt2 * inverse - s2 * d))
    going, limited, own, gained, lost, guess, more = rates(
        closure, point, ratio, change, network, guess, (strain[1], strain[2]), differentiate, rule
    )
    outcome = choose((outcome <= _LIMITED) & limited, _LIMITED, outcome)
    outcome = choose(going, outcome, choose(outcome <= _LIMITED, _NOT_CONVERGED, outcome))
    write(k, first, dp, lanes)
    write(k, first + 1, dt1, lanes)
    write(k, first + 2, dt2, lanes)
    for i in range(3):
        write(k, first + 3 + i, own[i], lanes)
        write(k, first + GAINED + i, gained[i], lanes)
        write(k, first + LOST + i, lost[i], lanes)
    if differentiate:
        follow = 1.0 if options.feedback else 0.0
        for column in range(COLUMNS):
            row = UNKNOWNS + UNKNOWNS * column
            tp, u1, u2 = read(trial, row, lanes), read(trial, row + 1, lanes), read(trial, row + 2, lanes)
            mine = (read(trial, row + 3, lanes), read(trial, row + 4, lanes), read(trial, row + 5, lanes))
            # of ln p and s, then of the network
            relative = tp * inverse
            w1, w2 = u1 * inverse - s1 * relative, turns * (u2 * inverse - s2 * relative)
            tz, ta1, ta2 = network_change(closure, partials, stress, mine, (relative, w1, w2))
            # of the stress rate: its own strain component, then the stiffness
            o_v, o_1, o_2 = 1.0 * (column == 0), 1.0 * (column == 1), 1.0 * (column == 2)
            cz, c1, c2 = follow * tz, follow * ta1, follow * ta2
            db = point.coupling * cz
            stiffening = (
                point.bulk * cz,
                (point.shear + 2.0 * point.stiffening * network.z) * cz,
                db,
                db * stiffness[3] + stiffness[2] * c1,
                db * stiffness[4] + stiffness[2] * c2,
            )
            r_p, r_1, r_2 = stress_rate(stiffness, o_v, o_1, o_2)
            x_p, x_1, x_2 = stress_rate_change(stiffening, strain[0], strain[1], strain[2])
            r_p, r_1, r_2 = r_p + x_p, r_1 + x_1, r_2 + x_2
            if options.sliding:
                r_p, r_1, r_2 = sliding_changes(
                    number, column, (p, t1, t2), (tp, u1, u2), (r_p, r_1, r_2),
                    stiffness, stiffening, outcome, slide, lanes,
                )
            # of d and ds, then of the closure's rates
            dd = r_p * inverse - d * relative
            b1 = (r_1 - dt1 * relative) * inverse - w1 * d - s1 * dd
            b2 = turns * ((r_2 - dt2 * relative) * inverse - s2 * dd) - w2 * d
            x, y, z = rate_changes(
                closure, point, ratio, change, network, (strain[1], strain[2]), more,
                (tz, ta1, ta2), (relative, w1, w2), (r_p, dd, b1, b2), (o_1, o_2),
            )
            write(k, first + row, r_p, lanes)
            write(k, first + row + 1, r_1, lanes)
            write(k, first + row + 2, r_2, lanes)
            write(k, first + row + 3, x, lanes)
            write(k, first + row + 4, y, lanes)
            write(k, first + row + 5, z, lanes)
    return outcome, network, stiffness, guess

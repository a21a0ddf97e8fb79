"""End values of a point: a_n, a_t, f from their exact differentials, what was gained and lost, what closures leave."""

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import read, write
from granfabric.constitutive.material_table import (
    M_A1,
    M_A2,
    M_F,
    M_GAINED,
    M_HELD,
    M_LOST,
    M_N1,
    M_N2,
    M_T1,
    M_T2,
    M_Z,
    MICRO,
)
from granfabric.constitutive.network.closures import leave
from granfabric.constitutive.stiffness import invariants


@formula
def end_values(closure, inputs, ends, point, stress, network, y, sums, largest, rotation, rule, lanes):
    """Write the micro-state at the end of an increment into the rows of `ends`, stress (xx, yy, xy) after it.

    Parameters
    ----------
    inputs : ndarray
        See `network.point`.
    ends : ndarray, shape (MICRO + 3, lanes)
    stress : tuple of 3
        xx, yy, xy, tension positive.
    network : Network
    y, sums : ndarray
        Unknowns at the end; sums of z, a_c gained and lost.
    largest : float
        Largest |s| so far.
    rotation : bool
    rule : tuple
        See `points.update_points`.
    """
    # what contacts hold is left by the closure that knows of it
    for row in range(M_HELD):
        write(ends, row, read(inputs, row, lanes), lanes)
    for i in range(3):
        write(ends, MICRO + i, stress[i], lanes)
        write(ends, M_GAINED + i, read(inputs, M_GAINED + i, lanes) + read(sums, i, lanes), lanes)
        write(ends, M_LOST + i, read(inputs, M_LOST + i, lanes) + read(sums, 3 + i, lanes), lanes)
    p, t1, t2 = invariants(stress[0], stress[1], stress[2])
    turns = 1.0 if rotation else 0.0
    ds1, ds2 = t1 / p - point.start_s1, turns * t2 / p - point.start_s2
    rest = 2.0 - point.c_n
    da1, da2 = network.a1 - read(inputs, M_A1, lanes), network.a2 - read(inputs, M_A2, lanes)
    write(ends, M_N1, read(inputs, M_N1, lanes) + point.c_n * ds1, lanes)
    write(ends, M_N2, read(inputs, M_N2, lanes) + point.c_n * ds2, lanes)
    write(ends, M_T1, read(inputs, M_T1, lanes) + rest * ds1 - da1, lanes)
    write(ends, M_T2, read(inputs, M_T2, lanes) + rest * ds2 - da2, lanes)
    write(ends, M_F, read(inputs, M_F, lanes) * (p / point.start_p) * (read(inputs, M_Z, lanes) / network.z), lanes)
    write(ends, M_Z, network.z, lanes)
    write(ends, M_A1, network.a1, lanes)
    write(ends, M_A2, network.a2, lanes)
    leave(closure, inputs, ends, point, p, network, y, largest, rule, lanes)

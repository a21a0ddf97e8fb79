"""Rates of stress and strain where some components of stress and the other components of strain are given."""

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.stiffness import fill_stiffness, stress_rate

from .layout import GIVEN, RATE, STIFF_A1, STIFF_A2, STIFF_B, STIFF_G, STIFF_K, STRAIN, L


@compiled()
def _solve_block(c, control):
    """Solve for the strains of stress-controlled components, whose equations stand in `c`, into its last column."""
    # elimination without pivoting is stable: any principal block of the stiffness is positive definite
    for i in range(3):
        if control[i] == 1:
            for row in range(i + 1, 3):
                if control[row] == 1:
                    factor = c[row, i] / c[i, i]
                    for j in range(i + 1, 4):
                        c[row, j] -= factor * c[i, j]
    for i in range(2, -1, -1):
        if control[i] == 1:
            total = c[i, 3]
            for j in range(i + 1, 3):
                if control[j] == 1:
                    total -= c[i, j] * c[j, 3]
            c[i, 3] = total / c[i, i]


@compiled()
def plastic_relief(w, lane, control, c, v, e1, e2):
    """What a plastic strain takes off the stress while controlled components stay.

    Parameters
    ----------
    v, e1, e2 : float
        Plastic volumetric strain and deviator (e_xx - e_yy, gamma_xy), compression positive.
    w, lane, control, c :
        As in `solve_mixed`.

    Returns
    -------
    tuple of 6 floats
        Decrease of p, t_1, t_2, compression positive; strain xx, yy, xy that appears in stress-controlled components,
        tension positive.
    """
    k, g, b = w[STIFF_K + lane], w[STIFF_G + lane], w[STIFF_B + lane]
    a1, a2 = w[STIFF_A1 + lane], w[STIFF_A2 + lane]
    fill_stiffness(k, g, b, a1, a2, c)
    xx, yy, xy = -0.5 * (v + e1), -0.5 * (v - e1), -e2
    r_xx, r_yy, r_xy = stress_rate(k, g, b, a1, a2, xx, yy, xy)
    c[0, 3], c[1, 3], c[2, 3] = r_xx, r_yy, r_xy
    _solve_block(c, control)
    f_xx = c[0, 3] if control[0] == 1 else 0.0
    f_yy = c[1, 3] if control[1] == 1 else 0.0
    f_xy = c[2, 3] if control[2] == 1 else 0.0
    s_xx, s_yy, s_xy = stress_rate(k, g, b, a1, a2, xx - f_xx, yy - f_yy, xy - f_xy)
    s_xx = 0.0 if control[0] == 1 else s_xx
    s_yy = 0.0 if control[1] == 1 else s_yy
    s_xy = 0.0 if control[2] == 1 else s_xy
    return -0.5 * (s_xx + s_yy), -0.5 * (s_xx - s_yy), -s_xy, f_xx, f_yy, f_xy


@compiled()
def solve_mixed(w, lane, control, c):
    """Complete the rates of one lane: writes rows STRAIN and the first three of RATE.

    Parameters
    ----------
    w : ndarray
        Workspace; reads GIVEN and the stiffness rows.
    lane : int
    control : ndarray of uint8, shape (3,)
        1 where GIVEN is a stress rate, 0 where it is a strain rate.
    c : ndarray, shape (3, 4)
        Workspace: stiffness and right-hand side.
    """
    k, g, b = w[STIFF_K + lane], w[STIFF_G + lane], w[STIFF_B + lane]
    a1, a2 = w[STIFF_A1 + lane], w[STIFF_A2 + lane]
    fill_stiffness(k, g, b, a1, a2, c)
    for i in range(3):
        c[i, 3] = w[GIVEN + i * L + lane]
        w[STRAIN + i * L + lane] = c[i, 3]
    for i in range(3):
        if control[i] == 1:
            for j in range(3):
                if control[j] == 0:
                    c[i, 3] -= c[i, j] * w[GIVEN + j * L + lane]
    _solve_block(c, control)
    for i in range(3):
        if control[i] == 1:
            w[STRAIN + i * L + lane] = c[i, 3]
    xx, yy, xy = stress_rate(k, g, b, a1, a2, w[STRAIN + lane], w[STRAIN + L + lane], w[STRAIN + 2 * L + lane])
    w[RATE + lane] = w[GIVEN + lane] if control[0] == 1 else xx
    w[RATE + L + lane] = w[GIVEN + L + lane] if control[1] == 1 else yy
    w[RATE + 2 * L + lane] = w[GIVEN + 2 * L + lane] if control[2] == 1 else xy

"""Where numbers stand: columns of the table of materials, and entries of a point's micro-state."""

# columns of the parameter table, in the order of `parameters.Material.variables`
(
    PAR_Z,
    PAR_PHI,
    PAR_KN,
    PAR_RATIO,
    PAR_P_ZERO,
    PAR_P_SLOPE,
    PAR_P_GAP,
    PAR_NEIGHBOURS,
    PAR_C_N,
    PAR_BULK,
    PAR_SHEAR,
    PAR_Z_ISO,
    PAR_FABRIC_XX,
    PAR_FABRIC_XY,
    PAR_M_PEAK,
    PAR_M_FIRST,
    PAR_GAMMA_R,
    PAR_EXPONENT,
    PAR_DILATANCY,
    PAR_M_CV,
    PAR_COHESION,
    PAR_FLUID,
    PAR_FLUID_POROSITY,
) = range(23)

# the micro-state: z, a_c (2), f/(kn r), a_n (2), a_t (2), gained z and a_c (3), lost z and a_c (3), z and a_c (3) of
# the initial packing, X_0 and X_1 (3), S_i, the largest |s|, the hardening strain, gamma_p, plastic volumetric
# strain and dissipation, what slip classes hold (8). A law carries as columns what its effects need.
M_Z, M_A1, M_A2, M_F, M_N1, M_N2, M_T1, M_T2, M_GAINED = range(9)
M_LOST, M_Z_REF, M_A1_REF, M_A2_REF, M_SHIFT, M_SPREAD, M_LARGEST_S = 11, 14, 15, 16, 17, 20, 21
M_KAPPA, M_GAMMA, M_HELD, MICRO = 22, 23, 26, 34

PRESSURE_FLOOR = 1e-18
"""Smallest p/kn at which grains are taken to carry stress."""

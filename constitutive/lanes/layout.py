"""Workspace of the compiled update: points side by side in lanes, so that the compiler can use vector instructions.

A workspace is one float64 array. Row R of it holds one quantity of `LANES` points, and a row is named by its *start*:
``w[R + lane]``. All starts are compile-time constants of one base pointer; that is what lets the compiler prove that
rows do not overlap. Every loop over lanes runs over all of them, whether or not a lane holds a point just now, so a
point's result does not depend on its neighbours.

Compression is positive in p, s, d and all harmonics inside; stress and strain rows are tension positive.
"""

from itertools import count
from typing import Any

LANES = 16
"""A multiple of every vector width; small enough that a workspace stays in the first-level cache."""

_next = count()


def _rows(number: int) -> int:
    """Start of that many fresh consecutive rows."""
    first = next(_next)
    for _ in range(number - 1):
        next(_next)
    return first * LANES


UNKNOWNS = 6
"""Stress xx, yy, xy; coordination number; fabric anisotropy 1, 2."""
COLUMNS = 3
"""Strain components by which is differentiated."""
SLOPES = UNKNOWNS * COLUMNS
"""Derivatives of the unknowns, column by column."""
EXTRAS = 9
"""z, a_c gained (3) and lost (3), and strain (3): integrated along, nothing depends on them."""
ADVANCED = UNKNOWNS + SLOPES
"""Rows that a substep advances together: the unknowns, then their derivatives."""
RATES = ADVANCED + EXTRAS
STAGES = 7
"""Most stages of an explicit Runge-Kutta pair; an implicit one has at most five."""

L = LANES

# the point in a lane
Y = _rows(UNKNOWNS)
TY = _rows(SLOPES)
SUMS = _rows(EXTRAS)
GIVEN = _rows(3)
START_P, START_S1, START_S2, START_N1, START_N2 = (_rows(1) for _ in range(5))
REFERENCE_Z, REFERENCE_A1, REFERENCE_A2 = (_rows(1) for _ in range(3))
MEASURE, ACCEPT, OUTCOME, WORST = (_rows(1) for _ in range(4))
STEP = _rows(UNKNOWNS + UNKNOWNS * COLUMNS)
"""The substep, repeated for all advanced rows."""
ERROR = _rows(UNKNOWNS)

# parameters of the lane's material
P_ZERO, HALF_GAP, NEIGHBOURS, C_N, FORCE_SCALE, FLOOR = (_rows(1) for _ in range(6))
BULK, SHEAR, SHEAR_OFFSET, COUPLING = (_rows(1) for _ in range(4))
"""K = bulk z, G = shear (z - offset), B = coupling z."""

# one stage: unknowns there and their derivatives; rates of both, and of the extras
TRIAL = _rows(UNKNOWNS)
TRIAL_TY = _rows(SLOPES)
TRIAL_Z, TRIAL_A1, TRIAL_A2 = TRIAL + 3 * L, TRIAL + 4 * L, TRIAL + 5 * L
RATE = _rows(UNKNOWNS)
SLOPE = _rows(SLOPES)
GAINED, LOST, STRAIN = (_rows(3) for _ in range(3))

# intermediate quantities of a stage
INVERSE_P, S1, S2, D, DS1, DS2, N1, N2, LIMIT, FORCE = (_rows(1) for _ in range(10))
STIFF_K, STIFF_G, STIFF_B, STIFF_A1, STIFF_A2 = (_rows(1) for _ in range(5))
V1, V2, X1, X2, GAIN_FACTOR, SHARE, SOLVED = (_rows(1) for _ in range(7))
COS, SIN, F_V1, F_V2, F_A1, F_A2, F_N = (_rows(1) for _ in range(7))
I11, I12, I21, I22 = (_rows(1) for _ in range(4))

# the distribution of weak-contact forces: the initial packing, X_0 at the start, the largest |s| so far; S_i at the end
# of an increment, when its row holds z; a_n of the stage, derivatives of X_1 and a_n
ORIGIN_Z, ORIGIN_A1, ORIGIN_A2, START_SHIFT, LARGEST_S = (_rows(1) for _ in range(5))
SLOT = _rows(1)
CARRIED_N = _rows(2)
SHIFT_TY = _rows(2 * COLUMNS)
NORMAL_TY = _rows(2 * COLUMNS)
SLOT_SCALE = _rows(1)
"""By what the error of the fourth unknown is measured: z, or 1 for S_i."""
COLUMN_TY, COLUMN_SLOPE = _rows(UNKNOWNS), _rows(UNKNOWNS)
"""One column of the derivatives, brought to a place known to the compiler."""
ROW_VALUE, ROW_BY_V, ROW_BY_A, ROW_BY_N, ROW_JACOBIAN = _rows(2), _rows(6), _rows(4), _rows(2), _rows(9)
"""Loss and gain of one moment and their derivatives, likewise."""

# moments over the arc of loss
C = _rows(4)
K = _rows(3)
P1 = _rows(4)
S1M = _rows(3)
P2 = _rows(5)
S2M = _rows(4)
ARC_C1, ARC_S1, ARC_C2, ARC_S2 = (_rows(1) for _ in range(4))
SERIES_BEFORE, SERIES_NOW, SERIES_POWER1, SERIES_POWER2, SERIES_FACTOR = (_rows(1) for _ in range(5))
SERIES_SUM = _rows(4)

# loss and gain: values (3), derivative by d, w (3, 3), by a_c (3, 2), by a_n (3, 2); loss first
VALUE = _rows(6)
BY_V = _rows(18)
BY_A = _rows(12)
BY_N = _rows(6)
# scatter of the change of force, derivatives by it: of loss and gain, and of the rates of z, a_c
SIGMA = _rows(1)
BY_SIGMA = _rows(6)
SIGMA_JACOBIAN = _rows(3)

# net rates of z, a_c by nine inputs
INPUTS = 9
IN_D, IN_S1, IN_S2, IN_Z, IN_A1, IN_A2, IN_N1, IN_N2, IN_F = range(INPUTS)
JACOBIAN = _rows(3 * INPUTS)

# stages kept by the integrator
STAGE = _rows(RATES * STAGES)
OLD_ITERATE, OLD_RESIDUAL = STAGE + 5 * RATES * L, STAGE + 6 * RATES * L
"""The last pass of an implicit stage, in the places of the stages that implicit schemes do not have."""
EVALUATIONS = _rows(1)
"""Evaluations of the rates in the substep under way."""
SOLVING, SETTLED, KEPT_X1, KEPT_X2 = (_rows(1) for _ in range(4))
KEPT_STIFFNESS = _rows(5)
WEIGHT = _rows(UNKNOWNS)
BLOCK_RESIDUAL, BLOCK_CHANGE, BLOCK_CROSS, BLOCK_SIZE = (_rows(1) for _ in range(4))

# sliding: the hardening strain and its derivatives at the start of the substep, at a stage and as rates; plastic
# volumetric strain and dissipation are integrated along. Rows of their own: a law without sliding does not touch them.
PLASTIC_ADVANCED = 1 + COLUMNS
PLASTIC_RATES = PLASTIC_ADVANCED + 2
KAPPA = _rows(PLASTIC_ADVANCED)
PLASTIC_SUMS = _rows(2)
TRIAL_KAPPA = _rows(PLASTIC_ADVANCED)
KAPPA_RATE = _rows(PLASTIC_ADVANCED)
VOLUME_RATE, DISSIPATION_RATE = _rows(1), _rows(1)
PLASTIC_STAGE = _rows(PLASTIC_RATES * STAGES)
M_PEAK, M_FIRST, GAMMA_R, EXPONENT, DILATANCY, M_CV, COHESION = (_rows(1) for _ in range(7))
ELASTIC_P, ELASTIC_T1, ELASTIC_T2, FLOW_1, FLOW_2, AT_REST = (_rows(1) for _ in range(6))
"""Rates of p and of the deviator without plastic strain; direction of the flow; whether stress starts from q = 0."""
ON_CONE, SLIDES, DECIDES, REVERSED, CROSSED = (_rows(1) for _ in range(5))
"""1 or 0: the substep starts on the cone; plastic strain in this substep; its first stage is being computed; the
multiplier has changed sign in it; it ended at the cone."""
LOW, LOW_F, HIGH, HIGH_F, SIDE, WHOLE_STEP, TRIES = (_rows(1) for _ in range(7))
"""Bracket of the pseudo-time at which the cone is reached."""
STRAIN_CORRECTION = _rows(3)
TIME_CHANGE, STEP_CHANGE = _rows(COLUMNS), _rows(COLUMNS)
"""Derivatives by the strain increment of the pseudo-time at which the substep starts, and of its length."""
SEED, PLANNED_STEP = _rows(1), _rows(1)
"""A change of the step by which Y' is found; the length of the substep before it was shortened."""
KEPT_COLUMN = _rows(UNKNOWNS)

SIZE = next(_next) * LANES
"""Length of a workspace."""

# entries of the integer options given to the kernels
LOSS, GAIN, ROTATION, FEEDBACK, TANGENTIAL, DENSITY, CLOSED_FORM, FORCE_CHANGE, ISOSTATIC, SLIDING = range(10)
HARMONIC, MAXIMUM_ENTROPY = 0, 1
MEAN_FIELD, SHIFTED_DISTRIBUTION, FLUCTUATING = 0, 1, 2
NEGLECTED, SELF_CONSISTENT, CLOSURE_FRICTIONAL = 0, 1, 2

# entries of the closure numbers
CHI, CHI_P, C_E, C_P, C_I, C_T, SLIP, DELAY, C_W = range(9)

KERNEL_OPTIONS: dict[str, Any] = {"fastmath": {"contract"}}
"""Multiply-add in one rounding is the same for every lane; nothing else of IEEE arithmetic is given up."""

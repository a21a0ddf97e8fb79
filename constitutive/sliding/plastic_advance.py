"""The hardening strain kappa and its derivatives along the stages of a Runge-Kutta substep; their error; acceptance.

They have rows of their own: a law without sliding touches none of them.
"""

from granfabric.constitutive.compilation import compiled
from granfabric.constitutive.lanes.layout import (
    ACCEPT,
    COLUMNS,
    CROSSED,
    DECIDES,
    GAMMA_R,
    KAPPA,
    KAPPA_RATE,
    LANES,
    MEASURE,
    PLANNED_STEP,
    PLASTIC_ADVANCED,
    PLASTIC_RATES,
    PLASTIC_STAGE,
    PLASTIC_SUMS,
    RATES,
    REVERSED,
    SEED,
    SETTLED,
    SLIDES,
    SOLVING,
    STAGE,
    STEP,
    STEP_CHANGE,
    STRAIN_CORRECTION,
    SUMS,
    TIME_CHANGE,
    TRIAL_KAPPA,
    TRIAL_TY,
    UNKNOWNS,
    L,
)


@compiled()
def begin_sliding(w):
    """Before the first stage of a substep."""
    for lane in range(LANES):
        w[DECIDES + lane] = 1.0
        w[REVERSED + lane] = 0.0
        for row in range(3):
            w[STRAIN_CORRECTION + row * L + lane] = 0.0
        # a substep that begins later ends when planned; one that was shortened is a share of the planned one
        planned = w[PLANNED_STEP + lane]
        share = w[STEP + lane] / planned if planned > 0.0 else 0.0
        for column in range(COLUMNS):
            w[STEP_CHANGE + column * L + lane] = -share * w[TIME_CHANGE + column * L + lane]
        if w[CROSSED + lane] > 0.0:
            w[STEP_CHANGE + lane] += w[SEED + lane]


@compiled()
def advance_plastic(w, stages, coefficients, derivatives):
    """TRIAL_KAPPA = KAPPA + h sum c_m rates, over the first `stages` stages; with derivatives, of them too."""
    rows = PLASTIC_ADVANCED if derivatives else 1
    for row in range(rows):
        for lane in range(LANES):
            total = 0.0
            for m in range(stages):
                if coefficients[m] != 0.0:
                    total += coefficients[m] * w[PLASTIC_STAGE + (m * PLASTIC_RATES + row) * L + lane]
            w[TRIAL_KAPPA + row * L + lane] = w[KAPPA + row * L + lane] + w[STEP + lane] * total


@compiled()
def advance_length(w, stages, coefficients):
    """Add what a change of the substep's length does to the derivatives: rows TRIAL_TY and those after TRIAL_KAPPA."""
    for column in range(COLUMNS):
        for lane in range(LANES):
            change = w[STEP_CHANGE + column * L + lane]
            if change == 0.0:
                continue
            for m in range(stages):
                weight = change * coefficients[m]
                if weight != 0.0:
                    for i in range(UNKNOWNS):
                        rate = w[STAGE + (m * RATES + i) * L + lane]
                        w[TRIAL_TY + (column * UNKNOWNS + i) * L + lane] += weight * rate
                    rate = w[PLASTIC_STAGE + m * PLASTIC_RATES * L + lane]
                    w[TRIAL_KAPPA + (1 + column) * L + lane] += weight * rate


@compiled()
def keep_plastic(w, stage):
    """Keep the rates of a stage; what comes after the first does not decide any more."""
    for row in range(PLASTIC_RATES):
        for lane in range(LANES):
            w[PLASTIC_STAGE + (stage * PLASTIC_RATES + row) * L + lane] = w[KAPPA_RATE + row * L + lane]
    for lane in range(LANES):
        w[DECIDES + lane] = 0.0


@compiled()
def begin_plastic_stage(w, stage):
    """Start the iteration of an implicit stage from the rates of the one before."""
    for row in range(PLASTIC_RATES):
        for lane in range(LANES):
            at = PLASTIC_STAGE + (stage * PLASTIC_RATES + row) * L + lane
            w[at] = w[at - PLASTIC_RATES * L]


@compiled()
def improve_plastic_stage(w, stage, diagonal, tolerance, rounding, derivatives):
    """One pass over the rates of kappa of an implicit stage; takes SETTLED back in lanes where they still change.

    As for the other unknowns: kappa is measured by kappa + gamma_r, its derivatives by themselves, `rounding` at least.
    """
    for lane in range(LANES):
        if w[SOLVING + lane] == 0.0:
            continue
        kept = PLASTIC_STAGE + stage * PLASTIC_RATES * L + lane
        size = abs(w[KAPPA_RATE + lane])
        limit = tolerance * ((w[GAMMA_R + lane] + w[KAPPA + lane]) / (diagonal * w[STEP + lane]) + size)
        settled = abs(w[KAPPA_RATE + lane] - w[kept]) <= limit
        if derivatives:
            square, change = 0.0, 0.0
            for column in range(1, PLASTIC_ADVANCED):
                new = w[KAPPA_RATE + column * L + lane]
                square += new * new
                change += (new - w[kept + column * L]) ** 2
            settled = settled and change <= max(tolerance, rounding) ** 2 * square
        for row in range(PLASTIC_RATES):
            w[kept + row * L] = w[KAPPA_RATE + row * L + lane]
        if not settled:
            w[SETTLED + lane] = 0.0


@compiled()
def estimate_plastic_error(w, error, tolerance):
    """Raise MEASURE to the error of kappa relative to kappa + gamma_r, in units of the tolerance."""
    for lane in range(LANES):
        total = 0.0
        for m in range(error.shape[0]):
            total += error[m] * w[PLASTIC_STAGE + m * PLASTIC_RATES * L + lane]
        scale = tolerance * (w[GAMMA_R + lane] + w[KAPPA + lane])
        # lanes that have not held a point yet have no scale
        measure = abs(w[STEP + lane] * total) / scale if scale > 0.0 else 0.0
        w[MEASURE + lane] = w[MEASURE + lane] if measure <= w[MEASURE + lane] else measure


@compiled()
def accept_plastic(w, b):
    """Move the accepted lanes to the end of their substep. What is dissipated in one is never negative."""
    for lane in range(LANES):
        if w[ACCEPT + lane] > 0.0 and w[SLIDES + lane] > 0.0:
            for row in range(PLASTIC_ADVANCED):
                w[KAPPA + row * L + lane] = w[TRIAL_KAPPA + row * L + lane]
            volume, work = 0.0, 0.0
            for m in range(b.shape[0]):
                rates = PLASTIC_STAGE + (m * PLASTIC_RATES + PLASTIC_ADVANCED) * L + lane
                volume += b[m] * w[rates]
                work += b[m] * w[rates + L]
            w[PLASTIC_SUMS + lane] += w[STEP + lane] * volume
            w[PLASTIC_SUMS + L + lane] += w[STEP + lane] * max(work, 0.0)
            for row in range(3):
                w[SUMS + (6 + row) * L + lane] += w[STRAIN_CORRECTION + row * L + lane]

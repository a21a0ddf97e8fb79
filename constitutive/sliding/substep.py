"""The hardening strain kappa and its derivatives along the stages of a Runge-Kutta substep; their error; acceptance."""

from granfabric.constitutive.compilation import formula

_UNKNOWNS = 6


@formula
def begin_sliding(slide, step):
    """Before the first stage of a substep."""
    slide["decides"], slide["turned_back"] = True, False
    # a substep that begins later ends when planned; one that was shortened is a share of the planned one
    share = step / slide["planned_step"] if slide["planned_step"] > 0.0 else 0.0
    for column in range(3):
        slide["correction"][column] = 0.0
        slide["step_change"][column] = -share * slide["time_change"][column]
    if slide["crossed"]:
        slide["step_change"][0] += slide["seed"]


@formula
def advance_kappa(slide, step, stages, coefficients):
    """kappa at a stage: that of the start and h sum c_m rates over the first `stages` stages; and its derivatives."""
    total = 0.0
    for m in range(stages):
        total += coefficients[m] * slide["kappa_rate"][m]
    slide["trial_kappa"] = slide["kappa"] + step * total
    for column in range(3):
        slope = 0.0
        for m in range(stages):
            slope += coefficients[m] * slide["kappa_slope"][m, column]
        slide["trial_kappa_by"][column] = (
            slide["kappa_by"][column] + step * slope + slide["step_change"][column] * total
        )


@formula
def advance_length(trial, k, slide, stages, coefficients, rates):
    """Add what a change of the substep's length does to the derivatives in `trial`; `rates` is the rows of a stage."""
    for column in range(3):
        change = slide["step_change"][column]
        if change != 0.0:
            for m in range(stages):
                if coefficients[m] != 0.0:
                    for i in range(_UNKNOWNS):
                        row = _UNKNOWNS * (1 + column) + i
                        trial[row, 0] += change * coefficients[m] * k[m * rates + i, 0]


@formula
def kappa_error(slide, step, error):
    """Error of kappa relative to kappa + gamma_r."""
    total = 0.0
    for m in range(error.shape[0]):
        total += error[m] * slide["kappa_rate"][m]
    return abs(step * total) / (slide["reference"] + slide["kappa"])


@formula
def accept_sliding(slide, step, b):
    """Move to the end of the substep. What is dissipated in one is never negative."""
    if slide["slides"]:
        slide["kappa"] = slide["trial_kappa"]
        volume, work = 0.0, 0.0
        for m in range(b.shape[0]):
            volume += b[m] * slide["volume_rate"][m]
            work += b[m] * slide["work_rate"][m]
        slide["volume"] += step * volume
        slide["work"] += step * max(work, 0.0)
        for column in range(3):
            slide["kappa_by"][column] = slide["trial_kappa_by"][column]


@formula
def begin_implicit(slide, number):
    """Start the iteration of an implicit stage from the rates of the one before."""
    slide["kappa_rate"][number] = slide["kappa_rate"][number - 1]
    slide["volume_rate"][number] = slide["volume_rate"][number - 1]
    slide["work_rate"][number] = slide["work_rate"][number - 1]
    for column in range(3):
        slide["kappa_slope"][number, column] = slide["kappa_slope"][number - 1, column]


@formula
def keep_settled(slide, number, diagonal, step, tolerance, rounding, derivatives):
    """Whether the rates of kappa of an implicit stage, just evaluated in the stage after the last, have settled.

    They take their place as those of stage `number`. kappa is measured by kappa + gamma_r, its derivatives by
    themselves, `rounding` at least.
    """
    last = slide["kappa_rate"].shape[0] - 1
    new = slide["kappa_rate"][last]
    limit = tolerance * ((slide["reference"] + slide["kappa"]) / (diagonal * step) + abs(new))
    settled = abs(new - slide["kappa_rate"][number]) <= limit
    if derivatives:
        square, change = 0.0, 0.0
        for column in range(3):
            slope = slide["kappa_slope"][last, column]
            square += slope * slope
            change += (slope - slide["kappa_slope"][number, column]) ** 2
        settled = settled and change <= max(tolerance, rounding) ** 2 * square
    slide["kappa_rate"][number] = new
    slide["volume_rate"][number] = slide["volume_rate"][last]
    slide["work_rate"][number] = slide["work_rate"][last]
    for column in range(3):
        slide["kappa_slope"][number, column] = slide["kappa_slope"][last, column]
    return settled

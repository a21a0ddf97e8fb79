"""The hardening strain kappa and its derivatives along the stages of a Runge-Kutta substep; their error; acceptance."""

from granfabric.constitutive.compilation import formula
from granfabric.constitutive.lanes.eight import choose, read, somewhere, write
from granfabric.constitutive.lanes.elementary import larger

_UNKNOWNS = 6


@formula
def begin_sliding(slide, step, lanes):
    """Before the first stage of a substep."""
    zero = 0.0 * step
    write(slide["turned_back"], 0, zero, lanes)
    # a substep that begins later ends when planned; one that was shortened is a fraction of the planned one
    planned = read(slide["planned_step"], 0, lanes)
    share = choose(planned > 0.0, step / choose(planned > 0.0, planned, 1.0), zero)
    for column in range(3):
        write(slide["correction"], column, zero, lanes)
        write(slide["step_change"], column, -share * read(slide["time_change"], column, lanes), lanes)
    seed = choose(read(slide["crossed"], 0, lanes) > 0.5, read(slide["seed"], 0, lanes), zero)
    write(slide["step_change"], 0, read(slide["step_change"], 0, lanes) + seed, lanes)


@formula
def advance_kappa(slide, step, stages, coefficients, lanes):
    """kappa at a stage: that of the start and h sum c_m rates over the first `stages` stages; and its derivatives."""
    total = 0.0 * step
    for m in range(stages):
        total += coefficients[m] * read(slide["kappa_rate"], m, lanes)
    write(slide["trial_kappa"], 0, read(slide["kappa"], 0, lanes) + step * total, lanes)
    for column in range(3):
        slope = 0.0 * step
        for m in range(stages):
            if coefficients[m] != 0.0:
                slope += coefficients[m] * read(slide["kappa_slope"], 3 * m + column, lanes)
        slope = step * slope + read(slide["step_change"], column, lanes) * total
        write(slide["trial_kappa_by"], column, read(slide["kappa_by"], column, lanes) + slope, lanes)


@formula
def advance_length(trial, k, slide, stages, coefficients, rates, lanes):
    """Add what a change of the substep's length does to the derivatives in `trial`; `rates` is the rows of a stage."""
    for column in range(3):
        change = read(slide["step_change"], column, lanes)
        if somewhere(change != 0.0):
            for m in range(stages):
                if coefficients[m] != 0.0:
                    for i in range(_UNKNOWNS):
                        row = _UNKNOWNS * (1 + column) + i
                        more = change * coefficients[m] * read(k, m * rates + i, lanes)
                        write(trial, row, read(trial, row, lanes) + choose(change != 0.0, more, 0.0), lanes)


@formula
def kappa_error(slide, step, error, lanes):
    """Error of kappa relative to kappa + gamma_r."""
    total = 0.0 * step
    for m in range(error.shape[0]):
        total += error[m] * read(slide["kappa_rate"], m, lanes)
    scale = read(slide["reference"], 0, lanes) + read(slide["kappa"], 0, lanes)
    # lanes that have not held a point yet have no scale
    return choose(scale > 0.0, abs(step * total) / choose(scale > 0.0, scale, 1.0), 0.0)


@formula
def accept_sliding(slide, accepted, step, b, sums, first_strain, lanes):
    """Move to the ends of the substeps. What is dissipated in one is never negative."""
    moved = accepted & (read(slide["slides"], 0, lanes) > 0.5)
    if not somewhere(moved):
        return
    volume, work = 0.0 * step, 0.0 * step
    for m in range(b.shape[0]):
        volume += b[m] * read(slide["volume_rate"], m, lanes)
        work += b[m] * read(slide["work_rate"], m, lanes)
    old = read(slide["volume"], 0, lanes)
    write(slide["volume"], 0, choose(moved, old + step * volume, old), lanes)
    old = read(slide["work"], 0, lanes)
    write(slide["work"], 0, choose(moved, old + step * larger(work, 0.0), old), lanes)
    kappa = choose(moved, read(slide["trial_kappa"], 0, lanes), read(slide["kappa"], 0, lanes))
    write(slide["kappa"], 0, kappa, lanes)
    for i in range(3):
        slope = choose(moved, read(slide["trial_kappa_by"], i, lanes), read(slide["kappa_by"], i, lanes))
        write(slide["kappa_by"], i, slope, lanes)
        row = first_strain + i
        more = choose(moved, read(slide["correction"], i, lanes), 0.0)
        write(sums, row, read(sums, row, lanes) + more, lanes)


@formula
def begin_implicit(slide, number, lanes):
    """Start the iteration of an implicit stage from the rates of the one before."""
    write(slide["kappa_rate"], number, read(slide["kappa_rate"], number - 1, lanes), lanes)
    write(slide["volume_rate"], number, read(slide["volume_rate"], number - 1, lanes), lanes)
    write(slide["work_rate"], number, read(slide["work_rate"], number - 1, lanes), lanes)
    for column in range(3):
        row = 3 * number + column
        write(slide["kappa_slope"], row, read(slide["kappa_slope"], row - 3, lanes), lanes)


@formula
def keep_settled(slide, number, new, solving, diagonal, step, tolerance, rounding, derivatives, lanes):
    """Whether the rates of kappa of an implicit stage, just evaluated as those of stage `new`, have settled.

    Where the iteration goes on they take their place as those of stage `number`. kappa is measured by kappa + gamma_r,
    its derivatives by themselves, `rounding` at least.
    """
    rate, old = read(slide["kappa_rate"], new, lanes), read(slide["kappa_rate"], number, lanes)
    scale = read(slide["reference"], 0, lanes) + read(slide["kappa"], 0, lanes)
    settled = abs(rate - old) <= tolerance * (scale / (diagonal * step) + abs(rate))
    square, change = 0.0 * step, 0.0 * step
    for column in range(3):
        row = 3 * number + column
        slope, before = read(slide["kappa_slope"], 3 * new + column, lanes), read(slide["kappa_slope"], row, lanes)
        square += slope * slope
        change += (slope - before) * (slope - before)
        write(slide["kappa_slope"], row, choose(solving, slope, before), lanes)
    if derivatives:
        limit = max(tolerance, rounding)
        settled = settled & (change <= limit * limit * square)
    write(slide["kappa_rate"], number, choose(solving, rate, old), lanes)
    volume, work = read(slide["volume_rate"], number, lanes), read(slide["work_rate"], number, lanes)
    write(slide["volume_rate"], number, choose(solving, read(slide["volume_rate"], new, lanes), volume), lanes)
    write(slide["work_rate"], number, choose(solving, read(slide["work_rate"], new, lanes), work), lanes)
    return settled

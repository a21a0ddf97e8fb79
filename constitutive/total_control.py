"""Increments of total stress in some components and of strain in the others, for a law that is driven by strain.

Which effective stress belongs to a prescribed total stress depends on the volumetric strain that it will make. So the
strain is found by Newton's method with the exact tangent of the update, each point by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .arrays import UpdateArrays
from .contract import Array, Status, UpdateReport

MOST_ITERATIONS = 40
TOLERANCE = 1e-12
"""Difference of the stress that counts as none, over the size of stress and its increment."""
ACCEPTED = 1e-8
"""The same, where it does not fall any more: the law's own substeps change from one iteration to the next."""
SMALLEST_CUT = 2.0**-10


def follow_total(update: Callable[..., UpdateReport], arrays: UpdateArrays) -> UpdateReport:
    """Find the strain increment and write the end of the step.

    Parameters
    ----------
    update : callable
        `contract.Law.update` in terms of total stress.
    arrays : UpdateArrays
        Checked, with `control` and `strain_increment`; `increment` holds stress [Pa] where `control` is 1.

    Returns
    -------
    UpdateReport
        Substeps of the last evaluation. A point that finds no strain has the status NOT_CONVERGED and its start values.
    """
    assert arrays.control is not None and arrays.strain_increment is not None
    stressed = arrays.control == 1
    target = arrays.stress_start + arrays.increment
    sizes = [arrays.stress_start, np.where(stressed, arrays.increment, 0.0), arrays.state_start[:, -1:]]
    scale = np.max([np.abs(part).max(axis=1) for part in sizes], axis=0, initial=0.0)
    tangent = np.zeros((len(stressed), 3, 3))

    def evaluate(trial: Array) -> tuple[UpdateReport, Array, Array]:
        report = update(
            trial,
            arrays.stress_start,
            arrays.state_start,
            arrays.stress_end,
            arrays.state_end,
            tangent,
            "propagated",
            arrays.rows,
        )
        missing = np.where(stressed, target - arrays.stress_end, 0.0)
        size = np.where(report.status > Status.LIMITED, np.inf, np.abs(missing).max(axis=1))
        return report, missing, size

    # prescribed strains act from the outset; only the others are looked for
    strain = np.where(stressed, 0.0, arrays.increment)
    report, missing, size = evaluate(strain)
    best, accepted, latest = size.copy(), strain, strain
    correction = np.zeros_like(strain)
    better, cut = np.ones(len(size), dtype=bool), np.ones(len(size))
    for _ in range(MOST_ITERATIONS):
        done = (best <= TOLERANCE * scale) | (~better & (best <= ACCEPTED * scale)) | ~np.isfinite(best)
        if (done | (cut < SMALLEST_CUT)).all():
            break
        moves = better & ~done
        correction[moves] = _solve(tangent[moves], missing[moves], stressed[moves])
        # from a worse place half the way back, else on along Newton's correction
        length = np.where(done, 0.0, cut)
        latest = accepted + length[:, None] * correction
        report, missing, size = evaluate(latest)
        better = size < best
        accepted = np.where(better[:, None], latest, accepted)
        best = np.where(better, size, best)
        cut = np.where(better, 1.0, 0.5 * cut)
    if not np.array_equal(latest, accepted):
        report, missing, size = evaluate(accepted)
    status = np.array(report.status, dtype=np.int8)
    status[(status <= Status.LIMITED) & ~(best <= ACCEPTED * scale)] = Status.NOT_CONVERGED
    failed = status > Status.LIMITED
    arrays.stress_end[failed] = arrays.stress_start[failed]
    arrays.state_end[failed] = arrays.state_start[failed]
    arrays.strain_increment[:] = np.where(failed[:, None], 0.0, accepted)
    return replace(report, status=status, proposed_step_factor=0.5 if failed.any() else report.proposed_step_factor)


def _solve(tangent: Array, missing: Array, stressed: Array) -> Array:
    """Changes of the strains that are not prescribed, for missing stress; zero where there is no answer."""
    matrix = np.where(stressed[:, :, None], tangent, np.eye(3))
    made = np.zeros_like(missing)
    for point in range(len(missing)):
        try:
            found = np.linalg.solve(matrix[point], missing[point])
        except np.linalg.LinAlgError:
            continue
        if np.isfinite(found).all():
            made[point] = np.where(stressed[point], found, 0.0)
    return made

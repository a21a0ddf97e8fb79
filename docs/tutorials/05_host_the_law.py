"""
5. Host the law in a code of your own
=====================================

The law needs nothing of the finite element code that comes with it. First it advances 100,000 points in one call, then
it goes into a small finite element loop written from scratch.
"""

import time

import matplotlib.pyplot as plt
import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

import granfabric as gf

material = gf.Material(
    coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9, bulk_reduction=0.88, shear_reduction=0.69
)
law = gf.ContactLaw([material])

# %%
# Many points at once
# -------------------
# All arrays are C-contiguous float64 with one row a point: strain and stress (xx, yy, xy; engineering shear strain;
# tension positive), state as wide as the description says. The host owns them, start and end of the step apart.

points = 100_000
rng = np.random.default_rng(1)
stress = np.tile([-100e3, -100e3, 0.0], (points, 1))
state = law.initial_state(stress)
strain_increment = 1e-6 * rng.standard_normal((points, 3))
stress_end, state_end = np.empty_like(stress), np.empty_like(state)
tangent = np.empty((points, 3, 3))

law.update(strain_increment[:1], stress[:1], state[:1], stress_end[:1], state_end[:1], tangent[:1])  # compiles
since = time.perf_counter()
report = law.update(strain_increment, stress, state, stress_end, state_end, tangent)
seconds = time.perf_counter() - since
print(f"{points} points in {seconds:.2f} s; failed: {report.failed}, substeps at most: {report.substeps.max()}")

# %%
# State columns are found by name.

z = state_end[:, law.description.columns("coordination")].ravel()
print(f"coordination number: mean {z.mean():.5f}, smallest {z.min():.5f}")
for variable in law.description.state:
    print(f"  {variable.name:28} {variable.components} column(s) [{variable.unit}]  {variable.meaning}")

# %%
# A finite element loop
# ---------------------
# Bilinear squares with 2 x 2 integration points on a block of 0.1 m, fixed below, under a rough platen that goes down;
# its sides are held by constant forces that balance the initial stress. The loop is Newton's: update all
# points, assemble, solve, and accept the end arrays once the residual is small.

cells, size = 8, 0.1
h = size / cells
line = np.arange(cells + 1)
corner = (line[:-1, None] * (cells + 1) + line[None, :-1]).ravel()
elements = np.stack([corner, corner + 1, corner + cells + 2, corner + cells + 1], axis=1)
dofs = np.stack([2 * elements, 2 * elements + 1], axis=2).reshape(len(elements), 8)
total = 2 * (cells + 1) ** 2
y = np.repeat(line, cells + 1)

gauss = 0.5 + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / np.sqrt(12.0)
b = np.zeros((4, 3, 8))  # strain of a square from its corner displacements
for matrix, (s, t) in zip(b, gauss):
    gradient = np.array([[-(1 - t), -(1 - s)], [1 - t, -s], [t, s], [-t, 1 - s]]) / h
    matrix[0, 0::2], matrix[1, 1::2] = gradient[:, 0], gradient[:, 1]
    matrix[2, 0::2], matrix[2, 1::2] = gradient[:, 1], gradient[:, 0]
weight = h * h / 4.0


def nodal_forces(stress):
    """Internal forces of the stresses at the integration points, element by element."""
    local = weight * np.einsum("qij,eqi->ej", b, stress.reshape(-1, 4, 3))
    return np.bincount(dofs.ravel(), local.ravel(), minlength=total)


def stiffness(tangent):
    """Sparse matrix of the tangents at the integration points."""
    local = weight * np.einsum("qki,eqkl,qlj->eij", b, tangent.reshape(-1, 4, 3, 3), b)
    rows, columns = np.repeat(dofs, 8, axis=1).ravel(), np.tile(dofs, (1, 8)).ravel()
    return coo_matrix((local.ravel(), (rows, columns)), shape=(total, total)).tocsr()


points = 4 * len(elements)
stress = np.tile([-100e3, -100e3, 0.0], (points, 1))
state = law.initial_state(stress)
stress_end, state_end = np.empty_like(stress), np.empty_like(state)
tangent = np.empty((points, 3, 3))
reference = nodal_forces(stress)
bottom, top = np.flatnonzero(y == 0), np.flatnonzero(y == cells)
held = np.concatenate([2 * bottom, 2 * bottom + 1, 2 * top, 2 * top + 1])
free = np.setdiff1d(np.arange(total), held)
displacement = np.zeros(total)

for step in range(1, 6):
    trial = displacement.copy()
    trial[2 * top + 1] = -1e-6 * step
    norms = []
    for _ in range(10):
        increment = np.einsum("qij,ej->eqi", b, (trial - displacement)[dofs]).reshape(-1, 3)
        report = law.update(np.ascontiguousarray(increment), stress, state, stress_end, state_end, tangent)
        if report.failed:
            raise SystemExit(report.message)
        force = nodal_forces(stress_end)
        residual = (force - reference)[free]
        norms.append(np.linalg.norm(residual) / np.linalg.norm(force))
        if norms[-1] < 1e-10:
            break
        trial[free] -= spsolve(stiffness(tangent)[free][:, free], residual)
    displacement = trial
    stress, stress_end = stress_end, stress  # commit: what was the end is the start now
    state, state_end = state_end, state
    axial = -force[2 * top + 1].sum() / size
    z = state[:, law.description.columns("coordination")]
    print(
        f"step {step}: axial stress {axial / 1e3:7.2f} kPa, z from {z.min():.4f} to {z.max():.4f}; "
        f"residuals {', '.join(f'{norm:.0e}' for norm in norms)}"
    )

# %%
# Contacts are lost most away from the platens, which confine the block at its ends.

figure, axes = plt.subplots(figsize=(4.6, 3.8), layout="constrained")
squares = z.reshape(-1, 4).mean(axis=1).reshape(cells, cells)
picture = axes.imshow(squares, origin="lower", extent=(0.0, size, 0.0, size))
figure.colorbar(picture, ax=axes, label="coordination number $z$ [-]")
axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
plt.show()

# %%
# A failed point would end the step: the host then keeps its start arrays, cuts the increment and tries again.
# ``report.proposed_step_factor`` proposes by how much. ``report.message`` names the point and the reason.

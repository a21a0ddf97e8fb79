"""
4. Write a law of your own behind the contract
==============================================

The host knows a law by five things: a description, the initial state, one update of all points, its tangent, and a
report. Any object that has them can be put into a boundary-value problem. Here it is a hypoelastic law whose bulk and
shear moduli grow with the pressure, in plain NumPy.
"""

import matplotlib.pyplot as plt
import numpy as np

import granfabric as gf
from granfabric.constitutive.contract import Law, LawDescription, Status, UpdateReport, Variable

# %%
# The law
# -------
# With p the mean pressure, compression positive, and Poisson's ratio kept constant:
#
# * bulk modulus ``K = K0 p/p0``, so that ``p`` grows exponentially with the volumetric strain;
# * shear modulus ``G = r K``, taken at the pressure half way through the increment.
#
# The law keeps one state variable, the accumulated shear strain, to show how state is declared. Start arrays are read
# only, end arrays are always written, and a point that fails keeps its start values: the host cuts the step then.


class PressureDependentElasticity:
    """Hypoelastic law with ``K = K0 p/p0``; tension positive, engineering shear strain."""

    def __init__(self, bulk_modulus, reference_pressure, ratio):
        self.slope = bulk_modulus / reference_pressure
        self.ratio = ratio

    @property
    def description(self):
        """Names, units and bounds: what writers and drivers read."""
        return LawDescription(
            name="pressure-dependent elasticity",
            state=(Variable("shear_strain", "accumulated eps_1 - eps_2", lower=0.0, default=0.0),),
            parameters=(
                Variable("bulk_modulus", "bulk modulus K0 at the reference pressure", "Pa", lower=0.0),
                Variable("reference_pressure", "p0", "Pa", lower=0.0),
                Variable("ratio", "G/K", lower=0.0),
            ),
        )

    def initial_state(self, stress, material_index=None):
        """One column, zero."""
        return np.zeros((len(stress), 1))

    def update(
        self,
        strain_increment,
        stress_start,
        state_start,
        stress_end,
        state_end,
        tangent=None,
        tangent_kind="propagated",
        material_index=None,
    ):
        """All points at once; the tangent is the derivative of exactly this update."""
        xx, yy, xy = strain_increment.T
        volumetric = xx + yy
        pressure = -0.5 * (stress_start[:, 0] + stress_start[:, 1])
        half = np.exp(-0.5 * self.slope * volumetric)
        shear = self.ratio * self.slope * pressure * half  # at the middle of the increment
        mean = -pressure * (half**2 - 1.0)
        good = np.isfinite(half) & (pressure > 0.0)

        stress_end[:] = stress_start
        state_end[:] = state_start
        stress_end[good, 0] += (mean + shear * (xx - yy))[good]
        stress_end[good, 1] += (mean - shear * (xx - yy))[good]
        stress_end[good, 2] += (shear * xy)[good]
        state_end[good, 0] += np.hypot(xx - yy, xy)[good]

        if tangent is not None:
            bulk = self.slope * pressure * half**2
            by_volume = -0.5 * self.slope * shear  # derivative of the shear modulus by the volumetric strain
            tangent[:] = 0.0
            tangent[:, 0, 0] = tangent[:, 1, 1] = bulk + shear
            tangent[:, 0, 1] = tangent[:, 1, 0] = bulk - shear
            tangent[:, 2, 2] = shear
            for column in (0, 1):
                tangent[:, 0, column] += by_volume * (xx - yy)
                tangent[:, 1, column] -= by_volume * (xx - yy)
                tangent[:, 2, column] += by_volume * xy

        status = np.where(good, Status.OK, Status.NO_PRESSURE).astype(np.int8)
        ones = np.ones(len(status), dtype=np.int32)
        return UpdateReport(status, ones, np.zeros_like(ones), 1.0 if good.all() else 0.5)


law = PressureDependentElasticity(bulk_modulus=100e6, reference_pressure=100e3, ratio=0.6)
print("obeys the contract:", isinstance(law, Law))

# %%
# Check the tangent first
# -----------------------
# A wrong tangent costs iterations or convergence, and is hard to find later. Central differences find it at once.

rng = np.random.default_rng(0)
start = np.array([[-100e3, -140e3, 20e3]])
increment = 1e-4 * rng.standard_normal((1, 3))
state = law.initial_state(start)


def stress_after(strain):
    """Stress at the end of an increment."""
    end, state_end = np.empty_like(start), np.empty_like(state)
    law.update(strain, start, state, end, state_end)
    return end


exact = np.empty((1, 3, 3))
law.update(increment, start, state, np.empty_like(start), np.empty_like(state), exact)
numeric = np.empty((3, 3))
for column in range(3):
    step = np.zeros((1, 3))
    step[0, column] = 1e-8
    numeric[:, column] = ((stress_after(increment + step) - stress_after(increment - step)) / 2e-8)[0]
error = np.abs(exact[0] - numeric).max() / np.abs(numeric).max()
print(f"tangent against differences: {error:.1e}")

# %%
# Put it into a boundary-value problem
# ------------------------------------
# A specimen between rough platens. Newton's iterations show by their residuals that the tangent is right.

space = gf.Space(gf.rectangle(0.05, 0.1, 6, 12), "P2")
confined = [gf.Pressure("left", 100e3), gf.Pressure("right", 100e3)]
stages = [
    gf.Stage("initial", [gf.Fixed("bottom"), gf.Fixed("top"), *confined]),
    gf.Stage("compression", [gf.Displacement("top", "y", -2e-5)], increments=4),
]
problem = gf.Problem(space, law, stages, initial_stress=(-100e3, -100e3, 0.0))

steps = []
summary = gf.solve(problem, on_step=steps.append)
print("finished:", summary.finished)
for step in steps:
    force = step.reactions["top"][1] / 0.05
    residuals = ", ".join(f"{residual:.0e}" for residual in step.residuals)
    print(f"{step.stage:12} step {step.step}: mean axial stress {force / 1e3:8.2f} kPa; residuals {residuals}")

# %%
# The accumulated shear strain, the state variable of the law, is concentrated at the corners of the platens.

last = steps[-1]
shear_strain = last.state[:, law.description.columns("shear_strain")].ravel()
figure, axes = plt.subplots(figsize=(4.0, 4.6), layout="constrained")
colours = axes.tricontourf(space.points[:, 0], space.points[:, 1], 1e6 * shear_strain, levels=12)
figure.colorbar(colours, ax=axes, label="accumulated shear strain [$10^{-6}$]")
axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]", aspect="equal")
plt.show()

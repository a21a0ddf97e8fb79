"""
1. A first point
================

One material point is compressed at constant mean pressure and unloaded again. The script shows how a law is put
together, how a stress path is written, and what the choice of the closure changes.
"""

import matplotlib.pyplot as plt
import numpy as np

import granfabric as gf

# %%
# The material
# ------------
# A packing of disks is described by its state before loading: coordination number *z*, solid fraction, stiffness of the
# contacts, and the density of weak normal forces ``P0``, which governs how many contacts open. Stiffnesses are in Pa,
# because the disks have unit thickness.
#
# ``bulk_reduction`` and ``shear_reduction`` say how much softer the packing is than the uniform-strain estimate.

material = gf.Material(
    coordination=4.06,
    solid_fraction=0.846,
    normal_stiffness=1e9,
    force_density_at_zero=0.5,
    bulk_reduction=0.88,
    shear_reduction=0.69,
)

# %%
# The path
# --------
# Stresses are tension positive, in the order xx, yy, xy. The vertical stress grows and the lateral stress falls by the
# same amount, so that the mean pressure stays at 100 kPa, until the stress ratio q/p is 0.3. A second leg unloads.

initial_stress = (-100e3, -100e3, 0.0)
legs = [
    gf.Leg(target=(-70e3, -130e3, 0.0), increments=30),
    gf.Leg(target=(-100e3, -100e3, 0.0), increments=30),
]

# %%
# Two closures
# ------------
# ``mean_field`` is the closure of the source: every contact of a direction feels the mean change of force of that
# direction. ``shifted_distribution`` follows the distribution of weak contact forces and lets contacts return.

closures = {
    "mean_field (the source)": gf.Closure(force_change="mean_field"),
    "shifted_distribution": gf.Closure(force_change="shifted_distribution"),
}
histories = {
    name: gf.drive(gf.ContactLaw([material], closure), initial_stress, legs) for name, closure in closures.items()
}

for name, history in histories.items():
    z = history.columns["coordination"]
    print(f"{name:24}  z at q/p = 0.3: {z[30]:.3f}   after unloading: {z[-1]:.3f}")

# %%
# Both lose contacts on loading. On unloading the mean field goes on losing them, because its rates have no memory; a
# packing of disks regains most of what it has lost, and so does the second closure.

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
for name, history in histories.items():
    ratio = history.columns["q"] / history.columns["p"]
    left.plot(ratio, history.columns["coordination"], label=name)
    right.plot(ratio, np.abs(history.columns["fabric_anisotropy"]), label=name)
left.set(xlabel="stress ratio $q/p$ [-]", ylabel="coordination number $z$ [-]")
right.set(xlabel="stress ratio $q/p$ [-]", ylabel="fabric anisotropy $|a_c|$ [-]")
right.legend(frameon=False)
plt.show()

# %%
# The same from the command line
# ------------------------------
# ``granfabric point p_constant`` runs the shipped scene of this path and writes ``history.csv`` and pictures;
# ``granfabric scenes --copy p_constant`` gives a scene file of your own to change.

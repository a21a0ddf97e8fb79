"""
2. Calibrate the law from a DEM
===============================

The inputs of the law are measured on a packing of disks and on small probes of it. The law then predicts a loading that
went into none of the measurements, and the same packing is loaded in the DEM for comparison.
"""

import matplotlib.pyplot as plt
import numpy as np

import granfabric as gf

# %%
# A packing
# ---------
# Disks in a periodic cell are compacted without friction; friction is switched on afterwards. The same seed gives the
# same packing. 800 disks are enough to see how it works; for numbers to rely on take several packings of thousands,
# because the standard deviation between packings falls with the square root of their number of disks.

packing = gf.make_packing(800, seed=3)
print(f"{packing.count} disks, solid fraction {packing.solid_fraction:.4f}")

# %%
# Inputs of the law
# -----------------
# The packing at rest gives the coordination number and the densities of weak forces and narrow gaps; elastic probes
# give the moduli; small loops give the slip at contacts. Nothing goes further than q/p = 0.05.
# An isotropic unloading tells how many contacts a falling pressure takes, and where the shear stiffness vanishes.

inputs = gf.measure_packing(packing)
for name, value in inputs.values.items():
    print(f"{name:30} {value:.4g} +- {inputs.errors[name]:.2g}  {'; '.join(inputs.doubts.get(name, []))}")

# %%
# ``granfabric dem SCENE`` does the same and writes the numbers to ``material.toml``, which scenes read with
# ``material_file``. Here they go straight into the law.

law = gf.ContactLaw([inputs.material], inputs.closure)

# %%
# Prediction and test
# -------------------
# Compression at constant mean pressure to q/p = 0.2, in the law and in the DEM. Pressures in the DEM follow from kn/p
# = 1e4, the default of a packing.

pressure = packing.normal_stiffness / 1e4
largest = 0.2
run = gf.DemRun(packing, gf.RunOptions((gf.Segment("biaxial", "constant_pressure", stress_ratio=largest),)))
run.execute()
disks = run.history()

target = (-pressure * (1.0 - largest), -pressure * (1.0 + largest), 0.0)
predicted = gf.drive(law, (-pressure, -pressure, 0.0), [gf.Leg(target=target, increments=20)]).columns

ratio_disks = disks["q"] / disks["p"]
ratio_law = predicted["q"] / predicted["p"]
for name in ("coordination", "fabric_anisotropy"):
    at_law = np.interp(ratio_disks, ratio_law, np.abs(predicted[name]))
    difference = np.max(np.abs(np.abs(disks[name]) - at_law))
    print(f"largest difference in {name}: {difference:.3f}")

# %%
# A packing as small as this has an error of several per cent of its own.

figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
for axes, name, label in (
    (left, "coordination", "coordination number $z$ [-]"),
    (right, "fabric_anisotropy", "fabric anisotropy $|a_c|$ [-]"),
):
    axes.plot(ratio_disks, np.abs(disks[name]), "o", color="0.2", markersize=3, label="DEM")
    axes.plot(ratio_law, np.abs(predicted[name]), label="law, inputs measured")
    axes.set(xlabel="stress ratio $q/p$ [-]", ylabel=label)
right.legend(frameon=False)
plt.show()

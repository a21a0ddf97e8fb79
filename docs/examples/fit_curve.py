from pathlib import Path

import granfabric as gf

curve = Path(__file__).with_name("measured_loading.csv")
known = {"material.solid_fraction": 0.8455, "material.normal_stiffness": 1e9}
found = gf.fit(curve, free="z, P0, c_t, slip, initial_fabric_xx", changes=known)

for name, value in found.values.items():
    print(f"{name:24} {value:8.4f} +- {found.errors[name]:.4f}")
for line in found.remarks:
    print(line)

rms = found.residuals.groupby("quantity")["residual"].apply(lambda residual: (residual**2).mean() ** 0.5)
print(rms.round(4).to_string())
Path("fitted.toml").write_text(found.text, encoding="utf-8")  # granfabric run ... --set material_file=fitted.toml

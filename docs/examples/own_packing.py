"""From a packing of another code to the inputs of the law, and back."""

import granfabric as gf

# what another code would have left: disks, and contacts with their forces
packing = gf.make_packing(400, 3, gf.PackingOptions(preparation_friction=0.1))
gf.save_packing("packing.data", packing)  # for LAMMPS; .dump and .csv as well
gf.save_packing("packing.csv", packing, contacts="contacts.csv")

# a table tells its cell and the contact law; of LAMMPS's data file stiffness and friction have to be given
sample = gf.load_packing("packing.csv", contacts="contacts.csv")
same = gf.load_packing("packing.data", normal_stiffness=1e9, stiffness_ratio=1.0, friction=0.5)
print("disks:", sample.count, same.count, "solid fraction:", round(sample.solid_fraction, 3))

inputs = gf.measure_packing(sample)
with open("material.toml", "w", encoding="utf-8") as file:
    file.write(inputs.text("packing.csv"))
print(f"coordination: {inputs.values['coordination']:.2f} +- {inputs.errors['coordination']:.2f}")

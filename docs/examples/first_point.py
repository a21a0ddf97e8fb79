import granfabric as gf

law = gf.ContactLaw([gf.Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
history = gf.drive(law, (-100e3, -100e3, 0.0), [gf.Leg(target=(-130e3, -70e3, 0.0), increments=30)])
print(history.columns["coordination"][-1])  # 3.6674

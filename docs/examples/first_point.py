from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Material
from granfabric.constitutive.path import Leg, drive

law = ContactLaw([Material(coordination=4.06, solid_fraction=0.846, normal_stiffness=1e9)])
history = drive(law, (-100e3, -100e3, 0.0), [Leg(target=(-130e3, -70e3, 0.0), increments=30)])
print(history.columns["coordination"][-1])  # 3.6674

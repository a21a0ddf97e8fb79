"""Both sides of the comparison in finite stress probes from the isotropic state."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from granfabric.constitutive.effects import Effects
from granfabric.constitutive.law import ContactLaw
from granfabric.constitutive.parameters import Closure
from granfabric.constitutive.path import Leg, drive
from granfabric.dem_ref.inputs.probes import stress_probe
from granfabric.dem_ref.loading.legs import stress_invariants
from granfabric.dem_ref.measures.contacts import fabric_anisotropy, love_weber_stress
from granfabric.dem_ref.sample.disks import Sample

from .model_side import material

PROBES = {
    "dp = +0.1 p": (0.1, 0.0),
    "dp = -0.1 p": (-0.1, 0.0),
    "dq = 0.1 p": (0.0, 0.1),
    "dp = +0.1 p, dq = 0.1 p": (0.1, 0.1),
    "dp = -0.1 p, dq = 0.1 p": (-0.1, 0.1),
}
"""Changes of p and q over p; major compression along y."""


def dem_probes(sample: Sample) -> dict[str, list[float]]:
    """Change of the coordination number, and of the fabric anisotropy along y, in every probe of the DEM."""
    p = stress_invariants(love_weber_stress(sample))[0]
    found = {}
    for name, (dp, dq) in PROBES.items():
        probe = stress_probe(sample, dp * p, dq * p)
        fabric = fabric_anisotropy(probe.after) - fabric_anisotropy(probe.before)
        found[name] = [probe.change.coordination_gained - probe.change.coordination_lost, -float(fabric[0])]
    return found


def model_probes(closure: Closure, inputs: Mapping[str, float], pressure: float) -> dict[str, list[float]]:
    """The same of the point law, at the given pressure [Pa]; NaN where it could not go."""
    law = ContactLaw([material(inputs)], closure=closure, effects=Effects())
    found = {}
    for name, (dp, dq) in PROBES.items():
        target = (-pressure * (1.0 + dp - dq), -pressure * (1.0 + dp + dq), 0.0)
        history = drive(law, (-pressure, -pressure, 0.0), [Leg(target=target)])
        if not history.finished:
            found[name] = [float("nan")] * 2
            continue
        z, a_c = history.columns["coordination"], history.columns["fabric_anisotropy_1"]
        found[name] = [float(np.diff(z)[-1]), -float(np.diff(a_c)[-1])]
    return found

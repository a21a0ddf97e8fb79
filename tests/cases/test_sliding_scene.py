"""The shipped point scene with sliding: numbers of its text, columns; what a DEM run measures reaches the law."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from granfabric.cases.records import files
from granfabric.cases.scene.material_file import law_tables, material_text, read_material
from granfabric.constitutive.path import SLIDING_COLUMNS
from granfabric.dem_ref.inputs.sliding import SLIDING_KEYS

STRAINS = (1e-4, 2e-4, 4e-4, 1e-3, 4e-3)


def run(granfabric: Callable, folder: Path, *more: str) -> dict[str, np.ndarray]:
    result = granfabric("point", "sliding_biaxial", "-o", folder, "--set", "output.pictures=false", *more)
    assert result.code == 0, result.err
    return {name: np.array(values) for name, values in files.read_csv(folder / "history.csv").items()}


def test_numbers_of_the_scene(granfabric: Callable, tmp_path: Path) -> None:
    columns = run(granfabric, tmp_path)
    assert tuple(columns)[-3:] == SLIDING_COLUMNS
    rows = [int(np.argmin(np.abs(columns["strain_yy"] + strain))) for strain in STRAINS]
    np.testing.assert_allclose(-columns["strain_yy"][rows], STRAINS, rtol=1e-9)
    shear = columns["strain_xx"] - columns["strain_yy"]
    # the text gives two or three digits
    np.testing.assert_allclose((columns["q"] / columns["p"])[rows], [0.236, 0.325, 0.377, 0.400, 0.408], atol=6e-4)
    plastic = columns["plastic_shear_strain"]
    np.testing.assert_allclose(plastic[rows] / shear[rows], [0.32, 0.53, 0.75, 0.91, 0.98], atol=6e-3)
    volume = (columns["strain_xx"] + columns["strain_yy"])[rows]
    np.testing.assert_allclose(volume, [-6.7e-5, -8.7e-5, -3.2e-5, 3.1e-4, 2.27e-3], rtol=0.02)
    np.testing.assert_allclose(columns["coordination"][rows], [3.74, 3.62, 3.53, 3.48, 3.46], atol=6e-3)
    assert (np.diff(columns["plastic_dissipation"]) >= 0.0).all()


def test_without_sliding_no_peak_and_no_column(granfabric: Callable, tmp_path: Path) -> None:
    """The stress ratio rises to the end, far beyond the peak that grains have, and tends to where the network that
    lost contacts has no stiffness left, a little above isostaticity.
    """
    columns = run(granfabric, tmp_path, "--set", "effects.sliding=false")
    assert not set(SLIDING_COLUMNS) & set(columns)
    ratio = columns["q"] / columns["p"]
    assert (np.diff(ratio) > 0.0).all() and (np.diff(ratio)[1:] < 1.001 * np.diff(ratio)[:-1]).all()
    assert columns["strain_yy"][-1] == pytest.approx(-4e-3, rel=1e-12)
    assert ratio[-1] == pytest.approx(0.638, abs=1e-3)
    moduli = np.diff(columns["stress_yy"]) / np.diff(columns["strain_yy"])
    assert 0.0 < moduli[-1] < 1e-4 * moduli[0]
    assert 2.44 < columns["coordination"][-1] < 2.65
    np.testing.assert_allclose(columns["stress_xx"], -100e3, rtol=1e-9)


def test_measured_parameters_reach_the_law(tmp_path: Path) -> None:
    """What a DEM run measures for sliding are parameters of the material, and are read back."""
    values = dict.fromkeys(SLIDING_KEYS, 0.25)
    assert set(law_tables(values)) == {"material"}
    file = tmp_path / "material.toml"
    file.write_text(material_text(values, "a test"))
    assert read_material(file)["material"] == pytest.approx(values)


@pytest.mark.slow
def test_dem_peak_measures_sliding_for_the_law(granfabric: Callable, tmp_path: Path) -> None:
    """A few disks to one per cent: the table has the parameters, and the point scene takes them."""
    small = ("packing.particles=600", "path.0.largest_strain=0.01", "output.every=0", "output.pictures=false")
    words = [word for text in small for word in ("--set", text)]
    result = granfabric("dem", "dem_peak", "-o", tmp_path / "dem", *words)
    assert result.code == 0, result.err
    measured = read_material(tmp_path / "dem" / "material.toml")["material"]
    assert set(SLIDING_KEYS) <= set(measured)
    # so few disks scatter
    assert 0.3 < measured["peak_stress_ratio"] < 0.5
    assert 2e-5 < measured["reference_plastic_strain"] < 2e-4
    columns = run(granfabric, tmp_path / "point", "--set", f"material_file={tmp_path / 'dem' / 'material.toml'}")
    assert columns["plastic_shear_strain"][-1] > 1e-3

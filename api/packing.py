"""From a packing of disks to the law: measured inputs with their errors."""

from __future__ import annotations

from dataclasses import dataclass, field

from granfabric.cases.scene.material_file import closure_table, law_tables, material_text
from granfabric.cases.scene.measured import Inputs, measure_inputs, remarks
from granfabric.constitutive.parameters import Closure, Material
from granfabric.dem_ref.sample.disks import Sample

__all__ = ["MeasuredInputs", "measure_packing"]


@dataclass(frozen=True)
class MeasuredInputs:
    """Inputs of the point law measured on a packing.

    Parameters
    ----------
    values, errors : dict of str to float
        By the names of scene keys, and their standard errors (NaN where not known).
    doubts : dict of str to list of str
        What is doubtful about a value: outside the law's bounds, an error larger than itself, not measured.
    """

    values: dict[str, float]
    errors: dict[str, float]
    doubts: dict[str, list[str]] = field(default_factory=dict)

    @property
    def material(self) -> Material:
        """Material of the law.

        Raises
        ------
        ParameterError
            If a value is outside the law's bounds; see `doubts`.
        """
        return Material(**law_tables(self.values)["material"])

    @property
    def closure(self) -> Closure:
        """Closure with the measured numbers and the choices that they are for.

        Raises
        ------
        ParameterError
            If a value is outside the law's bounds; see `doubts`.
        """
        return Closure(**closure_table(law_tables(self.values)))

    def text(self, origin: str) -> str:
        """Text of a material file, errors and doubts as comments, for `material_file` of a scene."""
        missing = [name for name in self.doubts if name not in self.values]
        return material_text(self.values, origin, self.errors, missing)


def measure_packing(sample: Sample, rattlers: str = "included") -> MeasuredInputs:
    """Measure the inputs of the point law, as `granfabric dem` does.

    Parameters
    ----------
    sample : Sample
        Under isotropic stress with friction, for instance from `make_packing`; held at its stress first if it is not at
        rest. Not changed.
    rattlers : {"included", "excluded"}
        Whether disks that carry nothing count in the coordination number.

    Raises
    ------
    SampleError
        If the packing does not come to rest, is not isotropic, or does not carry the probes.

    Examples
    --------
    >>> import granfabric as gf
    >>> inputs = gf.measure_packing(gf.make_packing(200, 1))
    >>> 3.5 < inputs.material.coordination < 4.2 and inputs.errors["coordination"] > 0.0
    True
    >>> inputs.closure.force_change
    'shifted_distribution'
    """
    found: Inputs = measure_inputs(sample, rattlers)
    return MeasuredInputs(dict(found.values), dict(found.errors), remarks(found))

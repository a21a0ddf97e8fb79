"""Contact gain and loss in granular assemblies: a point law, a finite element host, a reference DEM.

What a first day needs; everything else is in the packages below it.

- one point: `Material`, `Closure`, `Effects`, `Integration`, `ContactLaw`, `Leg`, `drive`
- a field: `rectangle`, `read_mesh`, `Space`, `Stage` and its loads, `geostatic_stress`, `Problem`, `StepControl`,
  `solve`, `solve_to_folder`
- scenes: `scene_names`, `load_scene`, `run_scene`, `read_material`
- many runs: `sweep`, `SweepResults`
- results: `read_results`
- measured curves: `fit`, `compare_with_data`
- disks: `make_packing`, `PackingOptions`, `read_grading`, `Segment`, `DemRun`, `RunOptions`, `load_packing`,
  `save_packing`, `load_sample`, `save_sample`, `measure_packing`

Stress and strain are tension positive, in the order xx, yy, xy with the engineering shear strain; SI units.
"""

from importlib.metadata import version

import lazy_loader

__version__ = version("granfabric")

# The names stand in __init__.pyi, for type checkers and for this; a module is loaded when a name of it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

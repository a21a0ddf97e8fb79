"""The finite element host: meshes, spaces, assembly, equilibrium, stepping and files. Knows a law by its contract."""

import os

# Idle OpenMP threads spin by default and then fight with others for the processors: on a busy machine with two cores
# small problems became a hundred times slower. Read when the first of them starts, hence set here.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# The same quarrel seen from the other side; the matrices here leave little for a second thread to do. This reaches the
# libraries that are loaded after this line, CHOLMOD's in particular.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

"""Scenes, command line, comparison and pictures; the only package that uses all others."""

import os

# Read by the libraries when they are loaded, hence before NumPy: idle threads sleep instead of spinning, and linear
# algebra takes one thread. On a machine with two cores they otherwise fight with the threads of the compiled kernels.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

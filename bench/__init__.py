"""Speed and accuracy, measured: `make bench`."""

import os

# Before NumPy is loaded: matrices here are small, and threads that share them wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

"""Speed and accuracy, measured: `make bench`.

Benches of a package stand in its folder `bench` and are modules of this package, too.
"""

import os
from pathlib import Path

# Before NumPy is loaded: matrices here are small, and threads that share them wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

PACKAGES = sorted(Path(__file__).resolve().parents[1].glob("packages/*/bench"))
__path__ = [*__path__, *map(str, PACKAGES)]

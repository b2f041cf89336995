"""Speed and accuracy, measured: `make bench`.

Benches of a package stand in its folder `bench` and are modules of this package, too.
"""

import importlib
import os
from pathlib import Path
from types import ModuleType

# Before NumPy is loaded: matrices here are small, and threads that share them wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

PACKAGES = sorted(Path(__file__).resolve().parents[1].glob("packages/*/bench"))
__path__ = [*__path__, *map(str, PACKAGES)]


def import_bench(name: str) -> ModuleType:
    """Return the module of a bench, in whichever folder or package it stands."""
    file = next(Path(__file__).parent.glob(f"*/{name}.py"), None)
    return importlib.import_module(f"bench.{file.parent.name}.{name}" if file else f"bench.{name}")

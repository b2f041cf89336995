"""Processes that keep processors busy while something is measured or tested."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def load_processors(count: int) -> Iterator[None]:
    """Keep processors busy with processes of this user's, at the usual priority."""
    spin = [sys.executable, "-IS", "-c", "while True: pass"]
    loads = [subprocess.Popen(spin) for _ in range(count)]
    try:
        yield
    finally:
        for load in loads:
            load.kill()
        for load in loads:
            load.wait()

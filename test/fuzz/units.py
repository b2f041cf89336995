"""Units of FMI that watch themselves, called in any order: see `fuzz.cores`.

python -m fuzz.units SEED CALLS FOLDER: so many calls, on a machine that is compiled in a folder.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from fmu_client import Fmu, abuse, rich_machine

from emulator_node.scene import load_scene
from fmu.export import export
from fuzz.line import TAKEN, tell


def main() -> None:
    """Make calls, and tell how many."""
    seed, calls, folder = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    scene = load_scene(rich_machine(folder, ("turns", "slides", "swings")))
    export(scene, folder / "unit.fmu", "native")
    fmu = Fmu(folder / "unit.fmu", folder / "unpacked")
    statuses = abuse(np.random.default_rng(seed), fmu, calls)
    tell(outcome=TAKEN, count=sum(statuses.values()))


if __name__ == "__main__":
    main()

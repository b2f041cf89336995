"""Units of FMI that watch themselves, called in any order: see `fuzz.cores`.

python -m fuzz.units SEED CALLS FOLDER: so many calls to units of FMI 3.0 and 2.0 of a machine that
is compiled in a folder.
"""

import sys
from pathlib import Path

import numpy as np
from fmu_2_client import Fmu2, abuse_2
from fmu_client import Fmu, abuse, rich_machine

from arm_emulator.machine.scene.scene import load_scene
from arm_emulator_fmu.export import export
from fuzz.line import TAKEN, report


def main() -> None:
    """Make calls, and report how many."""
    seed, calls, folder = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    scene = load_scene(rich_machine(folder, ("turns", "slides", "swings")))
    for version in ("3", "2"):
        export(scene, folder / f"{version}.fmu", "native", version)
    files = [(folder / f"{version}.fmu", folder / version) for version in ("3", "2")]
    rng = np.random.default_rng(seed)
    three = abuse(rng, Fmu(*files[0]), calls)
    two = abuse_2(rng, Fmu2(*files[1]), calls)
    report(outcome=TAKEN, count=sum(three.values()) + sum(two.values()), statuses=[three, two])


if __name__ == "__main__":
    main()

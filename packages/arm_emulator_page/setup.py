"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from package_setup import set_up

set_up(
    "arm_emulator_page",
    "A page in the browser: a run, its moments, the machine and its controls.",
    needs=("trimesh", "viser", "websockets"),
    entry_points={
        "arm_emulator.page": [
            "live = arm_emulator_page.live_process",
            "run = arm_emulator_page.served_run:serve_run",
        ],
    },
)

"""Install the package beside arm_emulator, which finds its library by its entry point."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from package_setup import set_up

set_up(
    "arm_emulator_fleet",
    "Many arms of one scene in one process, advanced side by side.",
    entry_points={
        "arm_emulator.scene_units": [
            "fleet = arm_emulator_fleet.unit:build_fleet_unit",
        ],
        "arm_emulator.card_compilers": [
            "fleet = arm_emulator_fleet.gpu_compiler:compile_scene_for_card",
        ],
    },
)

"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from package_setup import set_up

set_up(
    "arm_emulator_export",
    "Files of a scene for ros2_control, MoveIt and Foxglove.",
)

"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from package_setup import set_up

set_up(
    "arm_emulator_identification",
    "A scene's numbers from records of its motion; validation by real machines.",
    needs=("arm_emulator_fleet",),
)

"""Install the package beside arm_emulator, which finds its commands by their entry points."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from package_setup import set_up

set_up(
    "arm_emulator_fieldbus",
    "Drives of CiA 402 on EtherCAT and CANopen, and a Modbus converter.",
    needs=("python-can",),
    entry_points={
        "arm_emulator.units": [
            "drives = arm_emulator_fieldbus.drives_unit:drives_unit",
            "ethercat = arm_emulator_fieldbus.ethercat:ethercat_unit",
        ],
        "arm_emulator.drive_modes": [
            "cia402 = arm_emulator_fieldbus.object_dictionary:modes",
        ],
    },
)

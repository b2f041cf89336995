"""The C interfaces of core/boundary, read from their headers."""

from arm_emulator.core import BOUNDARY
from arm_emulator.toolchain.c_header import Header

ARM = Header(BOUNDARY / "arm.h")
EQUATIONS = Header(BOUNDARY / "equations.h")
SENSITIVITY = Header(BOUNDARY / "sensitivity.h")
FIRMWARE = Header(BOUNDARY / "firmware.h")

OK, REFUSED, DIVERGED = map(ARM.get_constant, ("ARM_OK", "ARM_REFUSED", "ARM_DIVERGED"))
FAULT_THERMAL = ARM.get_constant("ARM_FAULT_THERMAL")

# Places of a state in C, by their names in `PlantState` and `FleetState`.
PLACES = {
    "theta_m": "motor_angle",
    "omega_m": "motor_speed",
    "t": "time",
}

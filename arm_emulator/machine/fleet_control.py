"""Control code in C in the loop with the arms of a fleet."""

from __future__ import annotations

from arm_emulator.base.count import check_count
from arm_emulator.build.c_header import CData
from arm_emulator.machine.core_calls import FLEET
from arm_emulator.machine.scene import Scene

_LARGEST = 2**64 - 1  # address


class FleetControl:
    """A function in C that commands arms in every servo period, for `Fleet.follow`.

    Its signature is `arm_fleet_step_of_control` of core/boundary/arm_fleet.h. It is called for one
    group of arms at a time, by several threads for different groups, and keeps what it remembers
    of an arm apart from that of the others.

    Attributes:
        step: its address.
        with_: address that it gets as its first argument.

    Args:
        step: address of the function, as ``ctypes.cast(f, ctypes.c_void_p).value``. Its library
            must stay loaded.
        with_: address of what it works on, which must outlive this; 0: null.

    Raises:
        Refusal: no addresses.
    """

    def __init__(self, step: int, with_: int = 0) -> None:
        step = check_count("FleetControl", "step", step, 1, _LARGEST)
        with_ = check_count("FleetControl", "with_", with_, 0, _LARGEST)
        self.step: CData = FLEET.ffi.cast("arm_fleet_step_of_control", step)
        self.with_: CData = FLEET.ffi.cast("void *", with_)

    def begin(self, scene: Scene, count: int) -> None:
        """Prepare for a fleet of so many arms.

        Raises:
            Refusal: it cannot command this one. Nothing has changed then.
        """

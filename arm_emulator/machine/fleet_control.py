"""Control code in C in the loop with the arms of a fleet."""

from __future__ import annotations

from arm_emulator.base.closed import Closed, Uncopied
from arm_emulator.base.count import check_count
from arm_emulator.base.given import as_flag
from arm_emulator.build.c_header import CData
from arm_emulator.machine.core_calls import FLEET
from arm_emulator.machine.scene import Scene

_LARGEST = 2**64 - 1  # address


class FleetControl(Uncopied, Closed):
    """A function in C that commands arms in every servo period, for `Fleet.follow`.

    Its signature is `arm_fleet_step_of_control` of core/boundary/arm_fleet.h, or
    `arm_fleet_step_of_rows` if it is written over vectors, for all arms of a group at once. It is
    called for one group of arms at a time, by several threads for different groups, and keeps what
    it remembers of an arm apart from that of the others.

    Attributes:
        functions: it, by the name of its field in `arm_fleet_control`.
        with_: address that it gets as its first argument.

    Args:
        step: address of the function, as ``ctypes.cast(f, ctypes.c_void_p).value``. Its library
            must stay loaded.
        with_: address of what it works on, which must outlive this; 0: null.
        in_lanes: whether it takes rows of lanes.

    Raises:
        Refusal: no addresses, or `in_lanes` that is neither True nor False.
    """

    instead = "a new one for the fleet's copy"

    def __init__(self, step: int, with_: int = 0, *, in_lanes: bool = False) -> None:
        step = check_count("FleetControl", "step", step, 1, _LARGEST)
        with_ = check_count("FleetControl", "with_", with_, 0, _LARGEST)
        by_rows = as_flag(in_lanes, "FleetControl", "in_lanes")
        name, kind = ("step_rows", "rows") if by_rows else ("step", "control")
        self.functions: dict[str, CData] = {name: FLEET.ffi.cast(f"arm_fleet_step_of_{kind}", step)}
        self.with_: CData = FLEET.ffi.cast("void *", with_)

    def begin(self, scene: Scene, count: int) -> None:
        """Prepare for a fleet of so many arms.

        Raises:
            Refusal: it cannot command this one. Nothing has changed then.
        """

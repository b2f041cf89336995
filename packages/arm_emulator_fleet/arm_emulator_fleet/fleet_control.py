"""Control code in C in the loop with the arms of a fleet."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Array, NonCopyable, check_count, coerce_flag
from arm_emulator.extension.compiler import CData
from arm_emulator.extension.machine import STATE_NAMES_IN_C as PLACES
from arm_emulator.extension.machine import Measured, MeasuredPlace, Scene, list_outputs
from arm_emulator_fleet.unit import FLEET

if TYPE_CHECKING:
    from arm_emulator_fleet.device_array import DeviceArray

_LARGEST = 2**64 - 1  # address
TRUE_VALUES = "t", "current", "theta_m", "omega_m", "q", "v"  # of a frame


class FleetControl(NonCopyable):
    """A function in C that commands arms in every servo period, for `Fleet.follow`.

    Its signature is `arm_fleet_step_of_control` of core/arm_fleet.h, or
    `arm_fleet_step_of_rows` if it is written over vectors, for all arms of a group at once. It is
    called for one group of arms at a time, by several threads for different groups. It keeps the
    memory of each arm separate.

    Attributes:
        functions: it, by the name of its field in `arm_fleet_control`.
        name: of the function on a device; None: it has an address.
        field: name of its field.
        with_: address that it gets as its first argument, on the device if it runs there.
        device: where it runs; None: in lanes of the processor.

    Args:
        step: address of the function, as ``ctypes.cast(f, ctypes.c_void_p).value``. Its library
            must stay loaded. For arms on a device its name there (ARM_ADDRESS of core/kernel.hpp),
            in a file of `Fleet`'s `kernels`.
        with_: address of what it works on, which must outlive this; 0: null. On a device, an array
            there (`Fleet.to_device`).
        in_lanes: whether it takes rows of lanes.

    Raises:
        Refusal: no addresses, or `in_lanes` that is neither True nor False.
    """

    instead = "a new one for the fleet's copy"
    device: str | None = None

    def __init__(
        self, step: int | str, with_: int | DeviceArray = 0, *, in_lanes: bool = False
    ) -> None:
        by_rows = coerce_flag(in_lanes, "FleetControl", "in_lanes")
        self.field, self._kind = ("step_rows", "rows") if by_rows else ("step", "control")
        self.name = step if isinstance(step, str) else None
        self.functions: dict[str, CData] = {}
        self._kept = with_
        if self.name is None:
            address = check_count("FleetControl", "step", step, 1, _LARGEST)
            self.functions[self.field] = self._cast_function(address)
        place = getattr(with_, "pointer", with_)
        place = check_count("FleetControl", "with_", place, 0, _LARGEST)
        self.with_: CData = FLEET.ffi.cast("void *", place)

    def place_function(self, find: Callable[[str], int]) -> None:
        """Look up a function that was given by its name: find(name) is its address."""
        if self.name is not None:
            self.functions[self.field] = self._cast_function(find(self.name))

    def _cast_function(self, address: int) -> CData:
        return FLEET.ffi.cast(f"arm_fleet_step_of_{self._kind}", address)

    def begin(self, scene: Scene, count: int) -> None:
        """Prepare for a fleet of so many arms.

        Raises:
            Refusal: it cannot command this one. Nothing has changed then.
        """


class FleetFrame:
    """Measured and true values of all arms after a step.

    The arrays are reused in every step; copy them to keep values.

    Attributes:
        of: scene, count, and device of the fleet.
        measured: what the sensors give, as `Fleet.measured`, in place.
        powered: whether the drives have power (count,).
        faults: the joint at which each arm diverged (count,); -1: it goes on.
        t: logical time (count,) [s].
        current: (count, N) [A].
        theta_m: motor angle (count, N) [rad].
        omega_m: motor speed (count, N) [rad/s].
        q: link side (count, N) [rad or m].
        v: link side (count, N) [rad/s or m/s].

    Args:
        scene: of the fleet.
        count: of arms.
    """

    def __init__(self, scene: Scene, count: int) -> None:
        self.of: tuple[Scene, int, str | None] = scene, count, None
        shape = count, len(scene.joints)
        place = MeasuredPlace(scene, count)
        self.measured: Measured = place.make_view()
        self.faults: NDArray[np.int32] = np.full(count, -1, np.int32)
        self.t: Array = np.zeros(count)
        self.current: Array = np.zeros(shape)
        self.theta_m: Array = np.zeros(shape)
        self.omega_m: Array = np.zeros(shape)
        self.q: Array = np.zeros(shape)
        self.v: Array = np.zeros(shape)
        powered = np.ones(count, np.uint8)
        self.powered: NDArray[np.bool_] = powered.view(np.bool_)
        places = {PLACES.get(name, name): getattr(self, name) for name in TRUE_VALUES}
        self._rows = (*places.values(), self.faults, self.powered, *place.arrays.values())
        # For the core.
        # Outputs that the scene does not have stay 0.
        there = {output.symbol.partition(".")[0] for output in list_outputs(scene)}
        arrays = {name: rows for name, rows in place.arrays.items() if name in there}
        self.measurement = FLEET.make_struct("arm_fleet_measurement", powered=powered, **arrays)
        self.truth = FLEET.make_struct("arm_fleet_truth", fault=self.faults, **places)

    def __reduce__(self) -> tuple[Any, ...]:
        return FleetFrame, self.of[:2], self.__getstate__()

    def __getstate__(self) -> list[NDArray[Any]]:
        return [rows.copy() for rows in self._rows]

    def __setstate__(self, rows: list[NDArray[Any]]) -> None:
        for own, row in zip(self._rows, rows, strict=True):
            own[...] = row

    def __repr__(self) -> str:
        return f"<FleetFrame of {self.of[1]} {self.of[0].name}>"

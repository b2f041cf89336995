"""Measured and true values of all arms after a step, which stay on their device."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.machine import STATE_NAMES_IN_C as PLACES
from arm_emulator.extension.machine import Measured, MeasuredPlace, Scene, list_outputs
from arm_emulator_fleet.device import Memory
from arm_emulator_fleet.device_array import DeviceArray
from arm_emulator_fleet.device_core import DeviceCore, cast_address, cast_pointer
from arm_emulator_fleet.fleet_control import FleetFrame
from arm_emulator_fleet.unit import FLEET

_TRUE = {
    "t": (np.float64, False),
    "current": (np.float64, True),
    "theta_m": (np.float64, True),
    "omega_m": (np.float64, True),
    "q": (np.float64, True),
    "v": (np.float64, True),
}


class DeviceFrame(FleetFrame):
    """A `FleetFrame` of arms on a device: its arrays are `DeviceArray`, reused in every step.

    Attributes:
        of: scene, count, and device of the fleet.
        measured: what the sensors give, see `DeviceMeasured`.
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
        place: name of the device.
        core: of the arms.

    Raises:
        Refusal: the device has no room for it.
    """

    measured: Any
    faults: Any
    powered: Any

    def __init__(self, scene: Scene, count: int, place: str, core: DeviceCore) -> None:
        self.of = scene, count, place
        N, device = len(scene.joints), core.device
        for name, (kind, of_joints) in _TRUE.items():
            shape = (count, N) if of_joints else (count,)
            setattr(self, name, DeviceArray(shape, kind, device))
            device.fill(getattr(self, name).memory, 0)
        self.faults = DeviceArray(count, np.int32, device)
        self.powered = DeviceArray(count, np.bool_, device)
        device.fill(self.faults.memory, 0xFF)
        device.fill(self.powered.memory, 1)
        self.measured = DeviceMeasured(scene, count, core)
        places = {PLACES.get(name, name): _point(getattr(self, name)) for name in _TRUE}
        self.truth = FLEET.new("arm_fleet_truth", fault=_point(self.faults), **places)
        powered = _point(self.powered)
        self.measurement = FLEET.new(
            "arm_fleet_measurement", powered=powered, **self.measured.places
        )

    def __reduce__(self) -> tuple[Any, ...]:
        raise Refusal("DeviceFrame", "frame", "stay on its device", "a copy or a pickle")

    def __repr__(self) -> str:
        return f"<DeviceFrame of {self.of[1]} {self.of[0].name} on {self.of[2]}>"


class DeviceMeasured:
    """Readings of the sensors on a device, as the attributes of `Measured`.

    An attribute is a `DeviceArray` of its own, with the values of the newest step when it is read.

    Attributes:
        places: of the arrays that the core writes, by their names in ``arm_measurement``.

    Args:
        scene: of the arms.
        count: of arms.
        core: of the arms.
    """

    def __init__(self, scene: Scene, count: int, core: DeviceCore) -> None:
        self._core = core
        # Nothing is ever written to it: it knows where each output is.
        self._layout: Measured = MeasuredPlace(scene, count).view()
        record = self._layout.arrays
        self._begin = _address(record)
        self._memory: Memory = core.device.allocate(record.itemsize)
        core.device.fill(self._memory, 0)
        there = {one.symbol.partition(".")[0] for one in list_outputs(scene)}
        self.places = {
            name: cast_address(self._memory.pointer + _address(record[name]) - self._begin)
            for name in record.dtype.names or ()
            if name in there and record[name].size
        }
        self._arrays: dict[str, DeviceArray] = {}

    def __getattr__(self, name: str) -> DeviceArray:
        if name.startswith("_"):
            raise AttributeError(name)
        view = self._layout.find(name)
        kind = np.float64 if view.dtype.kind == "f" else np.int64
        if not view.size or not 0 <= _address(view) - self._begin < self._memory.size:
            raise AttributeError(f"the arms have no {name}", name=name, obj=self)
        if name not in self._arrays:
            self._arrays[name] = DeviceArray(view.shape, kind, self._core.device)
        to = self._arrays[name]
        shape = (*view.shape, 1)[:3]
        strides = (*view.strides, 0)[:3]
        self._core.launch(
            "fleet_gather",
            to.size,
            given=cast_address(self._memory.pointer + _address(view) - self._begin),
            size=view.itemsize,
            shape=shape,
            stride=strides,
            to=_point(to),
        )
        return to

    def __dir__(self) -> list[str]:
        return dir(self._layout)


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])


def _point(array: DeviceArray) -> Any:
    return cast_pointer(array)

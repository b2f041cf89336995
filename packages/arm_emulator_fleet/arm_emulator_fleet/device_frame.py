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
from arm_emulator_fleet.fleet_control import TRUE_VALUES, FleetFrame
from arm_emulator_fleet.unit import FLEET


class DeviceFrame(FleetFrame):
    """A `FleetFrame` of arms on a device: its arrays are `DeviceArray`, reused in every step.

    Attributes:
        measured: what the sensors give, see `DeviceMeasured`.

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
        for name in TRUE_VALUES:
            array = DeviceArray((count,) if name == "t" else (count, N), np.float64, device)
            device.fill(array.memory, 0)
            setattr(self, name, array)
        self.faults = DeviceArray(count, np.int32, device)
        self.powered = DeviceArray(count, np.bool_, device)
        device.fill(self.faults.memory, 0xFF)
        device.fill(self.powered.memory, 1)
        self.measured = DeviceMeasured(scene, count, core)
        places = {PLACES.get(name, name): cast_pointer(getattr(self, name)) for name in TRUE_VALUES}
        self.truth = FLEET.make_struct("arm_fleet_truth", fault=cast_pointer(self.faults), **places)
        powered = cast_pointer(self.powered)
        self.measurement = FLEET.make_struct(
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
        self._layout: Measured = MeasuredPlace(scene, count).make_view()
        record = self._layout.arrays
        self._begin = _get_address(record)
        self._memory: Memory = core.device.allocate(record.itemsize)
        core.device.fill(self._memory, 0)
        there = {output.symbol.partition(".")[0] for output in list_outputs(scene)}
        self.places = {
            name: cast_address(self._memory.pointer + _get_address(record[name]) - self._begin)
            for name in record.dtype.names or ()
            if name in there and record[name].size
        }
        self._arrays: dict[str, DeviceArray] = {}

    def __getattr__(self, name: str) -> DeviceArray:
        if name.startswith("_"):
            raise AttributeError(name)
        view = self._layout.find(name)
        kind = np.float64 if view.dtype.kind == "f" else np.int64
        if not view.size or not 0 <= _get_address(view) - self._begin < self._memory.size:
            raise AttributeError(f"the arms have no {name}", name=name, obj=self)
        if name not in self._arrays:
            self._arrays[name] = DeviceArray(view.shape, kind, self._core.device)
        to = self._arrays[name]
        shape = (*view.shape, 1)[:3]
        strides = (*view.strides, 0)[:3]
        self._core.launch(
            "fleet_gather",
            to.size,
            given=cast_address(self._memory.pointer + _get_address(view) - self._begin),
            size=view.itemsize,
            shape=shape,
            stride=strides,
            to=cast_pointer(to),
        )
        return to

    def __dir__(self) -> list[str]:
        return dir(self._layout)


def _get_address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])

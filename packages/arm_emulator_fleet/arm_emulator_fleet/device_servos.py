"""The functions of core/servo_fleet.h for servos on a device."""

from __future__ import annotations

from typing import Any

import numpy as np

from arm_emulator.extension.compiler import C_NULL as NULL
from arm_emulator.extension.compiler import CData
from arm_emulator_fleet.device import Memory
from arm_emulator_fleet.device_core import DeviceCore, cast_pointer, view_bytes
from arm_emulator_fleet.unit import SERVOS


class DeviceServos:
    """The calls of core/servo_fleet.h that `ServoFleet` makes, carried out by kernels.

    Attributes:
        pointer: to the servos on the device.

    Args:
        core: of the arms.
    """

    def __init__(self, core: DeviceCore) -> None:
        self._core, self._device = core, core.device
        self._servos = self._device.allocate(SERVOS.get_size("servo_fleet"))
        self.pointer = cast_pointer(self._servos)
        self._memory: dict[str, Memory] = {}

    def servo_fleet_begin(self, servos: CData, arms: int) -> None:
        """Take over the numbers of the joints of so many arms, and forget everything."""
        self._joints, self._arms = int(servos.joints), arms
        sizes = self._core.read_sizes("servos_measure_memory", 3)
        groups = self._core.count_groups(arms)
        self._reserve_memory("groups", groups * sizes[0])
        self._reserve_memory("joints", groups * self._joints * sizes[1])
        places = [self._memory[name].pointer for name in ("groups", "joints")]
        self._write_rows("lanes", np.array(places, np.uint64))
        self._copy_servos(servos)
        self._core.launch("servos_begin", groups, servos=self._servos, arms=arms)

    def servo_fleet_end(self, servos: CData) -> None:
        """Do nothing: the device's memory goes with this."""

    def servo_fleet_reset(self, servos: CData, arms: int, mask: CData) -> None:
        """Have the servos of a mask forget everything; targets begin anew."""
        mask_bytes = self._device.allocate(arms)
        self._device.write(mask_bytes, view_bytes(mask, arms))
        groups = self._core.count_groups(arms)
        self._core.launch("servos_reset", groups, servos=self._servos, arms=arms, mask=mask_bytes)

    def servo_fleet_aim(self, servos: CData, arms: int) -> None:
        """Take over motion periods and rows of targets."""
        self._copy_servos(servos)
        groups = self._core.count_groups(arms)
        self._core.launch("servos_aim", groups, servos=self._servos, arms=arms)

    def servo_fleet_retune(self, servos: CData, arm: int, joint: CData) -> None:
        """Change the numbers of the joints of an arm."""
        size = self._joints * SERVOS.get_size("servo_joint")
        gains = self._device.allocate(size)
        self._device.write(gains, view_bytes(joint, size))
        self._core.launch("servos_retune", 1, servos=self._servos, arm=arm, joint=gains)

    def _copy_servos(self, servos: CData) -> None:
        """Copy a struct and all that it points to."""
        own = SERVOS.make_struct("servo_fleet")
        own[0] = servos[0]
        N, rows = self._joints, int(servos.rows)
        own.place = self._copy_rows("place", servos.place, 4 * N)
        own.arm = self._put_arms(servos)
        if servos.since != NULL:
            rows = int(servos.first_row[self._arms])
            own.since = self._copy_rows("since", servos.since, 8 * rows)
            own.first_row = self._copy_rows("first_row", servos.first_row, 8 * (self._arms + 1))
            own.row = self._copy_rows("row", servos.row, 8 * self._arms)
            numbers = rows * N
        else:
            numbers = rows * max(int(servos.row_stride), N)
        for name in ("q", "v", "tau"):
            setattr(own, name, self._copy_rows(name, getattr(servos, name), 8 * numbers))
        own.lanes = cast_pointer(self._memory["lanes"])
        self._device.write(self._servos, view_bytes(own, self._servos.size))

    def _put_arms(self, servos: CData) -> CData:
        """Copy the servo of each arm, and the numbers of their joints."""
        size = SERVOS.get_size("servo") * self._arms
        arms = view_bytes(servos.arm, size).view(SERVOS.get_dtype("servo")).copy()
        size = self._joints * SERVOS.get_size("servo_joint")
        hosts, index = np.unique(arms["joint"], return_inverse=True)
        numbers = [view_bytes(SERVOS.ffi.cast("servo_joint *", int(host)), size) for host in hosts]
        joints = self._write_rows("numbers", np.concatenate(numbers))
        arms["joint"] = joints.pointer + np.uint64(size) * index.reshape(-1).astype(np.uint64)
        arms["state"] = 0
        return cast_pointer(self._write_rows("arms", arms.view(np.uint8)))

    def _copy_rows(self, name: str, host: CData, size: int) -> CData:
        if host == NULL:
            return NULL
        return cast_pointer(self._write_rows(name, view_bytes(host, size)))

    def _write_rows(self, name: str, array: Any) -> Memory:
        memory = self._reserve_memory(name, array.nbytes)
        self._device.write(memory, array)
        return memory

    def _reserve_memory(self, name: str, size: int) -> Memory:
        if name not in self._memory or self._memory[name].size != size:
            self._memory[name] = self._device.allocate(size)
        return self._memory[name]

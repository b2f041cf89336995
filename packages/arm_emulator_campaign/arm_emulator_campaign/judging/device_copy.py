"""A copy of an array on a device."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from arm_emulator_fleet.device import Device, Memory


def copy_to_device(device: Device, array: NDArray[Any]) -> Memory:
    """Return new memory of a device with the bytes of an array, 8 at least."""
    memory = device.allocate(max(8, array.nbytes))
    device.write(memory, array)
    return memory

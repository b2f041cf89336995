"""Devices by their names."""

from __future__ import annotations

import re
from functools import cache

from arm_emulator.extension.base import Refusal
from arm_emulator_fleet.device import Device
from arm_emulator_fleet.processor_device import ProcessorDevice

PROCESSOR = cache(ProcessorDevice)

GPU = re.compile(r"gpu(?::(\d{1,4}))?", re.ASCII)


def open_device(where: str, name: str) -> Device:
    """Return a device; the same object for the same name.

    Args:
        where: name in refusals.
        name: "processor", "gpu" (the first card), "gpu:1" (the second).

    Raises:
        Refusal: no such name, no driver of NVIDIA, or no such card.
    """
    if name == "processor":
        return PROCESSOR()
    match = GPU.fullmatch(name) if isinstance(name, str) else None
    if match is None:
        raise Refusal(where, "device", "be known", name, '"processor", "gpu", "gpu:1"')
    # Nothing of it is loaded for the processor.
    from arm_emulator_fleet.cuda_device import open_card

    return open_card(where, int(match[1] or 0))

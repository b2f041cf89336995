"""Kernels of one source, compiled for the device that runs them."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.compiler import Unit, compiled_library
from arm_emulator_fleet import gpu_compiler
from arm_emulator_fleet.device import Device, Module
from arm_emulator_fleet.unit import NATIVE


def load_kernels(device: Device, unit: Unit) -> Module:
    """Return the kernels of a unit on a device, compiling them if no cached file fits.

    On a card ptxas makes the code where it is installed and knows the card. Elsewhere the driver
    makes it of PTX, which it does again in each process unless its own cache has it.

    Args:
        device: a card, or the processor.
        unit: sources of the kernels in both forms, see `Module`.

    Raises:
        Refusal: there is neither a sound cached file nor a working compiler, or the device cannot
            load it.
    """
    if device.architecture == NATIVE:
        return device.load(Path(compiled_library(unit).file))
    # First, so that an error in the sources is that of clang.
    ptx = gpu_compiler.load_ptx(unit, device.architecture)
    try:
        image = gpu_compiler.load_cubin(unit, device.architecture)
    except Refusal:  # no ptxas, or one that is older than the card
        image = ptx
    return device.load(image)

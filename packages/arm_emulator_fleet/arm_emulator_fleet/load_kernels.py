"""Kernels of one source, compiled for the device that runs them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
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
    return load_parts(device, [unit])[0]


def load_parts(device: Device, units: Sequence[Unit]) -> list[Module]:
    """Return kernels of several units, which are compiled at the same time; see `load_kernels`.

    Args:
        device: see there.
        units: for a card; on the processor the first has all kernels of the others.

    Raises:
        Refusal: see there.
    """
    if device.architecture == NATIVE:
        return len(units) * [device.load(Path(compiled_library(units[0]).file))]
    with ThreadPoolExecutor(len(units)) as threads:
        images = list(threads.map(lambda unit: _find_image(unit, device.architecture), units))
    return [device.load(image) for image in images]


def _find_image(unit: Unit, architecture: str) -> bytes:
    # First, so that an error in the sources is that of clang.
    ptx = gpu_compiler.load_ptx(unit, architecture)
    try:
        return gpu_compiler.load_cubin(unit, architecture)
    except Refusal:  # no ptxas, or one that is older than the card
        return ptx

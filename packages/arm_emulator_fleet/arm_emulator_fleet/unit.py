"""The compiled fleet of a scene: the core's machine behind arm_fleet.h."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from arm_emulator.extension.compiler import (
    BOUNDARY_FOLDER,
    SERVO_FOLDER,
    Header,
    Library,
    Unit,
    compiled_library,
)
from arm_emulator.extension.machine import Scene, build_machine_unit
from arm_emulator_fleet.device import Device, Module
from arm_emulator_fleet.gpu_compiler import has_ptxas, load_cubin, load_ptx

FOLDER = Path(__file__).resolve().parent / "core"
FLEET = Header(FOLDER / "arm_fleet.h", (BOUNDARY_FOLDER,))
NATIVE = "native"  # architecture of the processor
LANES_OF_THREAD = 2  # of a card: arms that it advances
LANES = "ARM_LANES", "SERVO_FLEET_LANES"  # their names in C++
SERVOS = Header(FOLDER / "servo_fleet.h", (BOUNDARY_FOLDER, SERVO_FOLDER))
KERNELS = Header(FOLDER / "fleet_kernels.h", (BOUNDARY_FOLDER, SERVO_FOLDER))


def load_fleet(scene: Scene) -> Library:
    """Return the scene's compiled fleet, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return compiled_library(build_fleet_unit(scene))


def build_fleet_unit(scene: Scene) -> Unit:
    """Return the sources of `load_fleet`."""
    machine = build_machine_unit(scene)
    unit = build_machine_unit(scene, "fleet_boundary.hpp")
    return replace(
        unit,
        name=f"{scene.name}-fleet",
        headers=(*unit.headers, FLEET),
        folders=(*unit.folders, BOUNDARY_FOLDER, FOLDER),
        about=f"a fleet of {scene.name} ({len(scene.joints)} joints)",
        saves_as=machine,
    )


def load_kernels(scene: Scene, device: Device) -> Module:
    """Return the scene's kernels (core/fleet_kernels.hpp), compiled for a device.

    Raises:
        Refusal: there is neither a sound cached file nor a working compiler, or the device cannot
            load it.
    """
    unit = build_kernels_unit(scene)
    if device.architecture == NATIVE:
        return device.load(Path(compiled_library(unit).file))
    load = load_cubin if has_ptxas() else load_ptx
    return device.load(load(unit, device.architecture))


def build_kernels_unit(scene: Scene) -> Unit:
    """Return the sources of `load_kernels`."""
    unit = build_machine_unit(scene, "fleet_kernels.hpp")
    return replace(
        unit,
        name=f"{scene.name}-kernels",
        source=f'#include "begin_kernels.hpp"\n{unit.source}#include "end_kernels.hpp"\n',
        flags=(*unit.flags, *(f"-D{name}={LANES_OF_THREAD}" for name in LANES)),
        headers=(),
        more=(),
        data={},
        folders=(*unit.folders, BOUNDARY_FOLDER, SERVO_FOLDER, FOLDER),
        about=f"kernels of a fleet of {scene.name} ({len(scene.joints)} joints)",
        saves_as=build_machine_unit(scene),
    )

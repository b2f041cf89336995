"""The compiled fleet of a scene: the core's machine behind arm_fleet.h."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.compiler import (
    BOUNDARY_FOLDER,
    SERVO_FOLDER,
    Header,
    Library,
    Unit,
    compiled_library,
)
from arm_emulator.extension.machine import Scene, build_machine_unit

FOLDER = Path(__file__).resolve().parent / "core"
FLEET = Header(FOLDER / "arm_fleet.h", (BOUNDARY_FOLDER,))
NATIVE = "native"  # architecture of the processor
LANES_OF_THREAD = 2  # arms that a thread of a device advances, of scenes that have lanes
SERVOS = Header(FOLDER / "servo_fleet.h", (BOUNDARY_FOLDER, SERVO_FOLDER))
# A card has the kernel of smooth steps in a module of its own, a processor all kernels in one.
ALL_KERNELS, SMOOTH_KERNEL = "fleet_kernels.hpp", "advance_to_event.hpp"
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


def build_card_units(scene: Scene, more: Sequence[Path] = ()) -> list[Unit]:
    """Return the sources of both modules of a card, see `build_kernels_unit`.

    Raises:
        Refusal: see there.
    """
    return [build_kernels_unit(scene, more, part) for part in (ALL_KERNELS, SMOOTH_KERNEL)]


def build_kernels_unit(scene: Scene, more: Sequence[Path] = (), kernels: str = ALL_KERNELS) -> Unit:
    """Return the sources of the scene's kernels for a device.

    Args:
        scene: of all arms.
        more: files in C++ that are included behind them.
        kernels: `ALL_KERNELS` or `SMOOTH_KERNEL`.

    Raises:
        Refusal: the scene is one that no device advances.
    """
    if scene.threads > 1:
        rule = "be 1 on a device: its arms are its threads"
        raise Refusal(scene.where, "threads", rule, scene.threads)
    unit = build_machine_unit(scene, kernels)
    name, part = "kernels", "kernels"
    if kernels == SMOOTH_KERNEL:
        name, part = "smooth-kernel", "the kernel of smooth steps"
    source = unit.source + "".join(f'#include "{file.name}"\n' for file in more)
    return replace(
        unit,
        name=f"{scene.name}-{name}",
        source=f'#include "begin_kernels.hpp"\n{source}#include "end_kernels.hpp"\n',
        flags=(*unit.flags, f"-DARM_LANES={LANES_OF_THREAD}"),
        headers=(),
        more=(),
        data={},
        folders=(
            *unit.folders,
            BOUNDARY_FOLDER,
            SERVO_FOLDER,
            FOLDER,
            *(file.parent for file in more),
        ),
        about=f"{part} of a fleet of {scene.name} ({len(scene.joints)} joints)",
        saves_as=build_machine_unit(scene),
    )

"""The compiled fleet of a scene: the core's machine behind arm_fleet.h."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from arm_emulator.extension.compiler import (
    BOUNDARY_FOLDER,
    Header,
    Library,
    Unit,
    compiled_library,
)
from arm_emulator.extension.machine import Scene, build_machine_unit

FOLDER = Path(__file__).resolve().parent / "core"
FLEET = Header(FOLDER / "arm_fleet.h", (BOUNDARY_FOLDER,))


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

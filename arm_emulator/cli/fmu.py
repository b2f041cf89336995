"""`arm_emulator fmu`: a scene's machine as a functional mock-up unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from arm_emulator.analysis.scene_warnings import warn_of_scene
from arm_emulator.doors.fmu.export import TARGET, export
from arm_emulator.machine.scene import load_scene


def write_fmu(
    scene_name: str,
    out: Path,
    varied: list[str] | None,
    target: str | None,
    version: str,
    windows: bool = False,
) -> int:
    """Write the unit, and print its properties.

    Args:
        scene_name: scene file or name.
        out: the file.
        varied: names of numbers that become parameters, instead of those of the scene.
        target: processors of its binary; None: most.
        version: of FMI.
        windows: add a binary for Windows.

    Raises:
        Refusal: a scene, name, target or file is refused.
    """
    overrides: dict[str, Any] = {} if varied is None else {"varied": varied}
    scene = load_scene(scene_name, overrides)
    warn_of_scene(scene)
    export(scene, out, target or TARGET, version, windows)
    parameters = f", {len(scene.varied)} parameters" if scene.varied else ""
    print(
        f"{out}: FMI {version}.0 co-simulation, {len(scene.joints)} joints{parameters}; "
        f"a servo period of {scene.servo_period:g} s"
    )
    return 0

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
    """Write the unit, and state what it is.

    Args:
        scene_name: scene file or name.
        out: the file.
        varied: names of numbers that become parameters, in place of those of the scene.
        target: which processors its binary is for; None: most.
        version: of FMI.
        windows: with a binary for Windows, too.

    Raises:
        Refusal: a scene, a name, a target or a file that is not taken.
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

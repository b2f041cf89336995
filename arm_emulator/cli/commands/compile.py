"""Compile a scene ahead of its first use."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName


@command()
def compile_scene(
    scene: SceneName = "three_axis",
    /,
    *,
    target: str = "native",
    into: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    fleet: bool = False,
    fieldbus: bool = False,
) -> int:
    """Compile a scene ahead of its first use, and print the libraries.

    Args:
        target: native (this machine's processor), or a level such as x86-64-v3 for machines without
            a compiler.
        into: folder of the libraries (default: the cache).
        fleet: compile the library of a fleet, too.
        fieldbus: compile the libraries of field buses, too.
    """
    from arm_emulator.build.unit import compile_units
    from arm_emulator.campaign.requirement import robustness_unit
    from arm_emulator.campaign.signals import sampler_unit
    from arm_emulator.machine.compiler import compile_ahead
    from arm_emulator.machine.firmware_loop import firmware_loop_unit
    from arm_emulator.machine.record_ring import record_ring_unit
    from arm_emulator.machine.scene import load_scene
    from arm_emulator.motion.way_library import way_unit
    from arm_emulator.runs.servo_step import servo_step_unit
    from arm_emulator.servo.servo_law import servo_unit

    of_scene = compile_ahead(load_scene(scene), target, into, fleet=fleet)
    code = [servo_unit(), way_unit(), servo_step_unit(), firmware_loop_unit(), record_ring_unit()]
    code += [robustness_unit(), sampler_unit()]
    if fieldbus:
        from arm_emulator.doors.fieldbus.drives import drives_unit
        from arm_emulator.doors.fieldbus.ethercat import ethercat_unit

        code += [drives_unit(), ethercat_unit()]
    for library in [*of_scene, *compile_units(code, target, into)]:
        print(library)
    return 0

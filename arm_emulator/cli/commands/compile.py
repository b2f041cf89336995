"""Compile a scene ahead of its first use."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.packages import CARDS, SCENE_UNITS, UNITS, find_entry, load_all
from arm_emulator.cli.command import command
from arm_emulator.cli.commands.servo_header import make_servo_data_unit
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.plant.compiler import compile_ahead
from arm_emulator.machine.plant.formula_rows import build_formula_unit
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.machine.session.record_ring import build_record_ring_unit
from arm_emulator.motion.model.arm_tree import make_path_unit
from arm_emulator.ros.c import make_middleware_unit
from arm_emulator.runs.servo_step import make_servo_step_unit
from arm_emulator.servo.servo_law import make_servo_unit
from arm_emulator.tick.c import tick_unit
from arm_emulator.toolchain.compile_unit import compile_units
from emulator_node.c import make_answered_ticks_unit, make_real_time_ticks_unit
from servo_node.c import make_answered_states_unit


@command(keys="`libraries`")
def compile_scene(
    scene: SceneName = "three_axis",
    /,
    *,
    target: str = "native",
    into: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    fleet: bool = False,
    packages: bool = False,
    servo: bool = False,
    device: Annotated[str | None, Parameter(metavar="SM")] = None,
) -> int:
    """Compile a scene ahead of its first use, and print the libraries.

    Args:
        target: native (this machine's processor), or a level such as x86-64-v3 for machines without
            a compiler.
        into: folder of the libraries (default: the cache).
        fleet: compile the library of a fleet, too.
        packages: compile the libraries of packages beside the core, too, such as field buses; for
            cards, those of campaigns.
        servo: compile our servo with the scene's gains, too.
        device: compile the kernels of a fleet for cards of NVIDIA, too, for example sm_90: to PTX,
            and where ptxas is installed, to code of the card.
    """
    machine = load_scene(scene)
    of_fleet = [find_entry("fleet", SCENE_UNITS, "fleet").load()(machine)] if fleet else []
    of_card: list[Path] = []
    if device is not None:
        of_fleets = find_entry("fleet", CARDS, "fleet").load()
        for compile_for_card in load_all(CARDS) if packages else [of_fleets]:
            of_card += compile_for_card(machine, device, into)
    of_scene = compile_ahead(machine, target, into)
    code = [
        *of_fleet,
        tick_unit(),
        make_servo_unit(),
        make_path_unit(),
        make_servo_step_unit(),
        build_record_ring_unit(),
    ]
    code += [
        build_formula_unit(),
        make_middleware_unit(),
        make_answered_ticks_unit(),
        make_real_time_ticks_unit(),
        make_answered_states_unit(),
    ]
    if servo:
        code.append(make_servo_data_unit(scene))
    if packages:
        code += [unit_of() for unit_of in load_all(UNITS)]
    libraries = [*of_scene, *compile_units(code, target, into), *of_card]
    for library in libraries:
        output.print_line(str(library))
    output.add_facts({"libraries": libraries})
    return 0

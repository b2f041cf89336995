"""Write the machine as a unit for simulators (FMI)."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.extension.base import print_warnings
from arm_emulator.extension.commands import SceneName, command, output
from arm_emulator.extension.machine import load_scene
from arm_emulator_fmu.export import TARGET, export


@command(keys="`file`, `fmi`, `joints`, `parameters`, `period`")
def write_unit(
    scene: SceneName,
    /,
    *,
    out: Annotated[Path, Parameter(metavar="FILE")],
    varied: Annotated[str | None, Parameter(metavar="NAMES")] = None,
    target: str | None = None,
    fmi: Literal["3", "2"] = "3",
    windows: bool = False,
) -> int:
    """Write a scene's machine as a functional mock-up unit for co-simulation.

    Args:
        out: file to write, such as arm.fmu.
        varied: parameters, separated by commas (default: numbers that the scene lists).
        target: processors of the binary: a level (default: x86-64-v2), or native, this machine's.
        fmi: version, 3.0 or 2.0.
        windows: add a binary for 64-bit Windows (by mingw).
    """
    names = None if varied is None else [name for name in varied.split(",") if name]
    machine = load_scene(scene, {} if names is None else {"varied": names})
    print_warnings(*machine.warnings)
    export(machine, out, target or TARGET, fmi, windows)
    parameters = f", {len(machine.varied)} parameters" if machine.varied else ""
    output.print_line(
        f"{out}: FMI {fmi}.0 co-simulation, {len(machine.joints)} joints{parameters}; "
        f"a servo period of {machine.servo_period:g} s"
    )
    output.add_facts({
        "file": out, "fmi": f"{fmi}.0", "joints": machine.joint_names,
        "parameters": machine.varied, "period": machine.servo_period,
    })  # fmt: skip
    return 0

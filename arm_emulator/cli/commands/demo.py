"""Run the paper's experiment with three nodes, and draw it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Clock, SceneName


@command(of_ros=True)
def demo(
    scene: SceneName = "three_axis",
    /,
    *,
    clock: Clock = "lockstep",
    out: Annotated[Path, Parameter(metavar="FOLDER")] = Path("out"),
) -> int:
    """Displace the tool with three nodes, and draw the deviation of each displacement.

    Args:
        scene: scene file or name, or a robot's URDF.
        out: folder of the results.
    """
    from arm_emulator.base.config_files import ROBOTS
    from arm_emulator.cli.demo import demo as experiment

    if Path(scene).suffix in ROBOTS:
        from arm_emulator.cli.new import scene_of_robot

        scene = str(scene_of_robot(Path(scene), out))
    return experiment(scene, clock, out)

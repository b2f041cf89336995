"""Start the three nodes, end all when one ends."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Clock, SceneName


@command(until_stopped=True, of_ros=True)
def up(
    scene: SceneName = "three_axis",
    /,
    *,
    clock: Clock = "lockstep",
    start: Literal["free_run", "first_answer", "paused"] = "first_answer",
    rerun_port: Annotated[int, Parameter(metavar="PORT")] = 0,
    rerun_file: Annotated[str, Parameter(metavar="FILE")] = "",
    record: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    namespace: str = "",
    use_sim_time: bool = False,
    params_file: Annotated[Path | None, Parameter(metavar="FILE")] = None,
) -> int:
    """Start the three nodes until Ctrl-C, or until one of them ends.

    Args:
        start: behaviour until the servo's first answer.
        rerun_port: port at which a Rerun viewer may connect.
        rerun_file: Rerun recording to write.
        record: new bag, written by the emulator itself, independent of the network.
        namespace: of all nodes and topics, such as /cell1.
        use_sim_time: the nodes' own clocks follow the emulator's.
        params_file: ROS parameter file that overrides all other parameters.
    """
    from arm_emulator.cli.up import up as bring_up

    return bring_up(
        scene,
        clock,
        start,
        rerun_port,
        rerun_file,
        record=record,
        namespace=namespace,
        use_sim_time=use_sim_time,
        params_file=params_file,
    )

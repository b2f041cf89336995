"""Serve control software in any language by lines of JSON."""

from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.run_outputs import NOTHING
from arm_emulator.base.validation.address import parse_address
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Clock, Keep, PageAt, SceneName
from arm_emulator.cli.served import serve_clients
from arm_emulator.doors.json_lines import TcpServer
from arm_emulator.machine.scene.scene import load_scene


@command(until_stopped=True, keys="`scene`, `address`, `clock`")
def serve_tcp(
    scene: SceneName = "three_axis",
    /,
    *,
    listen: Annotated[str, Parameter(metavar="[HOST:]PORT")] = "127.0.0.1:50780",
    clock: Clock = "lockstep",
    page: PageAt = None,
    outputs: Keep = NOTHING,
) -> int:
    """Serve clients by TCP, one after the other, until Ctrl-C.

    Args:
        listen: address that clients connect to.
    """
    outputs.check_options("tcp")
    host, port = parse_address("tcp", "--listen", listen)
    return serve_clients(
        "tcp",
        load_scene(scene),
        clock,
        outputs,
        page,
        lambda on: TcpServer(on, host, port),
    )

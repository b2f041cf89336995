"""Serve control software of this machine by lines of JSON."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.run_outputs import NOTHING
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Clock, Keep, PageAt, SceneName
from arm_emulator.cli.served import serve_clients
from arm_emulator.doors.json_lines import UnixSocketServer
from arm_emulator.machine.scene.scene import load_scene


@command(until_stopped=True, keys="`scene`, `address`, `clock`")
def serve_unix_socket(
    scene: SceneName = "three_axis",
    /,
    *,
    listen: Annotated[Path, Parameter(metavar="FILE")] = Path("arm.sock"),
    clock: Clock = "lockstep",
    page: PageAt = None,
    outputs: Keep = NOTHING,
) -> int:
    """Serve clients by a Unix socket, one after the other, until Ctrl-C.

    Args:
        listen: file that clients connect to.
    """
    outputs.check_options("unix-socket")
    return serve_clients(
        "unix-socket", load_scene(scene), clock, outputs, page,
        lambda session: UnixSocketServer(session, listen),
    )  # fmt: skip

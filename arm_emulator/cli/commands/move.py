"""Send a target for the tool or the joints to a running network, and report its progress."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json

Triple = tuple[float, float, float]


@command(of_ros=True)
def move(
    *,
    to: Annotated[Triple | None, Parameter(metavar="X Y Z")] = None,
    by: Annotated[Triple | None, Parameter(metavar="X Y Z")] = None,
    quaternion: Annotated[
        tuple[float, float, float, float] | None, Parameter(metavar="X Y Z W")
    ] = None,
    joints: Annotated[list[str] | None, Parameter(metavar="NAME=ANGLE ...")] = None,
    seconds: Annotated[float, Parameter(metavar="S")] = 2.0,
    timeout: Annotated[float, Parameter(metavar="S")] = 60.0,
    namespace: str = "",
    json: Json = False,
) -> int:
    """Send a target over ROS, and print its states: accepted, moving, reached.

    The exit code is 0 when the target is reached, and 1 when it is refused, unreachable, replaced
    or aborted, or after the timeout.

    Args:
        to: target of the tool (m, in the world).
        by: displacement of the tool from its present position (m, in the world).
        quaternion: orientation of the tool (default: unchanged).
        joints: angles of joints (rad or m); the others hold.
        seconds: logical time of a motion of joints.
        timeout: wall time to wait for the end.
        namespace: of the network, such as /cell1.
    """
    from arm_emulator.cli.move import move as send

    return send(
        to=to,
        by=by,
        quaternion=quaternion,
        joints=joints,
        seconds=seconds,
        timeout=timeout,
        namespace=namespace,
        json=json,
    )

"""Print the state of a running network: its clock, its nodes' health, its newest target."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json


@command(of_ros=True)
def status(
    *,
    timeout: Annotated[float, Parameter(metavar="S")] = 3.0,
    namespace: str = "",
    json: Json = False,
) -> int:
    """Print the state of a running network; the exit code is 1 if a node is missing or not healthy.

    Args:
        timeout: wall time to wait for missing nodes.
        namespace: of the network, such as /cell1.
    """
    from arm_emulator.cli.status import status as show

    return show(timeout, namespace, json=json)

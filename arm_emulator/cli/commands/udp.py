"""Serve control software in any language by datagrams."""

from typing import Annotated

from cyclopts import Parameter

from arm_emulator.base.run_outputs import NOTHING
from arm_emulator.base.validation.address import parse_address
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Clock, Keep, PageAt, SceneName
from arm_emulator.cli.output import output
from arm_emulator.cli.served import serve_clients
from arm_emulator.doors.udp import Datagrams, UdpServer
from arm_emulator.machine.scene.scene import load_scene


@command(
    until_stopped=True,
    keys=(
        "`scene`, `address`, `clock`; `layout`, `command`, `measurement` (fields of the datagrams,"
        " as in NumPy); with the option header `header` alone"
    ),
)
def serve_udp(
    scene: SceneName = "three_axis",
    /,
    *,
    listen: Annotated[str, Parameter(metavar="[HOST:]PORT")] = "127.0.0.1:50770",
    clock: Clock = "lockstep",
    header: bool = False,
    page: PageAt = None,
    outputs: Keep = NOTHING,
) -> int:
    """Serve clients by UDP until Ctrl-C.

    Args:
        listen: address that commands are sent to.
        header: print the datagrams as structs of C, and end.
    """
    outputs.check_options("udp")
    host, port = parse_address("udp", "--listen", listen)
    machine = load_scene(scene)
    layout = Datagrams(machine)
    if header:
        text = layout.write_header()
        output.print_line(text.removesuffix("\n"))
        output.add_facts({"header": text})
        return 0
    return serve_clients(
        "udp", machine, clock, outputs, page, lambda session: UdpServer(session, host, port),
        layout=layout.layout, command=layout.command.descr, measurement=layout.measurement.descr,
    )  # fmt: skip

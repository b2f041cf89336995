"""A machine that a command serves to clients: its clock, what is kept of it, its page."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from arm_emulator.base.run_outputs import RunOutputs
from arm_emulator.base.warning import print_warnings
from arm_emulator.cli.output import output
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.session.real_time import open_real_time_session
from arm_emulator.machine.session.session import Session
from arm_emulator.page.control_server import serve_controls
from arm_emulator.runs.recorder import Recorder


@contextmanager
def serve_session(
    scene: Scene, clock: str, outputs: RunOutputs, page: str | None
) -> Iterator[Session]:
    """Context in which a session that waits for its first answer is recorded and watched.

    Args:
        scene: of the machine.
        clock: "realtime", or another one, in which ticks wait for their answers.
        outputs: records of it.
        page: address of its page in the browser, if any.
    """
    print_warnings(*scene.warnings)
    waits = clock != "realtime"
    if waits:
        session = Session(scene, "lockstep", "first_answer")
    else:
        session = open_real_time_session(scene, "first_answer")
    with session, Recorder(session.plant, outputs, waits), serve_controls(session, page):
        yield session


def serve_clients(
    door: str,
    scene: Scene,
    clock: str,
    outputs: RunOutputs,
    page: str | None,
    server_of: Callable[[Session], Any],
    **facts: object,
) -> int:
    """Report where a machine is served, and serve it; return the exit code.

    Args:
        door: name of the command.
        scene: of the machine.
        clock: see `serve_session`.
        outputs: records of it.
        page: address of its page in the browser, if any.
        server_of: makes the server of a session, with `address` and `serve`.
        facts: further ones to report.
    """
    with serve_session(scene, clock, outputs, page) as session:
        server = server_of(session)
        address = server.address
        output.add_facts({"scene": scene.name, "address": address, "clock": clock, **facts})
        at = "{}:{}".format(*address) if isinstance(address, tuple) else address
        print(f"{door}: scene {scene.name}, {at}, clock {clock}", flush=True)
        server.serve()
    return 0

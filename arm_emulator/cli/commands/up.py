"""Start the three nodes, end all when one ends."""

import contextlib
import os
import time
from pathlib import Path
from typing import Annotated, Literal

import rclpy  # noqa: F401  # where it is missing nothing is started
from cyclopts import Parameter

from arm_emulator.base.io.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Clock, PageAt, SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.session.pace import parse_factor
from arm_emulator.page.page_address import VARIABLE, PageAddress, make_token
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ctrl_c import CtrlC


@command(
    until_stopped=True,
    keys="`scene`, `clock`, `record`, `page` (its address), `ended` (the node that ended first)",
)
def start_nodes(
    scene: SceneName = "three_axis",
    /,
    *,
    clock: Clock = "lockstep",
    pace: Annotated[str, Parameter(metavar="FACTOR")] = "1",
    start: Literal["free_run", "first_answer", "paused"] = "first_answer",
    rerun_port: Annotated[int, Parameter(metavar="PORT")] = 0,
    rerun_file: Annotated[str, Parameter(metavar="FILE")] = "",
    page: PageAt = None,
    record: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    namespace: str = "",
    allow_second: bool = False,
    use_sim_time: bool = False,
    params_file: Annotated[Path | None, Parameter(metavar="FILE")] = None,
) -> int:
    """Start the three nodes until Ctrl-C, or until one of them ends.

    Args:
        pace: logical time per wall time, or max: as fast as the nodes compute. Bits do not depend
            on it.
        start: behaviour until the servo's first answer.
        rerun_port: port at which a Rerun viewer may connect.
        rerun_file: Rerun recording to write.
        record: new bag, written by the emulator itself, independent of the network.
        namespace: of all nodes and topics, such as /cell1.
        allow_second: start although another network uses the same topics.
        use_sim_time: the nodes' own clocks follow the emulator's.
        params_file: ROS parameter file that overrides all other parameters.
    """
    output.add_facts(
        {"scene": scene, "clock": clock, "record": record, "page": None, "ended": None}
    )
    factor = parse_factor("up", pace)
    if clock == "realtime" and factor != 1.0:
        rule = "be 1 with --clock realtime, which is never faster or slower"
        raise Refusal("up", "--pace", rule, pace)
    streams: dict[str, object] = {
        "rerun_port": rerun_port, "alone": not allow_second, "real_time_factor": factor,
    }  # fmt: skip
    if rerun_file:
        streams["rerun_file"] = rerun_file
    if page is not None:
        address = PageAddress.from_text(page).choose_free_port()
        streams |= {"page_host": address.host, "page_port": address.port}
        os.environ[VARIABLE] = token = make_token()
        output.add_facts({"page": address.write_url(token)})
    if record is not None:
        if record.exists():
            raise Refusal("up", f"folder {record}", "be new", "one that exists")
        streams["record"] = record.resolve()
    with contextlib.suppress(KeyboardInterrupt):
        if params_file is None:  # which may change the servo's gains
            _check_loops(find_scene(scene))
        network = Bringup(
            scene,
            clock=clock,
            start=start,
            emulator=streams,
            namespace=namespace,
            use_sim_time=use_sim_time,
            params_file=params_file,
        )
        with contextlib.suppress(KeyboardInterrupt), network:
            while not CtrlC.signal:  # an interruption in a destructor is lost
                ended = network.find_ended()
                if ended is not None:
                    name, code = ended
                    output.add_facts({"ended": name})
                    print(f"{name} ended with exit code {code}; ending the others")
                    return code if code >= 0 else 128 - code
                time.sleep(0.1)
        if record is not None:
            return max(0, network.stop_nodes().get("emulator", 0))  # 1: its record is not complete
    return 0


def _check_loops(file: Path) -> None:
    """Refuse servos that are unstable on the machine, or warn of them."""
    from arm_emulator.analysis.servo_loop import warn_of_loops
    from arm_emulator.machine.scene.scene import load_scene
    from arm_emulator.runs.gains import check_fit, load_gains, warn_of_gravity

    try:
        scene, gains = load_scene(file), load_gains(file)
    except Refusal:
        return  # the node that reads the file reports
    check_fit(scene, gains.servo, gains.motion)
    warn_of_loops(scene, gains.servo)
    warn_of_gravity(scene, gains.motion)

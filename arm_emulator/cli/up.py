"""`arm_emulator up`: the three nodes until Ctrl-C, or until one of them ends."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from arm_emulator.base.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.bringup import Bringup
from arm_emulator.ros.ctrl_c import CtrlC


def up(
    scene: str,
    clock: str,
    start: str,
    rerun_port: int,
    rerun_file: str,
    *,
    record: Path | None = None,
    namespace: str = "",
    use_sim_time: bool = False,
    params_file: Path | None = None,
) -> int:
    """Run the network and return the exit code; see `Bringup` for the arguments.

    `record` is the folder of a new bag, written by the emulator. The exit code is that of the node
    that ended first (128 + the signal's number if a signal ended it), and 0 on Ctrl-C or SIGTERM.
    """
    streams: dict[str, object] = {"rerun_port": rerun_port}
    if rerun_file:
        streams["rerun_file"] = rerun_file
    if record is not None:
        if record.exists():
            raise Refusal("up", f"folder {record}", "be new", "one that exists")
        streams["record"] = record.resolve()
    CtrlC()
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
            while True:
                ended = network.ended()
                if ended is not None:
                    name, code = ended
                    print(f"{name} ended with exit code {code}; ending the others")
                    return code if code >= 0 else 128 - code
                time.sleep(0.1)
        if record is not None:
            return max(0, network.stop().get("emulator", 0))  # 1: its record is not complete
    return 0


def _check_loops(file: Path) -> None:
    """Refuse servos that are unstable on the machine, or warn of them."""
    from arm_emulator.analysis.servo_loop import warn_of_loops
    from arm_emulator.machine.scene import load_scene
    from arm_emulator.runs.gains import check_fit, load_gains, warn_of_gravity

    try:
        scene, gains = load_scene(file), load_gains(file)
    except Refusal:
        return  # the node that reads the file reports
    check_fit(scene, gains.servo, gains.motion)
    warn_of_loops(scene, gains.servo)
    warn_of_gravity(scene, gains.motion)

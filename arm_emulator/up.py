"""`arm_emulator up`: the three nodes until Ctrl-C, or until one of them ends."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from arm_emulator.bringup import Bringup
from ros_shell.ctrl_c import CtrlC
from words.refusal import Refusal


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

    `record` is the folder of a new bag, written by the emulator.

    It is that of the node that ended first (128 + the signal's number if a signal ended it), and 0
    on Ctrl-C or SIGTERM.
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

"""`arm_emulator up`: the three nodes until Ctrl-C, or until one of them ends."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

from arm_emulator.bringup import Bringup
from arm_emulator.ctrl_c import CtrlC


def up(
    scene: str,
    clock: str,
    start: str,
    rerun_port: int,
    rerun_file: str,
    *,
    namespace: str = "",
    use_sim_time: bool = False,
    params_file: Path | None = None,
) -> int:
    """Run the network and return the exit code; see `Bringup` for the arguments.

    It is that of the node that ended first (128 + the signal's number if a signal ended it), and 0
    on Ctrl-C or SIGTERM.
    """
    streams: dict[str, object] = {"rerun_port": rerun_port}
    if rerun_file:
        streams["rerun_file"] = rerun_file
    CtrlC()
    with (
        contextlib.suppress(KeyboardInterrupt),
        Bringup(
            scene,
            clock=clock,
            start=start,
            emulator=streams,
            namespace=namespace,
            use_sim_time=use_sim_time,
            params_file=params_file,
        ) as network,
    ):
        while True:
            ended = network.ended()
            if ended is not None:
                name, code = ended
                print(f"{name} ended with exit code {code}; ending the others")
                return code if code >= 0 else 128 - code
            time.sleep(0.1)
    return 0

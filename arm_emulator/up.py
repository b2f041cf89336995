"""`arm_emulator up`: the three nodes until Ctrl-C, or until one of them ends."""

from __future__ import annotations

import contextlib
import time

from arm_emulator.bringup import Bringup


def up(scene: str, clock: str, start: str, rerun_port: int, rerun_file: str) -> int:
    """Run the network and return the exit code: that of the node that ended first, 0 on Ctrl-C."""
    streams: dict[str, object] = {"rerun_port": rerun_port}
    if rerun_file:
        streams["rerun_file"] = rerun_file
    with (
        contextlib.suppress(KeyboardInterrupt),
        Bringup(scene, clock=clock, start=start, emulator=streams) as network,
    ):
        while True:
            ended = network.ended()
            if ended is not None:
                name, code = ended
                print(f"{name} ended with exit code {code}; ending the others")
                return code
            time.sleep(0.1)
    return 0

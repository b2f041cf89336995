"""Record the network into a rosbag2 bag."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Topics


@command(until_stopped=True, of_ros=True)
def record(out: Path, /, *, topics: Topics = None, from_start: bool = False) -> int:
    """Record the network into a rosbag2 bag until Ctrl-C.

    Args:
        out: folder of the new bag.
        from_start: reset a machine that is already running: `check-bag` needs a run from tick 0 on.
    """
    from arm_emulator.ros.recorder_presence import RecorderPresence

    # Before anything that takes time: an emulator started together with this command waits.
    with RecorderPresence(topics) as presence:
        from arm_emulator.cli.record import record as write

        return write(out, topics, from_start, presence)

"""Record the network into a rosbag2 bag."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Topics
from arm_emulator.cli.output import output
from arm_emulator.ros.recording.recorder_presence import RecorderPresence


@command(until_stopped=True, keys="`bag`, `messages`, `topics`, `seconds`, `lost`")
def record(out: Path, /, *, topics: Topics = None, from_start: bool = False) -> int:
    """Record the network into a rosbag2 bag until Ctrl-C.

    Args:
        out: folder of the new bag.
        from_start: reset a machine that is already running: `check-bag` needs a run from tick 0 on.
    """
    # Before anything that takes time: an emulator started together with this command waits.
    with RecorderPresence(topics) as presence:
        from arm_emulator.ros.recording.recorder import Recorded
        from arm_emulator.ros.recording.recorder import record as write

        def report(one: Recorded) -> None:
            lost = f"; lost: {one.lost}" if one.lost else ""
            output.line(
                f"{out}: {one.messages} messages on {len(one.topics)} topics in "
                f"{one.seconds:.1f} s{lost}"
            )
            output.facts({
                "bag": out, "messages": one.messages, "topics": one.topics,
                "seconds": one.seconds, "lost": one.lost or None,
                **({"refused": str(one.refused)} if one.refused else {}),
            })  # fmt: skip
            output.end()

        return write(out, topics, from_start, presence, report)

"""Record the network into a rosbag2 bag."""

from pathlib import Path

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Topics
from arm_emulator.cli.output import output
from arm_emulator.ros.recording.recorder_presence import RecorderPresence


@command(until_stopped=True, keys="`bag`, `messages`, `topics`, `seconds`, `lost`")
def record_network(out: Path, /, *, topics: Topics = None, from_start: bool = False) -> int:
    """Record the network into a rosbag2 bag until Ctrl-C.

    Args:
        out: folder of the new bag.
        from_start: reset a machine that is already running: `check-bag` needs a run from tick 0 on.
    """
    # Before anything that takes time: an emulator started together with this command waits.
    with RecorderPresence(topics) as presence:
        from arm_emulator.ros.recording.recorder import Recorded
        from arm_emulator.ros.recording.recorder import record_topics as write

        def report_topic(recorded: Recorded) -> None:
            lost = f"; lost: {recorded.lost}" if recorded.lost else ""
            output.print_line(
                f"{out}: {recorded.messages} messages on {len(recorded.topics)} topics in "
                f"{recorded.seconds:.1f} s{lost}"
            )
            output.add_facts({
                "bag": out, "messages": recorded.messages, "topics": recorded.topics,
                "seconds": recorded.seconds, "lost": recorded.lost or None,
                **({"refused": str(recorded.refused)} if recorded.refused else {}),
            })  # fmt: skip
            output.print_object()

        return write(out, topics, from_start, presence, report_topic)

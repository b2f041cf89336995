"""Repair the bag of a killed recorder."""

from pathlib import Path

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.output import output
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_writer import repair_bag as mend


@command(keys="`bag`, `messages`, `mended`")
def repair_bag(bag: Path, /) -> int:
    """Repair a bag whose recorder was killed.

    Args:
        bag: folder of the bag.
    """
    try:
        mended = mend(bag)
    except OSError as error:
        raise Refusal("repair", str(bag), "be writable", error.strerror) from None
    count = sum(topic.count for topic in Bag(bag).topics.values())
    output.add_facts({"bag": bag, "messages": count, "mended": mended})
    output.print_line(f"{bag}: {count} messages, {'mended' if mended else 'was whole already'}")
    return 0

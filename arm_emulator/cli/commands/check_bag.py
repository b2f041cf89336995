"""Drive the machine again with recorded commands and compare every bit."""

import dataclasses
from pathlib import Path

from arm_emulator.bags.comparison import compare_bag
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.ros.recording.bag_metadata import ARITHMETIC_OF, FORKED_AT, PARENT
from arm_emulator.toolchain.flags import ARITHMETIC


@command(
    keys=(
        "`bag`, `scene`, `clock`, `equal`, `difference`, `counts`, `not_compared`, "
        "`topics_not_compared`, `about` (facts that the bag has of itself, such as the parent "
        "of a fork)"
    ),
)
def check_bag(bag: Path, /, *, scene: SceneName | None = None, strict: bool = False) -> int:
    """Drive the machine again with the commands of a bag, and compare every bit.

    Args:
        bag: folder of the bag.
        scene: scene file or name (default: the one that the bag names).
        strict: exit code 1 also if any message is not compared.
    """
    compared = compare_bag(bag, scene)
    tally, left_out, difference = compared.tally, compared.left_out, compared.difference
    clock = "" if compared.lockstep else " in real time"
    output.print_line(f"scene {compared.scene}{clock}: {tally.compared}")
    if parent := compared.about.get(PARENT):
        output.print_line(f"forked from {parent} at tick {compared.about.get(FORKED_AT)}")
    recorded_in = compared.about.get(ARITHMETIC_OF, ARITHMETIC)  # other recorders name none
    if recorded_in != ARITHMETIC:
        output.print_line(f"recorded in another arithmetic, {recorded_in}; this is {ARITHMETIC}")
    output.print_line(
        f"compared: {'; '.join(f'{name} ({of})' for name, of in compared.fields.items())}"
    )
    for line in left_out:
        output.print_line(f"not compared: {line}")
    if compared.others:
        output.print_line(f"topics that are not compared: {', '.join(compared.others)}")
    output.add_facts(
        {
            "bag": bag,
            "scene": compared.scene,
            "clock": "lockstep" if compared.lockstep else "realtime",
            "equal": difference is None,
            "difference": difference,
            "counts": dataclasses.asdict(tally),
            "not_compared": left_out,
            "topics_not_compared": compared.others,
            "about": compared.about,
        }
    )
    if difference is not None:
        output.print_line(f"the first difference: {difference}")
        for hint in compared.hints:
            output.print_line(f"note: {hint}")
    elif tally.after:
        output.print_line("not checked to its end; what was compared is equal to the last bit")
    else:
        output.print_line(
            f"equal to the last bit{', as far as it was compared' if left_out else ''}"
        )
    return int(bool(difference or tally.after or (strict and left_out)))

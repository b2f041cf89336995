"""`arm_emulator check-bag`: compare a bag with the machine driven again, and print the outcome."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from arm_emulator.bags.comparison import compare
from arm_emulator.cli.output import Output


def check(path: Path, scene_name: str | None, strict: bool = False, *, json: bool = False) -> int:
    """Compare, and print the compared and omitted messages and the outcome.

    The exit code is 0 if all is equal; 1 at a difference, or if states after the start of a run
    could not be compared; with `strict` also if any other message could not.

    Args:
        path: the bag.
        scene_name: scene file or name; None: the one that the bag names.
        strict: permit no omission.
        json: print one JSON object instead of lines.

    Raises:
        Refusal: the bag is damaged or contains nothing to check, or there is no scene.
    """
    found = compare(path, scene_name)
    tally, left_out, difference = found.tally, found.left_out, found.difference
    output = Output(json)
    clock = "" if found.lockstep else " in real time"
    output.line(f"scene {found.scene}{clock}: {tally.compared}")
    output.line(f"compared: {'; '.join(f'{name} ({of})' for name, of in found.fields.items())}")
    for line in left_out:
        output.line(f"not compared: {line}")
    if found.others:
        output.line(f"topics that are not compared: {', '.join(found.others)}")
    output.facts(
        {
            "scene": found.scene,
            "clock": "lockstep" if found.lockstep else "realtime",
            "equal": difference is None,
            "difference": difference,
            "counts": dataclasses.asdict(tally),
            "not_compared": left_out,
            "topics_not_compared": found.others,
        }
    )
    if difference is not None:
        output.line(f"the first difference: {difference}")
        for hint in found.hints:
            output.line(f"note: {hint}")
    elif tally.after:
        output.line("not checked to its end; what was compared is equal to the last bit")
    else:
        output.line(f"equal to the last bit{', as far as it was compared' if left_out else ''}")
    return int(bool(difference or tally.after or (strict and left_out)))

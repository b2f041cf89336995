"""Drive the machine again with recorded commands and compare every bit."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, SceneName


@command(of_ros=True)
def check_bag(
    bag: Path, /, *, scene: SceneName | None = None, strict: bool = False, json: Json = False
) -> int:
    """Drive the machine again with the commands of a bag, and compare every bit.

    Args:
        bag: folder of the bag.
        scene: scene file or name (default: the one that the bag names).
        strict: exit code 1 also if any message is not compared.
    """
    from arm_emulator.cli.check_bag import check

    return check(bag, scene, strict, json=json)

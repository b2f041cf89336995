"""Check what this machine has of what the emulator needs, and what an earlier run left behind."""

from __future__ import annotations

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json


@command()
def doctor(*, json: Json = False) -> int:
    """Check compiler, packages, ROS, processes, shared memory and disk: a line each, with a remedy.

    The exit code is 1 where something is a problem. What only some commands need is a note.
    """
    from arm_emulator.cli.doctor import doctor as examine

    return examine(json=json)

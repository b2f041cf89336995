"""Check this machine for the emulator's needs, and for remains of earlier runs."""

from __future__ import annotations

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json


@command()
def doctor(*, json: Json = False) -> int:
    """Check compiler, packages, ROS, processes, shared memory and disk: a line each, with a remedy.

    The exit code is 1 if there is a problem. A missing package of some commands is a note.
    """
    from arm_emulator.cli.doctor import doctor as examine

    return examine(json=json)

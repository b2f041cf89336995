"""List the faults that a scene may have."""

from __future__ import annotations

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json, SceneName


@command()
def faults(scene: SceneName = "three_axis", /, *, json: Json = False) -> int:
    """List the faults that a scene may have, and which of them it lists."""
    from arm_emulator.cli.faults import list_faults

    return list_faults(scene, json=json)

"""List the compiled scenes that are kept."""

from __future__ import annotations

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Json


@command()
def cache(*, clear: bool = False, json: Json = False) -> int:
    """List the compiled scenes that are kept, or remove them.

    Args:
        clear: remove them.
    """
    from arm_emulator.cli.cache import clear_cache, list_cache

    return clear_cache() if clear else list_cache(json)

"""Publish the messages of a bag at the recorded times."""

from __future__ import annotations

from pathlib import Path

from arm_emulator.cli.command import command
from arm_emulator.cli.options import Topics


@command(until_stopped=True, of_ros=True)
def replay(bag: Path, /, *, topics: Topics = None, rate: float = 1.0, wait: bool = False) -> int:
    """Publish the messages of a bag at the recorded times.

    Args:
        bag: folder of the bag.
        rate: recorded seconds per second.
        wait: begin when every topic has a subscriber.
    """
    from arm_emulator.cli.replay import replay as publish

    return publish(bag, topics, rate, wait)

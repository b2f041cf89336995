"""Recorders of this machine, known to an emulator before the network discovers them.

Discovery takes its time, on a busy machine seconds: until then an emulator that starts cannot know
whether a recorder waits for its first tick. So a recorder holds a name without a file, which
ends with its process however that ends, and which reaches as far as the loopback interface does.
"""

from __future__ import annotations

import os
import re
import secrets
import socket
from collections.abc import Collection
from pathlib import Path

RECORDER = re.compile(r"\d+\.[0-9a-f]{8}")  # how recorders are named
STATES = "motor_states"  # last part of the topic on which an emulator publishes its states
LONGEST = 107  # bytes of an abstract socket's name
ALL = "/*"


class RecorderPresence:
    """Announces a recorder to the emulators on this machine, until `close`.

    Args:
        topics: names of the topics that are recorded, with or without the leading ``/``; None: all.

    Attributes:
        recorder: a name that no other recorder has.
    """

    def __init__(self, topics: Collection[str] | None) -> None:
        self.recorder = f"{os.getpid()}.{secrets.token_hex(4)}"
        self._held: list[socket.socket] = []
        for topic in (ALL,) if topics is None else topics:
            if topic != ALL and topic.rsplit("/")[-1] != STATES:
                continue  # no emulator needs to wait for it
            name = f"{_prefix()}{self.recorder}/{topic.lstrip('/')}"
            if len(name.encode()) > LONGEST:
                name = f"{_prefix()}{self.recorder}{ALL}"
            one = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._held.append(one)
            one.bind(name)

    def __enter__(self) -> RecorderPresence:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Be here no longer."""
        for one in self._held:
            one.close()


def recorders_of(states: str) -> set[str]:
    """Return the names of the recorders on this machine that record a topic of motor states."""
    try:
        table = Path("/proc/net/unix").read_text(encoding="utf-8", errors="replace")
    except OSError:  # not Linux: they are known when the network discovers them
        return set()
    prefix, found = _prefix().replace("\0", "@"), set()
    for line in table.splitlines():
        _, sign, name = line.partition(prefix)
        recorder, slash, topic = name.partition("/")
        if sign and slash and f"/{topic}" in (states, ALL):
            found.add(recorder)
    return found


def _prefix() -> str:
    return f"\0arm_emulator: recorder {os.environ.get('ROS_DOMAIN_ID') or 0} "

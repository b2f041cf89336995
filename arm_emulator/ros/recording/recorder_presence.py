"""Recorders on this computer, known to an emulator before the network discovers them.

Discovery takes time, on a busy machine seconds: until then a starting emulator cannot know whether
a recorder waits for its first tick. A recorder therefore holds a name without a file, which
disappears with its process in any case, and is visible within the loopback interface.
"""

import os
import re
import secrets
import socket
from collections.abc import Collection
from pathlib import Path
from typing import Self

RECORDER = re.compile(r"\d+\.[0-9a-f]{8}")  # names of recorders
NAME = "recorder"  # of its node
STATES = "motor_states"  # last part of the topic on which an emulator publishes its states
LONGEST = 107  # bytes of an abstract socket's name
ALL = "/*"


class RecorderPresence:
    """Announces a recorder to the emulators on this computer, until `close`.

    Args:
        topics: names of the topics that are recorded, with or without the leading ``/``; None: all.

    Attributes:
        recorder: unique name.
    """

    def __init__(self, topics: Collection[str] | None) -> None:
        self.recorder = f"{os.getpid()}.{secrets.token_hex(4)}"
        self._sockets: list[socket.socket] = []
        start = f"{_get_prefix()}{self.recorder}"
        names = set[str]()
        for topic in (ALL,) if topics is None else topics:
            name = f"{start}/{topic.lstrip('/')}"
            if len(name.encode()) <= LONGEST:
                names.add(name)
            elif topic.rsplit("/")[-1] == STATES:  # an emulator has to wait for it
                names.add(f"{start}{ALL}")
        for name in names:
            opened = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._sockets.append(opened)
            opened.bind(name)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the announcement."""
        for opened in self._sockets:
            opened.close()


def list_recorders(topic: str) -> set[str]:
    """Return the names of the recorders on this computer that record a topic."""
    try:
        table = Path("/proc/net/unix").read_text(encoding="utf-8", errors="replace")
    except OSError:  # not Linux: only the network discovers them
        return set()
    prefix, recorders = _get_prefix().replace("\0", "@"), set()
    for line in table.splitlines():
        _, sign, name = line.partition(prefix)
        recorder, slash, recorded = name.partition("/")
        if sign and slash and f"/{recorded}" in (topic, ALL):
            recorders.add(recorder)
    return recorders


def _get_prefix() -> str:
    return f"\0arm_emulator: recorder {os.environ.get('ROS_DOMAIN_ID') or 0} "

"""Recorded messages, in the order in which a replay gives them."""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from typing import Any

from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds
from arm_emulator.ros.recording.bag import BagMessage
from arm_emulator_msgs.msg import MotionStatus

AHEAD = 1000  # messages: how far a message with the right stamp may be behind others


class StampedMessages:
    """Recorded messages of a topic, found by their keys in the order of the bag."""

    def __init__(self, messages: list[tuple[int, bytes]]) -> None:
        self._messages, self._next = messages, 0
        self._places: dict[int, list[int]] = {}
        for place, (key, _) in enumerate(messages):
            self._places.setdefault(key, []).append(place)

    @property
    def is_over(self) -> bool:
        """Whether messages were taken, up to the last one."""
        return 0 < len(self._messages) == self._next

    @property
    def period(self) -> int:
        """Difference of the last two keys; 0: there are not two."""
        last = [*self._places][-2:]
        return last[1] - last[0] if len(last) == 2 else 0

    def take_message(self, key: int) -> bytes | None:
        """Return the next message with a key, or None if none is near."""
        places = self._places.get(key, [])
        k = bisect.bisect_left(places, self._next)
        if k == len(places) or places[k] - self._next > AHEAD:
            return None
        self._next = places[k] + 1
        return self._messages[places[k]][1]


@dataclass(frozen=True)
class ReplayedOrder:
    """An order to the node under test, and when it was taken in the recording."""

    topic: str
    data: bytes
    published: int  # wall time [ns]
    run: int  # number of its run
    after: int | None  # stamp of the joint states after which it was taken [ns]; None: not known
    first: bool  # it was taken before any
    kind: int  # of its status; 0: it has none


class RecordedMessage:
    """A recorded message, and its bytes.

    Attributes:
        message: the message.
        data: its bytes.
        published: wall time [ns].
    """

    def __init__(self, message: Any, record: BagMessage) -> None:
        self.message, self.data, self.published = message, record.data, record.published

    @property
    def stamp(self) -> int:
        """Logical time of its header [ns]."""
        return get_stamp(self.message)

    @property
    def key(self) -> int:
        """The number that question and answer have in common."""
        return get_key(self.message)


STATES_OF_TAKEN_ORDERS = (MotionStatus.STATE_ACCEPTED, MotionStatus.STATE_REFUSED)
_JOINT_NUMBERS = ("position", "velocity", "effort")


def get_stamp(message: Any) -> int:
    """Return the logical time of a message's header [ns]."""
    return convert_to_nanoseconds(message.header.stamp)


def get_key(message: Any) -> int:
    """Return what question and answer have in common: the tick, or else the stamp."""
    return int(message.tick) if hasattr(message, "tick") else get_stamp(message)


def get_number_bytes(message: Any) -> bytes:
    """Return the bits of an answer's numbers."""
    names = ("command", "inputs") if hasattr(message, "command") else _JOINT_NUMBERS
    return b"".join(getattr(message, name).tobytes() for name in names)

"""Messages that C has taken and published, written into the emulator's own record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from arm_emulator.ros.c import MESSAGES, MIDDLEWARE
from arm_emulator.ros.messages.middleware import Outgoing
from arm_emulator.toolchain.c_header import CData

if TYPE_CHECKING:
    from arm_emulator.ros.recording.run_record import (
        RunRecord,  # a stock machine may lack packages for bags
    )

HEAD = MESSAGES.get_constant("ROS_LOG_HEAD")


def compute_log_room(ticks: int, outgoing: Sequence[Outgoing], commands: int) -> int:
    """Return the room that the messages of some ticks need [bytes].

    Args:
        ticks: how many.
        outgoing: messages of a tick.
        commands: largest size of the commands that answer it [bytes].
    """
    sizes = [commands, *(message.layout.size for message in outgoing)]
    return ticks * sum(HEAD + size for size in sizes)


def record_log(record: RunRecord, log: CData, outgoing: Sequence[Outgoing], commands: str) -> None:
    """Write what a log has kept.

    Args:
        record: to write into.
        log: ``ros_log *``, in which messages have the place in `outgoing` as their number, motor
            states the first.
        outgoing: messages of a tick.
        commands: topic of the commands, whose number is the next one.
    """
    data = MIDDLEWARE.ffi.buffer(log.data, log.used)
    topics = [*(message.publisher.topic_name for message in outgoing), commands]
    tick_at = outgoing[0].layout.places["tick"]
    at = 0
    while at < len(data):
        number, size, wall = np.frombuffer(data[at : at + HEAD], np.int64).tolist()
        at += HEAD
        message = data[at : at + size]
        if number == 0:
            record.count_tick(int.from_bytes(message[tick_at : tick_at + 8], "little"))
        record.add_message(topics[number], message, wall)
        at += size
    record.dropped += log.dropped

"""Time stamps of messages, as logical times."""

from typing import Any

from builtin_interfaces.msg import Time

from arm_emulator.base.refusal import Refusal

NANOSECONDS = 1_000_000_000


def convert_to_stamp(nanoseconds: int) -> Time:
    """Return a message's time stamp for a logical time [ns]."""
    return Time(sec=nanoseconds // NANOSECONDS, nanosec=nanoseconds % NANOSECONDS)


def set_stamp(stamp: Any, nanoseconds: int) -> None:
    """Set the fields of a time stamp in place to a logical time [ns]."""
    stamp.sec, stamp.nanosec = divmod(nanoseconds, NANOSECONDS)


def convert_to_nanoseconds(stamp: Time) -> int:
    """Return the logical time [ns] of a message's time stamp."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def check_time(where: str, stamp: Time) -> int:
    """Return the logical time [ns] of a stamp that came from outside.

    Raises:
        Refusal: the time is negative or malformed.
    """
    if stamp.sec < 0 or stamp.nanosec >= NANOSECONDS:
        actual = f"{stamp.sec} s and {stamp.nanosec} ns"
        raise Refusal(
            where, "header.stamp", "be a logical time >= 0 s, with less than 1e9 ns", actual
        )
    return convert_to_nanoseconds(stamp)

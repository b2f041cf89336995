"""Block transfers of service data objects, seen from the server (CiA 301, 7.2.4.3.9 to 7.2.4.3.17).

A block is up to 127 segments of 7 bytes, which are confirmed together.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Callable

BLOCK_SIZE, SEQUENCE, CHECKSUM = 0x05040002, 0x05040003, 0x05040004
COMMAND, MEMORY, WRONG_LENGTH = 0x05040001, 0x05040005, 0x06070010
LARGEST_BLOCK = 127  # segments
LAST = 0x80  # bit of a segment

Abort = Callable[[int], Exception]


class BlockUpload:
    """A value on its way to the client.

    Args:
        value: all of it.
        segments: in a block, as the client wants.
        with_crc: whether the client checks.
        abort: makes the exception for an abort code.
    """

    def __init__(self, value: bytes, segments: int, with_crc: bool, abort: Abort) -> None:
        if not 1 <= segments <= LARGEST_BLOCK:
            raise abort(BLOCK_SIZE)
        self._value, self._segments, self._with_crc, self._abort = value, segments, with_crc, abort
        self._at = 0  # bytes that the client has confirmed
        self._sent = 0  # segments of the block that is on its way
        self._started = False

    def answer(self, request: bytes) -> list[bytes] | None:
        """Return what is sent for a request of the client; None: the transfer is over."""
        command = request[0]
        if command == 0xA3 and not self._started:
            self._started = True
            return self._block()
        if command == 0xA2 and self._started and self._sent:
            confirmed, self._segments = request[1], request[2]
            if confirmed > self._sent:
                raise self._abort(SEQUENCE)
            if not 1 <= self._segments <= LARGEST_BLOCK:
                raise self._abort(BLOCK_SIZE)
            self._at = min(self._at + 7 * confirmed, len(self._value))
            return self._block() if self._at < len(self._value) else [self._end()]
        if command == 0xA1 and self._started and not self._sent:
            return None
        raise self._abort(COMMAND)

    def _block(self) -> list[bytes]:
        frames = []
        for number in range(1, self._segments + 1):
            begin = self._at + 7 * (number - 1)
            part = self._value[begin : begin + 7]
            last = begin + 7 >= len(self._value)
            frames.append(bytes((number | LAST * last,)) + part.ljust(7, b"\0"))
            if last:
                break
        self._sent = len(frames)
        return frames

    def _end(self) -> bytes:
        self._sent = 0
        unused = -len(self._value) % 7 if self._value else 7
        check = binascii.crc_hqx(self._value, 0) if self._with_crc else 0
        return struct.pack("<BH5x", 0xC1 | unused << 2, check)


class BlockDownload:
    """A value on its way from the client.

    Args:
        announced: bytes of it; None: not said.
        largest: bytes that are taken.
        with_crc: whether the client sends a checksum.
        abort: makes the exception for an abort code.
        take: gets the value when all of it is there.
    """

    def __init__(
        self,
        announced: int | None,
        largest: int,
        with_crc: bool,
        abort: Abort,
        take: Callable[[bytes], None],
    ) -> None:
        if (announced or 0) > largest:
            raise abort(MEMORY)
        self._announced, self._largest, self._with_crc = announced, largest, with_crc
        self._abort, self._take = abort, take
        self._value = bytearray()
        self._number = 0  # of the segment that came last in its turn
        self._seen = 0  # and of the one that came last at all
        self._complete = False

    def answer(self, request: bytes) -> list[bytes] | None:
        """Return what is sent for a request of the client; None: 0xA1, and the transfer is over."""
        if self._complete:
            self._finish(request)
            return None
        number, last = request[0] & 0x7F, bool(request[0] & LAST)
        if number == 0 or number <= self._seen:
            raise self._abort(SEQUENCE)
        self._seen = number
        if number == self._number + 1:  # one that was lost is sent again, and all after it
            self._number = number
            self._value += request[1:]
            if len(self._value) > self._largest + 7:
                raise self._abort(MEMORY)
            self._complete = last
        if not (last or number == LARGEST_BLOCK):
            return []
        confirmed, self._number, self._seen = self._number, 0, 0
        return [bytes((0xA2, confirmed, LARGEST_BLOCK)) + bytes(5)]

    def _finish(self, request: bytes) -> None:
        if request[0] & 0xE3 != 0xC1:
            raise self._abort(COMMAND)
        unused = request[0] >> 2 & 7
        value = bytes(self._value[: len(self._value) - unused])
        if self._with_crc and binascii.crc_hqx(value, 0) != request[1] | request[2] << 8:
            raise self._abort(CHECKSUM)
        if self._announced not in (None, len(value)):
            raise self._abort(WRONG_LENGTH)
        self._take(value)

"""The server side of CANopen's service data objects: 8 bytes in, 8 bytes out (CiA 301, 7.2.4).

Expedited and segmented transfers; block transfers are refused.
"""

from __future__ import annotations

import struct
from typing import Protocol

from fieldbus.drives import Aborted

LARGEST_VALUE = 256  # bytes, of a segmented download

TOGGLE, TIMEOUT, COMMAND = 0x05030000, 0x05040000, 0x05040001
MEMORY, WRONG_LENGTH = 0x05040005, 0x06070010


class ObjectDictionary(Protocol):
    """What a server has behind it."""

    def upload(self, index: int, sub: int) -> bytes:
        """Return the bytes of an entry; raise `Aborted` if it cannot be read."""

    def download(self, index: int, sub: int, value: bytes) -> None:
        """Write an entry; raise `Aborted` if it is not taken, and nothing has changed then."""

    def length(self, index: int, sub: int) -> int:
        """Return how many bytes a number has; 4 if there is no such entry."""


class SdoServer:
    """One server, which serves one transfer at a time."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self.reset()

    def reset(self) -> None:
        """Forget a transfer that is under way."""
        self._at = (0, 0)  # index and sub that the transfer is about
        self._left: bytes | None = None  # to be uploaded
        self._taken: bytearray | None = None  # downloaded so far
        self._announced: int | None = None  # bytes of the download
        self._toggle = 0

    def answer(self, request: bytes) -> bytes:
        """Return the reply to a request, empty where none is due."""
        if len(request) != 8:
            return b""
        command = request[0]
        try:
            match command >> 5:
                case 0:
                    return self._take_segment(command, request[1:])
                case 1:
                    return self._begin_download(request)
                case 2:
                    return self._begin_upload(request)
                case 3:
                    return self._give_segment(command)
                case 4:  # the client has aborted
                    self.reset()
                    return b""
            self.reset()
            self._at = _multiplexer(request)
            raise Aborted(*self._at, COMMAND)
        except Aborted as no:
            at = self._at
            self.reset()
            return struct.pack("<BHBI", 0x80, *at, no.code)

    def _begin_upload(self, request: bytes) -> bytes:
        self.reset()
        self._at = at = _multiplexer(request)
        value = self._dictionary.upload(*at)
        size = len(value)
        if 1 <= size <= 4:
            return struct.pack("<BHB", 0x43 | (4 - size) << 2, *at) + value.ljust(4, b"\0")
        self._left = value
        return struct.pack("<BHBI", 0x41, *at, size)

    def _give_segment(self, command: int) -> bytes:
        if self._left is None:
            raise Aborted(*self._at, COMMAND)
        self._check_toggle(command)
        part, self._left = self._left[:7], self._left[7:]
        last = not self._left
        head = self._toggle | (7 - len(part)) << 1 | last
        self._toggle ^= 0x10
        if last:
            self.reset()
        return bytes((head,)) + part.ljust(7, b"\0")

    def _begin_download(self, request: bytes) -> bytes:
        self.reset()
        self._at = at = _multiplexer(request)
        command, expedited, sized = request[0], request[0] & 2, request[0] & 1
        if expedited:
            size = 4 - (command >> 2 & 3) if sized else min(self._dictionary.length(*at), 4)
            self._dictionary.download(*at, request[4 : 4 + size])
        else:
            self._announced = struct.unpack("<I", request[4:])[0] if sized else None
            if (self._announced or 0) > LARGEST_VALUE:
                raise Aborted(*at, MEMORY)
            self._taken = bytearray()
        return struct.pack("<BHBI", 0x60, *at, 0)

    def _take_segment(self, command: int, data: bytes) -> bytes:
        if self._taken is None:
            raise Aborted(*self._at, COMMAND)
        self._check_toggle(command)
        self._taken += data[: 7 - (command >> 1 & 7)]
        if len(self._taken) > LARGEST_VALUE:
            raise Aborted(*self._at, MEMORY)
        reply = bytes((0x20 | self._toggle,)) + bytes(7)
        self._toggle ^= 0x10
        if command & 1:
            if self._announced not in (None, len(self._taken)):
                raise Aborted(*self._at, WRONG_LENGTH)
            self._dictionary.download(*self._at, bytes(self._taken))
            self.reset()
        return reply

    def _check_toggle(self, command: int) -> None:
        if command & 0x10 != self._toggle:
            raise Aborted(*self._at, TOGGLE)


def _multiplexer(request: bytes) -> tuple[int, int]:
    return request[1] | request[2] << 8, request[3]

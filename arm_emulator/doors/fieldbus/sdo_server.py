"""The server side of CANopen's service data objects: 8 bytes in, 8 bytes out (CiA 301, 7.2.4).

Expedited and segmented transfers; those by blocks are in sdo_block.py.
"""

from __future__ import annotations

import struct
from typing import Protocol

from arm_emulator.doors.fieldbus.drives import Aborted
from arm_emulator.doors.fieldbus.sdo_block import LARGEST_BLOCK, BlockDownload, BlockUpload

LARGEST_VALUE = 256  # bytes, of a segmented download

TOGGLE, COMMAND = 0x05030000, 0x05040001
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
        self._blocks: BlockUpload | BlockDownload | None = None

    def answer(self, request: bytes) -> list[bytes]:
        """Return the replies to a request, if any are due."""
        if len(request) != 8:
            return []
        try:
            if self._blocks is not None and request[0] != 0x80:
                return self._go_on(self._blocks, request)
            reply = self._serve(request)
        except Aborted as no:
            reply = struct.pack("<BHBI", 0x80, *self._at, no.code)
            self.reset()
        return [reply] if reply else []

    def _serve(self, request: bytes) -> bytes:
        command = request[0]
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
            case 5 if not command & 3:
                return self._begin_block_upload(request)
            case 6 if not command & 1:
                return self._begin_block_download(request)
        self.reset()
        self._at = _multiplexer(request)
        raise Aborted(*self._at, COMMAND)

    def _begin_block_upload(self, request: bytes) -> bytes:
        self.reset()
        self._at = at = _multiplexer(request)
        value, with_crc = self._dictionary.upload(*at), bool(request[0] & 4)
        self._blocks = BlockUpload(value, request[4], with_crc, self._abort)
        return struct.pack("<BHBI", 0xC6, *at, len(value))

    def _begin_block_download(self, request: bytes) -> bytes:
        self.reset()
        self._at = at = _multiplexer(request)
        announced = struct.unpack("<I", request[4:])[0] if request[0] & 2 else None
        self._blocks = BlockDownload(
            announced,
            LARGEST_VALUE,
            bool(request[0] & 4),
            self._abort,
            lambda value: self._dictionary.download(*at, value),
        )
        return struct.pack("<BHBB3x", 0xA4, *at, LARGEST_BLOCK)

    def _go_on(self, blocks: BlockUpload | BlockDownload, request: bytes) -> list[bytes]:
        replies = blocks.answer(request)
        if replies is not None:
            return replies
        self.reset()
        return [b"\xa1" + bytes(7)] if isinstance(blocks, BlockDownload) else []

    def _abort(self, code: int) -> Aborted:
        return Aborted(*self._at, code)

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

"""Modbus over a serial line: frames, functions, exceptions. Bytes in, bytes out.

After "Modbus application protocol specification V1.1b3" and "Modbus over serial line V1.02"
(modbus.org). Input and holding registers of a station are one and the same table.
"""

import enum
import struct
from collections.abc import Callable, Sequence
from typing import Protocol

BROADCAST = 0
LARGEST_STATION = 247
LARGEST_FRAME = 256  # bytes


class Function(enum.IntEnum):
    """Function codes of requests."""

    READ_HOLDING = 3
    READ_INPUT = 4
    WRITE_SINGLE = 6
    DIAGNOSTICS = 8
    WRITE = 16
    READ_WRITE = 23


class Code(enum.IntEnum):
    """Reasons of an exception."""

    FUNCTION = 1
    ADDRESS = 2
    VALUE = 3
    FAILURE = 4


class ModbusException(Exception):
    """Exception response of a station."""

    def __init__(self, code: Code) -> None:
        self.code = code
        super().__init__(code.name)


class Registers(Protocol):
    """Registers of a station: words of 16 bits."""

    def read(self, address: int, count: int) -> Sequence[int]:
        """Return `count` words from an address on.

        Raises:
            ModbusException: not all of these addresses exist.
        """

    def write(self, address: int, words: Sequence[int]) -> None:
        """Write words from an address on, all of them or none.

        Raises:
            ModbusException: nothing has changed.
        """


def _make_crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ (0xA001 if byte & 1 else 0)
        table.append(byte)
    return tuple(table)


_CRC = _make_crc_table()


def compute_crc(data: bytes) -> int:
    """Return the checksum of a frame: x^16 + x^15 + x^2 + 1, bits reversed, begun with ones.

    It detects every odd number of flipped bits, every two of them and every burst of up to 16 bits.
    Of other damage it misses one case in 65536.
    """
    value, table = 0xFFFF, _CRC
    for byte in data:
        value = value >> 8 ^ table[(value ^ byte) & 0xFF]
    return value


def make_frame(station: int, body: bytes) -> bytes:
    """Return the bytes of a frame: station, function and data, checksum (low byte first)."""
    data = bytes((station,)) + body
    return data + struct.pack("<H", compute_crc(data))


def is_sound(data: bytes) -> bool:
    """Return whether a frame has a permitted length and the right checksum."""
    return 4 <= len(data) <= LARGEST_FRAME and compute_crc(data[:-2]) == data[-2] | data[-1] << 8


# Bytes of a request with its checksum, by its function; and the place of a byte that counts more.
_LENGTHS = {1: 8, 2: 8, 3: 8, 4: 8, 5: 8, 6: 8, 7: 4, 8: 8, 11: 4, 12: 4, 17: 4, 22: 10, 24: 6}
_COUNTED = {15: (9, 6), 16: (9, 6), 20: (5, 2), 21: (5, 2), 23: (13, 10)}


def measure_request(data: bytes | bytearray) -> int | None:
    """Return the length of a request by its first bytes; None: not known (yet)."""
    if len(data) < 2:
        return None
    function = data[1]
    if function in _COUNTED:
        length, at = _COUNTED[function]
        return length + data[at] if len(data) > at else None
    return _LENGTHS.get(function)


class FrameReceiver:
    """Finds requests in the bytes of a line.

    A request ends where a silence of 3.5 characters begins. Where the receiver need not wait for
    it, it does not: bytes that have the length of their function, and the right checksum,
    are a request as soon as they are there. Other bytes stay until the silence, and are dropped
    then unless all together have the right checksum.

    Attributes:
        damaged: how often bytes were dropped.
    """

    def __init__(self) -> None:
        self._bytes = bytearray()
        self.damaged = 0

    @property
    def has_partial(self) -> bool:
        """Whether there are bytes that wait for more, or for silence."""
        return bool(self._bytes)

    def take_bytes(self, data: bytes) -> list[bytes]:
        """Take bytes, and return the requests that are complete."""
        buffer = self._bytes
        buffer += data
        requests = []
        while (length := measure_request(buffer)) and len(buffer) >= length:
            request = bytes(buffer[:length])
            if not is_sound(request):
                break
            requests.append(request)
            del buffer[:length]
        # Nothing of a frame that is too long is kept; the silence after it is still to come.
        del buffer[LARGEST_FRAME + 1 :]
        return requests

    def note_silence(self) -> list[bytes]:
        """Take note that nothing came for 3.5 characters; return the request that ended so."""
        data = bytes(self._bytes)
        self._bytes.clear()
        if not data:
            return []
        # A request whose length does not fit its function was damaged, whatever its checksum.
        if is_sound(data) and measure_request(data) in (None, len(data)):
            return [data]
        self.damaged += 1
        return []


class Counters:
    """Diagnostic counters (function 8) of a station since its start or since they were cleared."""

    def __init__(self) -> None:
        self.messages = 0  # on the line, for whichever station
        self.exceptions = 0
        self.served = 0  # for this station, or for all
        self.unanswered = 0


class ModbusStation:
    """A station on the line.

    Attributes:
        counters: for diagnostics.

    Args:
        number: its address, 1 to 247.
        registers: what it has behind its addresses.
        damaged: reports how many frames came damaged, for diagnostics.
    """

    def __init__(
        self, number: int, registers: Registers, damaged: Callable[[], int] = lambda: 0
    ) -> None:
        self.number = number
        self.counters = Counters()
        self._registers = registers
        self._damaged = damaged
        self._damaged_before = 0
        self._functions: dict[int, Callable[[bytes], bytes]] = {
            Function.READ_HOLDING: self._read_registers,
            Function.READ_INPUT: self._read_registers,
            Function.WRITE_SINGLE: self._write_single,
            Function.DIAGNOSTICS: self._read_diagnostics,
            Function.WRITE: self._write_registers,
            Function.READ_WRITE: self._read_write,
        }

    def answer_request(self, request: bytes) -> bytes:
        """Execute a sound frame, and return the reply; empty if none is due."""
        counters = self.counters
        counters.messages += 1
        station, function, data = request[0], request[1], request[2:-2]
        if station not in (self.number, BROADCAST):
            return b""
        counters.served += 1
        serve = self._functions.get(function)
        try:
            if function & 0x80 or serve is None:
                raise ModbusException(Code.FUNCTION)
            if station == BROADCAST and function not in (Function.WRITE_SINGLE, Function.WRITE):
                raise ModbusException(Code.FUNCTION)  # it would ask for a reply
            body = serve(data)
        except ModbusException as no:
            counters.exceptions += 1
            function, body = function | 0x80, bytes((no.code,))
        if station == BROADCAST:
            counters.unanswered += 1
            return b""
        return make_frame(self.number, bytes((function,)) + body)

    def _read_registers(self, data: bytes) -> bytes:
        address, count = _unpack_words(data, 2)
        _check_fit(1 <= count <= 125)
        words = self._registers.read(address, count)
        return struct.pack(f">B{count}H", 2 * count, *words)

    def _write_single(self, data: bytes) -> bytes:
        address, word = _unpack_words(data, 2)
        self._registers.write(address, (word,))
        return data

    def _write_registers(self, data: bytes) -> bytes:
        _check_fit(len(data) >= 5)
        address, count = _unpack_words(data[:4], 2)
        _check_fit(1 <= count <= 123 and data[4] == 2 * count)
        self._registers.write(address, _unpack_words(data[5:], count))
        return data[:4]

    def _read_write(self, data: bytes) -> bytes:
        """Write first, then read, as the standard demands; nothing is written if reading fails."""
        _check_fit(len(data) >= 9)
        address, count, to, written = _unpack_words(data[:8], 4)
        _check_fit(1 <= count <= 125 and 1 <= written <= 121 and data[8] == 2 * written)
        words = _unpack_words(data[9:], written)
        self._registers.read(address, count)
        self._registers.write(to, words)
        return self._read_registers(data[:4])

    def _read_diagnostics(self, data: bytes) -> bytes:
        _check_fit(len(data) >= 2)
        (sub,), rest = _unpack_words(data[:2], 1), data[2:]
        if sub == 0:  # return what was sent
            return data
        counters = self.counters
        reported = {
            2: 0,  # a register without a function
            11: counters.messages,
            12: self._damaged() - self._damaged_before,
            13: counters.exceptions,
            14: counters.served,
            15: counters.unanswered,
        }
        if sub != 10 and sub not in reported:
            raise ModbusException(Code.FUNCTION)
        _check_fit(rest == b"\0\0")
        if sub == 10:  # clear
            self.counters = Counters()
            self._damaged_before = self._damaged()
            return data
        return data[:2] + struct.pack(">H", reported[sub] & 0xFFFF)


def _unpack_words(data: bytes, count: int) -> tuple[int, ...]:
    _check_fit(len(data) == 2 * count)
    return struct.unpack(f">{count}H", data)


def _check_fit(fits: bool) -> None:
    if not fits:
        raise ModbusException(Code.VALUE)

"""A station on a Modbus line, and its master."""

import struct
from collections.abc import Sequence

from arm_emulator import Scene, Session
from arm_emulator_fieldbus.converter import RegisterConverter
from arm_emulator_fieldbus.modbus_line import ModbusLine
from arm_emulator_fieldbus.modbus_rtu import compute_crc, is_sound
from arm_emulator_fieldbus.serial_line import LineErrors

NO_ERRORS = LineErrors(0.0, 0)


class Master:
    """A master in the same process, written from the standard and not from our station."""

    def __init__(self, line: ModbusLine, number: int = 1) -> None:
        self.line, self.number = line, number

    def ask(self, body: bytes) -> bytes:
        """Return the body of the reply to one request on a line without errors."""
        reply = (
            self.line.exchange_bytes(sound(bytes((self.number,)) + body))
            or self.line.note_silence()
        )
        assert is_sound(reply) and reply[0] == self.number
        return reply[1:-2]

    def read(self, address: int, count: int, function: int = 4) -> list[int]:
        body = self.ask(struct.pack(">BHH", function, address, count))
        assert body[:2] == bytes((function, 2 * count)), "function and count of the reply"
        return list(struct.unpack(f">{count}H", body[2:]))

    def write(self, address: int, *words: int) -> None:
        count = len(words)
        body = struct.pack(f">BHHB{count}H", 16, address, count, 2 * count, *words)
        assert self.ask(body) == body[:5]

    def exchange(self, address: int, count: int, to: int, words: Sequence[int]) -> list[int]:
        body = self.ask(read_write(address, count, to, words))
        assert body[:2] == bytes((23, 2 * count))
        return list(struct.unpack(f">{count}H", body[2:]))


def read_write(address: int, count: int, to: int, words: Sequence[int]) -> bytes:
    n = len(words)
    return struct.pack(f">BHHHHB{n}H", 23, address, count, to, n, 2 * n, *words)


def sound(data: bytes) -> bytes:
    return data + struct.pack("<H", compute_crc(data))


def line_of(
    scene: Scene,
    clock: str = "lockstep",
    *,
    baud: int = 115_200,
    watchdog: int = 100,
    errors: LineErrors = NO_ERRORS,
) -> tuple[ModbusLine, RegisterConverter]:
    converter = RegisterConverter(Session(scene, "lockstep", "first_answer"), watchdog)
    return ModbusLine(converter, 1, clock, baud, errors), converter


def long_of(words: Sequence[int]) -> list[int]:
    return list(struct.unpack(f">{len(words) // 2}i", struct.pack(f">{len(words)}H", *words)))

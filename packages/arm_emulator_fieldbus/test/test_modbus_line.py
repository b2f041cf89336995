"""The line of Modbus: checksums, frames in pieces, times, errors."""

import math
import random
import struct
from collections.abc import Sequence

import numpy as np
import pytest
from draws import FULL
from modbus_line import Master, line_of, long_of, read_write, sound

from arm_emulator import Scene, Session, load_scene
from arm_emulator_fieldbus.converter import RegisterConverter
from arm_emulator_fieldbus.modbus_rtu import (
    FrameReceiver,
    ModbusStation,
    compute_crc,
    is_sound,
    measure_request,
)
from arm_emulator_fieldbus.serial_line import LineErrors, compute_bytes_time, compute_silence

FRAMES = 100_000 if FULL else 5_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis")


def remainder(data: bytes) -> int:
    """The checksum by its definition: division of polynomials, one bit after the other."""
    bits = [byte >> k & 1 for byte in data for k in range(8)] + [0] * 16
    for k in range(16):
        bits[k] ^= 1
    for k in range(len(bits) - 16):
        if bits[k]:
            for power in (16, 15, 2, 0):
                bits[k + 16 - power] ^= 1
    return sum(bit << k for k, bit in enumerate(bits[-16:]))


def test_checksum_is_the_remainder_of_a_division() -> None:
    assert (
        compute_crc(bytes.fromhex("01030000000a")) == 0xCDC5
    )  # the standard's example of a reader
    draw = random.Random(1)
    for _ in range(50):
        data = draw.randbytes(draw.randrange(1, 40))
        assert compute_crc(data) == remainder(data)


def test_checksum_sees_every_damaged_byte_and_every_two_flipped_bits() -> None:
    draw = random.Random(2)
    for _ in range(30):
        data = sound(draw.randbytes(draw.randrange(2, 60)))
        for place in range(len(data)):
            spoiled = bytearray(data)
            spoiled[place] ^= draw.randrange(1, 256)
            assert not is_sound(bytes(spoiled)), "a byte damaged"
            bit, two = draw.sample(range(8 * len(data)), 2)
            spoiled = bytearray(data)
            spoiled[bit // 8] ^= 1 << bit % 8
            spoiled[two // 8] ^= 1 << two % 8
            assert not is_sound(bytes(spoiled)), "two bits flipped"


@pytest.mark.parametrize("seed", range(5))
def test_frames_are_recognised_in_any_pieces(seed: int) -> None:
    draw = random.Random(seed)
    receiver, sent, frames = FrameReceiver(), [], []
    stream = b""
    for _ in range(200):
        n = draw.randrange(1, 122)
        frame = sound(
            draw.choice(
                [
                    struct.pack(
                        ">BBHH", 1, draw.choice([3, 4, 6]), *draw.choices(range(9999), k=2)
                    ),
                    struct.pack(">BBHHB", 1, 16, 2001, n, 2 * n) + draw.randbytes(2 * n),
                    b"\1" + read_write(1000, 3, 2001, draw.choices(range(9999), k=n)),
                ]
            )
        )
        sent.append(frame)
        stream += frame
    while stream:
        cut = draw.randrange(1, 300)
        frames += receiver.take_bytes(stream[:cut])
        stream = stream[cut:]
    assert frames == sent and receiver.damaged == 0


@pytest.mark.parametrize("seed", range(5))
def test_line_takes_its_time(scene: Scene, seed: int) -> None:
    """Servo periods pass while bytes are on the line, under the commands of then."""
    draw = random.Random(seed)
    baud = draw.choice([9600, 19200, 57600, 115200, 1_000_000])
    line, converter = line_of(scene, "line", baud=baud, watchdog=0)
    master, truth = Master(line), Session(scene, "lockstep", "first_answer")
    period, now, silence = 1_000_000, 0.0, compute_silence(baud)
    zoh = volts = np.zeros(3)
    for _ in range(40):
        words = [draw.randrange(-9999, 9999) & 0xFFFF for _ in range(3)]
        count = draw.randrange(1, 10)
        reported = master.exchange(1000 + 1, 2 + count, 2001, words)
        now += 19 * 11 / baud * 1e9 + silence  # 19 bytes ask
        while (truth.tick + 1) * period <= now:
            truth.advance_under(zoh, truth.tick)
            zoh = volts
        volts = np.array(words, np.uint16).astype(np.int16) * (48.0 / 32768)
        assert reported[:2] == [0, truth.tick], "the tick when the request was complete"
        now += (5 + 2 * (2 + count)) * 11 / baud * 1e9 + silence
        assert line.time == pytest.approx(now, abs=1.0)
    assert converter.session.plant.save() == truth.plant.save()
    assert truth.tick > 10


def test_times_of_the_line() -> None:
    assert compute_bytes_time(1, 11_000) == 1_000_000
    assert compute_silence(11_000) == 3_500_000 and compute_silence(115_200) == 1_750_000


class Recorder:
    """Registers that report what reached them."""

    def __init__(self, converter: RegisterConverter) -> None:
        self._converter = converter
        self.wrote: list[tuple[int, tuple[int, ...]]] = []

    def read(self, address: int, count: int) -> Sequence[int]:
        return self._converter.read(address, count)

    def write(self, address: int, words: Sequence[int]) -> None:
        self.wrote.append((address, tuple(words)))
        self._converter.write(address, words)


def test_no_wrong_value_is_accepted_from_a_line_with_errors(scene: Scene) -> None:
    """One byte in a hundred is lost or damaged, in both directions: every sixth to second frame.

    A frame with one damaged byte is always found out, by its length or by the checksum. It takes
    two or more flipped bytes and none lost, and the checksum then lets one in 65536 pass: of
    100 000 exchanges of 19 and 23 bytes it is 1e5 (171 + 253) (0.005)^2 / 65536 = 0.016. So none
    is expected, and this seed gives 0.
    """
    line, converter = line_of(scene, watchdog=0, errors=LineErrors(0.01, 17))
    recorder = Recorder(converter)
    line.station = ModbusStation(1, recorder)
    answer = line.station.answer_request
    answered: list[bytes] = []

    def answer_and_report(request: bytes) -> bytes:
        answered.append(answer(request))
        return answered[-1]

    line.station.answer_request = answer_and_report  # type: ignore[method-assign]
    draw = random.Random(3)
    done = damaged_requests = damaged_replies = 0
    for _ in range(FRAMES):
        words = tuple(draw.randrange(0x10000) for _ in range(3))
        body = read_write(1000, 9, 2001, words)
        recorder.wrote.clear()
        answered.clear()
        reply = line.exchange_bytes(sound(b"\1" + body)) + line.note_silence()
        if not recorder.wrote:
            damaged_requests += 1
            assert converter.session.tick == done, "time passed without commands"
            continue
        assert recorder.wrote == [(2001, words)], "what was written is what was sent"
        done += 1
        assert converter.session.tick == done
        if not (is_sound(reply) and reply[:3] == bytes((1, 23, 18)) and len(reply) == 23):
            damaged_replies += 1
            continue
        assert [reply] == answered, "what the master believes is what was answered"
        counts = long_of(struct.unpack(">9H", reply[3:-2])[3:])
        assert counts == converter.session.measured.encoder_counts.tolist()
    # 1 - 0.99^19 = 17 % and 1 - 0.99^23 = 21 % of the frames, within five standard deviations.
    for share, of, expected in (
        (damaged_requests, FRAMES, 1 - 0.99**19),
        (damaged_replies, done, 1 - 0.99**23),
    ):
        off = 5.0 * math.sqrt(of * expected * (1.0 - expected))
        assert abs(share - of * expected) < off
    assert converter.session.fault is None


def test_errors_do_not_depend_on_pieces() -> None:
    data, draw = random.Random(5).randbytes(20_000), random.Random(6)
    line_errors = LineErrors(0.03, 7)
    arrived = line_errors.damage_bytes(data)
    pieces, at = LineErrors(0.03, 7), 0
    joined = b""
    while at < len(data):
        cut = draw.randrange(1, 300)
        joined += pieces.damage_bytes(data[at : at + cut])
        at += cut
    assert joined == arrived and pieces.count == line_errors.count
    assert abs(line_errors.count - 600) < 5 * math.sqrt(600)
    assert LineErrors(0.03, 8).damage_bytes(data) != arrived


def test_requests_have_the_lengths_of_the_standard() -> None:
    assert measure_request(b"\1") is None and measure_request(b"\1\x10\0\0\0\1") is None
    assert measure_request(b"\1\x10\0\0\0\1\2") == 11 and measure_request(b"\1\x55") is None

"""The data converter on Modbus RTU: frames, registers, the line's time and errors, the watchdog."""

from __future__ import annotations

import math
import os
import random
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from draws import FULL
from machines import one_link_urdf, write_scene

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.commands.modbus import modbus
from arm_emulator.doors.fieldbus import converter as registers
from arm_emulator.doors.fieldbus.converter import Converter
from arm_emulator.doors.fieldbus.modbus_line import ModbusLine
from arm_emulator.doors.fieldbus.modbus_rtu import (
    Code,
    Receiver,
    Station,
    crc,
    is_sound,
    request_length,
)
from arm_emulator.doors.fieldbus.serial_line import LineErrors, bytes_time, silence_time
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.machine.session import EndOfTime, Session

NO_ERRORS = LineErrors(0.0, 0)
FRAMES = 100_000 if FULL else 5_000
MALFORMED = 1_000_000 if FULL else 5_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis")


class Master:
    """A master in the same process, written from the standard and not from our station."""

    def __init__(self, line: ModbusLine, number: int = 1) -> None:
        self.line, self.number = line, number

    def ask(self, body: bytes) -> bytes:
        """Return the body of the reply to one request on a line without errors."""
        reply = self.line.bring(sound(bytes((self.number,)) + body)) or self.line.silence()
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


def sound(data: bytes) -> bytes:
    return data + struct.pack("<H", crc(data))


def line_of(
    scene: Scene,
    clock: str = "lockstep",
    *,
    baud: int = 115_200,
    watchdog: int = 100,
    errors: LineErrors = NO_ERRORS,
) -> tuple[ModbusLine, Converter]:
    converter = Converter(Session(scene, "lockstep", "first_answer"), watchdog)
    return ModbusLine(converter, 1, clock, baud, errors), converter


def long_of(words: Sequence[int]) -> list[int]:
    return list(struct.unpack(f">{len(words) // 2}i", struct.pack(f">{len(words)}H", *words)))


def test_checksum_is_the_remainder_of_a_division() -> None:
    assert crc(bytes.fromhex("01030000000a")) == 0xCDC5  # the standard's example of a reader
    draw = random.Random(1)
    for _ in range(50):
        data = draw.randbytes(draw.randrange(1, 40))
        assert crc(data) == remainder(data)


def test_checksum_sees_every_damaged_byte_and_every_two_flipped_bits() -> None:
    draw = random.Random(2)
    for _ in range(30):
        data = sound(draw.randbytes(draw.randrange(2, 60)))
        for place in range(len(data)):
            spoiled = bytearray(data)
            spoiled[place] ^= draw.randrange(1, 256)
            assert not is_sound(bytes(spoiled)), "a byte damaged"
            one, two = draw.sample(range(8 * len(data)), 2)
            spoiled = bytearray(data)
            spoiled[one // 8] ^= 1 << one % 8
            spoiled[two // 8] ^= 1 << two % 8
            assert not is_sound(bytes(spoiled)), "two bits flipped"


@pytest.mark.parametrize("seed", range(3))
def test_registers_drive_the_machine_as_a_session_does(scene: Scene, seed: int) -> None:
    """Equal bits in lock-step, whichever functions write the commands."""
    draw = random.Random(seed)
    line, converter = line_of(scene)
    master, truth = Master(line), Session(scene, "lockstep", "first_answer")
    N = len(scene.joints)
    words, volt = [0] * N, scene.supply_voltage / 32768
    for tick in range(60):
        count = 3 + 6 * N
        first = draw.randrange(N)
        new = [draw.randrange(0x10000) for _ in range(draw.randrange(1, N - first + 1))]
        reported = None
        match draw.choice([6, 16, 23]):
            case 6:
                new = new[:1]
                body = struct.pack(">BHH", 6, 2001 + first, new[0])
                assert master.ask(body) == body
            case 16:
                master.write(2001 + first, *new)
            case 23:
                reported = master.exchange(1000, count, 2001 + first, new)
        words[first : first + len(new)] = new
        signed = np.array(words, np.uint16).astype(np.int16)
        truth.advance_under(signed * volt, tick)
        reported = reported or master.read(1000, count)
        state = truth.measured
        assert reported[:3] == [registers.POWERED | registers.RUNNING, 0, tick + 1]
        assert long_of(reported[3 : 3 + 2 * N]) == state.encoder_counts.tolist()
        current, applied = np.array(reported[3 + 2 * N :], ">u2").view(">f4").reshape(2, N)
        assert current.tolist() == state.current.astype(np.float32).tolist()
        assert applied.tolist() == (signed * volt).astype(np.float32).tolist()
        assert master.read(2001, N, function=3) == words
    assert converter.session.plant.save() == truth.plant.save()


def test_description_reports_scales(scene: Scene) -> None:
    master = Master(line_of(scene)[0])
    assert master.read(0, 4) == [2, 3, 15, 16960]  # 1 000 000 ns
    for joint, it in enumerate(scene.joints):
        raw = struct.pack(">48H", *master.read(10000 + 48 * joint, 48))
        kind, mode, full, counts, wrap, ratio, link, link_wrap = struct.unpack(
            ">HHddqddq", raw[:52]
        )
        assert (kind, mode, wrap, link_wrap) == (0, 1, 0, 0)
        assert (full, ratio) == (scene.supply_voltage, it.gear.ratio)
        assert counts == pytest.approx(it.counts_per_turn / (2 * math.pi), rel=1e-15)
        assert link == 0.0 or link > 0.0
        assert raw[64:].rstrip(b"\0").decode() == it.name


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ("05 07d0 ff00", Code.FUNCTION),  # write a coil
        ("2b 0e0100", Code.FUNCTION),  # identification
        ("e4 00000001", Code.FUNCTION),  # not a function but an exception
        ("08 0005 0000", Code.FUNCTION),  # an unknown diagnosis
        ("08 000b 0001", Code.VALUE),
        ("03 0000 0000", Code.VALUE),
        ("04 0000 007e", Code.VALUE),  # 126 registers
        ("04 0003 0002", Code.ADDRESS),  # one behind the last of a block
        ("04 ffff 0001", Code.ADDRESS),
        ("04 ffff 0002", Code.ADDRESS),  # beyond the last address
        ("06 03e8 0001", Code.ADDRESS),  # the status is not for writing
        ("06 07d0 0008", Code.VALUE),  # no such bit of the control word
        ("10 07d1 0003 05 0001000100", Code.VALUE),
        ("10 07d1 0000 00", Code.VALUE),
        ("10 07d1 0004 08 0001000100010001", Code.ADDRESS),  # four joints of three
        ("10 07d0 0004 08 0010000100010001", Code.VALUE),  # bad control, good commands
        ("17 03e8 0009 07d1 0003 05 0001000100", Code.VALUE),
        ("17 03e8 007e 07d1 0003 06 000100010001", Code.VALUE),
        ("17 0400 0009 0fff 0003 06 000100010001", Code.ADDRESS),
        ("17 0004 0001 07d1 0003 06 000100010001", Code.ADDRESS),  # writable, but not readable
    ],
)
def test_exceptions_leave_the_state_as_it_was(scene: Scene, body: str, code: Code) -> None:
    line, converter = line_of(scene)
    master = Master(line)
    master.write(2001, 5, 6, 7)
    before = state_of(line, converter)
    request = bytes.fromhex(body)
    assert master.ask(request) == bytes((request[0] | 0x80, code))
    assert state_of(line, converter) == before


def state_of(line: ModbusLine, converter: Converter) -> tuple[object, ...]:
    session = converter.session
    settings = [*converter.read(2000, 4), *converter.read(3000, 1), converter.status]
    return session.plant.save(), session.tick, settings, converter.wanted.tolist()


def test_a_station_answers_its_own_requests_only(scene: Scene) -> None:
    line, converter = line_of(scene)
    assert line.bring(sound(bytes.fromhex("02 03 0000 0001"))) == b"", "another station's request"
    assert line.bring(sound(bytes.fromhex("00 03 0000 0001"))) == b"", "a read of all stations"
    assert converter.session.tick == 0
    assert line.bring(sound(bytes.fromhex("00 10 07d1 0003 06 000100020003"))) == b""
    assert converter.session.tick == 1 and converter.read(2001, 3) == [1, 2, 3]
    line.bring(sound(bytes.fromhex("01 03 0000 0001"))[:-1] + b"x")
    assert line.silence() == b"" and line.receiver.damaged == 1
    reported = {
        n: Master(line).ask(bytes.fromhex(f"08 {n:04x} 0000"))[3:] for n in (11, 12, 14, 15)
    }
    assert {n: word[1] for n, word in reported.items()} == {11: 4, 12: 1, 14: 5, 15: 2}
    Master(line).ask(bytes.fromhex("08 000a 0000"))
    assert Master(line).ask(bytes.fromhex("08 000c 0000"))[3:] == b"\0\0", "cleared"
    assert Master(line).ask(bytes.fromhex("08 0000 1234")) == bytes.fromhex("08 0000 1234")


@pytest.mark.parametrize("seed", range(5))
def test_frames_are_found_in_whatever_pieces_they_come(seed: int) -> None:
    draw = random.Random(seed)
    receiver, sent, found = Receiver(), [], []
    stream = b""
    for _ in range(200):
        n = draw.randrange(1, 122)
        one = sound(
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
        sent.append(one)
        stream += one
    while stream:
        cut = draw.randrange(1, 300)
        found += receiver.feed(stream[:cut])
        stream = stream[cut:]
    assert found == sent and receiver.damaged == 0


@pytest.mark.parametrize("seed", range(5))
def test_line_takes_its_time(scene: Scene, seed: int) -> None:
    """Servo periods pass while bytes are on the line, under the commands of then."""
    draw = random.Random(seed)
    baud = draw.choice([9600, 19200, 57600, 115200, 1_000_000])
    line, converter = line_of(scene, "line", baud=baud, watchdog=0)
    master, truth = Master(line), Session(scene, "lockstep", "first_answer")
    period, now, silence = 1_000_000, 0.0, silence_time(baud)
    held = wanted = np.zeros(3)
    for _ in range(40):
        words = [draw.randrange(-9999, 9999) & 0xFFFF for _ in range(3)]
        count = draw.randrange(1, 10)
        reported = master.exchange(1000 + 1, 2 + count, 2001, words)
        now += 19 * 11 / baud * 1e9 + silence  # 19 bytes ask
        while (truth.tick + 1) * period <= now:
            truth.advance_under(held, truth.tick)
            held = wanted
        wanted = np.array(words, np.uint16).astype(np.int16) * (48.0 / 32768)
        assert reported[:2] == [0, truth.tick], "the tick when the request was complete"
        now += (5 + 2 * (2 + count)) * 11 / baud * 1e9 + silence
        assert line.time == pytest.approx(now, abs=1.0)
    assert converter.session.plant.save() == truth.plant.save()
    assert truth.tick > 10


def test_times_of_the_line() -> None:
    assert bytes_time(1, 11_000) == 1_000_000
    assert silence_time(11_000) == 3_500_000 and silence_time(115_200) == 1_750_000


def test_silent_master_loses_the_drives(scene: Scene) -> None:
    """A master that only reads commands nothing: the drives go off, until it acknowledges."""
    line, converter = line_of(scene, "line", watchdog=20)
    master = Master(line)
    master.write(2000, 1, 3000, 0, 0)
    written = converter.session.tick
    while not converter.status & registers.WATCHDOG:
        master.read(1000, 3)
    # 20 ms are 20 periods; it is noticed at the end of the next one.
    first = converter.session.tick
    assert first - written >= 21 and not converter.session.powered
    for _ in range(20):
        master.read(1000, 3)
    assert converter.session.measured.applied.tolist() == [0.0] * 3
    master.write(2000, 1, 3000, 0, 0)
    assert converter.status & registers.WATCHDOG, "power alone does not bring them back"
    assert not converter.session.powered
    master.write(2000, 3, 3000, 0, 0)
    assert converter.status == registers.POWERED | registers.RUNNING
    for _ in range(2):  # 11 ms, within the watchdog's time
        master.read(1000, 3)
    assert converter.session.measured.applied[0] == pytest.approx(3000 * 48 / 32768, abs=1e-12)
    master.write(3000, 0)
    for _ in range(50):
        master.read(1000, 3)
    assert not converter.status & registers.WATCHDOG, "no watchdog was asked for"


def test_reset_begins_anew(scene: Scene) -> None:
    line, converter = line_of(scene)
    master, fresh = Master(line), Session(scene, "lockstep", "first_answer")
    for _ in range(10):
        master.write(2001, 9000, 9000, 9000)
    master.write(2000, 5)
    assert converter.session.plant.save() == fresh.plant.save()
    assert master.read(2000, 4) == [1, 0, 0, 0] and master.read(1000, 3) == [1, 0, 0]
    master.write(2000, 0)
    assert master.read(1000, 1) == [0], "no power"
    converter.session.fault = EndOfTime()
    master.write(2000, 1)
    assert master.read(1000, 1) == [registers.POWERED | registers.FAULT]
    before = state_of(line, converter)
    commands = struct.pack(">BHHB3H", 16, 2001, 3, 6, 1, 2, 3)
    assert master.ask(commands) == bytes((0x90, Code.FAILURE))
    assert state_of(line, converter) == before
    master.write(2000, 5, 1, 2, 3)
    assert master.read(1000, 3) == [registers.POWERED | registers.RUNNING, 0, 1]


class Recorder:
    """Registers that report what reached them."""

    def __init__(self, converter: Converter) -> None:
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
    line.station = Station(1, recorder)
    answer = line.station.answer
    answered: list[bytes] = []

    def answer_and_report(request: bytes) -> bytes:
        answered.append(answer(request))
        return answered[-1]

    line.station.answer = answer_and_report  # type: ignore[method-assign]
    draw = random.Random(3)
    done = damaged_requests = damaged_replies = 0
    for _ in range(FRAMES):
        words = tuple(draw.randrange(0x10000) for _ in range(3))
        body = read_write(1000, 9, 2001, words)
        recorder.wrote.clear()
        answered.clear()
        reply = line.bring(sound(b"\1" + body)) + line.silence()
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
    whole = LineErrors(0.03, 7)
    arrived = whole.damage(data)
    pieces, at = LineErrors(0.03, 7), 0
    joined = b""
    while at < len(data):
        cut = draw.randrange(1, 300)
        joined += pieces.damage(data[at : at + cut])
        at += cut
    assert joined == arrived and pieces.count == whole.count
    assert abs(whole.count - 600) < 5 * math.sqrt(600)
    assert LineErrors(0.03, 8).damage(data) != arrived


@pytest.mark.parametrize("clock", ["lockstep", "line"])
def test_malformed_frames_change_nothing(scene: Scene, clock: str) -> None:
    """Random bytes and spoiled requests, most with a right checksum, are refused as a whole."""
    line, converter = line_of(scene, clock, watchdog=0, baud=100_000_000)
    draw = random.Random(11)
    Master(line).write(2001, 1, 2, 3)
    good = [
        b"\1" + read_write(1000, 9, 2001, (1, 2, 3)),
        struct.pack(">BBHHB3H", 1, 16, 2001, 3, 6, 4, 5, 6),
        struct.pack(">BBHH", 1, 6, 2002, 77),
        struct.pack(">BBHH", 1, 4, 1000, 20),
        struct.pack(">BBHH", 1, 8, 0, 5),
    ]
    refused, before = 0, state_of(line, converter)
    for _ in range(MALFORMED // 2):
        if draw.random() < 0.3:
            data = draw.randbytes(draw.randrange(0, 300))
        else:
            spoiled = bytearray(draw.choice(good))
            for _ in range(draw.randrange(1, 4)):
                place = draw.randrange(1, len(spoiled))
                match draw.randrange(3):
                    case 0:
                        spoiled[place] = draw.randrange(256)
                    case 1:
                        del spoiled[place:]
                    case 2:
                        spoiled[place:place] = draw.randbytes(draw.randrange(1, 5))
                spoiled += b"\0" * (2 - len(spoiled))
            data = bytes(spoiled)
        if draw.random() < 0.8:
            data = sound(data)
        tick = converter.session.tick
        reply = line.bring(data) + line.silence()
        was, before = before, state_of(line, converter)
        if clock == "line" and converter.session.tick != tick:
            continue  # time has passed while it was on the line
        done = (bool(reply) and reply[1] in (6, 16, 23)) or data[:1] == b"\0"
        if not done:
            refused += 1
            assert before == was, data.hex()
        else:
            assert converter.session.fault is None
    assert refused > MALFORMED // 8
    assert Master(line).read(0, 2) == [2, 3], "it still answers"


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"baud": 49}, r"modbus: baud must be 50 to 100000000 bit/s, got 49"),
        ({"station": 0}, r"modbus: station must be 1 to 247, got 0"),
        ({"station": 248}, r"modbus: station must be 1 to 247, got 248"),
        ({"error_rate": 1.0}, r"line: error rate must be 0, or from 1e-12 to less than 1, got 1.0"),
        ({"error_rate": math.nan}, r"line: error rate must be .* got nan"),
        ({"error_rate": -0.1}, r"line: error rate must be .* got -0.1"),
        ({"watchdog": -1}, r"modbus: watchdog must be 0 to 65535 ms, got -1"),
        ({"link": Path(__file__)}, r"modbus: link .* must be makeable, got File exists"),
        ({"link": Path("/no/such/folder")}, r"modbus: link .* got No such file or directory"),
    ],
)
def test_impossible_options_are_refused(given: dict[str, object], line: str) -> None:
    usual = dict(
        clock="lockstep", baud=9600, station=1, error_rate=0.0, seed=0, watchdog=0, link=None
    )
    with pytest.raises(Refusal, match=line):
        modbus("three_axis", **{**usual, **given})  # type: ignore[arg-type]


def test_full_scale_is_the_supply_or_the_limit_of_the_motor(tmp_path: Path) -> None:
    for kind, numbers in (
        ("torque", {"torque_limit": 7.5}),
        ("current", {"current_limit": 12.0, "torque_constant": 0.1}),
    ):
        motor = {"kind": kind, "rotor_inertia": 1e-4, **numbers}
        given = load_scene(write_scene(tmp_path, one_link_urdf(), {"joint": {"motor": motor}}))
        limit = numbers[f"{kind}_limit"]
        assert registers.full_scale(given, given.joints[0]) == limit
        del motor[f"{kind}_limit"]
        without = load_scene(write_scene(tmp_path, one_link_urdf(), {"joint": {"motor": motor}}))
        with pytest.raises(Refusal, match=rf"joints.joint.motor.{kind}_limit must be given"):
            registers.full_scale(without, without.joints[0])


def test_requests_have_the_lengths_of_the_standard() -> None:
    assert request_length(b"\1") is None and request_length(b"\1\x10\0\0\0\1") is None
    assert request_length(b"\1\x10\0\0\0\1\2") == 11 and request_length(b"\1\x55") is None


@contextmanager
def served(tmp_path: Path, *arguments: str) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """The command in a process of its own, and its port opened as a master would."""
    link = tmp_path / "port"
    command = [sys.executable, "-m", "arm_emulator", "modbus", "three_axis", "--link", str(link)]
    with subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            while "baud" not in process.stdout.readline():
                assert process.poll() is None, process.stderr
            port = os.open(link, os.O_RDWR | os.O_NOCTTY)
            yield port, process
            os.close(port)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=30)
            assert process.returncode == 0 and "Traceback" not in err, out + err
            assert not link.is_symlink(), "the link is taken away"
        finally:
            process.kill()


def ask(port: int, request: bytes, length: int) -> bytes:
    """Return the reply from a port, or what of it has come within 20 s."""
    os.write(port, request)
    reply, until = b"", time.monotonic() + 20.0
    while len(reply) < length and (left := until - time.monotonic()) > 0:
        if select.select([port], [], [], left)[0]:
            reply += os.read(port, 256)
    return reply


def test_port_serves_in_lockstep_and_ends_on_ctrl_c(tmp_path: Path, scene: Scene) -> None:
    line, _ = line_of(scene)
    draw = random.Random(1)
    with served(tmp_path) as (port, process):
        os.write(port, b"noise that is no frame")
        time.sleep(0.1)  # a pause; were it too short, the next request would be lost, and the test
        for _ in range(20):
            request = sound(b"\1" + read_write(1000, 15, 2001, draw.choices(range(3000), k=3)))
            expected = line.bring(request)
            assert ask(port, request, len(expected)) == expected
        settings = termios.tcgetattr(port)
        settings[4] = settings[5] = termios.B9600
        termios.tcsetattr(port, termios.TCSANOW, settings)
        os.write(port, request)
        assert process.stderr is not None
        reported = "the master has set 9600 baud, this end has 115200: nothing gets through"
        assert reported in process.stderr.readline()
        settings[4] = settings[5] = termios.B115200
        termios.tcsetattr(port, termios.TCSANOW, settings)
        expected = line.bring(request)
        assert ask(port, request, len(expected)) == expected, "what was not heard changed nothing"


def test_port_in_real_time_takes_the_time_of_the_line_and_watches(tmp_path: Path) -> None:
    """A lower bound on the time of an exchange, which no load can break; and drives off in time."""
    with served(tmp_path, "--clock", "realtime", "--baud", "9600", "--watchdog", "50") as (port, _):
        request = sound(b"\1" + read_write(1000, 9, 2001, (2000, 0, 0)))
        started = time.monotonic()
        for _ in range(3):
            reply = ask(port, request, 23)
            assert is_sound(reply)
        least = 3 * ((19 + 23) * 11 / 9600 + 3.5 * 11 / 9600)
        assert time.monotonic() - started >= least
        status = sound(struct.pack(">BBHH", 1, 4, 1000, 3))
        until = time.monotonic() + 20.0
        while not ask(port, status, 11)[4] & registers.WATCHDOG:
            assert time.monotonic() < until, "drives still on"
        off = ask(port, status, 11)
        assert not off[4] & registers.POWERED and off[8] + (off[7] << 8) > 50

"""The data converter on Modbus RTU: frames, registers, the line's time and errors, the watchdog."""

import math
import random
import struct
from pathlib import Path

import numpy as np
import pytest
from draws import FULL
from machines import PMSM, make_link_urdf, write_scene
from modbus_line import Master, line_of, long_of, read_write, sound

from arm_emulator import Refusal, Scene, Session, load_scene
from arm_emulator.machine.session.session import EndOfTime
from arm_emulator_fieldbus import converter as registers
from arm_emulator_fieldbus.commands.modbus import serve_modbus
from arm_emulator_fieldbus.converter import RegisterConverter
from arm_emulator_fieldbus.modbus_line import ModbusLine
from arm_emulator_fieldbus.modbus_rtu import Code

MALFORMED = 1_000_000 if FULL else 5_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis")


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


@pytest.mark.parametrize("clock", ["lockstep", "line", "realtime"])
def test_an_input_that_a_motor_has_not_takes_0_alone(clock: str) -> None:
    """The station goes on behind a master that commands it, at each of its clocks."""
    line, converter = line_of(load_scene("three_axis", {"joints.elbow.motor": PMSM}), clock)
    master = Master(line)
    words = 1, 0, 0, 7, 0, 0, 8  # power, commands, command_d
    master.write(2000, *words)
    before = state_of(line, converter)
    for address, body in ((2004, (9,)), (2000, (4, 1, 2, 3, 0, 5, 6)), (2003, (3, 5, 0, 6))):
        count = len(body)
        request = struct.pack(f">BHHB{count}H", 16, address, count, 2 * count, *body)
        assert master.ask(request) == bytes((0x90, Code.VALUE)), address
        if clock == "lockstep":  # else time passes on the line
            assert state_of(line, converter) == before
    for _ in range(5):
        assert master.read(2000, len(words)) == list(words)


def state_of(line: ModbusLine, converter: RegisterConverter) -> tuple[object, ...]:
    session = converter.session
    settings = [*converter.read(2000, 4), *converter.read(3000, 1), converter.status]
    return session.plant.save(), session.tick, settings, converter.target.tolist()


def test_a_station_answers_its_own_requests_only(scene: Scene) -> None:
    line, converter = line_of(scene)
    assert line.exchange_bytes(sound(bytes.fromhex("02 03 0000 0001"))) == b"", (
        "another station's request"
    )
    assert line.exchange_bytes(sound(bytes.fromhex("00 03 0000 0001"))) == b"", (
        "a read of all stations"
    )
    assert converter.session.tick == 0
    assert line.exchange_bytes(sound(bytes.fromhex("00 10 07d1 0003 06 000100020003"))) == b""
    assert converter.session.tick == 1 and converter.read(2001, 3) == [1, 2, 3]
    line.exchange_bytes(sound(bytes.fromhex("01 03 0000 0001"))[:-1] + b"x")
    assert line.note_silence() == b"" and line.receiver.damaged == 1
    reported = {
        n: Master(line).ask(bytes.fromhex(f"08 {n:04x} 0000"))[3:] for n in (11, 12, 14, 15)
    }
    assert {n: word[1] for n, word in reported.items()} == {11: 4, 12: 1, 14: 5, 15: 2}
    Master(line).ask(bytes.fromhex("08 000a 0000"))
    assert Master(line).ask(bytes.fromhex("08 000c 0000"))[3:] == b"\0\0", "cleared"
    assert Master(line).ask(bytes.fromhex("08 0000 1234")) == bytes.fromhex("08 0000 1234")


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


def test_reset_restarts(scene: Scene) -> None:
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
        reply = line.exchange_bytes(data) + line.note_silence()
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
    ("options", "line"),
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
def test_impossible_options_are_refused(options: dict[str, object], line: str) -> None:
    defaults = dict(
        clock="lockstep", baud=9600, station=1, error_rate=0.0, seed=0, watchdog=0, link=None
    )
    with pytest.raises(Refusal, match=line):
        serve_modbus("three_axis", **{**defaults, **options})  # type: ignore[arg-type]


def test_full_scale_is_the_supply_or_the_limit_of_the_motor(tmp_path: Path) -> None:
    for kind, numbers in (
        ("torque", {"torque_limit": 7.5}),
        ("current", {"current_limit": 12.0, "torque_constant": 0.1}),
    ):
        motor = {"kind": kind, "rotor_inertia": 1e-4, **numbers}
        limited = load_scene(write_scene(tmp_path, make_link_urdf(), {"joint": {"motor": motor}}))
        limit = numbers[f"{kind}_limit"]
        assert registers.find_full_scale(limited, limited.joints[0]) == limit
        del motor[f"{kind}_limit"]
        without = load_scene(write_scene(tmp_path, make_link_urdf(), {"joint": {"motor": motor}}))
        with pytest.raises(Refusal, match=rf"joints.joint.motor.{kind}_limit must be given"):
            registers.find_full_scale(without, without.joints[0])

"""Faults set over field buses, by SDO and by registers: the bits of a session that sets them."""

import struct
from collections.abc import Callable

import numpy as np
import pytest
from canopen_master import download, uploaded
from cia402 import CSP, SERVO, TARGET, enable
from ethercat_master import Aborted, Master
from modbus_line import Master as Line
from modbus_line import line_of

from arm_emulator import Plant, Scene, Session, load_scene
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN, ETHERCAT
from arm_emulator_fieldbus.ethercat import Segment
from arm_emulator_fieldbus.modbus_rtu import Code

COUNT, NUMBER, NAME, MAGNITUDE = 0x2010, 0x2011, 0x2012, 0x2013
NAMES = ["faults.elbow.command_late", "faults.elbow.encoder_slips"]
OFFSET = 0.1  # rad, no sum of powers of two
BEGIN, END, TICKS = 30, 90, 140
OF_REGISTERS, OF_NAMES, PER_NAME = 4000, 20000, 40

Read = Callable[[int], bytes]
Write = Callable[[int, bytes], int]  # returns the code of an abort


@pytest.fixture(scope="module")
def scene() -> Scene:
    faults = ["elbow.command_late", "elbow.encoder_slips"]
    return load_scene("three_axis", overrides={"faults": faults})


def over_canopen(scene: Scene) -> tuple[Drives, Read, Write]:
    segment = CanSegment(Drives(Plant(scene), SERVO, CANOPEN), 1)
    segment.boot_nodes()

    def write(index: int, raw: bytes) -> int:
        try:
            download(segment, 2, index, 0, raw, by_segments=len(raw) > 2)
        except LookupError as no:
            return int(no.args[0])
        return 0

    return segment.drives, lambda index: uploaded(segment, 2, index, 0), write


def over_ethercat(scene: Scene) -> tuple[Drives, Read, Write]:
    master = Master(Segment(scene, SERVO, lockstep=True))
    master.bring_up()

    def write(index: int, raw: bytes) -> int:
        try:
            master.download(1, index, 0, raw)
        except Aborted as no:
            return no.code
        return 0

    return master.segment.drives, lambda index: master.upload(1, index, 0), write


Bus = Callable[[Scene], tuple[Drives, Read, Write]]
KINDS: dict[Bus, int] = {over_canopen: CANOPEN, over_ethercat: ETHERCAT}
BUSES = list(KINDS)


@pytest.mark.parametrize("bus", BUSES)
def test_every_fault_of_the_scene_is_named_and_set_by_its_number(scene: Scene, bus: Bus) -> None:
    drives, read, write = bus(scene)
    assert read(COUNT) == struct.pack("<H", len(NAMES))
    for k, name in enumerate(NAMES):
        assert write(NUMBER, struct.pack("<H", k + 1)) == 0
        assert read(NAME).decode() == name
        assert write(MAGNITUDE, struct.pack("<d", 1.0 + k)) == 0
        assert drives.plant.parameters[name] == 1.0 + k
        drives.plant.set_parameter(name, 2.0)  # by another door
        assert read(MAGNITUDE) == struct.pack("<d", 2.0), "the machine's, not the drive's"
        assert drives.read(0, NUMBER) == 1, "each drive has a choice of its own"
    drives.restart_drive()
    assert drives.plant.parameters == dict.fromkeys(NAMES, 2.0), "they outlive a drive's restart"


@pytest.mark.parametrize("bus", BUSES)
def test_a_refused_access_leaves_fault_and_choice(scene: Scene, bus: Bus) -> None:
    drives, read, write = bus(scene)
    assert write(NUMBER, struct.pack("<H", 2)) == 0
    assert write(MAGNITUDE, struct.pack("<d", OFFSET)) == 0
    before = drives.plant.save()
    assert write(NUMBER, struct.pack("<H", 3)) == 0x06090031
    for bad in (np.nan, np.inf, -np.inf, 1e300):
        assert write(MAGNITUDE, struct.pack("<d", bad)) == 0x06090030, bad
    assert write(MAGNITUDE, struct.pack("<f", OFFSET)) == 0x06070013
    assert write(COUNT, bytes(2)) == write(NAME, b"x") == 0x06010002
    assert (read(NUMBER), drives.plant.save()) == (struct.pack("<H", 2), before)
    assert write(NUMBER, bytes(2)) == 0
    assert (read(NAME), read(MAGNITUDE)) == (b"none", bytes(8))
    assert write(MAGNITUDE, struct.pack("<d", OFFSET)) == 0x08000022, "no fault is chosen"
    assert drives.plant.save() == before


def test_drives_of_a_scene_without_faults_have_none() -> None:
    drives = Drives(Plant(load_scene("three_axis")), SERVO, ETHERCAT)
    assert (drives.read(0, COUNT), drives.read(0, NUMBER)) == (0, 0)
    assert drives.upload_entry(0, NAME) == b"none"


@pytest.mark.parametrize("bus", BUSES)
def test_a_fault_over_sdo_is_that_of_a_session_from_its_tick_on(scene: Scene, bus: Bus) -> None:
    drives, _, write = bus(scene)
    session = Session(scene, "lockstep", "first_answer")
    twin = Drives(session.plant, SERVO, KINDS[bus])
    sound = Drives(Plant(scene), SERVO, KINDS[bus])
    alike = (drives, twin, sound)
    for drive_set in alike:
        enable(drive_set, CSP)
    start, moved = twin.read(2, TARGET), set()
    magnitudes = {"faults.elbow.command_late": 2.0, "faults.elbow.encoder_slips": OFFSET}
    for tick in range(TICKS):
        if tick in (BEGIN, END):
            for k, (name, magnitude) in enumerate(magnitudes.items()):
                value = magnitude if tick == BEGIN else 0.0
                assert write(NUMBER, struct.pack("<H", k + 1)) == 0
                assert write(MAGNITUDE, struct.pack("<d", value)) == 0
                session.set_varied(name, value)
        for drive_set in alike:
            drive_set.write(2, TARGET, start + round(400 * (1.0 - np.cos(0.05 * tick))))
            drive_set.period()
        assert drives.plant.save() == session.plant.save(), f"tick {tick}"
        moved.add(np.array_equal(drives.plant.state.q, sound.plant.state.q))
        assert tick >= BEGIN or moved == {True}, "before it begins"
    assert moved == {True, False}, "the faults act"


def words(value: float) -> tuple[int, ...]:
    return struct.unpack(">4H", struct.pack(">d", value))


def test_registers_set_faults_as_a_session_does(scene: Scene) -> None:
    line, converter = line_of(scene)
    master, truth = Line(line), Session(scene, "lockstep", "first_answer")
    sound = Session(scene, "lockstep", "first_answer")
    assert master.read(OF_REGISTERS, 1) == [len(NAMES)]
    raw = struct.pack(">80H", *master.read(OF_NAMES, len(NAMES) * PER_NAME))
    assert [raw[k : k + 80].rstrip(b"\0").decode() for k in (0, 80)] == NAMES
    differs = set()
    for tick in range(60):
        if tick == 20:  # both in one request, no period passes
            master.write(OF_REGISTERS + 1, *words(2.0), *words(OFFSET))
            for name, value in zip(NAMES, (2.0, OFFSET), strict=True):
                truth.set_varied(name, value)
            assert converter.session.tick == 20
        if tick == 40:  # the second alone
            master.write(OF_REGISTERS + 5, *words(0.0))
            truth.set_varied(NAMES[1], 0.0)
        command = [0, 0, 3000 + 100 * tick]
        master.write(2001, *command)
        volt = np.array(command) * scene.supply_voltage / 32768
        for session in (truth, sound):
            session.advance_under(volt, tick)
        assert converter.session.plant.save() == truth.plant.save(), f"tick {tick}"
        differs.add(np.array_equal(truth.plant.state.q, sound.plant.state.q))
    assert differs == {True, False}, "the faults act"
    assert master.read(OF_REGISTERS + 1, 8) == [*words(2.0), *words(0.0)]


@pytest.mark.parametrize(
    ("address", "register_values", "code"),
    [
        (1, words(2.0)[:3], Code.VALUE),  # a part of a number
        (2, words(2.0), Code.VALUE),
        (1, words(np.nan), Code.VALUE),
        (1, (*words(2.0), *words(1e300)), Code.VALUE),  # the second of two
        (0, (5,), Code.ADDRESS),  # how many there are
        (5, (*words(0.0), *words(0.0)), Code.ADDRESS),  # beyond the last
    ],
)
def test_registers_are_taken_all_or_none(
    scene: Scene, address: int, register_values: tuple[int, ...], code: Code
) -> None:
    line, converter = line_of(scene)
    before = converter.session.plant.save()
    n = len(register_values)
    body = struct.pack(f">BHHB{n}H", 16, OF_REGISTERS + address, n, 2 * n, *register_values)
    assert Line(line).ask(body) == bytes((0x90, code))
    assert converter.session.plant.save() == before


def test_names_of_faults_cannot_be_written(scene: Scene) -> None:
    body = struct.pack(">BHH", 6, OF_NAMES, 0)
    assert Line(line_of(scene)[0]).ask(body) == bytes((0x86, Code.ADDRESS))

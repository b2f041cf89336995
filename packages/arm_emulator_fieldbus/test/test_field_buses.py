"""The contract of both field buses: the same drives, one SDO server behind EtherCAT and CANopen."""

import random
import struct
from typing import ClassVar

import pytest
from canopen_master import SYNC, download, drives_of, segment_of, sent, uploaded
from draws import some
from ethercat_master import Aborted, Master

from arm_emulator import load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator_fieldbus import object_dictionary as dictionaries
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.declared import REPORTED, find_places
from arm_emulator_fieldbus.drives_unit import CANOPEN, ETHERCAT
from arm_emulator_fieldbus.ethercat import Segment
from arm_emulator_fieldbus.object_dictionary import list_entries

SCENE = load_scene("three_axis")
SERVO = load_gains(find_scene("three_axis")).servo
DRIVES = range(3)
CSP = 8


class CanOpen:
    """Nodes 1 to 3, asked through the second one."""

    kind = CANOPEN
    # Identifiers of its SDO server, which a drive alone has not.
    own: ClassVar = {(0x1200, 1): struct.pack("<I", 0x602), (0x1200, 2): struct.pack("<I", 0x582)}

    def __init__(self) -> None:
        self.segment = segment_of(SCENE, operational=True)
        self.drives = self.segment.drives
        self.emergencies: list[tuple[int, int]] = []
        self._draw = random.Random(3)

    def sdo(self, request: bytes) -> bytes:
        (reply,) = self.segment.receive_frame(CanFrame(0x602, request.ljust(8, b"\0")))
        return reply.data

    def upload(self, index: int, sub: int) -> bytes:
        return uploaded(self.segment, 2, index, sub)

    def download(self, index: int, sub: int, raw: bytes) -> int:
        """Return the code of the abort, 0 for none."""
        try:
            download(self.segment, 2, index, sub, raw, by_segments=self._draw.random() < 0.5)
        except LookupError as no:
            return int(no.args[0])
        return 0

    def cycle(self, words: list[int], positions: list[int]) -> None:
        for k in DRIVES:
            data = struct.pack("<Hi", words[k], positions[k])
            self.segment.receive_frame(CanFrame(0x301 + k, data))
        frames = self.segment.receive_frame(SYNC)
        for k in DRIVES:
            for data in sent(frames, 0x81 + k):
                code, register = struct.unpack_from("<HB", data)
                assert bool(code) == bool(register), "the error register"
                self.emergencies.append((k, code))


class EtherCat:
    """Slaves 0 to 2, asked through the second one."""

    kind = ETHERCAT
    own: ClassVar[dict[tuple[int, int], bytes]] = {}

    def __init__(self) -> None:
        self.master = Master(Segment(SCENE, SERVO, lockstep=True))
        self.master.bring_up()
        self.drives = self.master.segment.drives
        self.emergencies: list[tuple[int, int]] = []

    def sdo(self, request: bytes) -> bytes:
        return self.master.coe(1, 2, request.ljust(8, b"\0"))

    def upload(self, index: int, sub: int) -> bytes:
        return self.master.upload(1, index, sub)

    def download(self, index: int, sub: int, raw: bytes) -> int:
        try:
            self.master.download(1, index, sub, raw)
        except Aborted as no:
            return no.code
        return 0

    def cycle(self, words: list[int], positions: list[int]) -> None:
        rows = zip(words, positions, strict=True)
        self.master.exchange([struct.pack("<HiihbB", *row, 0, 0, CSP, 0) for row in rows])
        assert self.master.count == 3 * len(DRIVES), "all are in OP"
        for k in DRIVES:
            assert self.master.fetch(k) is None, "no message but emergencies"
        emergencies = self.master.emergencies
        self.emergencies += [(emergency.slave, emergency.code) for emergency in emergencies]
        emergencies.clear()


REQUESTS = 1000
# Not the bus's own objects, nor values that only a mailbox sends in its first reply: texts, and
# those of more than four bytes.
BOTH = [
    entry
    for entry in list_entries()
    if entry.buses == ETHERCAT | CANOPEN
    and 0 < entry.bits <= 32
    and not 0x1003 <= entry.index < 0x2000
]
ABORT = 0x80

Bus = CanOpen | EtherCat


@pytest.fixture(params=[CanOpen, EtherCat])
def bus(request: pytest.FixtureRequest) -> Bus:
    bus_under_test: Bus = request.param()
    return bus_under_test


def test_every_entry_is_read_and_written_as_the_drive_has_it(bus: Bus) -> None:
    draw, count = random.Random(2), 0
    for entry in list_entries():
        if not entry.buses & bus.kind:
            continue
        at = entry.index, entry.sub
        assert bus.upload(*at) == bus.own.get(at, bus.drives.upload_entry(1, *at)), entry
        count += 1
        if entry.access == "rw" and entry.index >= 0x6000 and entry.index != 0x6040:
            value = draw.randint(entry.least, entry.most) & (1 << entry.bits) - 1
            raw, expected = value.to_bytes(entry.bits // 8, "little"), 0
            try:  # what another drive answers to the same
                bus.drives.download_entry(2, *at, raw)
            except dictionaries.Aborted as no:
                expected = no.code
            assert bus.download(*at, raw) == expected, entry
            if expected == 0:
                assert bus.upload(*at) == raw, entry
    assert count > 150, "the whole dictionary"


# Requests, one after the other, and the abort of the last one.
ABORTS = [
    ("no such object", ["40 00 50 00"], 0x06020000),
    ("no such sub", ["40 18 10 09"], 0x06090011),
    ("constant", ["23 00 10 00"], 0x06010002),
    ("read only", ["2b 41 60 00 01 00"], 0x06010002),
    ("too long", ["23 40 60 00 01 00 00 00"], 0x06070012),
    ("too short", ["2f 40 60 00 01"], 0x06070013),
    ("above its range", ["2b 86 60 00 01 00"], 0x06090031),
    ("unknown command", ["e0 7a 60 00 04"], 0x05040001),
    ("a segment of nothing", ["60"], 0x05040001),
    ("a segment for nothing", ["00"], 0x05040001),
    ("larger than any object", ["21 7a 60 00 ff ff ff 7f"], 0x05040005),
    ("segments for no object", ["21 ff 7f 00 04"], 0x06020000),
    ("a toggle bit that should be 0", ["21 7a 60 00 04", "10"], 0x05030000),
    ("which ends the transfer", ["21 7a 60 00 04", "10", "00"], 0x05040001),
    ("three bytes of four", ["21 7a 60 00 04", "09 01 02 03"], 0x06070010),
]


@pytest.mark.parametrize(("case", "requests", "code"), ABORTS, ids=[abort[0] for abort in ABORTS])
def test_an_sdo_that_cannot_be_changes_nothing(
    bus: Bus, case: str, requests: list[str], code: int
) -> None:
    entries = [entry for entry in list_entries() if entry.buses & bus.kind]
    before = [bus.drives.upload_entry(1, entry.index, entry.sub) for entry in entries]
    for text in requests:
        request = bytes.fromhex(text)
        reply = bus.sdo(request)
    assert (reply[0], reply[4:]) == (0x80, struct.pack("<I", code)), reply.hex()
    if "nothing" not in case:  # else it is any object
        named = bytes.fromhex(requests[0])[1:4] if case != "which ends the transfer" else b""
        assert reply[1:4] == named.ljust(3, b"\0"), "the object of the transfer"
    assert [bus.drives.upload_entry(1, entry.index, entry.sub) for entry in entries] == before
    assert bus.upload(0x1008, 0) == SCENE.name.encode(), "the server goes on"


def enable(bus: Bus, positions: list[int]) -> None:
    for word in (6, 7, 15):
        bus.cycle([word] * 3, positions)
    assert [bus.drives.read(k, 0x6041) & 0x6F for k in DRIVES] == [0x27] * 3, "Operation enabled"


def test_a_following_error_is_reported_once_and_reset(bus: Bus) -> None:
    """A target that jumps: one drive in Fault, the others go on; a reset reports its end."""
    for k in DRIVES:
        bus.drives.write(k, 0x6060, CSP)
    bus.drives.write(1, 0x6065, 100)
    at = [bus.drives.read(k, 0x6064) for k in DRIVES]
    enable(bus, at)
    for _ in range(100):
        bus.cycle([15] * 3, [at[0], at[1] + 5000, at[2]])
    assert bus.emergencies == [(1, 0x8611)], "following error"
    faults = [bus.drives.read(k, 0x6041) & 0x4F == 0x08 for k in DRIVES]
    assert faults == [False, True, False], "in Fault"
    at[1] = bus.drives.read(1, 0x6064)
    for word in (0, 0x80, 0):
        bus.cycle([15, word, 15], at)
    assert bus.emergencies[1:] == [(1, 0)], "error reset"
    enable(bus, at)


def request(draw: random.Random, toggle: int, announced: int) -> bytes:
    """Return 8 bytes that mean the same on both buses; a segment where bytes are announced."""
    entry = draw.choice(BOTH)
    index, sub = (
        (entry.index, entry.sub) if draw.random() < 0.9 else (draw.randrange(0x7000, 0x10000), 1)
    )
    value = draw.choice((0, 1, entry.least, entry.most, entry.standard)) & 0xFFFFFFFF
    size = entry.bits // 8 if draw.random() < 0.8 else draw.choice((1, 2, 3, 4))
    part = min(announced, 7) if announced and draw.random() < 0.8 else size
    match 3 if announced and draw.random() < 0.8 else draw.randrange(5):
        case 0:
            return struct.pack("<BHB4x", 0x40, index, sub)
        case 1:
            return struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, sub, value)
        case 2:  # segments follow
            return struct.pack("<BHBI", 0x21, index, sub, draw.choice((size, size, 5, 1 << 20)))
        case 3:
            last, flipped = draw.random() < 0.7, 0x10 * (draw.random() < 0.1)
            data = value.to_bytes(7, "little")
            return bytes(((toggle ^ flipped) | (7 - part) << 1 | last,)) + data
        case _:
            return bytes((draw.choice((0x60, 0x70, 0x80, 0xE0)),)) + draw.randbytes(7)


@pytest.mark.parametrize("seed", some(range(40), 4))
def test_both_buses_answer_alike(seed: int) -> None:
    draw = random.Random(seed)
    by_can, master = drives_of(SCENE), Master(Segment(SCENE, SERVO, lockstep=True))
    master.preop(0)
    toggle, announced, aborts, taken = 0, 0, set(), 0
    for _ in range(REQUESTS):
        sdo_request = request(draw, toggle, announced)
        replies = by_can.serve_sdo(0, sdo_request)
        if sdo_request[0] >> 5 == 4:
            assert replies == [], "a client that gives up gets no answer"
            master.mail(0, b"\0\x20" + sdo_request)
            assert master.fetch(0) is None
            toggle, announced = 0, 0
            continue
        (reply,) = replies
        assert master.coe(0, 2, sdo_request) == reply, sdo_request.hex()
        if reply[0] == ABORT:
            aborts.add(reply[4:])
        taken += reply[0] >> 5 == 1
        began = sdo_request[0] == 0x21 and reply[0] != ABORT
        announced = int.from_bytes(sdo_request[4:], "little") if began else 0
        toggle = toggle ^ 0x10 if sdo_request[0] >> 5 == 0 and reply[0] != ABORT else 0
    assert len(aborts) >= 6, "kinds of aborts"
    assert taken >= 10, "segments that were taken"
    for entry in BOTH:
        at = entry.index, entry.sub
        assert by_can.upload_entry(0, *at) == master.segment.drives.upload_entry(0, *at), entry


def test_a_unit_behind_a_bearing_belongs_to_the_joint() -> None:
    """Deflections count among the machine's joints, not among the drives."""
    unit = {"accelerometer": {"noise": 0.1}}
    tilts = {"tilt_x": {"stiffness": 1e5}, "tilt_y": {"stiffness": 1e5}}
    keys = {"joints.waist.bearing": tilts, "imus.hand": {"link": "forearm", **unit}}
    scene = load_scene("three_axis", keys)
    without = load_scene("three_axis", {"imus.hand": keys["imus.hand"]})
    assert scene.imus[0].place == without.imus[0].place + 2
    found = {name for name, output in KNOWN.items() if output.per_unit}
    places = [find_places(one, 1) for one in (scene, without)]
    per_unit = [k for k, output in enumerate(REPORTED) if output.name in found]
    assert (places[0][:, per_unit] == places[1][:, per_unit]).all()
    assert (places[0][:, per_unit] >= 0).any()

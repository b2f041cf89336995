"""One SDO server behind both buses: the same requests get the same replies."""

from __future__ import annotations

import random
import struct

import pytest
from draws import some
from ethercat_master import Master

from arm_emulator.base.config_files import find_scene
from arm_emulator.doors.fieldbus.drives import CANOPEN, ETHERCAT, Drives, dictionary
from arm_emulator.doors.fieldbus.ethercat import Segment
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import load_scene
from arm_emulator.runs.gains import load_gains

SCENE = load_scene("three_axis")
SERVO = load_gains(find_scene("three_axis")).servo
REQUESTS = 1000
# Not the bus's own objects, nor texts, which only a mailbox sends in its first reply.
BOTH = [
    one
    for one in dictionary()
    if one.buses == ETHERCAT | CANOPEN and one.bits and not 0x1003 <= one.index < 0x2000
]
ABORT = 0x80


def request(draw: random.Random, toggle: int, announced: int) -> bytes:
    """Return 8 bytes that mean the same on both buses; a segment where bytes are announced."""
    one = draw.choice(BOTH)
    index, sub = (
        (one.index, one.sub) if draw.random() < 0.9 else (draw.randrange(0x7000, 0x10000), 1)
    )
    value = draw.choice((0, 1, one.least, one.most, one.standard)) & 0xFFFFFFFF
    size = one.bits // 8 if draw.random() < 0.8 else draw.choice((1, 2, 3, 4))
    part = min(announced, 7) if announced and draw.random() < 0.8 else size
    match 3 if announced and draw.random() < 0.8 else draw.randrange(5):
        case 0:
            return struct.pack("<BHB4x", 0x40, index, sub)
        case 1:
            return struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, sub, value)
        case 2:  # segments follow
            return struct.pack("<BHBI", 0x21, index, sub, draw.choice((size, size, 5, 1 << 20)))
        case 3:
            last, other = draw.random() < 0.7, 0x10 * (draw.random() < 0.1)
            data = value.to_bytes(7, "little")
            return bytes(((toggle ^ other) | (7 - part) << 1 | last,)) + data
        case _:
            return bytes((draw.choice((0x60, 0x70, 0x80, 0xE0)),)) + draw.randbytes(7)


@pytest.mark.parametrize("seed", some(range(40), 4))
def test_both_buses_answer_alike(seed: int) -> None:
    draw = random.Random(seed)
    by_can = Drives(Plant(SCENE), SERVO, CANOPEN)
    master = Master(Segment(SCENE, SERVO, lockstep=True))
    master.preop(0)
    toggle, announced, aborts, taken = 0, 0, set(), 0
    for _ in range(REQUESTS):
        asked = request(draw, toggle, announced)
        replies = by_can.sdo(0, asked)
        if asked[0] >> 5 == 4:
            assert replies == [], "a client that gives up gets no answer"
            master.mail(0, b"\0\x20" + asked)
            assert master.fetch(0) is None
            toggle, announced = 0, 0
            continue
        (reply,) = replies
        assert master.coe(0, 2, asked) == reply, asked.hex()
        if reply[0] == ABORT:
            aborts.add(reply[4:])
        taken += reply[0] >> 5 == 1
        began = asked[0] == 0x21 and reply[0] != ABORT
        announced = int.from_bytes(asked[4:], "little") if began else 0
        toggle = toggle ^ 0x10 if asked[0] >> 5 == 0 and reply[0] != ABORT else 0
    assert len(aborts) >= 6, "kinds of aborts"
    assert taken >= 10, "segments that were taken"
    for one in BOTH:
        at = one.index, one.sub
        assert by_can.upload(0, *at) == master.segment.drives.upload(0, *at), one


def test_the_abort_of_a_segment_names_the_object() -> None:
    drives = Drives(Plant(SCENE), SERVO, CANOPEN)
    drives.sdo(0, struct.pack("<BHBI", 0x21, 0x607A, 0, 4))
    (reply,) = drives.sdo(0, b"\x10" + bytes(7))  # the toggle bit should be 0
    assert reply == struct.pack("<BHBI", ABORT, 0x607A, 0, 0x05030000)
    (reply,) = drives.sdo(0, b"\x00" + bytes(7))
    assert reply == struct.pack("<BHBI", ABORT, 0, 0, 0x05040001), "which has ended the transfer"


def test_a_download_to_no_object_ends_before_its_segments() -> None:
    drives = Drives(Plant(SCENE), SERVO, CANOPEN)
    (reply,) = drives.sdo(0, struct.pack("<BHBI", 0x21, 0x7FFF, 0, 4))
    assert reply == struct.pack("<BHBI", ABORT, 0x7FFF, 0, 0x06020000)

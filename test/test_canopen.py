"""Drives as CANopen nodes, by their frames and without a bus: NMT, SDO, PDOs, heartbeats, EDS."""

from __future__ import annotations

import configparser
import math
import random
import re
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from draws import FULL

from arm_emulator.base.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.canopen import write_eds
from arm_emulator.doors.fieldbus.can_bus import can_bus
from arm_emulator.doors.fieldbus.canopen_node import Frame, State
from arm_emulator.doors.fieldbus.canopen_segment import Segment
from arm_emulator.doors.fieldbus.drives import CANOPEN, Aborted, Drives, dictionary
from arm_emulator.doors.fieldbus.eds import eds
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.runs.gains import load_gains

FRAMES = 1_000_000 if FULL else 12_000
SYNC = Frame(0x80)
ENTRIES = [one for one in dictionary() if one.buses & CANOPEN]
CSP = 8


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis")


def drives_of(scene: Scene) -> Drives:
    return Drives(Plant(scene), load_gains(find_scene(scene.name)).servo, CANOPEN)


def segment_of(scene: Scene, first: int = 1, *, operational: bool = False) -> Segment:
    segment = Segment(drives_of(scene), first)
    segment.boot()
    if operational:
        segment.receive(Frame(0, bytes((1, 0))))
    return segment


def uploaded(segment: Segment, number: int, index: int, sub: int) -> bytes:
    """A client of SDO, written from the standard; raises the abort code as a LookupError."""
    reply = sdo(segment, number, struct.pack("<BHB4x", 0x40, index, sub))
    if reply[0] & 2:
        assert reply[1:4] == struct.pack("<HB", index, sub)
        return reply[4 : 8 - (reply[0] >> 2 & 3)]
    assert reply[0] == 0x41, "segmented, with the size"
    size, value, toggle = struct.unpack("<I", reply[4:])[0], b"", 0
    while True:
        reply = sdo(segment, number, bytes((0x60 | toggle,)) + bytes(7))
        assert reply[0] & 0xF0 == toggle
        value += reply[1 : 8 - (reply[0] >> 1 & 7)]
        toggle ^= 0x10
        if reply[0] & 1:
            assert len(value) == size
            return value


def download(
    segment: Segment, number: int, index: int, sub: int, value: bytes, *, by_segments: bool = False
) -> None:
    size = len(value)
    if size <= 4 and not by_segments:
        head = 0x23 | (4 - size) << 2
        reply = sdo(segment, number, struct.pack("<BHB", head, index, sub) + value.ljust(4, b"\0"))
        assert reply == struct.pack("<BHB4x", 0x60, index, sub)
        return
    reply = sdo(segment, number, struct.pack("<BHBI", 0x21, index, sub, size))
    assert reply == struct.pack("<BHB4x", 0x60, index, sub)
    toggle = 0
    while True:
        part, value = value[:7], value[7:]
        head = toggle | (7 - len(part)) << 1 | (not value)
        reply = sdo(segment, number, bytes((head,)) + part.ljust(7, b"\0"))
        assert reply == bytes((0x20 | toggle,)) + bytes(7)
        toggle ^= 0x10
        if not value:
            return


def sdo(segment: Segment, number: int, request: bytes) -> bytes:
    (reply,) = segment.receive(Frame(0x600 + number, request))
    assert reply.id == 0x580 + number and len(reply.data) == 8
    if reply.data[0] == 0x80:
        raise LookupError(struct.unpack("<I", reply.data[4:])[0])
    return reply.data


def put(segment: Segment, number: int, index: int, sub: int, value: int, size: int) -> None:
    download(segment, number, index, sub, value.to_bytes(size, "little"))


def refused(segment: Segment, number: int, index: int, sub: int, value: int, size: int) -> int:
    with pytest.raises(LookupError) as no:
        put(segment, number, index, sub, value, size)
    return int(no.value.args[0])


def sent(frames: Sequence[Frame], id_: int) -> list[bytes]:
    return [frame.data for frame in frames if frame.id == id_]


def test_nodes_boot_and_follow_network_management(scene: Scene) -> None:
    """Any commands in any order, against the table of CiA 301."""
    segment = Segment(drives_of(scene), 10)
    assert segment.boot() == [Frame(0x700 + number, b"\0") for number in (10, 11, 12)]
    draw, model = random.Random(1), {number: 127 for number in (10, 11, 12)}
    toggle = {number: 0 for number in model}
    table = {1: 5, 2: 4, 128: 127, 129: 127, 130: 127}
    for _ in range(300):
        command = draw.choice([1, 2, 128, 129, 130, 0, 77])
        to = draw.choice([0, 9, 10, 11, 12, 13])
        frames = segment.receive(Frame(0, bytes((command, to))))
        reached = [number for number in model if to in (0, number)]
        for number in reached:
            model[number] = table.get(command, model[number])
        boots = [data for number in reached for data in sent(frames, 0x700 + number)]
        assert boots == ([b"\0"] * len(reached) if command in (129, 130) else [])
        assert {node.number: int(node.state) for node in segment.nodes} == model
        number = draw.choice(list(model))
        if command in (129, 130) and number in reached:
            toggle[number] = 0
        for other in reached:
            toggle[other] = 0 if command in (129, 130) else toggle[other]
        guarded = segment.receive(Frame(0x700 + number, remote=True))
        assert guarded == [Frame(0x700 + number, bytes((model[number] | toggle[number],)))]
        toggle[number] ^= 0x80
        ask = segment.receive(Frame(0x600 + number, struct.pack("<BHB4x", 0x40, 0x1000, 0)))
        assert bool(ask) == (model[number] != 4), "no SDO while stopped"
    for data in (b"", b"\1", b"\1\0\0"):
        before = [node.state for node in segment.nodes]
        segment.receive(Frame(0, data))
        assert [node.state for node in segment.nodes] == before


def test_whole_dictionary_is_read_and_written_as_the_drive_has_it(scene: Scene) -> None:
    segment, draw = segment_of(scene, 5), random.Random(2)
    drives = segment.drives
    for one in ENTRIES:
        if one.index == 0x1200 and one.sub:
            expected = struct.pack("<I", {1: 0x606, 2: 0x586}[one.sub])
        else:
            expected = drives.upload(1, one.index, one.sub)
        assert uploaded(segment, 6, one.index, one.sub) == expected, one
        if one.access == "rw" and one.index >= 0x6000 and one.index != 0x6040:
            value = draw.randint(one.least, one.most) & (1 << one.bits) - 1
            raw = value.to_bytes(one.bits // 8, "little")
            own = drives_of_one(drives, one.index, one.sub, raw)
            try:
                download(segment, 6, one.index, one.sub, raw, by_segments=draw.random() < 0.5)
                assert own == 0
            except LookupError as no:
                assert own == no.args[0]


def drives_of_one(drives: Drives, index: int, sub: int, raw: bytes) -> int:
    """Return the reply of another drive of the machine to the same write."""
    try:
        drives.download(2, index, sub, raw)
    except Aborted as no:
        return no.code
    return 0


@pytest.mark.parametrize(
    ("index", "sub", "value", "size", "code"),
    [
        (0x7FFF, 0, 0, 4, 0x06020000),  # no such object
        (0x6040, 1, 0, 2, 0x06090011),  # no such sub
        (0x1000, 0, 0, 4, 0x06010002),  # constant
        (0x6041, 0, 0, 2, 0x06010002),  # read only
        (0x6040, 0, 0, 4, 0x06070012),  # too long
        (0x6040, 0, 0, 1, 0x06070013),  # too short
        (0x6086, 0, 1, 2, 0x06090031),  # above its range
        (0x1005, 0, 1 << 30 | 0x80, 4, 0x06090030),  # it does not produce SYNC
        (0x1005, 0, 1 << 29 | 0x80, 4, 0x06090030),  # 29 bits
        (0x1005, 0, 0, 4, 0x06090030),  # the identifier of NMT
        (0x1014, 0, 0x601, 4, 0x06090030),  # that of an SDO
        (0x1005, 0, 0x712, 4, 0x06090030),  # that of a heartbeat
        (0x1016, 1, 200 << 16 | 5, 4, 0x06090030),  # node-ID 200
        (0x1400, 1, 0x333, 4, 0x08000022),  # another identifier while it is in use
        (0x1400, 1, 0x80000000, 4, 0),
        (0x1400, 1, 0x80000601, 4, 0),  # not in use: any
        (0x1400, 1, 0x601, 4, 0x06090030),
        (0x1402, 2, 241, 1, 0x06090030),
        (0x1802, 2, 250, 1, 0x06090030),
        (0x1802, 2, 252, 1, 0),
        (0x1600, 1, 0x60400010, 4, 0x08000022),  # mapped while there are entries
        (0x1010, 1, int.from_bytes(b"save", "little"), 4, 0x08000020),  # nothing is stored
        (0x1011, 1, 0x12345678, 4, 0x08000020),  # without the word that means it
    ],
)
def test_aborts_change_nothing(
    scene: Scene, index: int, sub: int, value: int, size: int, code: int
) -> None:
    segment = segment_of(scene)
    before = dumped(segment, 1)
    if code:
        assert refused(segment, 1, index, sub, value, size) == code
        assert dumped(segment, 1) == before
    else:
        put(segment, 1, index, sub, value, size)
        assert uploaded(segment, 1, index, sub) == value.to_bytes(size, "little")


def dumped(segment: Segment, number: int) -> list[bytes]:
    node = next(node for node in segment.nodes if node.number == number)
    return [node.upload(one.index, one.sub) for one in ENTRIES]


def test_transfers_that_go_wrong_are_aborted(scene: Scene) -> None:
    segment = segment_of(scene)
    ask = struct.pack("<BHB4x", 0x40, 0x1008, 0)

    def code(request: bytes) -> int:
        with pytest.raises(LookupError) as no:
            sdo(segment, 1, request)
        return int(no.value.args[0])

    assert code(b"\x60" + bytes(7)) == 0x05040001, "a segment without a transfer"
    assert code(b"\x00" + bytes(7)) == 0x05040001
    sdo(segment, 1, ask)
    assert code(b"\x70" + bytes(7)) == 0x05030000, "a toggle bit that did not alternate"
    assert code(b"\x60" + bytes(7)) == 0x05040001, "which has ended the transfer"
    sdo(segment, 1, struct.pack("<BHBI", 0x21, 0x607A, 0, 4))
    assert code(b"\x09\x01\x02\x03" + bytes(4)) == 0x06070010, "three bytes of four announced"
    assert code(struct.pack("<BHBI", 0x21, 0x607A, 0, 1 << 30)) == 0x05040005
    assert code(b"\xe0" + struct.pack("<HBI", 0x607A, 0, 4)) == 0x05040001, "no such command"
    assert segment.receive(Frame(0x601, b"\x80" + bytes(7))) == [], "the client's abort"
    assert segment.receive(Frame(0x601, ask[:7])) == [], "seven bytes"
    assert uploaded(segment, 1, 0x1008, 0) == scene.name.encode()


def checksum(value: bytes) -> int:
    """Of blocks, by its definition: x^16 + x^12 + x^5 + 1, from zero, a bit at a time."""
    check = 0
    for byte in value:
        for k in range(7, -1, -1):
            high = check >> 15 ^ byte >> k & 1
            check = (check << 1 & 0xFFFF) ^ (0x1021 if high else 0)
    return check


@pytest.mark.parametrize("seed", range(3))
def test_block_uploads_bring_every_entry_whatever_is_lost(scene: Scene, seed: int) -> None:
    """A client that loses segments confirms those before, and gets the others once more."""
    segment, draw = segment_of(scene), random.Random(seed)

    def ask(request: bytes) -> list[bytes]:
        return sent(segment.receive(Frame(0x601, request)), 0x581)

    for one in [one for one in ENTRIES if not one.bits] + draw.sample(ENTRIES, 40):
        size = draw.randint(1, 127)
        (reply,) = ask(struct.pack("<BHBBB2x", 0xA4, one.index, one.sub, size, 0))
        expected = segment.nodes[0].upload(one.index, one.sub)
        assert reply == struct.pack("<BHBI", 0xC6, one.index, one.sub, len(expected))
        value, segments = b"", ask(b"\xa3" + bytes(7))
        while True:
            assert [part[0] & 0x7F for part in segments] == list(range(1, len(segments) + 1))
            assert len(segments) <= size
            got = draw.randint(0, len(segments)) if draw.random() < 0.5 else len(segments)
            value += b"".join(part[1:] for part in segments[:got])
            last = got and segments[got - 1][0] & 0x80
            size = draw.randint(1, 127)
            segments = ask(bytes((0xA2, got, size)) + bytes(5))
            if last:
                break
        (end,) = segments
        assert end[0] & 0xE3 == 0xC1
        value = value[: len(value) - (end[0] >> 2 & 7)]
        assert value == expected and checksum(value) == end[1] | end[2] << 8
        assert ask(b"\xa1" + bytes(7)) == []


@pytest.mark.parametrize("seed", range(3))
def test_block_downloads_take_the_value_only_as_a_whole(scene: Scene, seed: int) -> None:
    segment, draw = segment_of(scene), random.Random(seed)

    def ask(request: bytes) -> list[bytes]:
        return sent(segment.receive(Frame(0x601, request)), 0x581)

    for _ in range(40):
        before = uploaded(segment, 1, 0x607A, 0)
        value = draw.randbytes(draw.choice([4, 4, 4, 3, 5, 30]))
        sized, crc = draw.random() < 0.7, draw.random() < 0.9
        head = 0xC0 | 4 * crc | 2 * sized
        (reply,) = ask(struct.pack("<BHBI", head, 0x607A, 0, len(value) if sized else 0))
        assert reply == struct.pack("<BHBB3x", 0xA4, 0x607A, 0, 127)
        parts = [value[k : k + 7] for k in range(0, len(value), 7)]
        at = 0
        while at < len(parts):
            lost = draw.randrange(10)  # the segment of this block that does not arrive, if any
            replies = []
            for number, part in enumerate(parts[at:], 1):
                last = 0x80 * (at + number == len(parts))
                if number - 1 != lost or last:  # without the last one both would wait
                    replies += ask(bytes((number | last,)) + part.ljust(7, b"\0"))
            (confirmed,) = replies
            assert confirmed[0] == 0xA2 and confirmed[2] == 127
            assert confirmed[1] == min(lost, len(parts) - at) or lost >= len(parts) - at - 1
            at += confirmed[1]
        check = checksum(value) ^ (draw.random() < 0.3)
        unused = -len(value) % 7
        (end,) = ask(struct.pack("<BH5x", 0xC1 | unused << 2, check))
        wrong = crc and check != checksum(value)
        if len(value) == 4 and not wrong:
            assert end == b"\xa1" + bytes(7) and uploaded(segment, 1, 0x607A, 0) == value
        else:
            length = {3: 0x06070013}.get(len(value), 0x06070012)
            assert end == struct.pack("<BHBI", 0x80, 0x607A, 0, 0x05040004 if wrong else length)
            assert uploaded(segment, 1, 0x607A, 0) == before


def test_block_transfers_that_go_wrong_are_aborted(scene: Scene) -> None:
    segment = segment_of(scene)

    def code(*requests: bytes) -> int:
        for request in requests:
            replies = sent(segment.receive(Frame(0x601, request)), 0x581)
        (reply,) = replies
        assert reply[:4] == struct.pack("<BHB", 0x80, 0x1008, 0)
        return int(struct.unpack("<I", reply[4:])[0])

    up = struct.pack("<BHBBB2x", 0xA4, 0x1008, 0, 1, 0)
    down = struct.pack("<BHBI", 0xC6, 0x1008, 0, 5)
    start, end = b"\xa3" + bytes(7), b"\xa1" + bytes(7)
    assert code(struct.pack("<BHBBB2x", 0xA4, 0x1008, 0, 0, 0)) == 0x05040002
    assert code(struct.pack("<BHBBB2x", 0xA4, 0x1008, 0, 128, 0)) == 0x05040002
    assert code(up, end) == 0x05040001
    assert code(up, start, b"\xa2\x02\x01" + bytes(5)) == 0x05040003, "two of one confirmed"
    assert code(up, start, b"\xa2\x01\x00" + bytes(5)) == 0x05040002
    assert code(struct.pack("<BHBI", 0xC6, 0x1008, 0, 1 << 20)) == 0x05040005
    assert code(down, bytes(8)) == 0x05040003, "segment 0"
    assert code(down, b"\x81" + bytes(7), bytes(8)) == 0x05040001, "no end where it is due"
    assert code(down, b"\x81" + bytes(7), b"\xc9" + bytes(7)) == 0x06010002, "it is constant"
    assert code(*[down, *(bytes((k,)) + bytes(7) for k in range(1, 39))]) == 0x05040005


def test_receive_pdos_hold_from_the_next_sync_or_at_once(scene: Scene) -> None:
    segment = segment_of(scene)
    put(segment, 2, 0x1402, 2, 255, 1)
    position = struct.pack("<Hi", 0, 4711)
    segment.receive(Frame(0x302, position))
    assert uploaded(segment, 2, 0x607A, 0) != position[2:], "pre-operational: no PDOs"
    segment.receive(Frame(0, b"\1\0"))
    before = uploaded(segment, 2, 0x607A, 0)
    segment.receive(Frame(0x302, position))
    assert uploaded(segment, 2, 0x607A, 0) == before, "waits for SYNC"
    segment.receive(SYNC)
    assert uploaded(segment, 2, 0x607A, 0) == position[2:]
    segment.receive(Frame(0x402, struct.pack("<Hi", 0, -5)))
    assert uploaded(segment, 2, 0x60FF, 0) == struct.pack("<i", -5), "at once"
    assert uploaded(segment, 1, 0x60FF, 0) == bytes(4), "the other node's stays"
    (reported,) = segment.receive(Frame(0x402, b"\1\2\3"))
    assert reported == Frame(0x82, struct.pack("<HB5x", 0x8210, 0)), "too short, and reported"
    assert uploaded(segment, 2, 0x60FF, 0) == struct.pack("<i", -5)
    segment.receive(Frame(0x302, struct.pack("<Hi", 0, 1)))
    put(segment, 2, 0x1017, 0, 0, 2)  # another setting
    segment.receive(SYNC)
    assert uploaded(segment, 2, 0x607A, 0) == struct.pack("<i", 1), "what waited was kept"


@pytest.mark.parametrize("every", [1, 2, 7, 240])
def test_transmit_pdos_come_with_every_nth_sync(scene: Scene, every: int) -> None:
    segment = segment_of(scene)
    put(segment, 1, 0x1801, 2, every, 1)
    segment.receive(Frame(0, b"\1\0"))
    for k in range(1, 500):
        reported = uploaded(segment, 1, 0x6064, 0)
        (*data,) = sent(segment.receive(SYNC), 0x281)
        assert len(data) == (k % every == 0), k
        assert not data or data[0][2:] == reported, "as it was when SYNC came"
    assert segment.tick == 499, "one servo period per SYNC"


def test_transmit_pdos_on_event_on_request_and_by_timer(scene: Scene) -> None:
    segment = segment_of(scene)
    put(segment, 1, 0x1800, 5, 3, 2)  # at the latest after 3 ms
    put(segment, 1, 0x1801, 2, 252, 1)
    put(segment, 1, 0x1802, 2, 253, 1)
    frames = segment.receive(Frame(0, b"\1\0"))
    assert len(sent(frames, 0x181)) == 1, "on entering operational"
    came = [len(sent(segment.receive(SYNC), 0x181)) for _ in range(9)]
    assert came == [0, 0, 1] * 3, "the statusword stands still: by the timer"
    assert sent(segment.receive(Frame(0x281, remote=True)), 0x281), "sampled by SYNC"
    assert sent(segment.receive(Frame(0x381, remote=True)), 0x381), "sampled when asked for"
    put(segment, 1, 0x1802, 1, 0x80000381, 4)
    assert not segment.receive(Frame(0x381, remote=True)), "switched off"


def test_mapping_is_changed_as_the_standard_states(scene: Scene) -> None:
    segment = segment_of(scene, operational=True)
    assert refused(segment, 1, 0x1A01, 0, 0, 1) == 0x08000022, "operational, and in use"
    put(segment, 1, 0x1801, 1, 0x80000281, 4)
    put(segment, 1, 0x1A01, 0, 0, 1)
    put(segment, 1, 0x1801, 1, 0x281, 4)
    assert not sent(segment.receive(SYNC), 0x281), "nothing is mapped"
    put(segment, 1, 0x1801, 1, 0x80000281, 4)
    assert refused(segment, 1, 0x1A01, 1, 0x607A0020, 4) == 0x06040041, "it cannot transmit that"
    put(segment, 1, 0x1A01, 1, 0x60640020, 4)
    put(segment, 1, 0x1A01, 2, 0x606C0020, 4)
    put(segment, 1, 0x1A01, 3, 0x60410010, 4)
    assert refused(segment, 1, 0x1A01, 0, 3, 1) == 0x06040042, "10 bytes"
    put(segment, 1, 0x1A01, 0, 2, 1)
    put(segment, 1, 0x1801, 1, 0x123 + 0x200, 4)
    reported = uploaded(segment, 1, 0x6064, 0) + uploaded(segment, 1, 0x606C, 0)
    assert sent(segment.receive(SYNC), 0x323) == [reported]
    fresh = dumped(segment_of(scene), 1)
    segment.receive(Frame(0, bytes((128, 1))))
    segment.receive(Frame(0, bytes((130, 1))))
    assert dumped(segment, 1) == fresh, "a reset of the communication restores it"


def test_heartbeats_are_sent_and_watched(scene: Scene) -> None:
    segment = segment_of(scene, operational=True)
    put(segment, 1, 0x1017, 0, 10, 2)
    ms = 1_000_000
    beats = [t for t in range(0, 100) if segment.heartbeats(5 * ms + t * ms)]
    assert beats == list(range(0, 100, 10))
    assert segment.heartbeats(200 * ms) == [Frame(0x701, b"\5")]
    assert segment.receive(Frame(0x701, remote=True)) == [], "no guarding beside it"
    put(segment, 2, 0x1016, 1, 0x7F << 16 | 5, 4)
    for _ in range(20):
        assert not sent(segment.receive(SYNC), 0x82), "not heard yet: not watched"
    for _ in range(3):
        segment.receive(Frame(0x77F, b"\5"))
        for _ in range(5):
            assert not sent(segment.receive(SYNC), 0x82)
    lost = sent(segment.receive(SYNC), 0x82)
    assert [data[:2] for data in lost] == [b"\x30\x81"], "life guard error"
    assert [node.state for node in segment.nodes] == [5, State.PRE_OPERATIONAL, 5]
    for _ in range(10):
        assert not sent(segment.receive(SYNC), 0x82), "reported once"


def enable(segment: Segment, mode: int) -> None:
    """Bring all drives to Operation enabled by process data, one SYNC per step."""
    segment.receive(Frame(0, b"\1\0"))
    for word in (6, 7, 15):
        for node in segment.nodes:
            segment.receive(Frame(0x200 + node.number, struct.pack("<Hb", word, mode)))
        segment.receive(SYNC)
    for node in segment.nodes:
        assert uploaded(segment, node.number, 0x6041, 0)[0] & 0x6F == 0x27, "Operation enabled"


# Mode, identifier of the RPDO with its target, of the TPDO with what became of it; their entries.
CYCLIC = [
    (8, 0x300, 0x280, "<Hi", 0x607A, 0x6064),
    (9, 0x400, 0x380, "<Hi", 0x60FF, 0x606C),
    (10, 0x500, 0x480, "<Hh", 0x6071, 0x6077),
]


@pytest.mark.parametrize(("mode", "rx", "tx", "layout", "target", "actual"), CYCLIC)
def test_a_motion_by_frames_is_that_of_the_drives(
    scene: Scene, mode: int, rx: int, tx: int, layout: str, target: int, actual: int
) -> None:
    """Cyclic positions, speeds and torques by PDOs: equal bits, and positions are followed."""
    rng = np.random.default_rng(mode)
    segment, drives = segment_of(scene, 3), drives_of(scene)
    enable(segment, mode)
    for word in (6, 7, 15):
        for k in range(3):
            drives.write(k, 0x6060, mode)
            drives.write(k, 0x6040, word)
        drives.period()
    start = [drives.read(k, 0x6064) for k in range(3)]
    counts = 0.3 * 1024 / (2 * np.pi) / scene.gear_ratios  # 0.3 rad
    turning = 2 * np.pi * rng.uniform(0.3, 1.0, 3)
    for tick in range(800):
        angle = turning * tick * 1e-3
        wanted = {
            8: np.array(start) + counts * (1 - np.cos(angle)) / 2,
            9: counts * turning * np.sin(angle) / 2,
            10: 40 * np.sin(angle),  # 4 % of the rated torque
        }[mode]
        targets = np.rint(wanted).astype(int).tolist()
        for k, one in enumerate(targets):
            segment.receive(Frame(rx + 3 + k, struct.pack(layout, 15, one)))
        frames = segment.receive(SYNC)
        for k, one in enumerate(targets):
            reported = struct.unpack(layout, sent(frames, tx + 3 + k)[0])
            assert reported == (drives.read(k, 0x6041), drives.read(k, actual)), f"at SYNC {tick}"
            drives.write(k, 0x6040, 15)
            drives.write(k, target, one)
        drives.period()
        if mode == 8:  # 0.004 rad at the link, some periods' way
            assert all(abs(drives.read(k, actual) - targets[k]) < 60 for k in range(3))
    assert segment.drives.plant.save() == drives.plant.save()
    moved = [abs(drives.read(k, 0x6064) - start[k]) for k in range(3)]
    assert min(moved) > 100, "the arm has moved"


def test_a_cycle_is_as_long_as_the_interpolation_time_of_all_drives(scene: Scene) -> None:
    segment = segment_of(scene)
    for number, passed in ((1, 1), (2, 1), (3, 4)):
        put(segment, number, 0x60C2, 1, 4, 1)
        before = segment.tick
        segment.receive(SYNC)
        assert segment.tick - before == passed, f"4 ms set at {number} of three drives"


@pytest.mark.parametrize("value", [1, 4, 15, 25, 40, 254])
def test_an_interpolation_time_that_is_rounded_is_noted(scene: Scene, value: int) -> None:
    """In 0.1 ms, the servo period being 1 ms."""
    segment = segment_of(scene)
    for sub, number in ((1, value), (2, 256 - 4), (1, value)):
        put(segment, 2, 0x60C2, sub, number, 1)
    if value < 10 or value % 10 == 0:
        assert segment.uneven == []
    else:
        words = f"node 2: 0x60C2 is {value / 10:g} servo periods: SYNC stands for "
        assert segment.uneven == [words + str(math.floor(value / 10 + 0.5))]


def test_a_fault_is_reported_with_its_code(scene: Scene) -> None:
    """A target that jumps is a following error: EMCY, Fault; the reset reports that it is over."""
    segment = segment_of(scene)
    enable(segment, CSP)
    put(segment, 2, 0x6065, 0, 100, 4)
    at = int.from_bytes(uploaded(segment, 2, 0x6064, 0), "little", signed=True)
    reported: list[bytes] = []
    for _ in range(100):
        segment.receive(Frame(0x302, struct.pack("<Hi", 15, at + 5000)))
        reported += sent(segment.receive(SYNC), 0x82)
    assert [data[:2] for data in reported] == [b"\x11\x86"], "following error, reported once"
    assert reported[0][2] != 0, "the error register"
    assert uploaded(segment, 2, 0x6041, 0)[0] & 0x4F == 0x08, "Fault"
    for word in (0, 0x80, 0):
        segment.receive(Frame(0x302, struct.pack("<Hi", word, at)))
        reported += sent(segment.receive(SYNC), 0x82)
    assert reported[1:] == [bytes(8)], "error reset"


def test_a_stopped_node_and_a_lost_master_take_the_drives_off(scene: Scene) -> None:
    for command, code in ((b"\2\1", b"\x00\x81"), (None, b"\x30\x81")):
        segment = segment_of(scene)
        enable(segment, CSP)
        if command:
            segment.receive(Frame(0, command))
        else:
            put(segment, 1, 0x1016, 1, 0x7F << 16 | 3, 4)
            segment.receive(Frame(0x77F, b"\5"))
        for _ in range(100):
            segment.receive(SYNC)
        node = segment.nodes[0]
        assert node.upload(0x6041, 0)[0] & 0x4F == 0x08, "Fault, as 0x6007 states"
        assert node.upload(0x603F, 0) == code
        assert segment.nodes[1].upload(0x6041, 0)[0] & 0x6F == 0x27, "the others go on"
        segment.receive(Frame(0, b"\x81\1"))
        assert not sent(segment.receive(SYNC), 0x81), "a reset node has nothing to report"
        assert node.upload(0x6041, 0)[0] & 0x4F == 0x40, "Switch on disabled"


def test_a_machine_that_diverged_stays_and_its_nodes_answer(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    segment = segment_of(scene, operational=True)
    segment.receive(SYNC)
    still = np.zeros(3)
    gone = Diverged("waist", 0.001, scene, still, still, still, (still, still))

    def diverge() -> None:
        raise gone

    monkeypatch.setattr(segment.drives, "period", diverge)
    for _ in range(3):
        assert sent(segment.receive(SYNC), 0x281), "SYNC is answered"
    assert segment.fault is gone and segment.tick == 1
    assert uploaded(segment, 1, 0x1000, 0) == b"\x92\x01\x02\0"


def test_data_sheets_that_cannot_be_written_are_refused() -> None:
    with pytest.raises(Refusal, match=r"canopen: file .* must be writable, got File exists"):
        write_eds("three_axis", Path(__file__))


def noise(draw: random.Random, numbers: Sequence[int]) -> Frame:
    """A frame of some kind that a node might take, sound or spoiled."""
    number = draw.choice(numbers)
    one = draw.choice(ENTRIES)
    match draw.randrange(8):
        case 0 | 1 | 2:  # SDO with an entry of the dictionary, any command
            head = draw.choice([0x40, 0x2F, 0x2B, 0x23, 0x21, 0xA4, 0xC6, draw.randrange(256)])
            raw = struct.pack("<BHB", head, one.index, one.sub)
            value = draw.choice([draw.randbytes(4), bytes(4), struct.pack("<I", draw.randrange(9))])
            return Frame(0x600 + number, raw + value)
        case 3:  # segments, and anything else
            head = draw.choice(
                [0x00, 0x10, 0x01, 0x60, 0xA3, 0xA2, 0x81, 0xC1, draw.randrange(256)]
            )
            return Frame(0x600 + number, bytes((head,)) + draw.randbytes(draw.choice([7, 7, 7, 3])))
        case 4:
            commands = [1, 1, 1, 128, 2, 129, 130, draw.randrange(256)]
            return Frame(0, bytes((draw.choice(commands), draw.choice([0, number, 99]))))
        case 5:
            data = draw.randbytes(draw.randrange(9))
            return Frame(draw.choice([0x200, 0x300, 0x400, 0x500]) + number, data)
        case 6:
            return draw.choice([SYNC, Frame(0x80, b"\1"), Frame(0x77F, b"\5")])
    return Frame(draw.randrange(0x800), draw.randbytes(draw.randrange(9)), draw.random() < 0.3)


@pytest.mark.parametrize("seed", range(4))
def test_random_frames_leave_sound_nodes(scene: Scene, seed: int) -> None:
    """No frame breaks a node; what a server aborts, and what is for nobody, changes nothing."""
    segment, draw = segment_of(scene), random.Random(seed)
    numbers, looked = [1, 2, 3], 0
    for k in range(FRAMES // 4):
        frame = noise(draw, numbers)
        look = k % 50 == 0 and frame.id not in (0, 0x80)
        before = whole(segment) if look else None
        frames = segment.receive(frame)
        assert all(0 <= one.id < 0x800 and len(one.data) <= 8 for one in frames)
        if not look:
            continue
        aborted = frames and frames[0].id & 0x780 == 0x580 and frames[0].data[0] == 0x80
        for_nobody = frame.id & 0x7F not in numbers and not frame.remote and not frames
        if aborted or (for_nobody and frame.id not in ids_of(segment)):
            assert whole(segment) == before, frame
            looked += 1
    assert looked > FRAMES // 4 // 50 // 8
    assert np.isfinite(segment.drives.plant.state.q).all()
    segment.receive(Frame(0, b"\x81\0"))
    for number in numbers:
        assert uploaded(segment, number, 0x1000, 0) == b"\x92\x01\x02\0", "it still answers"


def ids_of(segment: Segment) -> set[int]:
    """Identifiers that PDOs, SYNC and heartbeats have after whatever was set."""
    ids = set()
    for node in segment.nodes:
        for index, sub in [(0x1005, 0), *((0x1400 + k, 1) for k in range(4))]:
            ids.add(int.from_bytes(node.upload(index, sub), "little") & 0x7FF)
        ids.add(0x700 + (int.from_bytes(node.upload(0x1016, 1), "little") >> 16 & 0x7F))
    return ids


def whole(segment: Segment) -> tuple[object, ...]:
    dumps = [dumped(segment, node.number) for node in segment.nodes]
    return dumps, [node.state for node in segment.nodes], segment.drives.plant.save()


def test_data_sheet_reports_every_entry(scene: Scene) -> None:
    node = segment_of(scene, 7).nodes[0]
    sheet = configparser.RawConfigParser()
    sheet.optionxform = str  # type: ignore[assignment,method-assign]
    sheet.read_string(eds(node, "a.eds", "a"))
    listed = [
        int(value, 16)
        for part in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
        for key, value in sheet[part].items()
        if key != "SupportedObjects"
    ]
    assert sorted(listed) == sorted({one.index for one in ENTRIES})
    for one in ENTRIES:
        name = f"{one.index:04X}" + ("" if one.code == 7 else f"sub{one.sub:X}")
        section = sheet[name]
        assert section["AccessType"] == one.access and section["ObjectType"] == "0x7"
        assert section["PDOMapping"] == str(int(one.rx or one.tx))
        if not one.bits:
            continue
        if one.type == "REAL32":
            assert float(section.get("DefaultValue", "0")) == 0.0 and "LowLimit" not in section
            continue
        span = _RANGES[int(section["DataType"], 0)]
        low, high = (
            int(section.get(key, str(bound)), 0)
            for key, bound in zip(("LowLimit", "HighLimit"), span, strict=True)
        )
        assert (low, high) == (one.least, one.most), f"limits of {name}"
        assert span[0] <= low <= high <= span[1], f"limits of {name} within its type"
        if "DefaultValue" in section:
            text = section["DefaultValue"].replace("$NODEID", "7")
            value = sum(int(part, 0) for part in text.split("+"))
            raw = node.upload(one.index, one.sub)
            assert value == int.from_bytes(raw, "little", signed=value < 0), name
            assert low <= value <= high, f"default of {name}"


# Keys that CiA 306 permits in a data sheet, and the values of the types in use.
_KEYS = {
    "FileInfo": "FileName FileVersion FileRevision EDSVersion Description CreationTime "
    "CreationDate CreatedBy ModificationTime ModificationDate ModifiedBy",
    "DeviceInfo": "VendorName VendorNumber ProductName ProductNumber RevisionNumber OrderCode "
    "BaudRate_10 BaudRate_20 BaudRate_50 BaudRate_125 BaudRate_250 BaudRate_500 BaudRate_800 "
    "BaudRate_1000 SimpleBootUpMaster SimpleBootUpSlave Granularity DynamicChannelsSupported "
    "GroupMessaging NrOfRXPDO NrOfTXPDO LSS_Supported",
    "object": "SubNumber ParameterName ObjectType DataType LowLimit HighLimit AccessType "
    "DefaultValue PDOMapping ObjFlags CompactSubObj",
}
_RANGES = {
    1: (0, 1),
    **{2 + k: (-(1 << bits - 1), (1 << bits - 1) - 1) for k, bits in enumerate((8, 16, 32))},
    **{5 + k: (0, (1 << bits) - 1) for k, bits in enumerate((8, 16, 32))},
}


def test_data_sheet_holds_what_the_standard_names(scene: Scene) -> None:
    sheet = configparser.RawConfigParser(strict=True)
    sheet.optionxform = str  # type: ignore[assignment,method-assign]
    sheet.read_string(eds(segment_of(scene, 7).nodes[0], "a.eds", "a"))
    for name in sheet.sections():
        numbered = re.fullmatch(r"(Mandatory|Optional|Manufacturer)Objects|DummyUsage", name)
        known = _KEYS.get(name) or (_KEYS["object"] if re.match(r"[0-9A-F]{4}", name) else "")
        for key in sheet[name]:
            of_list = numbered and re.fullmatch(r"SupportedObjects|\d+|Dummy000\d", key)
            assert of_list or key in known.split(), f"[{name}] {key}"


def test_a_bus_that_cannot_be_opened_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(Refusal, match=r"canopen: package python-can must be installed \(pip"):
        with can_bus("virtual", "0", None):
            pass
    monkeypatch.undo()
    pytest.importorskip("can", reason="python-can is not installed, see requirements-peers.txt")
    for bus, channel, words in (
        (
            "carrier_pigeon",
            "0",
            r"bus must be one of python-can, got carrier_pigeon; valid: .*virtual",
        ),
        ("socketcan", "no_such_line", r"bus socketcan, channel no_such_line must open, got "),
    ):
        with pytest.raises(Refusal, match=words):
            with can_bus(bus, channel, None):
                pass


@pytest.mark.parametrize("first", [0, 126, -1])
def test_unknown_nodes_are_refused(scene: Scene, first: int) -> None:
    with pytest.raises(Refusal, match=f"first node-ID must be 1 to 125, got {first}"):
        Segment(drives_of(scene), first)

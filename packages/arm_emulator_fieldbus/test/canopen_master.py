"""A small CANopen master for tests: frames into nodes of the same process, no bus."""

import struct
from collections.abc import Sequence

import pytest

from arm_emulator import Plant, Scene, load_gains
from arm_emulator.base.io.config_files import find_scene
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fieldbus.object_dictionary import list_entries

SYNC = CanFrame(0x80)
ENTRIES = [entry for entry in list_entries() if entry.buses & CANOPEN]


def drives_of(scene: Scene) -> Drives:
    return Drives(Plant(scene), load_gains(find_scene(scene.name)).servo, CANOPEN)


def segment_of(scene: Scene, first: int = 1, *, operational: bool = False) -> CanSegment:
    segment = CanSegment(drives_of(scene), first)
    segment.boot_nodes()
    if operational:
        segment.receive_frame(CanFrame(0, bytes((1, 0))))
    return segment


def uploaded(segment: CanSegment, number: int, index: int, sub: int) -> bytes:
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
    segment: CanSegment,
    number: int,
    index: int,
    sub: int,
    value: bytes,
    *,
    by_segments: bool = False,
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


def sdo(segment: CanSegment, number: int, request: bytes) -> bytes:
    (reply,) = segment.receive_frame(CanFrame(0x600 + number, request))
    assert reply.id == 0x580 + number and len(reply.data) == 8
    if reply.data[0] == 0x80:
        raise LookupError(struct.unpack("<I", reply.data[4:])[0])
    return reply.data


def put(segment: CanSegment, number: int, index: int, sub: int, value: int, size: int) -> None:
    download(segment, number, index, sub, value.to_bytes(size, "little"))


def refused(segment: CanSegment, number: int, index: int, sub: int, value: int, size: int) -> int:
    with pytest.raises(LookupError) as no:
        put(segment, number, index, sub, value, size)
    return int(no.value.args[0])


def sent(frames: Sequence[CanFrame], id_: int) -> list[bytes]:
    return [frame.data for frame in frames if frame.id == id_]


def dumped(segment: CanSegment, number: int) -> list[bytes]:
    node = next(node for node in segment.nodes if node.number == number)
    return [node.upload_entry(entry.index, entry.sub) for entry in ENTRIES]


def enable(segment: CanSegment, mode: int) -> None:
    """Bring all drives to Operation enabled by process data, one SYNC per step."""
    segment.receive_frame(CanFrame(0, b"\1\0"))
    for word in (6, 7, 15):
        for node in segment.nodes:
            segment.receive_frame(CanFrame(0x200 + node.number, struct.pack("<Hb", word, mode)))
        segment.receive_frame(SYNC)
    for node in segment.nodes:
        assert uploaded(segment, node.number, 0x6041, 0)[0] & 0x6F == 0x27, "Operation enabled"

"""SDO of CANopen nodes and the data sheet of their entries."""

import configparser
import random
import re
import struct

import pytest
from canopen_master import ENTRIES, dumped, put, refused, sdo, segment_of, sent, uploaded

from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.eds import make_eds
from arm_emulator_fieldbus.object_dictionary import REALS


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis")


@pytest.mark.parametrize(
    ("index", "sub", "value", "size", "code"),
    [
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


@pytest.mark.parametrize("head", [0x00, 0x60])
def test_a_segment_without_a_transfer_names_no_object(scene: Scene, head: int) -> None:
    segment = segment_of(scene)
    uploaded(segment, 1, 0x6041, 0)  # expedited: it is over with its reply
    (reply,) = segment.receive_frame(CanFrame(0x601, bytes((head,)) + bytes(7)))
    assert struct.unpack("<BHBI", reply.data) == (0x80, 0, 0, 0x05040001)


def test_uploads_in_segments_that_go_wrong_are_aborted(scene: Scene) -> None:
    segment = segment_of(scene)
    ask = struct.pack("<BHB4x", 0x40, 0x1008, 0)
    sdo(segment, 1, ask)
    for head, code in ((0x70, 0x05030000), (0x60, 0x05040001)):  # toggle; which has ended it
        with pytest.raises(LookupError) as no:
            sdo(segment, 1, bytes((head,)) + bytes(7))
        assert no.value.args[0] == code
    assert segment.receive_frame(CanFrame(0x601, b"\x80" + bytes(7))) == [], "the client's abort"
    assert segment.receive_frame(CanFrame(0x601, ask[:7])) == [], "seven bytes"
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
        return sent(segment.receive_frame(CanFrame(0x601, request)), 0x581)

    for sampled in [entry for entry in ENTRIES if not entry.bits] + draw.sample(ENTRIES, 40):
        size = draw.randint(1, 127)
        (reply,) = ask(struct.pack("<BHBBB2x", 0xA4, sampled.index, sampled.sub, size, 0))
        expected = segment.nodes[0].upload_entry(sampled.index, sampled.sub)
        assert reply == struct.pack("<BHBI", 0xC6, sampled.index, sampled.sub, len(expected))
        value, segments = b"", ask(b"\xa3" + bytes(7))
        while True:
            assert [part[0] & 0x7F for part in segments] == list(range(1, len(segments) + 1))
            assert len(segments) <= size
            received = draw.randint(0, len(segments)) if draw.random() < 0.5 else len(segments)
            value += b"".join(part[1:] for part in segments[:received])
            last = received and segments[received - 1][0] & 0x80
            size = draw.randint(1, 127)
            segments = ask(bytes((0xA2, received, size)) + bytes(5))
            if last:
                break
        (end,) = segments
        assert end[0] & 0xE3 == 0xC1
        value = value[: len(value) - (end[0] >> 2 & 7)]
        assert value == expected and checksum(value) == end[1] | end[2] << 8
        assert ask(b"\xa1" + bytes(7)) == []


@pytest.mark.parametrize("seed", range(3))
def test_block_downloads_take_the_value_only_when_complete(scene: Scene, seed: int) -> None:
    segment, draw = segment_of(scene), random.Random(seed)

    def ask(request: bytes) -> list[bytes]:
        return sent(segment.receive_frame(CanFrame(0x601, request)), 0x581)

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
            replies = sent(segment.receive_frame(CanFrame(0x601, request)), 0x581)
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


def test_data_sheet_reports_every_entry(scene: Scene) -> None:
    node = segment_of(scene, 7).nodes[0]
    sheet = configparser.RawConfigParser()
    sheet.optionxform = str  # type: ignore[assignment,method-assign]
    sheet.read_string(make_eds(node, "a.eds", "a"))
    listed = [
        int(value, 16)
        for part in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects")
        for key, value in sheet[part].items()
        if key != "SupportedObjects"
    ]
    assert sorted(listed) == sorted({entry.index for entry in ENTRIES})
    for entry in ENTRIES:
        name = f"{entry.index:04X}" + ("" if entry.code == 7 else f"sub{entry.sub:X}")
        section = sheet[name]
        assert section["AccessType"] == entry.access and section["ObjectType"] == "0x7"
        assert section["PDOMapping"] == str(int(entry.rx or entry.tx))
        if not entry.bits:
            continue
        if entry.type in REALS:
            assert float(section.get("DefaultValue", "0")) == 0.0 and "LowLimit" not in section
            continue
        span = _RANGES[int(section["DataType"], 0)]
        low, high = (
            int(section.get(key, str(bound)), 0)
            for key, bound in zip(("LowLimit", "HighLimit"), span, strict=True)
        )
        assert (low, high) == (entry.least, entry.most), f"limits of {name}"
        assert span[0] <= low <= high <= span[1], f"limits of {name} within its type"
        if "DefaultValue" in section:
            text = section["DefaultValue"].replace("$NODEID", "7")
            value = sum(int(part, 0) for part in text.split("+"))
            raw = node.upload_entry(entry.index, entry.sub)
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


def test_data_sheet_has_the_keys_of_the_standard(scene: Scene) -> None:
    sheet = configparser.RawConfigParser(strict=True)
    sheet.optionxform = str  # type: ignore[assignment,method-assign]
    sheet.read_string(make_eds(segment_of(scene, 7).nodes[0], "a.eds", "a"))
    for name in sheet.sections():
        numbered = re.fullmatch(r"(Mandatory|Optional|Manufacturer)Objects|DummyUsage", name)
        keys = _KEYS.get(name) or (_KEYS["object"] if re.match(r"[0-9A-F]{4}", name) else "")
        for key in sheet[name]:
            of_list = numbered and re.fullmatch(r"SupportedObjects|\d+|Dummy000\d", key)
            assert of_list or key in keys.split(), f"[{name}] {key}"

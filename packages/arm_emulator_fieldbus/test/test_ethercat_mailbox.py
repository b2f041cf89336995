"""Mailboxes of EtherCAT slaves: their dictionary, segments, malformed mail."""

import struct

import pytest
from ethercat_master import (
    FPRD,
    NOP,
    PREOP,
    STATION,
    Aborted,
    Master,
    at,
    frame,
    master,
    segment,
)  # fmt: skip

from arm_emulator_fieldbus.drives_unit import ETHERCAT

__all__ = ["master"]  # a fixture


def test_complete_access_reads_all_of_an_object(master: Master) -> None:
    master.preop(0)
    drives = master.segment.drives
    objects = sorted({entry.index for entry in drives.entries if entry.buses & ETHERCAT})
    for index in objects:
        subs = [entry for entry in drives.entries if entry.index == index]
        if len(subs) == 1:
            continue
        count = min(drives.read(0, index), len(subs) - 1)
        values = b"".join(drives.upload_entry(0, index, k + 1) for k in range(count))
        complete = master.upload(0, index, 0, complete=True)
        assert complete == struct.pack("<H", count) + values, f"{index:#x} from sub 0"
        if count:
            assert master.upload(0, index, 1, complete=True) == values, f"{index:#x} from sub 1"


def test_the_dictionary_lists_its_own_entries(master: Master) -> None:
    master.preop(0)
    drives = master.segment.drives
    objects = sorted({entry.index for entry in drives.entries if entry.buses & ETHERCAT})
    lists = {
        kind: list(struct.unpack(f"<{len(raw) // 2}H", raw))[1:]
        for kind in range(6)
        for raw in [master.information(0, 1, struct.pack("<H", kind))]
    }
    assert lists[1] == objects, "all objects"
    assert lists[0] == [len(lists[kind]) for kind in range(1, 6)], "how many there are"
    for kind, flag in ((2, "rx"), (3, "tx")):
        mapped = sorted({entry.index for entry in drives.entries if getattr(entry, flag)})
        assert lists[kind] == mapped, f"those to map, {flag}"
    for entry in drives.entries:
        if not entry.buses & ETHERCAT:
            continue
        if entry.sub == 0:
            reported = master.information(0, 3, struct.pack("<H", entry.index))
            assert reported[4] == entry.last_sub and reported[5] == entry.code, (
                f"{entry.index:#x}: subs, code"
            )
            assert reported[6:].decode() == entry.object, "its name"
        reported = master.information(0, 5, struct.pack("<HBB", entry.index, entry.sub, 0x70))
        at_, sub, _, kind, bits, rights = struct.unpack_from("<HBBHHH", reported)
        assert (at_, sub) == (entry.index, entry.sub), "the entry that was asked for"
        assert bool(rights & 0x08) == (entry.access in ("rw", "wo")), f"{entry.index:#x}: writable"
        assert bool(rights & 0x40) == entry.rx and bool(rights & 0x80) == entry.tx, "mappable"
        if entry.bits:
            assert bits == entry.bits, "its size"
            size = bits // 8
            signed = entry.least < 0
            values = [
                int.from_bytes(
                    reported[10 + k * size : 10 + (k + 1) * size], "little", signed=signed
                )
                for k in range(3)
            ]
            assert values == [entry.standard, entry.least, entry.most], (
                f"{entry.index:#x}: default, range"
            )
            unit = f" [{entry.unit}]" if entry.unit else ""
            assert reported[10 + 3 * size :].decode() == entry.name + unit, "name and unit"


@pytest.mark.parametrize("mailbox", [34, 35, 40, 41, 64, 256])
def test_mailboxes_of_any_size_report_the_same(mailbox: int) -> None:
    """The smaller they are, the more segments and fragments there are."""
    master = Master(segment(), mailbox)
    assert master.preop(0) == (PREOP, 0), "the slave takes the size"
    drives = master.segment.drives
    mapped = [0x60400010, 0x607A0020, 0x60FF0020, 0x60710010, 0x60600008, *range(8, 57, 8)]
    master.download(0, 0x1C12, 0, b"\0")
    data = struct.pack(f"<BB{len(mapped)}I", len(mapped), 0, *mapped)
    master.download(0, 0x1600, 0, data, complete=True, part=mailbox - 16)
    assert master.upload(0, 0x1600, 0, complete=True) == data, "a mapping in segments"
    for index in (0x1008, 0x1009, 0x100A):
        assert master.upload(0, index) == drives.upload_entry(0, index), "texts"
    objects = sorted({entry.index for entry in drives.entries if entry.buses & ETHERCAT})
    raw = master.information(0, 1, struct.pack("<H", 1))
    assert list(struct.unpack(f"<{len(raw) // 2}H", raw))[1:] == objects, "a list in fragments"


@pytest.mark.parametrize("part", [0, 1, 7, 8, 112])
def test_segments_of_any_length_bring_the_same(master: Master, part: int) -> None:
    """Complete access to a mapping of 7 objects, 30 bytes, in segments of `part` bytes."""
    master.preop(0)
    mapped = [0x60400010, 0x607A0020, 0x60FF0020, 0x60710010, 0x60600008, 0x60B10020, 0x60B20010]
    master.download(0, 0x1C12, 0, b"\0")
    data = struct.pack(f"<BB{len(mapped)}I", len(mapped), 0, *mapped)
    master.download(0, 0x1600, 0, data, complete=True, part=part or 3)
    assert master.upload(0, 0x1600, 0, complete=True) == data, "what was sent"


def test_complete_access_is_all_or_nothing(master: Master) -> None:
    master.preop(0)
    before = master.upload(0, 0x1600, 0, complete=True)
    master.download(0, 0x1C12, 0, b"\0")
    for bad in ([0x60400010, 0x60410010], [0x607A0020, 0x12345678], [0x60400010, 0x607A0010]):
        data = struct.pack(f"<BB{len(bad)}I", len(bad), 0, *bad)
        with pytest.raises(Aborted):
            master.download(0, 0x1600, 0, data, complete=True)
        assert master.upload(0, 0x1600, 0, complete=True) == before, f"as before {bad}"


def test_the_mapping_can_be_changed_in_preop_only(master: Master) -> None:
    master.bring_up()
    with pytest.raises(Aborted) as no:
        master.download(0, 0x1C12, 0, b"\0")
    assert no.value.code == 0x08000022, "not in this state"
    master.preop(0)
    master.download(0, 0x1C12, 0, b"\0")
    assert master.number(0, 0x1C12) == 0, "in PREOP"


def test_segments_out_of_turn_are_aborted(master: Master) -> None:
    master.preop(0)
    with pytest.raises(Aborted, match="06010000"):
        master.sdo(0, bytes.fromhex("50 18 10 02"))  # complete access from sub 2
    master.download(0, 0x1C12, 0, b"\0")
    data = struct.pack("<BB8I", 8, 0, *[0x60400010] * 8)
    master.sdo(0, struct.pack("<BHBI", 0x31, 0x1600, 0, len(data)) + data[:10])
    with pytest.raises(Aborted) as no:
        master.sdo(0, b"\x10" + data[10:20])  # toggle should be 0
    assert no.value.code == 0x05030000, "toggle bit"
    master.sdo(0, struct.pack("<BHBI", 0x31, 0x1600, 0, len(data)) + data[:10])
    with pytest.raises(Aborted) as no:
        master.sdo(0, b"\x01" + data[10:20])  # the last one, and too short
    assert no.value.code == 0x06070010, "length"


@pytest.mark.parametrize(
    ("kind", "body", "size", "error"),
    [(2, b"\0" * 10, None, 2), (3, b"\0\x20" + b"\x40" * 8, 1000, 8), (3, b"\0", None, 6),
     (3, b"\0\x20\x40", None, 6), (3, b"\0\x50" + bytes(8), None, 4), (15, b"", None, 2)],
)  # fmt: skip
def test_malformed_mail_is_answered_with_its_error(
    master: Master, kind: int, body: bytes, size: int | None, error: int
) -> None:
    master.preop(0)
    assert master.mail(0, body, kind, size) == 1, "taken"
    assert master.fetch(0) == (0, struct.pack("<HH", 1, error)), "an error of the mailbox"
    assert master.upload(0, 0x1000), "the mailbox goes on"


def test_a_mailbox_holds_a_single_message_and_repeats_it(master: Master) -> None:
    master.preop(0)
    assert master.one(FPRD, at(STATION, 0x1100), bytes(128))[1] == 0, "nothing to read"
    request = b"\0\x20" + bytes.fromhex("40 00 10 00") + bytes(4)
    assert master.mail(0, request) == 1, "a request"
    assert master.read(0, 0x080D, 1)[0] & 8, "the answer is there"
    first = master.read(0, 0x1100, 128)
    assert master.read(0, 0x080D, 1)[0] & 8 == 0, "and is taken"
    master.write(0, 0x080E, b"\x03")  # the master has not got it
    assert master.read(0, 0x080F, 1)[0] & 2, "acknowledged"
    assert master.read(0, 0x1100, 128) == first, "once more"
    master._counter[0] -= 1
    assert master.mail(0, request) == 1, "the same request with the same counter"
    assert master.fetch(0) is None, "is not carried out twice"


def test_datagrams_report_events_that_the_master_has_requested(master: Master) -> None:
    def events() -> int:
        back = master.segment.frame(frame((NOP, 0, b"")))
        return int(struct.unpack_from("<H", back, 24)[0])

    master.preop(0)
    master.mail(0, b"\0\x20" + bytes.fromhex("40 00 10 00") + bytes(4))
    assert events() == 0, "none as long as the mask is empty"
    master.write(0, 0x0200, struct.pack("<H", 0x0020))
    assert events() == 0x0020, "the mailbox has a message"
    assert master.word(0, 0x0210) & 0x0020, "as the register demands"
    master.fetch(0)
    assert events() == 0, "until it is read"


def test_a_mailbox_stores_a_request_until_it_has_room_to_answer(master: Master) -> None:
    master.preop(0)
    sent = 0
    while master.mail(0, b"\0\x20" + bytes.fromhex("40 00 10 00") + bytes(4)):
        sent += 1
        assert sent < 100, "the mailbox never states that it is full"
    answered = 0
    while master.fetch(0):
        answered += 1
    assert answered == sent, "every request that was taken has its answer"

"""The EtherCAT segment as a master meets it, in-process: no sockets, no root."""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from draws import FULL, some
from ethercat_master import (
    ACKNOWLEDGE,
    APRD,
    APRW,
    APWR,
    ARMW,
    BOOT,
    BRD,
    BRW,
    BWR,
    ERROR,
    FPRD,
    FPRW,
    FPWR,
    FRMW,
    HEADER,
    INIT,
    LRD,
    LRW,
    LWR,
    NOP,
    OP,
    PREOP,
    SAFEOP,
    STATION,
    Aborted,
    Master,
    answers,
    at,
    datagram,
    frame,
)  # fmt: skip
from fuzz import cores

from arm_emulator.base.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.ethercat import write_esi
from arm_emulator.doors.fieldbus.drives import ETHERCAT, Entry
from arm_emulator.doors.fieldbus.drives import Aborted as DictionaryAborted
from arm_emulator.doors.fieldbus.esi import esi
from arm_emulator.doors.fieldbus.ethercat import Segment
from arm_emulator.machine.scene import load_scene
from arm_emulator.runs.gains import load_gains

PERIOD = 1_000_000  # ns


def segment(lockstep: bool = True) -> Segment:
    path = find_scene("three_axis")
    return Segment(load_scene(path), load_gains(path).servo, lockstep)


@pytest.fixture
def master() -> Master:
    return Master(segment())


# -------------------------------------------------------------------------------------- datagrams


def test_working_counters_and_positions_are_those_of_the_standard(master: Master) -> None:
    """Each command on three slaves, where the counter and the position end."""
    N, first = master.slaves, STATION
    assert N == 3, "one slave per joint of three_axis"
    two = bytes(2)
    # command, address, counter, position afterwards
    cases = [
        (NOP, at(0, 0x10), 0, 0),
        (APRD, at(-1, 0x10), 1, N - 1),
        (APRD, at(5, 0x10), 0, 5 + N),
        (APWR, at(-2, 0x0F80), 1, N - 2),
        (APRW, at(0, 0x0F80), 3, N),
        (FPRD, at(first + 2, 0x10), 1, first + 2),
        (FPRD, at(0x7777, 0x10), 0, 0x7777),
        (FPWR, at(first, 0x0F80), 1, first),
        (FPRW, at(first, 0x0F80), 3, first),
        (BRD, at(0, 0x10), N, N),
        (BWR, at(0, 0x0F80), N, N),
        (BRW, at(0, 0x0F80), 3 * N, N),
        (ARMW, at(0, 0x0F80), N, N),
        (FRMW, at(first, 0x0F80), N, first),
        (LRD, 0x10000, 0, 0),
        (LWR, 0x10000, 0, 0),
        (LRW, 0x10000, 0, 0),
        (FPWR, at(first, 0x0000), 0, first),  # nothing there can be written
        (77, at(0, 0x10), 0, 0),
    ]
    for command, address, counter, position in cases:
        back = master.segment.frame(frame((command, address, two)))
        assert answers(back)[0][1] == counter, (
            f"working counter of command {command} at {address:#x}"
        )
        reported = struct.unpack_from("<H", back, 18)[0]
        assert reported == position & 0xFFFF, f"position after command {command}"
    assert master.segment.figures.unknown == 1, "one unknown command"


def test_what_is_read_and_written_is_what_stands_there(master: Master) -> None:
    rng = np.random.default_rng(1)
    values = [bytes(rng.integers(0, 256, 8, dtype=np.uint8)) for _ in range(master.slaves)]
    for k, value in enumerate(values):
        assert master.one(APWR, at(-k, 0x0F80), value)[1] == 1, "written"
        assert master.one(FPRD, at(STATION + k, 0x0F80), bytes(8)) == (value, 1), "read again"
    union = bytes(a | b | c for a, b, c in zip(*values, strict=True))
    assert master.one(BRD, at(0, 0x0F80), bytes(8))[0] == union, "BRD adds bits"
    other = bytes(8 * [0x5A])
    assert master.one(FPRW, at(STATION, 0x0F80), other) == (values[0], 3), "what stood there"
    assert master.one(FPRD, at(STATION, 0x0F80), bytes(8))[0] == other, "and now stands"
    assert master.one(ARMW, at(-1, 0x0F80), bytes(8))[0] == values[1], "slave 1 is read"
    for k in (1, 2):  # slaves behind it are written what it has, those before what was sent
        assert master.one(FPRD, at(STATION + k, 0x0F80), bytes(8))[0] == values[1], f"slave {k}"
    assert master.one(FPRD, at(STATION, 0x0F80), bytes(8))[0] == bytes(8), "slave 0"


def test_the_line_ends_at_its_last_slave_and_where_a_port_is_closed(master: Master) -> None:
    open_, closed = 0x0800, 0x0400  # port 1
    status = [master.word(k, 0x0110) & 0x0F00 for k in range(master.slaves)]
    assert status == [0x0200 | open_, 0x0200 | open_, 0x0200 | closed], "communication by ports"
    master.write(1, 0x0101, b"\x0c")
    assert master.one(BRD, 0, bytes(1))[1] == 2, "the frame turns at slave 1"
    master.write(1, 0x0101, b"\x00")
    assert master.one(BRD, 0, bytes(1))[1] == 3, "and reaches the last again"
    master.write(2, 0x0101, b"\x08")  # open where nothing is connected
    assert master.segment.frame(frame((NOP, 0, b""))) == b"", "the frame is lost there"


def test_a_slave_has_an_alias_once_it_is_reported_so(master: Master) -> None:
    write_eeprom(master, 1, 4, 0x0777)
    master.write(1, 0x0502, struct.pack("<HI", 0x0400, 0))  # reload
    assert master.word(1, 0x0012) == 0x0777, "the alias as the EEPROM has it"
    assert master.one(FPRD, at(0x0777, 0x10), bytes(2))[1] == 0, "not used yet"
    master.write(1, 0x0103, b"\x01")
    assert master.one(FPRD, at(0x0777, 0x10), bytes(2))[1] == 1, "used"


# ----------------------------------------------------------------------------------------- EEPROM


def eeprom(master: Master, slave: int, word: int) -> bytes:
    master.write(slave, 0x0502, struct.pack("<HI", 0x0100, word))
    status, _, data = struct.unpack("<HI8s", master.read(slave, 0x0502, 14))
    assert status & 0x8000 == 0 and status & 0x2000 == 0, f"EEPROM status {status:#x}"
    return bytes(data)


def write_eeprom(master: Master, slave: int, word: int, value: int) -> int:
    master.write(slave, 0x0502, struct.pack("<HIH", 0x0201, word, value))
    return master.word(slave, 0x0502)


def test_the_eeprom_reports_what_a_slave_is(master: Master) -> None:
    image = b"".join(eeprom(master, 0, word) for word in range(0, 1024, 4))
    crc = 0xFF
    for byte in image[:14]:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x07 if crc & 0x80 else crc << 1) & 0xFF
    assert image[14] == crc, "checksum of the configuration"
    drives = master.segment.drives
    identity = struct.unpack_from("<4I", image, 16)
    assert identity == tuple(drives.read(0, 0x1018, k) for k in (1, 2, 3, 4)), "as object 0x1018"
    assert struct.unpack_from("<5H", image, 0x30) == (0x1000, 256, 0x1100, 256, 4), "mailboxes, CoE"
    place, found = 0x80, {}
    while (kind := struct.unpack_from("<H", image, place)[0]) != 0xFFFF:
        size = 2 * struct.unpack_from("<H", image, place + 2)[0]
        found[kind] = image[place + 4 : place + 4 + size]
        place += 4 + size
    assert set(found) == {10, 30, 40, 41, 50, 51, 60}, "strings, general, FMMU, SM, PDOs, DC"
    assert found[10][2:].startswith(b"arm_emulator drive"), "the first string is the name"
    texts, at_ = [b""], 1
    for _ in range(found[10][0]):
        texts.append(found[10][at_ + 1 : at_ + 1 + found[10][at_]])
        at_ += 1 + found[10][at_]
    assert all(texts[1:]), "no empty texts"
    assert [texts[found[60][k + 0x12]] for k in (0, 24)] == [b"FreeRun", b"DC SYNC0"], "clocks"
    pdo = [found[51][k : k + 8] for k in range(8, 8 + 8 * found[51][2], 8)]
    names = {(one.index, one.sub): one.name for one in drives.entries}
    for entry in pdo:
        index, sub, name = struct.unpack_from("<HBB", entry)
        assert texts[name].decode() == names.get((index, sub), ""), f"the name of {index:#x}"
    bits = sum(found[51][k] for k in range(13, 8 + 8 * found[51][2], 8))
    assert struct.unpack_from("<HH", found[41], 16) == (0x1200, bits // 8), "outputs as mapped"


def test_the_eeprom_is_written_only_with_permission(master: Master) -> None:
    assert write_eeprom(master, 0, 0x30, 0xBEEF) & 0x6000 == 0, "written"
    assert eeprom(master, 0, 0x30)[:2] == b"\xef\xbe", "and read again"
    master.write(0, 0x0502, struct.pack("<HIH", 0x0200, 0x30, 0))
    assert master.word(0, 0x0502) & 0x4000, "without the bit that enables it: an error"
    assert eeprom(master, 0, 0x30)[:2] == b"\xef\xbe", "as before"
    assert eeprom(master, 0, 0xFFFF_FFF0) == b"\xff" * 8, "nothing beyond its end"
    master.write(0, 0x0500, b"\x01")  # handed to the drive
    master.write(0, 0x0502, struct.pack("<HI", 0x0100, 0x30))
    assert master.word(0, 0x0502) & 0x2000, "the master has no access now"


# ----------------------------------------------------------------------------------------- states


def test_states_go_up_step_by_step_and_down_at_will(master: Master) -> None:
    assert master.word(0, 0x0130) == INIT, "at the beginning"
    for wanted, code in ((SAFEOP, 0x11), (OP, 0x11), (BOOT, 0x13), (7, 0x12), (0, 0x12)):
        assert master.ask(0, wanted) == (INIT | ERROR, code), f"INIT to {wanted}"
        assert master.ask(0, INIT) == (INIT | ERROR, code), "not without an acknowledgement"
        assert master.ask(0, INIT | ACKNOWLEDGE) == (INIT, 0), "acknowledged"
    assert master.ask(0, PREOP) == (INIT | ERROR, 0x16), "no mailboxes"
    assert master.preop(0) == (PREOP, 0), "with mailboxes"
    assert master.ask(0, OP) == (PREOP | ERROR, 0x11), "PREOP to OP"
    assert master.ask(0, PREOP | ACKNOWLEDGE) == (PREOP, 0), "acknowledged"
    assert master.ask(0, SAFEOP) == (PREOP | ERROR, 0x1D), "no outputs"
    master.ask(0, PREOP | ACKNOWLEDGE)
    assert master.safeop(0, 0x10000) == (SAFEOP, 0), "with outputs and inputs"
    assert master.ask(0, OP) == (OP, 0), "at the top"
    for state in (SAFEOP, PREOP, INIT):
        assert master.ask(0, state) == (state, 0), f"down to {state}"


@pytest.mark.parametrize("way", [0, 1])
@pytest.mark.parametrize("change", [(1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 2), (0, 0, 4)])
def test_process_data_that_do_not_fit_are_refused(
    master: Master, way: int, change: tuple[int, int, int]
) -> None:
    master.preop(0)
    sizes = master.sizes(0)
    settings = [[0x1200, sizes[0], 0x64], [0x1500, sizes[1], 0x20]]
    start, size, control = settings[way]
    settings[way] = [start + change[0], size + change[1], control ^ change[2]]
    for k, (start, size, control) in enumerate(settings):
        master.guard(0, 2 + k, start, size, control)
    assert master.ask(0, SAFEOP) == (PREOP | ERROR, 0x1D + way), f"{settings[way]}"


def test_a_guard_that_is_switched_off_in_op_takes_the_slave_down(master: Master) -> None:
    master.bring_up()
    master.write(0, 0x0816, b"\0")
    assert (master.word(0, 0x0130), master.word(0, 0x0134)) == (PREOP | ERROR, 0x1D), "outputs"
    master.write(1, 0x0806, b"\0")
    assert (master.word(1, 0x0130), master.word(1, 0x0134)) == (INIT | ERROR, 0x16), "mailbox"
    assert master.word(2, 0x0130) == OP, "the others go on"


@pytest.mark.parametrize("state", [INIT, PREOP, SAFEOP])
def test_a_slave_counts_for_process_data_in_safeop_and_op_only(master: Master, state: int) -> None:
    """By logical and by physical addresses; and for mail from PREOP on."""
    master.bring_up()
    nothing = [bytes(master.out)] * master.slaves
    master.exchange(nothing)
    assert master.count == 3 * master.slaves, "all in OP"
    master.ask(1, state)
    here = state == SAFEOP
    each = master.out + master.into
    untouched = bytes([0xA5]) * (master.slaves * each)
    for command, counts in ((LRD, 1), (LWR, 1), (LRW, 3)):
        back, count = master.one(command, 0x10000, untouched)
        assert count == counts * (master.slaves - 1 + here), f"command {command}"
        if command != LWR:
            inputs = back[each + master.out : 2 * each]
            assert (inputs == untouched[: master.into]) != here, "only it fills its inputs"
    assert master.write(1, 0x1200, bytes(master.out)) == here, "outputs by FPWR"
    assert master.one(FPRD, at(STATION + 1, 0x1500), bytes(master.into))[1] == here, "inputs"
    assert master.write(1, 0x1000, bytes(master.mailbox)) == (state != INIT), "mail"
    assert master.write(1, 0x0F80, b"\1") == 1, "what nothing guards is open in any state"


def sound_cycle(memory: bytes) -> bool:
    """Whether SYNC0 is off or goes by whole servo periods."""
    cycle = struct.unpack_from("<I", memory, 0x09A0)[0]
    return memory[0x0981] & 3 != 3 or (cycle != 0 and cycle % PERIOD == 0)


def works(memory: bytes) -> bool:
    return memory[0x0130] & 15 in (SAFEOP, OP)


def counts(memory: bytes) -> int:
    """Return a slave's contribution to the working counter of an LRW, by its registers.

    An area counts where its guard is open, or where no guard is switched on: then it is plain RAM.
    """
    outputs = memory[0x060C] and (works(memory) or not memory[0x0816] & 1)
    inputs = memory[0x061C] and (works(memory) or not memory[0x081E] & 1)
    return 2 * bool(outputs) + bool(inputs and not memory[0x0826] & 1)


@pytest.mark.parametrize("seed", some(range(40), 3))
def test_whatever_a_master_sets_when_counters_and_time_fit_the_states(seed: int) -> None:
    """States, guards, units and SYNC0 at random: an exchange counts and lasts as they are then."""
    rng = np.random.default_rng(seed)
    master = Master(segment())
    master.bring_up()
    each = master.out + master.into
    seen: set[int] = set()
    for step in range(300):
        k = int(rng.integers(master.slaves))
        place = master.segment.memory(k)
        what = rng.integers(8)
        if what < 2:
            master.ask(k, int(rng.choice([INIT, PREOP, SAFEOP, OP])) | ACKNOWLEDGE)
        elif what == 2 and place[0x0130] & 15 in (INIT, PREOP):
            master.preop(k)
            master.safeop(k, 0x10000 + k * each)
        elif what == 3:
            master.write(k, 0x0981, bytes([rng.choice([0, 1, 2, 3, 3, 3])]))
        elif what == 4:
            cycle = int(rng.choice([0, 1, 2, 3, 7])) * PERIOD + int(
                rng.choice([0, 0, 1, PERIOD // 2])
            )
            master.write(k, 0x09A0, struct.pack("<I", cycle))
        elif what == 5:  # a guard that the drive knows nothing of, over its inputs
            master.guard(k, 4, 0x1500, master.into, 0x20, int(rng.integers(2)))
        elif what == 6 and rng.random() < 0.2:
            master.write(k, 0x0806 + 8 * int(rng.integers(4)), b"\0")
        elif what == 7:
            unit = 0x060C + 16 * int(rng.integers(2))
            master.write(k, unit, bytes([place[unit] ^ 1]))
        memories = [master.segment.memory(j) for j in range(master.slaves)]
        at_work = [one for one in memories if works(one)]
        seen |= {one[0x0130] for one in memories}
        assert all(map(sound_cycle, at_work)), f"step {step}: SYNC0 cuts periods"
        whole = at_work and all(counts(one) == 3 for one in at_work)
        cycles = [
            struct.unpack_from("<I", one, 0x09A0)[0] for one in at_work if one[0x0981] & 3 == 3
        ]
        before = master.segment.drives.tick
        master.exchange([bytes(master.out)] * master.slaves)
        assert master.count == sum(map(counts, memories)), f"step {step}: working counter"
        passed = master.segment.drives.tick - before
        lasts = min(cycles, default=PERIOD) // PERIOD if at_work else 0
        # One that is not whole may complete what the exchange before has begun.
        assert passed == lasts or (passed == 0 and not whole), f"step {step}: {passed} periods"
    assert {INIT, PREOP, SAFEOP, OP, PREOP | ERROR} <= seen, "every state came by"


def test_a_reset_puts_a_controller_to_where_it_began(master: Master) -> None:
    fresh = segment().memory(1)
    master.bring_up()
    for letter in b"RES":
        master.write(1, 0x0040, bytes([letter]))
    assert master.one(FPRD, at(STATION + 1, 0x10), bytes(2))[1] == 0, "no address any more"
    assert master.segment.memory(1)[:0x0900] == fresh[:0x0900], "registers as at the beginning"


# ------------------------------------------------------------------------------- object dictionary


def test_every_entry_is_read_as_the_drive_has_it(master: Master) -> None:
    master.preop(1)
    drives, count = master.segment.drives, 0
    for entry in drives.entries:
        if entry.buses & ETHERCAT and entry.access != "wo":
            value = master.upload(1, entry.index, entry.sub)
            assert value == drives.upload(1, entry.index, entry.sub), (
                f"{entry.index:#x}:{entry.sub}"
            )
            count += 1
    assert count > 150, "the whole dictionary"


def test_complete_access_reads_all_of_an_object(master: Master) -> None:
    master.preop(0)
    drives = master.segment.drives
    objects = sorted({one.index for one in drives.entries if one.buses & ETHERCAT})
    for index in objects:
        subs = [one for one in drives.entries if one.index == index]
        if len(subs) == 1:
            continue
        count = min(drives.read(0, index), len(subs) - 1)
        values = b"".join(drives.upload(0, index, k + 1) for k in range(count))
        whole = master.upload(0, index, 0, complete=True)
        assert whole == struct.pack("<H", count) + values, f"{index:#x} from sub 0"
        if count:
            assert master.upload(0, index, 1, complete=True) == values, f"{index:#x} from sub 1"


def test_the_dictionary_describes_itself(master: Master) -> None:
    master.preop(0)
    drives = master.segment.drives
    objects = sorted({one.index for one in drives.entries if one.buses & ETHERCAT})
    lists = {
        kind: list(struct.unpack(f"<{len(raw) // 2}H", raw))[1:]
        for kind in range(6)
        for raw in [master.information(0, 1, struct.pack("<H", kind))]
    }
    assert lists[1] == objects, "all objects"
    assert lists[0] == [len(lists[kind]) for kind in range(1, 6)], "how many there are"
    for kind, flag in ((2, "rx"), (3, "tx")):
        mapped = sorted({one.index for one in drives.entries if getattr(one, flag)})
        assert lists[kind] == mapped, f"those to map, {flag}"
    for one in drives.entries:
        if not one.buses & ETHERCAT:
            continue
        if one.sub == 0:
            reported = master.information(0, 3, struct.pack("<H", one.index))
            assert reported[4] == one.last_sub and reported[5] == one.code, (
                f"{one.index:#x}: subs, code"
            )
            assert reported[6:].decode() == one.object, "its name"
        reported = master.information(0, 5, struct.pack("<HBB", one.index, one.sub, 0x70))
        at_, sub, _, kind, bits, rights = struct.unpack_from("<HBBHHH", reported)
        assert (at_, sub) == (one.index, one.sub), "the entry that was asked for"
        assert bool(rights & 0x08) == (one.access in ("rw", "wo")), f"{one.index:#x}: writable"
        assert bool(rights & 0x40) == one.rx and bool(rights & 0x80) == one.tx, "mappable"
        if one.bits:
            assert bits == one.bits, "its size"
            size = bits // 8
            signed = one.type.startswith("INTEGER")
            values = [
                int.from_bytes(
                    reported[10 + k * size : 10 + (k + 1) * size], "little", signed=signed
                )
                for k in range(3)
            ]
            assert values == [one.standard, one.least, one.most], f"{one.index:#x}: default, range"
            unit = f" [{one.unit}]" if one.unit else ""
            assert reported[10 + 3 * size :].decode() == one.name + unit, "name and unit"


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
        assert master.upload(0, index) == drives.upload(0, index), "texts"
    objects = sorted({one.index for one in drives.entries if one.buses & ETHERCAT})
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


ABORTS = [
    ("no such object", "40 00 50 00", 0x06020000),
    ("no such sub", "40 18 10 09", 0x06090011),
    ("read only", "2b 41 60 00 01 00", 0x06010002),
    ("too long", "23 40 60 00 01 00 00 00", 0x06070012),
    ("unknown command", "e0 00 10 00", 0x05040001),
    ("a segment of nothing", "60 00 00 00", 0x05040001),
    ("a segment for nothing", "00 00 00 00", 0x05040001),
    ("complete access from sub 2", "50 18 10 02", 0x06010000),
    ("larger than any object", "21 40 60 00 ff ff ff 7f", 0x05040005),
]


@pytest.mark.parametrize(("what", "request_", "code"), ABORTS, ids=[one[0] for one in ABORTS])
def test_an_sdo_that_cannot_be_is_aborted(
    master: Master, what: str, request_: str, code: int
) -> None:
    master.preop(0)
    with pytest.raises(Aborted) as no:
        master.sdo(0, bytes.fromhex(request_))
    family = 0xFFFF0000 if what == "too long" else 0xFFFFFFFF
    assert no.value.code & family == code & family, what
    assert master.upload(0, 0x1000), "the mailbox goes on"


def test_segments_out_of_turn_are_aborted(master: Master) -> None:
    master.preop(0)
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


def test_a_mailbox_holds_one_message_and_repeats_it(master: Master) -> None:
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


def test_datagrams_report_events_that_the_master_has_asked_for(master: Master) -> None:
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


def test_a_mailbox_keeps_what_it_has_no_room_to_answer(master: Master) -> None:
    master.preop(0)
    sent = 0
    while master.mail(0, b"\0\x20" + bytes.fromhex("40 00 10 00") + bytes(4)):
        sent += 1
        assert sent < 100, "the mailbox never states that it is full"
    got = 0
    while master.fetch(0):
        got += 1
    assert got == sent, "every request that was taken has its answer"


# ------------------------------------------------------------------------------------ process data


def test_one_servo_period_passes_per_exchange_with_all_drives(master: Master) -> None:
    tick = lambda: master.segment.drives.tick  # noqa: E731
    master.bring_up()
    start = tick()
    for _ in range(10):
        master.exchange([bytes(master.out)] * master.slaves)
        assert master.count == 3 * master.slaves, "every slave was read and written"
    assert tick() == start + 10, "a period each"
    each = master.out + master.into
    master.one(LRW, 0x10000, bytes(each))
    master.one(LRW, 0x10000 + each, bytes(each))
    assert tick() == start + 10, "two of three drives are not all"
    master.one(LRW, 0x10000 + 2 * each, bytes(each))
    assert tick() == start + 11, "three are"
    master.one(LWR, 0x10000, bytes(3 * each))
    assert tick() == start + 11, "outputs alone are half of it"
    master.one(LRD, 0x10000, bytes(3 * each))
    assert tick() == start + 12, "with inputs it is whole"
    assert master.segment.figures.exchanges == tick(), "and all are counted"


def random_mapping(rng: np.random.Generator, entries: list[Entry]) -> list[list[int]]:
    """Up to three objects, each with some entries and gaps between them."""
    out = []
    for _ in range(rng.integers(0, 4)):
        chosen = rng.choice(len(entries), int(rng.integers(1, 6)), replace=False)
        words = []
        for one in (entries[k] for k in chosen):
            if rng.random() < 0.3:
                words.append(int(rng.choice([8, 16])))  # a gap
            words.append(one.index << 16 | one.sub << 8 | one.bits)
        out.append(words)
    return out


@pytest.mark.parametrize("seed", some(range(30), 6))
def test_any_mapping_carries_what_it_names(master: Master, seed: int) -> None:
    """Process data affect drives as the same values written through their dictionaries do."""
    rng = np.random.default_rng(seed)
    twin, drives = segment().drives, master.segment.drives
    master.slaves = 1
    master.preop(0)
    there = [one for one in drives.entries if one.buses & ETHERCAT and one.bits]
    ways = []
    for assignment, first, entries in (
        (0x1C12, 0x1600, [one for one in there if one.rx]),
        (0x1C13, 0x1A00, [one for one in there if one.tx]),
    ):
        mapping = random_mapping(rng, entries)
        master.download(0, assignment, 0, b"\0")
        for k, words in enumerate(mapping):
            data = struct.pack(f"<BB{len(words)}I", len(words), 0, *words)
            master.download(0, first + k, 0, data, complete=True)
        data = struct.pack(
            f"<BB{len(mapping)}H", len(mapping), 0, *range(first, first + len(mapping))
        )
        master.download(0, assignment, 0, data, complete=True)
        ways.append([word for words in mapping for word in words])
    out, into = master.sizes(0)
    status = master.safeop(0, 0x10000)
    assert status == (SAFEOP, 0), f"{out} and {into} bytes: {status}"
    assert master.ask(0, OP) == (OP, 0), "in OP"
    for _ in range(5):
        expected = b"".join(
            twin.upload(0, word >> 16, word >> 8 & 0xFF) if word >> 16 else bytes(word // 8)
            for word in ways[1]
        )
        sent = rng.bytes(out)
        place = 0
        for word in ways[0]:
            size = (word & 0xFF) // 8
            if word >> 16:
                with contextlib.suppress(DictionaryAborted):  # a value out of its range
                    twin.download(0, word >> 16, word >> 8 & 0xFF, sent[place : place + size])
            place += size
        back, count = master.one(LRW, 0x10000, sent + bytes(into))
        assert count == 2 * bool(out) + bool(into), "written and read"
        assert back[out:] == expected, "inputs are the values that the drive had"
        if out or into:
            twin.period()
        assert drives.tick == twin.tick, "as many servo periods"
        for one in there:
            if not 0x1600 <= one.index <= 0x1C13:
                value = drives.upload(0, one.index, one.sub)
                assert value == twin.upload(0, one.index, one.sub), f"{one.index:#x}:{one.sub}"


@pytest.mark.parametrize("shift", range(1, 8))
def test_single_bits_are_mapped_where_they_shall_be(master: Master, shift: int) -> None:
    """Outputs and inputs of slave 0 lie in the logical space from any bit on."""
    master.preop(0)
    out, into = master.sizes(0)
    master.safeop(0, 0)
    for k, (logical, size, place, way) in enumerate(((0, out, 0x1200, 2), (64, into, 0x1500, 1))):
        unit = struct.pack("<IHBBHBBB3x", logical, size + 1, shift, shift - 1, place, 0, way, 1)
        master.write(0, 0x0600 + 16 * k, unit)
    rng = np.random.default_rng(shift)
    value = int.from_bytes(rng.bytes(out), "little") & ~(0xFFFF | 0xFF << 112)
    data = (value << shift).to_bytes(64, "little") + bytes(into + 1)
    back, count = master.one(LRW, 0, data)
    assert count == 3, "read and written"
    assert master.segment.memory(0)[0x1200 : 0x1200 + out] == value.to_bytes(out, "little"), (
        "outputs"
    )
    expected = master.segment.memory(0)[0x1500 : 0x1500 + into]
    # The frame reports inputs as they were before the servo period that it set off.
    got = int.from_bytes(back[64:], "little") >> shift
    reported = got.to_bytes(into + 1, "little")[:into]
    assert reported[:2] == expected[:2], "the statusword, which has not changed"


def test_a_watchdog_that_runs_out_takes_the_slave_to_safeop() -> None:
    master = Master(segment(lockstep=False))
    master.bring_up()
    for _ in range(50):
        master.exchange([bytes(master.out)] * master.slaves)
        master.now += PERIOD
        master.segment.period(master.now)
    assert master.segment.figures.watchdogs == 0, "while outputs come"
    silent = 0
    while master.segment.figures.watchdogs == 0:
        master.now += PERIOD
        master.segment.period(master.now)
        silent += 1
        assert silent < 1000, "the watchdog never runs out"
    # The first silent period already ended 2 ms after the newest outputs.
    assert silent == 100, "more than the 100 ms that register 0x0420 begins with"
    for k in range(master.slaves):
        assert (master.word(k, 0x0130), master.word(k, 0x0134)) == (SAFEOP | ERROR, 0x1B), "SAFEOP"
        assert master.word(k, 0x0440) == 0, "the status of the watchdog"
        assert master.read(k, 0x0442, 1) == b"\1", "and its count"
        assert master.ask(k, OP) == (SAFEOP | ERROR, 0x1B), "not without an acknowledgement"
    master.exchange([bytes(master.out)] * master.slaves)
    for k in range(master.slaves):
        assert master.ask(k, OP | ACKNOWLEDGE) == (OP, 0), "up again"
    assert master.word(0, 0x0440) == 1, "the status of the watchdog"


ON = {0x40: 6, 0x60: 6, 0x21: 7, 0x23: 15, 0x27: 15, 0x08: 0x80, 0x28: 0x80}  # by the statusword


def enable(master: Master, mode: int = 8) -> list[tuple[int, int]]:
    """Exchange until all drives are in Operation enabled; their statuswords and positions."""
    reported = [(0, 0)] * master.slaves
    for _ in range(5000):
        outputs = [
            struct.pack("<HiihbB", ON.get(status & 0x6F, 0), position, 0, 0, mode, 0)
            for status, position in reported
        ]
        reported = [struct.unpack_from("<Hi", one) for one in master.exchange(outputs)]
        if not master.segment.lockstep:
            master.now += PERIOD
            master.segment.period(master.now)
        if all(status & 0x6F == 0x27 for status, _ in reported):
            return reported
    raise AssertionError(f"drives are not enabled: {[hex(status) for status, _ in reported]}")


def test_a_lost_master_faults_the_drives_until_they_are_reset() -> None:
    master = Master(segment(lockstep=False))
    master.bring_up()
    enable(master)
    for _ in range(200):
        master.now += PERIOD
        master.segment.period(master.now)
    for k in range(master.slaves):
        assert (master.word(k, 0x0130), master.word(k, 0x0134)) == (SAFEOP | ERROR, 0x1B), "lost"
        assert master.number(k, 0x603F) == 0x821B, "the drive's error: its sync manager's watchdog"
        assert master.number(k, 0x6041) & 0x4F == 0x08, "Fault"
    assert [(one.slave, one.code) for one in master.emergencies] == [
        (k, 0x821B) for k in range(master.slaves)
    ], "an emergency of each"
    for k in range(master.slaves):
        assert master.ask(k, OP | ACKNOWLEDGE) == (OP, 0), "up again"
    enable(master)
    for k in range(master.slaves):
        assert master.fetch(k) is None, "no more messages"
    assert [one.code for one in master.emergencies[master.slaves :]] == [0] * master.slaves, "over"


def test_a_target_out_of_reach_is_a_following_error_that_is_reported_and_reset(
    master: Master,
) -> None:
    master.bring_up()
    reported = enable(master)
    far = [position + (10_000_000 if k == 1 else 0) for k, (_, position) in enumerate(reported)]
    words: list[int] = []
    for _ in range(2000):
        outputs = [struct.pack("<HiihbB", 15, one, 0, 0, 8, 0) for one in far]
        words = [struct.unpack_from("<H", one)[0] for one in master.exchange(outputs)]
        if words[1] & 0x4F == 0x08:
            break
    assert [word & 0x4F == 0x08 for word in words] == [False, True, False], "one in Fault"
    assert master.fetch(1) is None, "no message but the emergency"
    assert [(one.slave, one.code) for one in master.emergencies] == [(1, 0x8611)], "following error"
    assert master.word(1, 0x0130) == OP, "the bus goes on"
    enable(master)


def test_lost_cycles_are_counted_by_the_clock() -> None:
    master = Master(segment(lockstep=False))
    master.bring_up()
    master.segment.period(master.now)
    before = master.segment.figures.lost_cycles
    for k in range(20):
        if k % 4:
            master.exchange([bytes(master.out)] * master.slaves)
        master.now += PERIOD
        master.segment.period(master.now)
    assert master.segment.figures.lost_cycles == before + 5, "every fourth"


# ---------------------------------------------------------------------------------------- clocks


def test_a_master_finds_delays_and_sets_clocks_alike() -> None:
    """As masters do: times on the way there and back, offsets to the first clock, steering."""
    master = Master(segment(lockstep=False))
    master.now = 123_456_789
    master.one(BWR, at(0, 0x0900), bytes(4))
    times = [struct.unpack("<II", master.read(k, 0x0900, 8)) for k in range(master.slaves)]
    local = [struct.unpack("<Q", master.read(k, 0x0918, 8))[0] for k in range(master.slaves)]
    assert times[-1][1] == 0, "nothing came back at the last slave"
    rounds = [(b - a) & 0xFFFFFFFF if b else 0 for a, b in times]
    delays = [(rounds[0] - one) // 2 for one in rounds]
    assert delays == [0, 500, 1000], "half of what the way there and back takes"
    target = 700_000_000_000_000_000
    for k in range(master.slaves):
        offset = target + delays[k] - local[k]
        master.write(k, 0x0920, struct.pack("<q", offset))
        master.write(k, 0x0928, struct.pack("<I", delays[k]))
    for _ in range(20):
        master.now += PERIOD
        master.one(FRMW, at(STATION, 0x0910), bytes(8))
    for k in range(1, master.slaves):
        assert struct.unpack("<I", master.read(k, 0x092C, 4))[0] == 0, "no difference is left"
    reported = [struct.unpack("<Q", master.read(k, 0x0910, 8))[0] for k in range(master.slaves)]
    assert reported == [target + 20 * PERIOD + delay for delay in delays], (
        "one time, as frames reach them"
    )
    # A clock that is set wrong by 5 us is steered back, 1 us a frame at most.
    master.write(1, 0x0920, struct.pack("<q", target + delays[1] - local[1] + 5000))
    differences = []
    for _ in range(8):
        master.one(FRMW, at(STATION, 0x0910), bytes(8))
        differences.append(struct.unpack("<I", master.read(1, 0x092C, 4))[0])
    assert differences == [5000, 4000, 3000, 2000, 1000, 0, 0, 0], "steered"


@pytest.mark.parametrize(
    ("cycle", "status"),
    [(PERIOD, (SAFEOP, 0)), (4 * PERIOD, (SAFEOP, 0)), (1_500_000, (PREOP | ERROR, 0x36))],
)
def test_the_cycle_of_sync0_is_whole_servo_periods(
    master: Master, cycle: int, status: tuple[int, int]
) -> None:
    for k in range(master.slaves):
        master.preop(k)
    master.out, master.into = master.sizes(0)
    for k in range(master.slaves):
        now = struct.unpack("<Q", master.read(k, 0x0910, 8))[0]
        master.write(k, 0x0990, struct.pack("<Q", now + 10 * PERIOD))
        master.write(k, 0x09A0, struct.pack("<I", cycle))
        master.write(k, 0x0980, b"\0\3")
        assert master.safeop(k, 0x10000 + k * (master.out + master.into)) == status, f"{cycle} ns"
    if status[1] == 0:
        start = master.segment.drives.tick
        master.exchange([bytes(master.out)] * master.slaves)
        assert master.segment.drives.tick == start + cycle // PERIOD, "periods per exchange"


@pytest.mark.parametrize("state", [SAFEOP, OP])
@pytest.mark.parametrize("cycle", [PERIOD, 3 * PERIOD, 2_500_000, 0, 1])
def test_sync0_that_is_set_late_is_checked_as_at_the_transition(
    master: Master, state: int, cycle: int
) -> None:
    master.bring_up()
    for k in range(master.slaves):
        master.ask(k, state)
        master.write(k, 0x09A0, struct.pack("<I", cycle))
        assert master.word(k, 0x0130) == state, "a cycle alone does nothing"
        master.write(k, 0x0980, b"\0\3")
        sound = cycle > 0 and cycle % PERIOD == 0
        reported = master.word(k, 0x0130), master.word(k, 0x0134)
        assert reported == ((state, 0) if sound else (PREOP | ERROR, 0x36)), f"{cycle} ns"
    start = master.segment.drives.tick
    master.exchange([bytes(master.out)] * master.slaves)
    assert master.segment.drives.tick == start + (cycle // PERIOD if sound else 0), "periods"
    assert master.count == (3 * master.slaves if sound else 0), "working counter"


def test_the_shortest_cycle_of_sync0_is_that_of_the_exchange(master: Master) -> None:
    master.bring_up()
    for k, periods in ((1, 6), (2, 2)):
        master.write(k, 0x09A0, struct.pack("<I", periods * PERIOD))
        master.write(k, 0x0980, b"\0\3")
    start = master.segment.drives.tick
    master.exchange([bytes(master.out)] * master.slaves)
    assert master.segment.drives.tick == start + 2


# ------------------------------------------------------------------------------- malformed frames


def bad_frame(rng: np.random.Generator, sound: bytes) -> bytes:
    """One of the classes of frames that no slave may carry out."""
    kind = rng.integers(7)
    out = bytearray(sound)
    if kind == 0:  # cut
        return bytes(out[: rng.integers(0, len(out))])
    if kind == 1:  # a datagram longer than the frame
        size = int(rng.integers(len(out), 0x800))
        struct.pack_into("<H", out, 22, size)
    elif kind == 2:  # the frame longer than it is
        struct.pack_into("<H", out, 14, 0x1000 | int(rng.integers(len(out) - 15, 0x800)))
    elif kind == 3:  # more datagrams than there are
        return (
            sound[:14]
            + struct.pack("<H", 0x1000 | len(sound) - 16)
            + datagram(sound[16], 0, sound[26:-2], more=True)
        )
    elif kind == 4:  # another protocol
        struct.pack_into(">H", out, 12, int(rng.integers(0, 0x88A4)))
    elif kind == 5:  # not datagrams
        struct.pack_into("<H", out, 14, len(out) - 16 | int(rng.choice([0, 4, 5, 15])) << 12)
    else:  # has been around
        struct.pack_into("<H", out, 22, struct.unpack_from("<H", out, 22)[0] | 0x4000)
    return bytes(out)


def test_malformed_frames_change_nothing_and_are_counted(master: Master) -> None:
    master.bring_up()
    rng = np.random.default_rng(7)
    before = [master.segment.memory(k) for k in range(master.slaves)]
    tick, frames = master.segment.drives.tick, master.segment.figures.frames
    counted = 300
    for _ in range(counted):
        command = int(rng.integers(1, 15))
        place = at(int(rng.choice([0, STATION])), int(rng.choice([0x120, 0x800, 0x1000, 0x1200])))
        sound = frame((command, place, rng.bytes(int(rng.integers(1, 200)))))
        assert master.segment.frame(bad_frame(rng, sound)) == b"", "nothing comes back"
    figures = master.segment.figures
    thrown = figures.malformed + figures.foreign + figures.circulating
    assert (thrown, figures.frames) == (counted, frames), "each is counted, none carried out"
    assert figures.malformed and figures.foreign and figures.circulating, "each class came up"
    for k, memory in enumerate(before):
        now = master.segment.memory(k)
        changed = {at_ for at_ in range(len(now)) if now[at_] != memory[at_]}
        assert changed <= {0x030C}, f"slave {k}: {sorted(map(hex, changed))}"
    assert master.read(0, 0x030C, 1)[0] == min(figures.malformed, 255), "as the first slave reports"
    assert master.segment.drives.tick == tick, "no time has passed"
    master.exchange([bytes(master.out)] * master.slaves)
    assert master.count == 3 * master.slaves, "and the segment goes on"


def test_frames_of_any_shape_do_no_harm(master: Master) -> None:
    """A short part of `make fuzz ARGS="--frames 1000000"`."""
    master.bring_up()
    rng = np.random.default_rng(3)
    for _ in some(range(30_000), 2_000):
        body = rng.bytes(int(rng.integers(0, 120)))
        one = HEADER + struct.pack("<H", 0x1000 | len(body)) + body
        back = master.segment.frame(one if rng.random() < 0.9 else rng.bytes(len(one)))
        assert back == b"" or len(back) == len(one), "a frame keeps its length"
    for k in range(master.slaves):
        assert master.segment.memory(k)[0x0130] & 15 in (INIT, PREOP, SAFEOP, OP), "a state"


def test_real_time_keeps_up_with_the_clock() -> None:
    """Many short turns, in which the command looks for Ctrl-C, lose no period between them."""
    one = segment(lockstep=False)
    silent, other = socket.socketpair()
    with silent, other:
        began = time.monotonic()
        for _ in range(400):
            one.serve(silent.fileno(), 0.0013)
        passed = (time.monotonic() - began) * 1e9 / PERIOD
    counted = one.figures.periods + one.figures.late_periods
    # Turns that begin anew would lose 0.3 periods each; the host may sleep 50 ms at the end.
    assert passed - 50 < counted <= passed, f"{counted} periods in {passed:.1f} ms"


def test_what_cannot_be_opened_or_written_is_refused(master: Master, tmp_path: Path) -> None:
    for name in ("", "no_such_thing", "lo", "x" * 300):
        with pytest.raises(Refusal, match="--interface must "):
            master.segment.open(name)
    with pytest.raises(Refusal, match="be writable"):
        write_esi("three_axis", tmp_path / "nowhere" / "file.xml")


@pytest.mark.skipif(not FULL, reason="takes minutes: make test-in-full, make fuzz")
def test_a_million_frames_under_sanitizers(tmp_path: Path) -> None:
    code = "from fuzz import frames; [frames.case(1, k) for k in range(100)]"
    environment = {**cores.environment(tmp_path), "PYTHONPATH": ":".join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-5000:]


def test_the_description_agrees_with_what_the_slaves_report(master: Master, tmp_path: Path) -> None:
    import xml.etree.ElementTree as ET

    root = ET.fromstring(esi(master.segment.drives).partition("\n")[2])
    device = root.find(".//Device")
    assert device is not None
    master.preop(0)
    sizes = [int(one.get("DefaultSize", "0")) for one in device.findall("Sm")]
    assert sizes == [256, 256, *master.sizes(0)], "sync managers"
    reported = {
        int(one.findtext("Index", "")[2:], 16) for one in device.findall(".//Objects/Object")
    }
    raw = master.information(0, 1, struct.pack("<H", 1))
    assert reported == set(struct.unpack(f"<{len(raw) // 2}H", raw)[1:]), "objects"
    for tag, index in (("RxPdo", 0x1600), ("TxPdo", 0x1A00)):
        pdo = next(
            one for one in device.findall(tag) if int(one.findtext("Index", "")[2:], 16) == index
        )
        entries = [
            int(row.findtext("Index", "")[2:], 16) << 16
            | int(row.findtext("SubIndex", "0")) << 8
            | int(row.findtext("BitLen", ""))
            for row in pdo.findall("Entry")
        ]
        mapped = [master.number(0, index, k + 1) for k in range(master.number(0, index))]
        assert entries == mapped, f"what {tag} maps"

"""The EtherCAT segment as a master meets it, in-process: no sockets, no root."""

import struct
from pathlib import Path

import numpy as np
import pytest
from draws import some
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
    INIT,
    LRD,
    LRW,
    LWR,
    NOP,
    OP,
    PERIOD,
    PREOP,
    SAFEOP,
    STATION,
    Master,
    at,
    frame,
    master,
    read_replies,
    segment,
)  # fmt: skip

from arm_emulator.base.refusal import Refusal
from arm_emulator_fieldbus.commands.ethercat import write_esi
from arm_emulator_fieldbus.esi import make_esi

__all__ = ["master"]  # a fixture


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
        assert read_replies(back)[0][1] == counter, (
            f"working counter of command {command} at {address:#x}"
        )
        reported = struct.unpack_from("<H", back, 18)[0]
        assert reported == position & 0xFFFF, f"position after command {command}"
    assert master.segment.figures.unknown == 1, "one unknown command"


def test_objects_read_back_as_written(master: Master) -> None:
    rng = np.random.default_rng(1)
    values = [bytes(rng.integers(0, 256, 8, dtype=np.uint8)) for _ in range(master.slaves)]
    for k, value in enumerate(values):
        assert master.one(APWR, at(-k, 0x0F80), value)[1] == 1, "written"
        assert master.one(FPRD, at(STATION + k, 0x0F80), bytes(8)) == (value, 1), "read again"
    union = bytes(a | b | c for a, b, c in zip(*values, strict=True))
    assert master.one(BRD, at(0, 0x0F80), bytes(8))[0] == union, "BRD adds bits"
    written = bytes(8 * [0x5A])
    assert master.one(FPRW, at(STATION, 0x0F80), written) == (values[0], 3), "what stood there"
    assert master.one(FPRD, at(STATION, 0x0F80), bytes(8))[0] == written, "and now stands"
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


def test_a_slave_uses_its_alias_once_the_master_has_enabled_it(master: Master) -> None:
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


def test_the_eeprom_identifies_a_slave(master: Master) -> None:
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
    place, sections = 0x80, {}
    while (kind := struct.unpack_from("<H", image, place)[0]) != 0xFFFF:
        size = 2 * struct.unpack_from("<H", image, place + 2)[0]
        sections[kind] = image[place + 4 : place + 4 + size]
        place += 4 + size
    assert set(sections) == {10, 30, 40, 41, 50, 51, 60}, "strings, general, FMMU, SM, PDOs, DC"
    assert sections[10][2:].startswith(b"arm_emulator drive"), "the first string is the name"
    texts, at_ = [b""], 1
    for _ in range(sections[10][0]):
        texts.append(sections[10][at_ + 1 : at_ + 1 + sections[10][at_]])
        at_ += 1 + sections[10][at_]
    assert all(texts[1:]), "no empty texts"
    assert [texts[sections[60][k + 0x12]] for k in (0, 24)] == [b"FreeRun", b"DC SYNC0"], "clocks"
    pdo = [sections[51][k : k + 8] for k in range(8, 8 + 8 * sections[51][2], 8)]
    names = {(entry.index, entry.sub): entry.name for entry in drives.entries}
    for entry in pdo:
        index, sub, name = struct.unpack_from("<HBB", entry)
        assert texts[name].decode() == names.get((index, sub), ""), f"the name of {index:#x}"
    bits = sum(sections[51][k] for k in range(13, 8 + 8 * sections[51][2], 8))
    assert struct.unpack_from("<HH", sections[41], 16) == (0x1200, bits // 8), "outputs as mapped"


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
    for target, code in ((SAFEOP, 0x11), (OP, 0x11), (BOOT, 0x13), (7, 0x12), (0, 0x12)):
        assert master.ask(0, target) == (INIT | ERROR, code), f"INIT to {target}"
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


@pytest.mark.parametrize("direction", [0, 1])
@pytest.mark.parametrize("change", [(1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 2), (0, 0, 4)])
def test_process_data_that_do_not_fit_are_refused(
    master: Master, direction: int, change: tuple[int, int, int]
) -> None:
    master.preop(0)
    sizes = master.sizes(0)
    settings = [[0x1200, sizes[0], 0x64], [0x1500, sizes[1], 0x20]]
    start, size, control = settings[direction]
    settings[direction] = [start + change[0], size + change[1], control ^ change[2]]
    for k, (start, size, control) in enumerate(settings):
        master.guard(0, 2 + k, start, size, control)
    assert master.ask(0, SAFEOP) == (PREOP | ERROR, 0x1D + direction), f"{settings[direction]}"


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
def test_counters_and_time_fit_the_states_under_any_order_of_a_master(seed: int) -> None:
    """States, guards, units and SYNC0 at random: an exchange counts and lasts as they are then."""
    rng = np.random.default_rng(seed)
    master = Master(segment())
    master.bring_up()
    each = master.out + master.into
    states: set[int] = set()
    for step in range(300):
        k = int(rng.integers(master.slaves))
        place = master.segment.read_memory(k)
        action = rng.integers(8)
        if action < 2:
            master.ask(k, int(rng.choice([INIT, PREOP, SAFEOP, OP])) | ACKNOWLEDGE)
        elif action == 2 and place[0x0130] & 15 in (INIT, PREOP):
            master.preop(k)
            master.safeop(k, 0x10000 + k * each)
        elif action == 3:
            master.write(k, 0x0981, bytes([rng.choice([0, 1, 2, 3, 3, 3])]))
        elif action == 4:
            cycle = int(rng.choice([0, 1, 2, 3, 7])) * PERIOD + int(
                rng.choice([0, 0, 1, PERIOD // 2])
            )
            master.write(k, 0x09A0, struct.pack("<I", cycle))
        elif action == 5:  # a guard that the drive knows nothing of, over its inputs
            master.guard(k, 4, 0x1500, master.into, 0x20, int(rng.integers(2)))
        elif action == 6 and rng.random() < 0.2:
            master.write(k, 0x0806 + 8 * int(rng.integers(4)), b"\0")
        elif action == 7:
            unit = 0x060C + 16 * int(rng.integers(2))
            master.write(k, unit, bytes([place[unit] ^ 1]))
        memories = [master.segment.read_memory(j) for j in range(master.slaves)]
        at_work = [memory for memory in memories if works(memory)]
        states |= {memory[0x0130] for memory in memories}
        assert all(map(sound_cycle, at_work)), f"step {step}: SYNC0 cuts periods"
        counted = at_work and all(counts(memory) == 3 for memory in at_work)
        cycles = [
            struct.unpack_from("<I", memory, 0x09A0)[0]
            for memory in at_work
            if memory[0x0981] & 3 == 3
        ]
        before = master.segment.drives.tick
        master.exchange([bytes(master.out)] * master.slaves)
        assert master.count == sum(map(counts, memories)), f"step {step}: working counter"
        passed = master.segment.drives.tick - before
        lasts = min(cycles, default=PERIOD) // PERIOD if at_work else 0
        # One that is not whole may complete what the exchange before has begun.
        assert passed == lasts or (passed == 0 and not counted), f"step {step}: {passed} periods"
    assert {INIT, PREOP, SAFEOP, OP, PREOP | ERROR} <= states, "every state came by"


def test_a_reset_puts_a_controller_to_where_it_began(master: Master) -> None:
    fresh = segment().read_memory(1)
    master.bring_up()
    for letter in b"RES":
        master.write(1, 0x0040, bytes([letter]))
    assert master.one(FPRD, at(STATION + 1, 0x10), bytes(2))[1] == 0, "no address any more"
    assert master.segment.read_memory(1)[:0x0900] == fresh[:0x0900], "registers as at the beginning"


def test_interfaces_and_files_that_cannot_be_opened_are_refused(
    master: Master, tmp_path: Path
) -> None:
    for name in ("", "no_such_thing", "lo", "x" * 300):
        with pytest.raises(Refusal, match="--interface must "):
            master.segment.open_interface(name)
    with pytest.raises(Refusal, match="be writable"):
        write_esi("three_axis", tmp_path / "nowhere" / "file.xml")


def test_the_description_agrees_with_the_reports_of_the_slaves(
    master: Master, tmp_path: Path
) -> None:
    import xml.etree.ElementTree as ET

    root = ET.fromstring(make_esi(master.segment.drives).partition("\n")[2])
    device = root.find(".//Device")
    assert device is not None
    master.preop(0)
    sizes = [int(manager.get("DefaultSize", "0")) for manager in device.findall("Sm")]
    assert sizes == [256, 256, *master.sizes(0)], "sync managers"
    reported = {
        int(device_object.findtext("Index", "")[2:], 16)
        for device_object in device.findall(".//Objects/Object")
    }
    raw = master.information(0, 1, struct.pack("<H", 1))
    assert reported == set(struct.unpack(f"<{len(raw) // 2}H", raw)[1:]), "objects"
    for tag, index in (("RxPdo", 0x1600), ("TxPdo", 0x1A00)):
        pdo = next(
            device_object
            for device_object in device.findall(tag)
            if int(device_object.findtext("Index", "")[2:], 16) == index
        )
        entries = [
            int(row.findtext("Index", "")[2:], 16) << 16
            | int(row.findtext("SubIndex", "0")) << 8
            | int(row.findtext("BitLen", ""))
            for row in pdo.findall("Entry")
        ]
        mapped = [master.number(0, index, k + 1) for k in range(master.number(0, index))]
        assert entries == mapped, f"what {tag} maps"

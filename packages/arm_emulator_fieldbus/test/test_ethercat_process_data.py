"""Process data of EtherCAT slaves, watchdogs, clocks, malformed frames."""

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
    BWR,
    ERROR,
    FRMW,
    HEADER,
    INIT,
    LRD,
    LRW,
    LWR,
    OP,
    PERIOD,
    PREOP,
    SAFEOP,
    STATION,
    Master,
    at,
    datagram,
    frame,
    master,
    segment,
)  # fmt: skip
from fuzz import cores

from arm_emulator_fieldbus.drives_unit import ETHERCAT
from arm_emulator_fieldbus.object_dictionary import Aborted as DictionaryAborted
from arm_emulator_fieldbus.object_dictionary import ObjectEntry

__all__ = ["master"]  # a fixture


# ------------------------------------------------------------------------------------ process data


def test_a_servo_period_passes_per_exchange_with_all_drives(master: Master) -> None:
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


def random_mapping(rng: np.random.Generator, entries: list[ObjectEntry]) -> list[list[int]]:
    """Up to three objects, each with some entries and gaps between them."""
    out = []
    for _ in range(rng.integers(0, 4)):
        chosen = rng.choice(len(entries), int(rng.integers(1, 6)), replace=False)
        words = []
        for entry in (entries[k] for k in chosen):
            if rng.random() < 0.3:
                words.append(int(rng.choice([8, 16])))  # a gap
            words.append(entry.index << 16 | entry.sub << 8 | entry.bits)
        out.append(words)
    return out


@pytest.mark.parametrize("seed", some(range(30), 6))
def test_any_mapping_carries_the_objects_that_it_names(master: Master, seed: int) -> None:
    """Process data affect drives as the same values written through their dictionaries do."""
    rng = np.random.default_rng(seed)
    twin, drives = segment().drives, master.segment.drives
    master.slaves = 1
    master.preop(0)
    there = [entry for entry in drives.entries if entry.buses & ETHERCAT and entry.bits]
    mapped = []
    for assignment, first, entries in (
        (0x1C12, 0x1600, [entry for entry in there if entry.rx]),
        (0x1C13, 0x1A00, [entry for entry in there if entry.tx]),
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
        mapped.append([word for words in mapping for word in words])
    out, into = master.sizes(0)
    status = master.safeop(0, 0x10000)
    assert status == (SAFEOP, 0), f"{out} and {into} bytes: {status}"
    assert master.ask(0, OP) == (OP, 0), "in OP"
    for _ in range(5):
        expected = b"".join(
            twin.upload_entry(0, word >> 16, word >> 8 & 0xFF) if word >> 16 else bytes(word // 8)
            for word in mapped[1]
        )
        sent = rng.bytes(out)
        place = 0
        for word in mapped[0]:
            size = (word & 0xFF) // 8
            if word >> 16:
                with contextlib.suppress(DictionaryAborted):  # a value out of its range
                    twin.download_entry(0, word >> 16, word >> 8 & 0xFF, sent[place : place + size])
            place += size
        back, count = master.one(LRW, 0x10000, sent + bytes(into))
        assert count == 2 * bool(out) + bool(into), "written and read"
        assert back[out:] == expected, "inputs are the values that the drive had"
        if out or into:
            twin.period()
        assert drives.tick == twin.tick, "as many servo periods"
        for mapped_entry in there:
            if not 0x1600 <= mapped_entry.index <= 0x1C13:
                value = drives.upload_entry(0, mapped_entry.index, mapped_entry.sub)
                assert value == twin.upload_entry(0, mapped_entry.index, mapped_entry.sub), (
                    f"{mapped_entry.index:#x}:{mapped_entry.sub}"
                )


@pytest.mark.parametrize("shift", range(1, 8))
def test_single_bits_are_mapped_where_they_shall_be(master: Master, shift: int) -> None:
    """Outputs and inputs of slave 0 lie in the logical space from any bit on."""
    master.preop(0)
    out, into = master.sizes(0)
    master.safeop(0, 0)
    for k, (logical, size, place, direction) in enumerate(
        ((0, out, 0x1200, 2), (64, into, 0x1500, 1))
    ):
        unit = struct.pack(
            "<IHBBHBBB3x", logical, size + 1, shift, shift - 1, place, 0, direction, 1
        )
        master.write(0, 0x0600 + 16 * k, unit)
    rng = np.random.default_rng(shift)
    value = int.from_bytes(rng.bytes(out), "little") & ~(0xFFFF | 0xFF << 112)
    data = (value << shift).to_bytes(64, "little") + bytes(into + 1)
    back, count = master.one(LRW, 0, data)
    assert count == 3, "read and written"
    assert master.segment.read_memory(0)[0x1200 : 0x1200 + out] == value.to_bytes(out, "little"), (
        "outputs"
    )
    expected = master.segment.read_memory(0)[0x1500 : 0x1500 + into]
    # The frame reports inputs as they were before the servo period that it set off.
    bits = int.from_bytes(back[64:], "little") >> shift
    reported = bits.to_bytes(into + 1, "little")[:into]
    assert reported[:2] == expected[:2], "the statusword, which has not changed"


def test_a_watchdog_that_runs_out_takes_the_slave_to_safeop() -> None:
    master = Master(segment(lockstep=False))
    master.bring_up()
    for _ in range(50):
        master.exchange([bytes(master.out)] * master.slaves)
        master.now += PERIOD
        master.segment.pass_period(master.now)
    assert master.segment.figures.watchdogs == 0, "while outputs come"
    silent = 0
    while master.segment.figures.watchdogs == 0:
        master.now += PERIOD
        master.segment.pass_period(master.now)
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
        reported = [struct.unpack_from("<Hi", image) for image in master.exchange(outputs)]
        if not master.segment.lockstep:
            master.now += PERIOD
            master.segment.pass_period(master.now)
        if all(status & 0x6F == 0x27 for status, _ in reported):
            return reported
    raise AssertionError(f"drives are not enabled: {[hex(status) for status, _ in reported]}")


def test_a_lost_master_faults_the_drives_until_they_are_reset() -> None:
    master = Master(segment(lockstep=False))
    master.bring_up()
    enable(master)
    for _ in range(200):
        master.now += PERIOD
        master.segment.pass_period(master.now)
    for k in range(master.slaves):
        assert (master.word(k, 0x0130), master.word(k, 0x0134)) == (SAFEOP | ERROR, 0x1B), "lost"
        assert master.number(k, 0x603F) == 0x821B, "the drive's error: its sync manager's watchdog"
        assert master.number(k, 0x6041) & 0x4F == 0x08, "Fault"
    assert [(emergency.slave, emergency.code) for emergency in master.emergencies] == [
        (k, 0x821B) for k in range(master.slaves)
    ], "an emergency of each"
    for k in range(master.slaves):
        assert master.ask(k, OP | ACKNOWLEDGE) == (OP, 0), "up again"
    enable(master)
    for k in range(master.slaves):
        assert master.fetch(k) is None, "no more messages"
    assert [emergency.code for emergency in master.emergencies[master.slaves :]] == [
        0
    ] * master.slaves, "over"


def test_lost_cycles_are_counted_by_the_clock() -> None:
    master = Master(segment(lockstep=False))
    master.bring_up()
    master.segment.pass_period(master.now)
    before = master.segment.figures.lost_cycles
    for k in range(20):
        if k % 4:
            master.exchange([bytes(master.out)] * master.slaves)
        master.now += PERIOD
        master.segment.pass_period(master.now)
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
    delays = [(rounds[0] - round_trip) // 2 for round_trip in rounds]
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
def test_the_cycle_of_sync0_is_an_integer_number_of_servo_periods(
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
    before = [master.segment.read_memory(k) for k in range(master.slaves)]
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
        now = master.segment.read_memory(k)
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
        ethernet = HEADER + struct.pack("<H", 0x1000 | len(body)) + body
        back = master.segment.frame(ethernet if rng.random() < 0.9 else rng.bytes(len(ethernet)))
        assert back == b"" or len(back) == len(ethernet), "a frame keeps its length"
    for k in range(master.slaves):
        assert master.segment.read_memory(k)[0x0130] & 15 in (INIT, PREOP, SAFEOP, OP), "a state"


def test_real_time_keeps_up_with_the_clock() -> None:
    """Many short turns, in which the command looks for Ctrl-C, lose no period between them."""
    served = segment(lockstep=False)
    silent, far_end = socket.socketpair()
    with silent, far_end:
        began = time.monotonic()
        for _ in range(400):
            served.serve_frames(silent.fileno(), 0.0013)
        passed = (time.monotonic() - began) * 1e9 / PERIOD
    counted = served.figures.periods + served.figures.late_periods
    # Turns that begin anew would lose 0.3 periods each; the host may sleep 50 ms at the end.
    assert passed - 50 < counted <= passed, f"{counted} periods in {passed:.1f} ms"


@pytest.mark.skipif(not FULL, reason="takes minutes: make test-in-full, make fuzz")
def test_a_million_frames_under_sanitizers(tmp_path: Path) -> None:
    code = "from fuzz import frames; [frames.case(1, k) for k in range(100)]"
    environment = {**cores.environment(tmp_path), "PYTHONPATH": ":".join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-5000:]

"""Drives as CANopen nodes, by their frames and without a bus: NMT, PDOs, heartbeats."""

import math
import random
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from canopen_master import (
    ENTRIES,
    SYNC,
    drives_of,
    dumped,
    enable,
    put,
    refused,
    segment_of,
    sent,
    uploaded,
)
from draws import FULL

from arm_emulator import Diverged, Refusal, Scene, load_scene
from arm_emulator_fieldbus.can_bus import open_bus
from arm_emulator_fieldbus.canopen_node import CanFrame, NmtState
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.commands.canopen import write_eds

FRAMES = 1_000_000 if FULL else 12_000
CSP = 8


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis")


def test_nodes_boot_and_follow_network_management(scene: Scene) -> None:
    """Any commands in any order, against the table of CiA 301."""
    segment = CanSegment(drives_of(scene), 10)
    assert segment.boot_nodes() == [CanFrame(0x700 + number, b"\0") for number in (10, 11, 12)]
    draw, model = random.Random(1), {number: 127 for number in (10, 11, 12)}
    toggle = {number: 0 for number in model}
    table = {1: 5, 2: 4, 128: 127, 129: 127, 130: 127}
    for _ in range(300):
        command = draw.choice([1, 2, 128, 129, 130, 0, 77])
        to = draw.choice([0, 9, 10, 11, 12, 13])
        frames = segment.receive_frame(CanFrame(0, bytes((command, to))))
        reached = [number for number in model if to in (0, number)]
        for number in reached:
            model[number] = table.get(command, model[number])
        boots = [data for number in reached for data in sent(frames, 0x700 + number)]
        assert boots == ([b"\0"] * len(reached) if command in (129, 130) else [])
        assert {node.number: int(node.state) for node in segment.nodes} == model
        number = draw.choice(list(model))
        if command in (129, 130) and number in reached:
            toggle[number] = 0
        for node_id in reached:
            toggle[node_id] = 0 if command in (129, 130) else toggle[node_id]
        guarded = segment.receive_frame(CanFrame(0x700 + number, remote=True))
        assert guarded == [CanFrame(0x700 + number, bytes((model[number] | toggle[number],)))]
        toggle[number] ^= 0x80
        ask = segment.receive_frame(
            CanFrame(0x600 + number, struct.pack("<BHB4x", 0x40, 0x1000, 0))
        )
        assert bool(ask) == (model[number] != 4), "no SDO while stopped"
    for data in (b"", b"\1", b"\1\0\0"):
        before = [node.state for node in segment.nodes]
        segment.receive_frame(CanFrame(0, data))
        assert [node.state for node in segment.nodes] == before


def test_receive_pdos_hold_from_the_next_sync_or_at_once(scene: Scene) -> None:
    segment = segment_of(scene)
    put(segment, 2, 0x1402, 2, 255, 1)
    position = struct.pack("<Hi", 0, 4711)
    segment.receive_frame(CanFrame(0x302, position))
    assert uploaded(segment, 2, 0x607A, 0) != position[2:], "pre-operational: no PDOs"
    segment.receive_frame(CanFrame(0, b"\1\0"))
    before = uploaded(segment, 2, 0x607A, 0)
    segment.receive_frame(CanFrame(0x302, position))
    assert uploaded(segment, 2, 0x607A, 0) == before, "waits for SYNC"
    segment.receive_frame(SYNC)
    assert uploaded(segment, 2, 0x607A, 0) == position[2:]
    segment.receive_frame(CanFrame(0x402, struct.pack("<Hi", 0, -5)))
    assert uploaded(segment, 2, 0x60FF, 0) == struct.pack("<i", -5), "at once"
    assert uploaded(segment, 1, 0x60FF, 0) == bytes(4), "the other node's stays"
    (reported,) = segment.receive_frame(CanFrame(0x402, b"\1\2\3"))
    assert reported == CanFrame(0x82, struct.pack("<HB5x", 0x8210, 0)), "too short, and reported"
    assert uploaded(segment, 2, 0x60FF, 0) == struct.pack("<i", -5)
    segment.receive_frame(CanFrame(0x302, struct.pack("<Hi", 0, 1)))
    put(segment, 2, 0x1017, 0, 0, 2)  # another setting
    segment.receive_frame(SYNC)
    assert uploaded(segment, 2, 0x607A, 0) == struct.pack("<i", 1), "what waited was kept"


@pytest.mark.parametrize("every", [1, 2, 7, 240])
def test_transmit_pdos_come_with_every_nth_sync(scene: Scene, every: int) -> None:
    segment = segment_of(scene)
    put(segment, 1, 0x1801, 2, every, 1)
    segment.receive_frame(CanFrame(0, b"\1\0"))
    for k in range(1, 500):
        reported = uploaded(segment, 1, 0x6064, 0)
        (*data,) = sent(segment.receive_frame(SYNC), 0x281)
        assert len(data) == (k % every == 0), k
        assert not data or data[0][2:] == reported, "as it was when SYNC came"
    assert segment.tick == 499, "one servo period per SYNC"


def test_transmit_pdos_on_event_on_request_and_by_timer(scene: Scene) -> None:
    segment = segment_of(scene)
    put(segment, 1, 0x1800, 5, 3, 2)  # at the latest after 3 ms
    put(segment, 1, 0x1801, 2, 252, 1)
    put(segment, 1, 0x1802, 2, 253, 1)
    frames = segment.receive_frame(CanFrame(0, b"\1\0"))
    assert len(sent(frames, 0x181)) == 1, "on entering operational"
    counts = [len(sent(segment.receive_frame(SYNC), 0x181)) for _ in range(9)]
    assert counts == [0, 0, 1] * 3, "the statusword stands still: by the timer"
    assert sent(segment.receive_frame(CanFrame(0x281, remote=True)), 0x281), "sampled by SYNC"
    assert sent(segment.receive_frame(CanFrame(0x381, remote=True)), 0x381), (
        "sampled when asked for"
    )
    put(segment, 1, 0x1802, 1, 0x80000381, 4)
    assert not segment.receive_frame(CanFrame(0x381, remote=True)), "switched off"


def test_mapping_is_changed_as_the_standard_states(scene: Scene) -> None:
    segment = segment_of(scene, operational=True)
    assert refused(segment, 1, 0x1A01, 0, 0, 1) == 0x08000022, "operational, and in use"
    put(segment, 1, 0x1801, 1, 0x80000281, 4)
    put(segment, 1, 0x1A01, 0, 0, 1)
    put(segment, 1, 0x1801, 1, 0x281, 4)
    assert not sent(segment.receive_frame(SYNC), 0x281), "nothing is mapped"
    put(segment, 1, 0x1801, 1, 0x80000281, 4)
    assert refused(segment, 1, 0x1A01, 1, 0x607A0020, 4) == 0x06040041, "it cannot transmit that"
    put(segment, 1, 0x1A01, 1, 0x60640020, 4)
    put(segment, 1, 0x1A01, 2, 0x606C0020, 4)
    put(segment, 1, 0x1A01, 3, 0x60410010, 4)
    assert refused(segment, 1, 0x1A01, 0, 3, 1) == 0x06040042, "10 bytes"
    put(segment, 1, 0x1A01, 0, 2, 1)
    put(segment, 1, 0x1801, 1, 0x123 + 0x200, 4)
    reported = uploaded(segment, 1, 0x6064, 0) + uploaded(segment, 1, 0x606C, 0)
    assert sent(segment.receive_frame(SYNC), 0x323) == [reported]
    fresh = dumped(segment_of(scene), 1)
    segment.receive_frame(CanFrame(0, bytes((128, 1))))
    segment.receive_frame(CanFrame(0, bytes((130, 1))))
    assert dumped(segment, 1) == fresh, "a reset of the communication restores it"


def test_heartbeats_are_sent_and_monitored(scene: Scene) -> None:
    segment = segment_of(scene, operational=True)
    put(segment, 1, 0x1017, 0, 10, 2)
    ms = 1_000_000
    beats = [t for t in range(0, 100) if segment.send_heartbeats(5 * ms + t * ms)]
    assert beats == list(range(0, 100, 10))
    assert segment.send_heartbeats(200 * ms) == [CanFrame(0x701, b"\5")]
    assert segment.receive_frame(CanFrame(0x701, remote=True)) == [], "no guarding beside it"
    put(segment, 2, 0x1016, 1, 0x7F << 16 | 5, 4)
    for _ in range(20):
        assert not sent(segment.receive_frame(SYNC), 0x82), "not heard yet: not watched"
    for _ in range(3):
        segment.receive_frame(CanFrame(0x77F, b"\5"))
        for _ in range(5):
            assert not sent(segment.receive_frame(SYNC), 0x82)
    lost = sent(segment.receive_frame(SYNC), 0x82)
    assert [data[:2] for data in lost] == [b"\x30\x81"], "life guard error"
    assert [node.state for node in segment.nodes] == [5, NmtState.PRE_OPERATIONAL, 5]
    for _ in range(10):
        assert not sent(segment.receive_frame(SYNC), 0x82), "reported once"


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
        positions = {
            8: np.array(start) + counts * (1 - np.cos(angle)) / 2,
            9: counts * turning * np.sin(angle) / 2,
            10: 40 * np.sin(angle),  # 4 % of the rated torque
        }[mode]
        targets = np.rint(positions).astype(int).tolist()
        for k, position in enumerate(targets):
            segment.receive_frame(CanFrame(rx + 3 + k, struct.pack(layout, 15, position)))
        frames = segment.receive_frame(SYNC)
        for k, position in enumerate(targets):
            reported = struct.unpack(layout, sent(frames, tx + 3 + k)[0])
            assert reported == (drives.read(k, 0x6041), drives.read(k, actual)), f"at SYNC {tick}"
            drives.write(k, 0x6040, 15)
            drives.write(k, target, position)
        drives.period()
        if mode == 8:  # 0.004 rad at the link, some periods' way
            assert all(abs(drives.read(k, actual) - targets[k]) < 60 for k in range(3))
    assert segment.drives.plant.save() == drives.plant.save()
    moved = [abs(drives.read(k, 0x6064) - start[k]) for k in range(3)]
    assert min(moved) > 100, "the arm has moved"


def test_sync_stands_for_the_shortest_communication_cycle_period(scene: Scene) -> None:
    """CiA 301: 0x1006 is the time between two SYNCs; 0: not given."""
    segment = segment_of(scene)
    for number, us, passed in ((1, 0, 1), (1, 4000, 4), (2, 7000, 4), (3, 2000, 2), (3, 0, 4)):
        put(segment, number, 0x1006, 0, us, 4)
        before = segment.tick
        segment.receive_frame(SYNC)
        assert segment.tick - before == passed, f"{us} us set at node {number}"


@pytest.mark.parametrize("us", [400, 1000, 1500, 2500, 4000, 25400])
def test_a_communication_cycle_period_that_is_rounded_is_noted(scene: Scene, us: int) -> None:
    """The servo period is 1 ms."""
    segment = segment_of(scene)
    put(segment, 2, 0x1006, 0, us, 4)
    for _ in range(2):
        segment.receive_frame(SYNC)
    assert segment.periods_per_sync == max(1, math.floor(us / 1000 + 0.5))
    words = f"node 2: 0x1006 is {us / 1000:g} servo periods: SYNC stands for "
    assert segment.notices == ([words + str(segment.periods_per_sync)] if us % 1000 else [])


def test_a_stopped_node_and_a_lost_master_take_the_drives_off(scene: Scene) -> None:
    for command, code in ((b"\2\1", b"\x00\x81"), (None, b"\x30\x81")):
        segment = segment_of(scene)
        enable(segment, CSP)
        if command:
            segment.receive_frame(CanFrame(0, command))
        else:
            put(segment, 1, 0x1016, 1, 0x7F << 16 | 3, 4)
            segment.receive_frame(CanFrame(0x77F, b"\5"))
        for _ in range(100):
            segment.receive_frame(SYNC)
        node = segment.nodes[0]
        assert node.upload_entry(0x6041, 0)[0] & 0x4F == 0x08, "Fault, as 0x6007 states"
        assert node.upload_entry(0x603F, 0) == code
        assert segment.nodes[1].upload_entry(0x6041, 0)[0] & 0x6F == 0x27, "the others go on"
        segment.receive_frame(CanFrame(0, b"\x81\1"))
        assert not sent(segment.receive_frame(SYNC), 0x81), "a reset node has nothing to report"
        assert node.upload_entry(0x6041, 0)[0] & 0x4F == 0x40, "Switch on disabled"


def test_a_machine_that_diverged_stays_and_its_nodes_answer(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    segment = segment_of(scene, operational=True)
    segment.receive_frame(SYNC)
    still = np.zeros(3)
    diverged = Diverged("waist", 0.001, scene, still, still, still)

    def diverge() -> None:
        raise diverged

    monkeypatch.setattr(segment.drives, "period", diverge)
    for _ in range(3):
        assert sent(segment.receive_frame(SYNC), 0x281), "SYNC is answered"
    assert segment.fault is diverged and segment.tick == 1
    assert uploaded(segment, 1, 0x1000, 0) == b"\x92\x01\x02\0"


def test_data_sheets_that_cannot_be_written_are_refused() -> None:
    with pytest.raises(Refusal, match=r"canopen: file .* must be writable, got File exists"):
        write_eds("three_axis", Path(__file__))


def noise(draw: random.Random, numbers: Sequence[int]) -> CanFrame:
    """A frame of some kind that a node might take, sound or spoiled."""
    number = draw.choice(numbers)
    entry = draw.choice(ENTRIES)
    match draw.randrange(8):
        case 0 | 1 | 2:  # SDO with an entry of the dictionary, any command
            head = draw.choice([0x40, 0x2F, 0x2B, 0x23, 0x21, 0xA4, 0xC6, draw.randrange(256)])
            raw = struct.pack("<BHB", head, entry.index, entry.sub)
            value = draw.choice([draw.randbytes(4), bytes(4), struct.pack("<I", draw.randrange(9))])
            return CanFrame(0x600 + number, raw + value)
        case 3:  # segments, and anything else
            head = draw.choice(
                [0x00, 0x10, 0x01, 0x60, 0xA3, 0xA2, 0x81, 0xC1, draw.randrange(256)]
            )
            return CanFrame(
                0x600 + number, bytes((head,)) + draw.randbytes(draw.choice([7, 7, 7, 3]))
            )
        case 4:
            commands = [1, 1, 1, 128, 2, 129, 130, draw.randrange(256)]
            return CanFrame(0, bytes((draw.choice(commands), draw.choice([0, number, 99]))))
        case 5:
            data = draw.randbytes(draw.randrange(9))
            return CanFrame(draw.choice([0x200, 0x300, 0x400, 0x500]) + number, data)
        case 6:
            return draw.choice([SYNC, CanFrame(0x80, b"\1"), CanFrame(0x77F, b"\5")])
    return CanFrame(draw.randrange(0x800), draw.randbytes(draw.randrange(9)), draw.random() < 0.3)


@pytest.mark.parametrize("seed", range(4))
def test_random_frames_leave_sound_nodes(scene: Scene, seed: int) -> None:
    """No frame breaks a node; aborted requests and frames without a receiver change nothing."""
    segment, draw = segment_of(scene), random.Random(seed)
    numbers, looked = [1, 2, 3], 0
    for k in range(FRAMES // 4):
        frame = noise(draw, numbers)
        look = k % 50 == 0 and frame.id not in (0, 0x80)
        before = list_everything(segment) if look else None
        frames = segment.receive_frame(frame)
        assert all(0 <= frame.id < 0x800 and len(frame.data) <= 8 for frame in frames)
        if not look:
            continue
        aborted = frames and frames[0].id & 0x780 == 0x580 and frames[0].data[0] == 0x80
        unaddressed = frame.id & 0x7F not in numbers and not frame.remote and not frames
        if aborted or (unaddressed and frame.id not in ids_of(segment)):
            assert list_everything(segment) == before, frame
            looked += 1
    assert looked > FRAMES // 4 // 50 // 8
    assert np.isfinite(segment.drives.plant.state.q).all()
    segment.receive_frame(CanFrame(0, b"\x81\0"))
    for number in numbers:
        assert uploaded(segment, number, 0x1000, 0) == b"\x92\x01\x02\0", "it still answers"


def ids_of(segment: CanSegment) -> set[int]:
    """Identifiers that PDOs, SYNC and heartbeats have after whatever was set."""
    ids = set()
    for node in segment.nodes:
        for index, sub in [(0x1005, 0), *((0x1400 + k, 1) for k in range(4))]:
            ids.add(int.from_bytes(node.upload_entry(index, sub), "little") & 0x7FF)
        ids.add(0x700 + (int.from_bytes(node.upload_entry(0x1016, 1), "little") >> 16 & 0x7F))
    return ids


def list_everything(segment: CanSegment) -> tuple[object, ...]:
    dumps = [dumped(segment, node.number) for node in segment.nodes]
    return dumps, [node.state for node in segment.nodes], segment.drives.plant.save()


def test_a_bus_that_cannot_be_opened_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "can", None)
    with pytest.raises(Refusal, match=r"canopen: package python-can must be installed \(pip"):
        with open_bus("virtual", "0", None):
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
            with open_bus(bus, channel, None):
                pass


@pytest.mark.parametrize("first", [0, 126, -1])
def test_unknown_nodes_are_refused(scene: Scene, first: int) -> None:
    with pytest.raises(Refusal, match=f"first node-ID must be 1 to 125, got {first}"):
        CanSegment(drives_of(scene), first)

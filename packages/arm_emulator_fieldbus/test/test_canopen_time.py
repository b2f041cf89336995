"""Times on CANopen, against the text of CiA 301: SYNC, its period and window, monitored times."""

import struct
from collections.abc import Sequence

import pytest
from canopen_master import SYNC, put, segment_of, sent, uploaded
from canopen_master import enable as enable_nodes
from cia402 import (
    ACTUAL,
    CSP,
    CSV,
    PLAIN,
    SERVO,
    STATUS,
    TARGET,
)

from arm_emulator import Plant, Refusal
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN


def can_segment(*, lockstep: bool) -> CanSegment:
    segment = CanSegment(Drives(Plant(PLAIN), SERVO, CANOPEN), 1, lockstep=lockstep)
    segment.boot_nodes()
    return segment


EVERYTHING = ("SYNC", "RPDO", "guarding")


def turning(segment: CanSegment) -> None:
    """Node 1 in cyclic velocity, with SYNC, RPDO 3 and guarding in each servo period."""
    segment.receive_frame(CanFrame(0, b"\1\0"))
    for k in range(330):
        word = (6, 7, 15)[min(k // 10, 2)]
        segment.receive_frame(CanFrame(0x201, struct.pack("<Hb", word, CSV)))
        cycle(segment, EVERYTHING, word)
    assert uploaded(segment, 1, STATUS, 0)[0] & 0x6F == 0x27
    assert speed(segment) > 5000


def cycle(segment: CanSegment, messages: Sequence[str], word: int = 15) -> list[CanFrame]:
    """A servo period with some of the messages; guarding is answered and left out."""
    frames: list[CanFrame] = []
    if "RPDO" in messages:
        frames += segment.receive_frame(CanFrame(0x401, struct.pack("<Hi", word, 9000)))
    if "SYNC" in messages:
        frames += segment.receive_frame(SYNC)
    if "guarding" in messages:
        segment.receive_frame(CanFrame(0x701, remote=True))
    return frames + segment.pass_period()


LOSSES = {
    "SYNC": (0x1006, 0, 4000, 4, 0x8700, 6),  # once and a half
    "RPDO": (0x1402, 5, 20, 2, 0x8250, 20),
    "guarding": (0x100C, 0, 10, 2, 0x8130, 30),  # three times
}


@pytest.mark.parametrize("messages", LOSSES)
def test_a_motor_stops_when_sync_or_targets_or_guarding_cease(messages: str) -> None:
    """Monitored are 0x1006, 0x1400:5 of RPDOs, and 0x100C times 0x100D (CiA 301); 0: not.

    The drive reacts as 0x6007 selects: here by a fault, with the code that EMCY reports.
    """
    index, sub, value, size, code, after = LOSSES[messages]
    others = [name for name in EVERYTHING if name != messages]
    for monitored in (False, True):
        segment = can_segment(lockstep=False)
        if monitored:
            put(segment, 1, index, sub, value, size)
            put(segment, 1, 0x100D, 0, 3, 1)
        turning(segment)
        # The last messages came before the last period; the time ends at a period's end.
        frames = [frame for _ in range(after - 1) for frame in cycle(segment, others)]
        assert not sent(frames, 0x81), "not before the time"
        frames = [frame for _ in range(2) for frame in cycle(segment, others)]
        emergencies = [struct.unpack_from("<H", data)[0] for data in sent(frames, 0x81)]
        assert emergencies == ([code] if monitored else [])
        for _ in range(2000):
            cycle(segment, others, 0)
        if not monitored:
            continue
        assert uploaded(segment, 1, STATUS, 0)[0] & 0x4F == 0x08, "fault"
        assert uploaded(segment, 1, 0x603F, 0) == struct.pack("<H", code)
        assert abs(speed(segment)) < 500
        segment.receive_frame(CanFrame(0, b"\1\0"))  # operational, where it left that
        for word in (0, 0x80):
            cycle(segment, EVERYTHING, word)
            cycle(segment, EVERYTHING, word)
        assert uploaded(segment, 1, STATUS, 0)[0] & 0x4F == 0x40, "the fault is reset"


def speed(segment: CanSegment) -> int:
    return int(struct.unpack("<i", uploaded(segment, 1, 0x606C, 0))[0])


def test_nothing_is_monitored_until_a_master_asks_for_it() -> None:
    """0x1006, 0x100C, 0x100D, 0x1400:5 and 0x1016 are 0 at first: the motor keeps its speed."""
    segment = can_segment(lockstep=False)
    turning(segment)
    for _ in range(500):
        cycle(segment, ())
    assert uploaded(segment, 1, STATUS, 0)[0] & 0x6F == 0x27
    assert speed(segment) > 5000


def test_synchronous_data_after_the_window_is_ignored() -> None:
    """0x1007: synchronous PDOs outside the window after SYNC are ignored; 0: there is no window.

    A maintainer of the stack CANopenNode quotes this rule of CiA 301 to a user whose synchronous
    RPDOs were lost. In lock-step time waits for SYNC, and nothing is too late.
    """
    for lockstep in (False, True):
        segment = can_segment(lockstep=lockstep)
        put(segment, 1, 0x1007, 0, 2000, 4)
        segment.receive_frame(CanFrame(0, b"\1\0"))
        for periods in (0, 1, 2, 3, 9):
            segment.receive_frame(SYNC)
            for _ in range(periods):
                segment.pass_period()
            target = struct.pack("<i", 1000 + periods)
            segment.receive_frame(CanFrame(0x301, struct.pack("<H", 0) + target))
            segment.receive_frame(SYNC)
            taken = uploaded(segment, 1, TARGET, 0) == target
            assert taken == (lockstep or periods <= 2), f"{periods} ms after SYNC"


def test_a_sync_stands_for_its_period_and_not_for_the_interpolation_time() -> None:
    """The times of a configuration of ros2_canopen: SYNC every 10 ms, 0x60C2 of 50 ms.

    A target is reached 50 ms after its SYNC, 5 SYNCs later; a SYNC lets 10 ms pass.
    """
    for source in ("0x1006", "option"):
        period = 0.01 if source == "option" else 0.0
        drives = Drives(Plant(PLAIN), SERVO, CANOPEN)
        segment = CanSegment(drives, 1, sync_period=period)
        segment.boot_nodes()
        put(segment, 1, 0x60C2, 1, 50, 1)
        put(segment, 1, 0x60C2, 2, 256 - 3, 1)
        if source == "0x1006":
            for node in (1, 2, 3):
                put(segment, node, 0x1006, 0, 10000, 4)
        enable_nodes(segment, CSP)
        before = segment.tick
        start = struct.unpack("<i", uploaded(segment, 1, ACTUAL, 0))[0]
        segment.receive_frame(CanFrame(0x301, struct.pack("<Hi", 15, start + 500)))
        demands = []
        for _ in range(6):
            segment.receive_frame(SYNC)
            demands.append(drives.read(0, 0x6062) - start)
        assert segment.tick - before == 60
        assert demands == [100, 200, 300, 400, 500, 500]
        assert segment.notices == [
            "node 1: 0x60C2 is 50 servo periods, and SYNC stands for 10 (0x1006)"
        ]


def test_a_sync_without_a_period_stands_for_a_servo_period() -> None:
    segment = segment_of(PLAIN)
    put(segment, 1, 0x60C2, 1, 50, 1)
    before = segment.tick
    segment.receive_frame(SYNC)
    assert segment.tick == before + 1


def test_the_interpolation_time_of_a_node_follows_the_period_of_sync() -> None:
    segment = segment_of(PLAIN)
    put(segment, 1, 0x1006, 0, 4000, 4)
    assert segment.drives.count_periods_per_target(0) == 4
    segment.receive_frame(CanFrame(0, b"\x81\1"))  # a reset of the node
    assert segment.drives.count_periods_per_target(0) == 1


@pytest.mark.parametrize("seconds", [-1.0, 4300.0, float("nan")])
def test_a_period_of_sync_that_0x1006_does_not_hold_is_refused(seconds: float) -> None:
    with pytest.raises(Refusal, match=r"canopen: sync period must be 0 to 4294\.97"):
        CanSegment(Drives(Plant(PLAIN), SERVO, CANOPEN), 1, sync_period=seconds)


def test_a_first_period_of_sync_that_is_rounded_is_noted() -> None:
    segment = CanSegment(Drives(Plant(PLAIN), SERVO, CANOPEN), 1, sync_period=0.0025)
    segment.boot_nodes()
    segment.receive_frame(SYNC)
    rule = "0x1006 is 2.5 servo periods: SYNC stands for 3"
    assert segment.notices == [f"node {number}: {rule}" for number in (1, 2, 3)]
    assert segment.tick == 3

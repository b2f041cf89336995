"""The interpolation time 0x60C2, the modes that are supported, and what targets make of them."""

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from canopen_master import SYNC, put, segment_of, uploaded
from canopen_master import enable as enable_nodes
from cia402 import (
    ACTUAL,
    CSP,
    PLAIN,
    SERVO,
    STATUS,
    TARGET,
    enable,
    make,
)
from ethercat_master import OP, PERIOD, PREOP, SAFEOP, Master, master

from arm_emulator import Plant, load_scene
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN, ETHERCAT
from arm_emulator_fieldbus.object_dictionary import Aborted

__all__ = ["master"]  # a fixture


def interpolation(read: Callable[..., int]) -> float:
    """The interpolation time: 0x60C2:1 times ten to the power 0x60C2:2 [s] (Nanotec PD4-E)."""
    return float(read(0x60C2, 1) * 10.0 ** read(0x60C2, 2))


@pytest.mark.parametrize("us", [125, 250, 500, 1000, 2000])
def test_the_interpolation_time_begins_as_the_servo_period(us: int) -> None:
    period = 1e-6 * us
    scene = load_scene(
        "three_axis",
        overrides={"servo_period": period, "integrator": {"scheme": "rosenbrock", "dt": period}},
    )
    drives = Drives(Plant(scene), replace(SERVO, period=period, motion_period=0.0), ETHERCAT)
    time = interpolation(lambda index, sub: drives.read(0, index, sub))
    assert time == pytest.approx(period, rel=1e-12)
    assert drives.count_periods_per_target(0) == 1


@pytest.mark.parametrize("us", [62.5, 4000, 20000, 255000, 300000, 1_234_567])
def test_the_interpolation_time_follows_the_cycle_of_the_bus_until_a_master_writes_it(
    us: float,
) -> None:
    """A time that no value of 8 bits expresses is as near as one gets: within 1 in 2 * 25."""
    drives = make()
    drives.set_cycle(0, round(1e3 * us))
    time = interpolation(lambda index, sub: drives.read(0, index, sub))
    exact = us not in {62.5, 1_234_567}
    assert time == pytest.approx(1e-6 * us, rel=1e-12 if exact else 0.02)
    drives.write(0, 0x60C2, 7, 1)
    drives.write(0, 0x60C2, -3, 2)
    drives.set_cycle(0, 4_000_000)
    assert drives.count_periods_per_target(0) == 7, "the master's choice stays"
    drives.restart_drive(0)
    assert drives.count_periods_per_target(0) == 4, "until the drive starts again"


CYCLE = 4  # servo periods of SYNC0


@pytest.mark.parametrize("late", [False, True])
def test_the_interpolation_time_follows_sync0(master: Master, late: bool) -> None:
    """0x1C32:1 is 2 with SYNC0, 0x1C32:2 the time in register 0x09A0 (ETG.1020).

    Beckhoff, object 1C32 (2: DC mode, synchronous with SYNC0); the crate etherage,
    synchronization.md (cycle_time). `late`: SYNC0 is set in OP.
    """

    def set_sync0() -> None:
        for k in range(master.slaves):
            master.write(k, 0x09A0, struct.pack("<I", CYCLE * PERIOD))
            master.write(k, 0x0980, b"\0\3")

    if late:
        master.bring_up()
        assert master.number(0, 0x1C32, 1) == 1 and master.number(0, 0x1C33, 1) == 0x22
        set_sync0()
    else:
        for k in range(master.slaves):
            master.preop(k)
        set_sync0()
        master.out, master.into = master.sizes(0)
        for k in range(master.slaves):
            assert master.safeop(k, 0x10000 + k * (master.out + master.into)) == (SAFEOP, 0)
            assert master.ask(k, OP) == (OP, 0)
    for index in (0x1C32, 0x1C33):
        assert master.number(0, index, 1) == 2
        assert master.number(0, index, 2) == master.number(0, index, 10) == CYCLE * PERIOD
    drives = master.segment.drives
    assert interpolation(lambda index, sub: drives.read(0, index, sub)) == pytest.approx(
        1e-9 * CYCLE * PERIOD, rel=1e-12
    )
    for k in range(master.slaves):
        master.ask(k, PREOP)
        master.write(k, 0x0980, b"\0\0")
        master.safeop(k, 0x10000 + k * (master.out + master.into))
    assert [master.number(0, index, 1) for index in (0x1C32, 0x1C33)] == [1, 0x22]
    assert drives.count_periods_per_target(0) == 1, "without SYNC0 as before"


def test_the_speed_of_cyclic_positions_is_even_at_a_slow_sync0(master: Master) -> None:
    """Targets of a constant speed every 8 ms: 0x606C is that speed, in every servo period.

    A target reached in one period of 8 would be 8 times too fast in it. The remaining ripple comes
    from the observer of whole counts: 0.02, measured on the same motion with a target per period.
    """
    cycle, speed = 8, 16  # servo periods, counts per period
    for k in range(master.slaves):
        master.preop(k)
        master.write(k, 0x09A0, struct.pack("<I", cycle * PERIOD))
        master.write(k, 0x0980, b"\0\3")
    master.out, master.into = master.sizes(0)
    for k in range(master.slaves):
        master.safeop(k, 0x10000 + k * (master.out + master.into))
        master.ask(k, OP)
    drives = master.segment.drives
    targets = [drives.read(k, ACTUAL) for k in range(master.slaves)]
    worst = 0.0
    for n in range(300):
        word = (6, 7, 15)[min(n, 2)]
        if n > 5:
            targets[0] += speed * cycle
        data = [struct.pack("<HiihbB", word, target, 0, 0, CSP, 0) for target in targets]
        master.exchange([row[: master.out] for row in data])
        if n > 150:
            demand = drives.read(0, 0x606B)
            assert demand == pytest.approx(1000 * speed, rel=1e-6), "demand, of the line"
            worst = max(worst, abs(drives.read(0, 0x606C) / (1000 * speed) - 1.0))
    assert worst < 0.02


def cyclic_position(master: Master, words: Sequence[int], targets: Sequence[int]) -> None:
    """One exchange of the first mapping: a controlword and a target for each slave."""
    pairs = zip(words, targets, strict=True)
    master.exchange(
        [struct.pack("<HiihbB", word, position, 0, 0, CSP, 0) for word, position in pairs]
    )


@pytest.mark.parametrize("others_stand", [True, False])
def test_a_master_that_sets_the_interpolation_time_alone_gets_lines(
    master: Master, others_stand: bool
) -> None:
    """Data in every period, a new target every 8 periods, 0x60C2 of 8 ms, no SYNC0 and no 0x1C32.

    A target is reached when the interpolation time has passed (Nanotec PD4-E, 0x60C2): the demand
    moves by the same counts in each period, and its speed is even. `others_stand`: slaves
    beside the first keep their targets.
    """
    periods, step = 8, 64
    for k in range(master.slaves):
        assert master.preop(k) == (PREOP, 0)
        master.download(k, 0x60C2, 1, bytes([periods]))
        master.download(k, 0x60C2, 2, struct.pack("<b", -3))
    master.out, master.into = master.sizes(0)
    for k in range(master.slaves):
        assert master.safeop(k, 0x10000 + k * (master.out + master.into)) == (SAFEOP, 0)
        assert master.ask(k, OP) == (OP, 0)
    drives = master.segment.drives
    assert [drives.count_periods_per_target(k) for k in range(master.slaves)] == [
        periods
    ] * master.slaves
    targets = start = [drives.read(k, ACTUAL) for k in range(master.slaves)]
    for word in (6, 7, 15, 15):
        cyclic_position(master, [word] * master.slaves, targets)
    moving = range(1 if others_stand else master.slaves)
    for n in range(25 * periods):
        steps = step * (n // periods + 1)
        targets = [at + steps if k in moving else at for k, at in enumerate(start)]
        cyclic_position(master, [15] * master.slaves, targets)
        for k, at in enumerate(start):
            line = step * (n + 1) / periods if k in moving else 0
            assert drives.read(k, 0x6062) - at == line, f"drive {k}, period {n}"
        if n > 100:
            assert drives.read(0, 0x606B) == pytest.approx(1000 * step / periods, rel=1e-6)


def test_a_target_that_rpdos_repeat_is_reached_in_the_interpolation_time() -> None:
    """CANopen: SYNC and RPDOs every period, 0x60C2 of 5 ms, each target sent five times."""
    segment = segment_of(PLAIN)
    put(segment, 1, 0x60C2, 1, 5, 1)
    put(segment, 1, 0x60C2, 2, 256 - 3, 1)
    enable_nodes(segment, CSP)
    start, demands = struct.unpack("<i", uploaded(segment, 1, ACTUAL, 0))[0], []
    for n in range(50):
        target = start + 100 * (n // 5 + 1)
        segment.receive_frame(CanFrame(0x301, struct.pack("<Hi", 15, target)))
        segment.receive_frame(SYNC)
        demands.append(segment.drives.read(0, 0x6062) - start)
    assert demands == [20 * (n + 1) for n in range(50)]


def test_a_target_that_changes_in_motion_begins_a_new_line() -> None:
    drives = make()
    drives.write(0, 0x60C2, 8, 1)
    enable(drives, CSP)
    start = drives.read(0, ACTUAL)
    for k, goal in enumerate([160] * 4 + [240] * 12):
        drives.write(0, TARGET, start + goal)
        drives.period()
        line = 20 * (k + 1) if k < 12 else 240
        assert drives.read(0, 0x6062) - start == line, "160 / 8 as well as (240 - 80) / 8"


@pytest.mark.parametrize("bus", [ETHERCAT, CANOPEN])
def test_a_mode_that_is_not_supported_is_refused_and_never_displayed(bus: int) -> None:
    """0x6502 has a bit for each mode 1 to 32; drives lack 7, interpolated position.

    Nanotec PD4-E: 0x6502, bit 6 is interpolated position; 0x6061 shows the mode that is active.
    """
    drives = make(bus=bus)
    supported = drives.read(0, 0x6502)
    assert not supported >> 6 & 1
    enable(drives, CSP)
    for mode in range(-128, 128):
        if mode == 0 or (mode > 0 and supported >> (mode - 1) & 1):
            continue
        with pytest.raises(Aborted, match="060900"):
            drives.write(0, 0x6060, mode)
        drives.period()
        assert drives.read(0, 0x6061) == drives.read(0, 0x6060) == CSP


def test_process_data_with_a_mode_that_is_not_supported_change_nothing(master: Master) -> None:
    master.bring_up()
    drives = master.segment.drives
    targets = [drives.read(k, ACTUAL) for k in range(master.slaves)]
    for word in (6, 7, 15, 15):
        cyclic_position(master, [word] * master.slaves, targets)
    master.exchange([struct.pack("<HiihbB", 15, target, 0, 0, 7, 0) for target in targets])
    cyclic_position(master, [15] * master.slaves, targets)
    for k in range(master.slaves):
        assert drives.read(k, 0x6061) == CSP and drives.read(k, STATUS) & 0x6F == 0x27

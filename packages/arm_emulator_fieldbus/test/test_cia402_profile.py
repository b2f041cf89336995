"""Drives against the text of CiA 402 and CiA 301, a claim per test.

The profiles are quoted by makers' manuals; each test names the manual whose wording it follows.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest
from canopen_master import SYNC, put, segment_of, sent, uploaded
from canopen_master import enable as enable_nodes
from cia402 import (
    ACTUAL,
    BIT12,
    BIT13,
    CONTROL,
    CSP,
    CSV,
    ENABLE,
    ERROR,
    HALT,
    HM,
    PLAIN,
    PP,
    REACHED,
    RICH,
    SERVO,
    STATUS,
    TARGET,
    TQ,
    command,
    enable,
    make,
    set_point,
    state,
    until,
)
from ethercat_master import OP, PERIOD, PREOP, SAFEOP, Master, master

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator_fieldbus.canopen_node import Frame
from arm_emulator_fieldbus.canopen_segment import Segment as CanSegment
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN, ETHERCAT
from arm_emulator_fieldbus.object_dictionary import Aborted

__all__ = ["master"]  # a fixture

LARGEST = 2**31 - 1

# ---------------------------------------------------------------------------------------- homing


@pytest.mark.parametrize("choice", ["home_to_zero", "zero_to_home"])
def test_the_zero_position_is_the_home_position_plus_the_home_offset(choice: str) -> None:
    """0x607C is added to the home position to get the zero position, or the reverse by choice.

    Elmo, CANopen DSP 402 Implementation Guide, 9.2; Parker TPDM, 12.1.7.1.
    """
    drives = make(load_scene("three_axis", overrides={"home_offset": choice}))
    drives.write(0, 0x6098, 35)
    drives.write(0, 0x607C, 1000)
    enable(drives, HM)
    home = drives.read(0, 0x6063)
    command(drives, ENABLE | 0x10, 2)
    zero = drives.read(0, 0x6063) - drives.read(0, ACTUAL)
    assert zero - home == (1000 if choice == "home_to_zero" else -1000)
    assert PLAIN.home_offset == "home_to_zero", "the profile's text is the default"


def test_another_meaning_of_the_home_offset_is_refused() -> None:
    with pytest.raises(Refusal, match=r"home_offset must be one of .* valid: home_to_zero, zero_"):
        load_scene("three_axis", overrides={"home_offset": "plus"})


def test_homing_method_0_is_accepted_and_a_start_with_it_fails() -> None:
    """0x6098 = 0: no homing method is assigned. Nothing moves, and bit 13 reports the start."""
    drives = make()
    drives.write(0, 0x6098, 0)
    enable(drives, HM)
    before = drives.read(0, ACTUAL)
    command(drives, ENABLE | 0x10, 20)
    assert drives.read(0, STATUS) & (BIT12 | BIT13) == BIT13
    assert abs(drives.read(0, ACTUAL) - before) <= 1
    assert 0 not in [drives.read(0, 0x60E3, k + 1) for k in range(drives.read(0, 0x60E3))]


# --------------------------------------------------------------------------------- interpolation


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
    assert drives.periods_per_target(0) == 1


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
    assert drives.periods_per_target(0) == 7, "the master's choice stays"
    drives.restart(0)
    assert drives.periods_per_target(0) == 4, "until the drive starts again"


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
    assert drives.periods_per_target(0) == 1, "without SYNC0 as before"


def test_the_speed_of_cyclic_positions_is_even_at_a_slow_sync0(master: Master) -> None:
    """Targets of a constant speed every 8 ms: 0x606C is that speed, in every servo period.

    A target reached in one period of 8 would be 8 times too fast in it. What remains is what the
    observer makes of whole counts: 0.02, measured on the same motion with a target per period.
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
        master.exchange([one[: master.out] for one in data])
        if n > 150:
            demand = drives.read(0, 0x606B)
            assert demand == pytest.approx(1000 * speed, rel=1e-6), "demand, of the line"
            worst = max(worst, abs(drives.read(0, 0x606C) / (1000 * speed) - 1.0))
    assert worst < 0.02


def cyclic_position(master: Master, words: Sequence[int], targets: Sequence[int]) -> None:
    """One exchange of the first mapping: a controlword and a target for each slave."""
    pairs = zip(words, targets, strict=True)
    master.exchange([struct.pack("<HiihbB", word, one, 0, 0, CSP, 0) for word, one in pairs])


@pytest.mark.parametrize("held", [True, False])
def test_a_master_that_sets_the_interpolation_time_alone_gets_lines(
    master: Master, held: bool
) -> None:
    """Data in every period, a new target every 8 periods, 0x60C2 of 8 ms, no SYNC0 and no 0x1C32.

    A target is reached when the interpolation time has passed (Nanotec PD4-E, 0x60C2): the demand
    moves by the same counts in each period, and its speed is even. `held`: slaves beside the first
    keep their targets.
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
    assert [drives.periods_per_target(k) for k in range(master.slaves)] == [periods] * master.slaves
    targets = start = [drives.read(k, ACTUAL) for k in range(master.slaves)]
    for word in (6, 7, 15, 15):
        cyclic_position(master, [word] * master.slaves, targets)
    moving = range(1 if held else master.slaves)
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
        segment.receive(Frame(0x301, struct.pack("<Hi", 15, target)))
        segment.receive(SYNC)
        demands.append(segment.drives.read(0, 0x6062) - start)
    assert demands == [20 * (n + 1) for n in range(50)]


def test_a_target_that_changes_on_the_way_begins_a_new_line() -> None:
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
def test_a_mode_that_is_not_supported_is_refused_and_never_shown(bus: int) -> None:
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


# ---------------------------------------------------------------------------------- bit 10, stops


@pytest.mark.parametrize("option", [1, 2, 3, 5, 6, 7, 8])
@pytest.mark.parametrize("mode", [CSV, HM, TQ])
def test_a_quick_stop_sets_target_reached_when_the_drive_has_halted(mode: int, option: int) -> None:
    """With 0x605A = 5 to 8, bit 10 is set when the quick stop is finished and the drive halted.

    Parker, TWIN-N/SPD-N user's manual, bit 10 of the statusword.
    """
    drives = make(RICH)
    drives.write(0, 0x605A, option)
    drives.write(0, 0x6098, -3)
    drives.write(0, 0x6099, 20000, 1)
    enable(drives, mode)
    drives.write(0, 0x60FF, 20000)
    drives.write(0, 0x6071, 100)
    drives.write(0, CONTROL, ENABLE | 0x10)
    until(drives, lambda: drives.read(0, 0x606C) > 12000)
    drives.write(0, CONTROL, 0x02)
    drives.period()
    assert state(drives) == "quick stop"
    threshold = drives.read(0, 0x606F) * drives.read(0, 0x2007)
    reached, before = False, drives.read(0, 0x606C)
    for _ in range(3000):
        if state(drives) != "quick stop":
            break
        if drives.read(0, STATUS) & REACHED and not reached:
            reached = True  # at the speed that the period began with; the link may swing on
            assert abs(before) <= threshold
        before = drives.read(0, 0x606C)
        drives.period()
    if option >= 5:
        assert state(drives) == "quick stop" and drives.read(0, STATUS) & REACHED
    else:
        assert state(drives) == "switch on disabled" and not reached


def test_halt_in_profile_torque_sets_target_reached_once_the_axis_stands() -> None:
    """With halt, bit 10 is 0 while the axis decelerates, and 1 when its velocity is 0.

    Danfoss, VLT servo drive programming guide, table 7.27; Festo CMMP-AS, controlword, bit 8:
    the torque is lowered to zero with the torque slope.
    """
    drives = make()
    enable(drives, TQ)
    drives.write(0, 0x6071, 300)
    until(drives, lambda: drives.read(0, 0x606C) > 30000)
    assert drives.read(0, STATUS) & REACHED, "the torque is reached"
    command(drives, ENABLE | HALT)
    threshold = drives.read(0, 0x606F) * drives.read(0, 0x2007)
    assert not drives.read(0, STATUS) & REACHED, "it decelerates"
    for _ in range(20000):
        stands = abs(drives.read(0, 0x606C)) <= threshold  # as the next period begins
        drives.period()
        assert bool(drives.read(0, STATUS) & REACHED) == (stands and not drives.read(0, 0x6074))
        if drives.read(0, STATUS) & REACHED:
            break
    assert drives.read(0, STATUS) & REACHED, "it has come to rest"
    command(drives, ENABLE, 100)
    assert drives.read(0, 0x6074) == 300, "the motion goes on without halt"


# ------------------------------------------------------------------------------- profile position


@pytest.mark.parametrize("relative", [False, True])
def test_change_immediately_takes_a_set_point_while_the_buffer_is_full(relative: bool) -> None:
    """Bit 5: the next positioning starts immediately; else after the present one is completed.

    Applied Motion ST10, appendix K. The set-point that waits is overwritten; a relative one counts
    from the target in progress.
    """
    drives = make()
    enable(drives, PP)
    start = drives.read(0, ACTUAL)
    set_point(drives, start + 60000)
    set_point(drives, start - 60000)
    drives.write(0, CONTROL, ENABLE)
    drives.period()
    assert drives.read(0, STATUS) & BIT12, "the buffer is full"
    drives.write(0, TARGET, start)
    command(drives, ENABLE | 0x10, 2)
    command(drives, ENABLE, 2)
    assert drives.read(0, 0x606B) > 0, "a further one that waits is not taken"
    drives.write(0, TARGET, -30000 if relative else start + 30000)
    command(drives, ENABLE | 0x30 | (0x40 if relative else 0), 1)
    assert drives.read(0, STATUS) & BIT12, "acknowledged"
    command(drives, ENABLE, 1)
    assert not drives.read(0, STATUS) & BIT12, "the buffer is free"
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED), 30000)
    drives.period(2000)
    assert drives.read(0, 0x6062) == start + 30000, "it ends at the newest, and nowhere else"


# ----------------------------------------------------------------------------------------- limits


@pytest.mark.parametrize("mode", [CSP, CSV, PP])
def test_an_endless_joint_turns_beyond_31_bits(mode: int) -> None:
    """The position wraps at the ends of 0x607B, where 0x607D limits nothing."""
    drives = make()
    assert [drives.read(0, 0x607D, k) for k in (1, 2)] == [-LARGEST - 1, LARGEST]
    drives.write(0, 0x607C, 200 - LARGEST)
    enable(drives, HM)
    command(drives, ENABLE | 0x10, 3)
    assert drives.read(0, ACTUAL) == LARGEST - 200
    enable(drives, mode)
    if mode == CSP:
        for k in range(300):
            drives.write(0, TARGET, ((LARGEST - 200 + 3 * k) + 2**31) % 2**32 - 2**31)
            drives.period()
    elif mode == CSV:
        drives.write(0, 0x60FF, 9000)
    else:
        drives.write(0, TARGET, 2000)
        command(drives, ENABLE | 0x70)
    until(drives, lambda: drives.read(0, ACTUAL) < 0, 3000)
    drives.period(100)
    assert -(2**31) <= drives.read(0, ACTUAL) < -(2**31) + 5000
    assert drives.read(0, ERROR) == 0


def test_a_limit_at_one_side_alone_still_holds() -> None:
    drives = make()
    enable(drives, CSP)
    drives.write(0, 0x607D, 500, 2)
    at = drives.read(0, ACTUAL)
    for k in range(1000):
        drives.write(0, TARGET, at + k)
        drives.period()
    assert drives.read(0, 0x6062) == 500


@pytest.mark.parametrize("bits", [10, 14, 17, 20, 23, 24])
def test_windows_and_decelerations_scale_with_the_encoder(bits: int) -> None:
    """Angles at the motor are those of 10 bits, and the motor stops in the same time.

    0x606D and 0x606F have 16 bits by the profile; 0x2007 and 0x2008 are the units that keep them,
    and accelerations of 32 bits, from saturating. They are 1 for encoders up to 16 bits.
    """
    coarse, fine = encoder(10), encoder(bits)
    factor = 2.0 ** (bits - 10)
    units = {0x6067: 1, 0x606D: 0x2007, 0x606F: 0x2007}
    units |= dict.fromkeys((0x6083, 0x6084, 0x6085, 0x609A), 0x2008)
    for index, unit in units.items():
        was, now = (
            one.read(0, index) * (1 if unit == 1 else one.read(0, unit)) for one in (coarse, fine)
        )
        # Rounded to whole counts, of 10 for the position window.
        tolerance = 0.03 if index == 0x6067 else 1e-3
        assert now == pytest.approx(was * factor, rel=tolerance), hex(index)
    if bits <= 14:
        assert fine.read(0, 0x2007) == fine.read(0, 0x2008) == 1
    times = []
    for drives, scale in ((coarse, 1.0), (fine, factor)):
        enable(drives, CSV)
        drives.write(0, 0x60FF, round(30000 * scale))
        drives.period(1000)
        drives.write(0, 0x605A, 6)
        drives.write(0, CONTROL, 0x02)
        times.append(until(drives, lambda d=drives: bool(d.read(0, STATUS) & REACHED)))
    # The speeds are observed through counts: the coarse encoder decides some periods later.
    assert times[1] == pytest.approx(times[0], abs=15)


def encoder(bits: int) -> Drives:
    counts = 2**bits
    scene = load_scene("three_axis", overrides={"joints.*.encoder.counts_per_turn": counts})
    joints = tuple(replace(joint, counts_per_turn=counts) for joint in SERVO.joints)
    return Drives(Plant(scene), replace(SERVO, joints=joints), ETHERCAT)


# ------------------------------------------------------------------------------------ touch probes


@pytest.mark.parametrize("probe", [0, 1])
def test_a_touch_probe_that_would_never_trigger_is_refused(probe: int) -> None:
    """0x60B8 bits 2 and 3: 0 is the probe's input, 1 the zero impulse, 2 the source 0x60D0.

    Beckhoff TF5500, ETouchProbeTriggerSource. Drives have no input, an index pulse one edge.
    """
    drives, without = make(RICH), make()
    for function in (0x11, 0x13, 0x19, 0x1D, 0x25, 0x35):
        with pytest.raises(Aborted, match="06090030"):
            drives.write(0, 0x60B8, function << 8 * probe)
    for function in (0x15, 0x17, 0x05, 0x00, 0x10, 0x38):  # bit 0 enables the probe
        drives.write(0, 0x60B8, function << 8 * probe)
    without.write(0, 0x60B8, 0x3838)
    with pytest.raises(Aborted, match="06090030"):
        without.write(0, 0x60B8, 0x15 << 8 * probe)


# ------------------------------------------------------------------------- properties of the drive

MOTORS: dict[str, tuple[dict[str, Any], int]] = {
    "dc": ({}, 13),
    "pmsm": (
        {
            "kind": "pmsm",
            "resistance": 1.0,
            "inductance_d": 1e-3,
            "inductance_q": 1e-3,
            "flux": 0.0125,
            "pole_pairs": 4,
            "rotor_inertia": 1e-4,
        },
        10,
    ),
    "torque": ({"kind": "torque", "torque_limit": 1.0, "rotor_inertia": 1e-4}, 0),
}


def test_the_motor_type_is_that_of_the_motor() -> None:
    """0x6402: 13 commutator and permanent magnets, 10 sinusoidal brushless, 0 non-standard.

    Table of 0x6402 at techoverflow.net, "CiA 402: How to write the motor type".
    """
    from arm_emulator.machine.parts.known import MOTORS as ALL

    known = {kind.kind: kind.cia_type for kind in ALL}
    assert known == {"dc": 13, "pmsm": 10, "stepper": 9, "torque": 0, "current": 0}
    drives = make(load_scene("three_axis", {"joints.elbow.motor": MOTORS["pmsm"][0]}))
    assert [drives.read(j, 0x6402) for j in range(3)] == [13, 13, 10]


@pytest.mark.parametrize(
    ("index", "sub"),
    [
        *((index, sub) for index in (0x607B, 0x608F, 0x6091, 0x6092) for sub in (1, 2)),
        *((index, 0) for index in (0x6075, 0x6076, 0x6402)),
    ],
)
def test_properties_of_the_machine_may_be_written_as_they_are(index: int, sub: int) -> None:
    """The profile has these as rw; start-up lists of masters write them."""
    drives = make()
    value = drives.upload(0, index, sub)
    drives.download(0, index, sub, value)
    other = bytes([value[0] ^ 1]) + value[1:]
    with pytest.raises(Aborted, match="06090030"):
        drives.download(0, index, sub, other)
    assert drives.upload(0, index, sub) == value


# ------------------------------------------------------------------- CANopen: time and monitoring


def can_segment(*, lockstep: bool) -> CanSegment:
    segment = CanSegment(Drives(Plant(PLAIN), SERVO, CANOPEN), 1, lockstep=lockstep)
    segment.boot()
    return segment


EVERYTHING = ("SYNC", "RPDO", "guarding")


def turning(segment: CanSegment) -> None:
    """Node 1 in cyclic velocity, with SYNC, RPDO 3 and guarding in each servo period."""
    segment.receive(Frame(0, b"\1\0"))
    for k in range(330):
        word = (6, 7, 15)[min(k // 10, 2)]
        segment.receive(Frame(0x201, struct.pack("<Hb", word, CSV)))
        cycle(segment, EVERYTHING, word)
    assert uploaded(segment, 1, STATUS, 0)[0] & 0x6F == 0x27
    assert speed(segment) > 5000


def cycle(segment: CanSegment, what: Sequence[str], word: int = 15) -> list[Frame]:
    """A servo period with some of the messages; guarding is answered and left out."""
    frames: list[Frame] = []
    if "RPDO" in what:
        frames += segment.receive(Frame(0x401, struct.pack("<Hi", word, 9000)))
    if "SYNC" in what:
        frames += segment.receive(SYNC)
    if "guarding" in what:
        segment.receive(Frame(0x701, remote=True))
    return frames + segment.pass_period()


LOSSES = {
    "SYNC": (0x1006, 0, 4000, 4, 0x8700, 6),  # once and a half
    "RPDO": (0x1402, 5, 20, 2, 0x8250, 20),
    "guarding": (0x100C, 0, 10, 2, 0x8130, 30),  # three times
}


@pytest.mark.parametrize("what", LOSSES)
def test_a_motor_stops_when_sync_or_targets_or_guarding_cease(what: str) -> None:
    """Monitored are 0x1006, 0x1400:5 of RPDOs, and 0x100C times 0x100D (CiA 301); 0: not.

    The drive reacts as 0x6007 selects: here by a fault, with the code that EMCY reports.
    """
    index, sub, value, size, code, after = LOSSES[what]
    others = [one for one in EVERYTHING if one != what]
    for monitored in (False, True):
        segment = can_segment(lockstep=False)
        if monitored:
            put(segment, 1, index, sub, value, size)
            put(segment, 1, 0x100D, 0, 3, 1)
        turning(segment)
        # The last messages came before the last period; the time ends at a period's end.
        frames = [one for _ in range(after - 1) for one in cycle(segment, others)]
        assert not sent(frames, 0x81), "not before the time"
        frames = [one for _ in range(2) for one in cycle(segment, others)]
        emergencies = [struct.unpack_from("<H", data)[0] for data in sent(frames, 0x81)]
        assert emergencies == ([code] if monitored else [])
        for _ in range(2000):
            cycle(segment, others, 0)
        if not monitored:
            continue
        assert uploaded(segment, 1, STATUS, 0)[0] & 0x4F == 0x08, "fault"
        assert uploaded(segment, 1, 0x603F, 0) == struct.pack("<H", code)
        assert abs(speed(segment)) < 500
        segment.receive(Frame(0, b"\1\0"))  # operational, where it left that
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
        segment.receive(Frame(0, b"\1\0"))
        for periods in (0, 1, 2, 3, 9):
            segment.receive(SYNC)
            for _ in range(periods):
                segment.pass_period()
            target = struct.pack("<i", 1000 + periods)
            segment.receive(Frame(0x301, struct.pack("<H", 0) + target))
            segment.receive(SYNC)
            taken = uploaded(segment, 1, TARGET, 0) == target
            assert taken == (lockstep or periods <= 2), f"{periods} ms after SYNC"


def test_a_sync_stands_for_its_period_and_not_for_the_interpolation_time() -> None:
    """The times of a configuration of ros2_canopen: SYNC every 10 ms, 0x60C2 of 50 ms.

    A target is reached 50 ms after its SYNC, 5 SYNCs later; a SYNC lets 10 ms pass.
    """
    for given in ("0x1006", "option"):
        period = 0.01 if given == "option" else 0.0
        drives = Drives(Plant(PLAIN), SERVO, CANOPEN)
        segment = CanSegment(drives, 1, sync_period=period)
        segment.boot()
        put(segment, 1, 0x60C2, 1, 50, 1)
        put(segment, 1, 0x60C2, 2, 256 - 3, 1)
        if given == "0x1006":
            for node in (1, 2, 3):
                put(segment, node, 0x1006, 0, 10000, 4)
        enable_nodes(segment, CSP)
        before = segment.tick
        start = struct.unpack("<i", uploaded(segment, 1, ACTUAL, 0))[0]
        segment.receive(Frame(0x301, struct.pack("<Hi", 15, start + 500)))
        demands = []
        for _ in range(6):
            segment.receive(SYNC)
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
    segment.receive(SYNC)
    assert segment.tick == before + 1


def test_the_interpolation_time_of_a_node_follows_the_period_of_sync() -> None:
    segment = segment_of(PLAIN)
    put(segment, 1, 0x1006, 0, 4000, 4)
    assert segment.drives.periods_per_target(0) == 4
    segment.receive(Frame(0, b"\x81\1"))  # a reset of the node
    assert segment.drives.periods_per_target(0) == 1


@pytest.mark.parametrize("seconds", [-1.0, 4300.0, float("nan")])
def test_a_period_of_sync_that_0x1006_does_not_hold_is_refused(seconds: float) -> None:
    with pytest.raises(Refusal, match=r"canopen: sync period must be 0 to 4294\.97"):
        CanSegment(Drives(Plant(PLAIN), SERVO, CANOPEN), 1, sync_period=seconds)


def test_a_first_period_of_sync_that_is_rounded_is_noted() -> None:
    segment = CanSegment(Drives(Plant(PLAIN), SERVO, CANOPEN), 1, sync_period=0.0025)
    segment.boot()
    segment.receive(SYNC)
    rule = "0x1006 is 2.5 servo periods: SYNC stands for 3"
    assert segment.notices == [f"node {number}: {rule}" for number in (1, 2, 3)]
    assert segment.tick == 3


def test_scenes_keep_the_choice_of_the_home_offset() -> None:
    scene: Scene = load_scene("three_axis", overrides={"home_offset": "zero_to_home"})
    assert scene != PLAIN and scene.home_offset == "zero_to_home"

"""Modes of drives behind field buses: cyclic, profile, halt, changes of the mode."""

import math
import random

import numpy as np
import pytest
from cia402 import (
    ACTUAL,
    BIT12,
    CONTROL,
    CSP,
    CST,
    CSV,
    ENABLE,
    ERROR,
    HALT,
    HM,
    MODE,
    MODE_DISPLAY,
    PP,
    PV,
    REACHED,
    ROOT,
    STATUS,
    TARGET,
    TQ,
    N,
    T,
    command,
    enable,
    make,
    set_point,
    state,
    truth,
    until,
)

from arm_emulator import Plant, Servo, load_scene, load_servo_config
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT


@pytest.mark.parametrize("feedforward", [0, 1000])
@pytest.mark.parametrize("name", ["three_axis", "ur5"])
def test_cyclic_position_is_our_own_servo_to_the_last_bit(name: str, feedforward: int) -> None:
    """The same targets to the servo, in counts as their middles, give the same voltages."""
    scene = load_scene(name)
    config = load_servo_config(ROOT / f"config/servo/{name}.yaml")
    plant, servo = Plant(scene), Servo(config)
    drives = Drives(Plant(scene), config, ETHERCAT)
    joints = range(len(scene.joints))
    ratio = np.array([joint.gear_ratio for joint in config.joints])
    counts = np.array([joint.counts_per_turn for joint in config.joints])
    count_angle = 2.0 * math.pi / counts
    for j in joints:
        drives.write(j, 0x2001, feedforward)
    enable(drives, CSP)

    def observe() -> None:
        measured = plant.measured
        servo.observe(measured.encoder_counts, measured.current, plant.measured.applied)

    observe()
    for _ in range(2):  # two words, then Operation enabled
        servo.release()
        plant.exchange(np.zeros(len(joints)))
        observe()
    speed, smoothing = np.zeros(len(joints)), 1e-4 * drives.read(0, 0x2002)
    target = position = start = plant.measured.encoder_counts.astype(float)
    swing = np.round(counts * 0.9 * np.resize([1.0, -1.0, 0.5], len(joints)))
    lag = 0.0
    for k in range(1500 if name == "three_axis" else 500):
        if k:  # the first target is that of `enable`
            target = start + np.round(swing * (1.0 - math.cos(0.003 * k)))
            for j in joints:
                drives.write(j, TARGET, int(target[j]))
            drives.period()
        speed = speed + ((target - position) / T - speed) * (T / (T + smoothing))
        position = target
        q = (position + 0.5) * count_angle * ratio
        v = 1e-3 * feedforward * speed * count_angle * ratio
        plant.exchange(servo.control(q, v))
        assert (drives.plant.measured.applied == plant.measured.applied).all(), (
            f"commands in period {k}"
        )
        observe()
        lag = max(lag, abs(drives.read(0, 0x60F4)))
    assert (truth(drives, "q") == plant.state.q).all(), "link angles"
    # Without feed-forward it lags by speed / Kp: 0.9 turns * 3 rad/s / Kp.
    gain = config.joints[0].position_gain
    expected = 0.0 if feedforward else swing[0] * 3.0 / gain
    assert lag == pytest.approx(expected, abs=0.03 * counts[0]), "following error, with its swing"


def test_targets_that_come_slower_are_joined_by_lines() -> None:
    drives = make()
    drives.write(0, 0x60C2, 8, 1)
    enable(drives, CSP)
    start, rng = drives.read(0, ACTUAL), random.Random(8)
    assert drives.count_periods_per_target(0) == 8, "periods in the interpolation time"
    before = start
    for _ in range(40):
        goal = before + rng.randrange(-200, 200)
        drives.write(0, TARGET, goal)
        for k in range(1, 9):
            drives.period()
            line = before + (goal - before) * k / 8
            assert abs(drives.read(0, 0x6062) - line) <= 0.5 + 1e-9, "demand, a whole number"
        before = goal


def test_cyclic_position_goes_on_beyond_32_bits() -> None:
    """Counts are read modulo 2**32, and targets are taken as those that are next."""
    scene = load_scene("three_axis", overrides={"joints.*.start": 9999.0})
    per_rad = 1024 / (2 * math.pi) / 0.01
    drives = make(scene)
    drives.write(0, 0x607D, 0, 1)
    drives.write(0, 0x607D, 0, 2)
    assert abs(drives.read(0, 0x6063) - 9999.0 * per_rad) <= 1, "counts at the start"
    for j in range(N):  # homing puts the zero so that the positions are about to wrap
        drives.write(j, 0x607D, 0, 1)
        drives.write(j, 0x607D, 0, 2)
        drives.write(j, 0x607C, 50 - 2**31)
    enable(drives, HM)
    command(drives, ENABLE | 0x10, 3)
    assert drives.read(0, ACTUAL) == 2**31 - 50, "the zero is the home plus the home offset"
    enable(drives, CSP)
    for k in range(400):
        at = 2**31 - 50 + k
        drives.write(0, TARGET, at if at < 2**31 else at - 2**32)
        drives.period()
    until(drives, lambda: drives.read(0, ACTUAL) == -(2**31) + 349)
    assert drives.read(0, ERROR) == 0, "no following error on the way"


def test_cyclic_velocity_moves_the_motor_at_the_speed() -> None:
    drives = make()
    enable(drives, CSV)
    per_rad = 1024 / (2 * math.pi)
    for j, speed in enumerate((9000, -6000, 3000)):
        drives.write(j, 0x60FF, speed - 500)
        drives.write(j, 0x60B1, 500)
    drives.period(2000)
    turned = truth(drives, "theta_m")
    drives.period(1000)
    mean = (truth(drives, "theta_m") - turned) * per_rad
    # Over a second the arm's elasticity swings by less than a hundredth of the speed.
    np.testing.assert_allclose(mean, [9000, -6000, 3000], rtol=0.01, err_msg="mean speeds")
    for j, speed in enumerate((9000, -6000, 3000)):
        reported = np.mean([drives.read(j, 0x606C) for _ in range(50) if not drives.period()])
        assert reported == pytest.approx(speed, rel=0.02), "velocity actual value, a mean of 50"
        assert drives.read(j, STATUS) & BIT12, "the drive follows"


def test_cyclic_torque_gives_that_torque() -> None:
    """0.1 % of 1 N m at 0.05 N m/A are 0.02 A; the current is at the reference within a period."""
    drives = make()
    enable(drives, CST)
    rng, off = random.Random(10), []
    for _ in range(60):
        torque = [rng.randrange(-120, 120) for _ in range(N)]
        for j in range(N):
            drives.write(j, 0x6071, torque[j] + 10)
            drives.write(j, 0x60B2, -10)
        drives.period(12)
        at = truth(drives, "current") / 0.02
        # Speeds are observed through a coarse encoder: 1 rad/s of the motor is 0.05 V, 0.05 A.
        np.testing.assert_allclose(at, torque, atol=12.0, err_msg="current in 0.1 %")
        off.append(at - torque)
        reported = [drives.read(j, 0x6077) for j in range(N)]
        np.testing.assert_allclose(reported, at, atol=0.51, err_msg="torque actual value")
    np.testing.assert_allclose(np.mean(off, axis=0), 0.0, atol=1.0, err_msg="mean of what is off")


def duration(distance: float, begin: float, speed: float, up: float, down: float) -> float:
    """Of the shortest motion over a way >= 0 that begins with a speed along it and ends at rest.

    The peak is found by halving: the way that it takes to speed up and to slow down grows with it.
    """

    def covered(peak: float) -> float:
        return (peak * peak - begin * begin) / (2.0 * up) + peak * peak / (2.0 * down)

    low, high = begin, speed
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if covered(middle) < distance else (low, middle)
    return (low - begin) / up + low / down + max(0.0, distance - covered(low)) / low


@pytest.mark.parametrize("seed", range(16))
def test_a_profile_arrives_when_its_trapezoid_states(seed: int) -> None:
    """From rest, and from a random moment of its speeding up: on, back, or by less than it needs
    to stop."""
    rng = np.random.default_rng([seed, 1])
    drives = make()
    drives.write(0, 0x6065, 0xFFFFFFFF)  # the arm may swing
    enable(drives, PP)
    start, sign = drives.read(0, ACTUAL), int(rng.choice([-1, 1]))
    speed, up, down = (
        int(10 ** rng.uniform(3.3, 4.3)),
        *(int(10 ** rng.uniform(4, 5)) for _ in "ud"),
    )
    for index, value in ((0x6081, speed), (0x6083, up), (0x6084, down)):
        drives.write(0, index, value)
    # With and without a part at full speed.
    distance = int(speed * speed * (0.5 / up + 0.5 / down) * rng.choice([0.3, 3.0])) + 100
    if seed % 2:
        set_point(drives, sign * distance, 0x40)  # relative
    else:
        set_point(drives, start + sign * distance)
    spent = 1
    predicted = duration(distance, 0.0, speed, up, down)
    if seed >= 4:
        spent += (some := int(rng.uniform(0.1, 0.9) * predicted * speed / (speed + up) / T))
        drives.period(some)
        x, v = 0.5 * up * (spent * T) ** 2, up * spent * T
        if v > speed or x + v * v / (2.0 * down) > distance:
            pytest.skip("it does not speed up any more")
        stop = v * v / (2.0 * down)
        ahead = stop + distance * rng.choice([0.1, 1.0]), stop - distance, 0.5 * stop
        new = float(round(x + ahead[seed % 3]))
        # A period passes until the bit is low, another until the set-point is taken.
        drives.write(0, CONTROL, ENABLE | 0x20)
        drives.write(0, TARGET, start + sign * int(new))
        drives.period()
        spent += 1
        x, v = 0.5 * up * (spent * T) ** 2, up * spent * T
        stop = v * v / (2.0 * down)
        assert v < speed, "it still speeds up"
        if seed % 3 == 0:
            predicted = spent * T + duration(new - x, v, speed, up, down)
        else:
            back = duration(x + stop - new, 0.0, speed, up, down)
            predicted = spent * T + v / down + back
        drives.write(0, CONTROL, ENABLE | 0x30)
        drives.period()
        spent += 1
        distance = int(new)
    end = start + sign * distance
    periods = spent + until(
        drives, lambda: drives.read(0, 0x6062) == end and drives.read(0, 0x606B) == 0, 60000
    )
    # The first one that is whole, or one before: speeds are asked to half a count/s.
    assert predicted / T - 1 <= periods <= predicted / T + 1, "periods on the way"
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    assert abs(drives.read(0, ACTUAL) - start - sign * distance) <= 10, (
        "position, within its window"
    )


def test_profiles_follow_in_sequence_or_change_at_once() -> None:
    drives = make()
    enable(drives, PP)
    start = drives.read(0, ACTUAL)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    set_point(drives, start + 3000)
    drives.period(50)
    set_point(drives, start + 1000)  # waits for the first
    assert not drives.read(0, STATUS) & REACHED, "target reached, with one more to go"
    highest = 0
    for _ in range(4000):
        drives.period()
        highest = max(highest, drives.read(0, 0x6062))
    assert highest == start + 3000, "the first is reached"
    assert drives.read(0, 0x6062) == start + 1000, "then the second"
    set_point(drives, start + 5000)
    drives.period(50)
    set_point(drives, start - 200, 0x20)
    at = drives.read(0, 0x6062)
    assert at < start + 4000, "it is on its way"
    positions = [drives.read(0, 0x6062) for _ in range(4000) if not drives.period()]
    assert max(positions) < start + 4900, "it turns round before the first is reached"
    assert positions[-1] == start - 200, "and goes to the second"
    # No jump in speed: its differences change by the accelerations at most.
    max_change = max(drives.read(0, 0x6083), drives.read(0, 0x6084)) * T * T
    assert np.abs(np.diff(positions, 2)).max() <= max_change + 2, "change of speed, rounding in it"


def test_halt_interrupts_a_profile_and_lets_it_go_on() -> None:
    drives = make()
    enable(drives, PP)
    start = drives.read(0, ACTUAL)
    set_point(drives, start + 6000)
    drives.period(100)
    drives.write(0, CONTROL, ENABLE | 0x10 | HALT)
    drives.period(2000)
    rest = drives.read(0, 0x6062)
    assert start < rest < start + 5900, "where it halts"
    assert drives.read(0, STATUS) & REACHED, "it stands"
    drives.period(100)
    assert drives.read(0, 0x6062) == rest, "it goes on standing"
    drives.write(0, CONTROL, ENABLE | 0x10)
    drives.period(4000)
    assert drives.read(0, 0x6062) == start + 6000, "it has gone on"


@pytest.mark.parametrize("option", [1, 2, 3])
@pytest.mark.parametrize("mode", [PV, TQ, CSP, CSV, CST])
def test_halt_stops_every_mode_and_lets_it_go_on(mode: int, option: int) -> None:
    drives = make()
    drives.write(0, 0x605D, option)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    enable(drives, mode)
    at = drives.read(0, ACTUAL)

    def go(periods: int) -> None:
        nonlocal at
        for _ in range(periods):
            at += 4
            drives.write(0, TARGET, at)
            drives.period()

    drives.write(0, 0x60FF, 4000)
    drives.write(0, 0x6071, 60)
    go(400)
    assert drives.read(0, 0x606C) > 2000, "speed before [counts/s]"
    drives.write(0, CONTROL, ENABLE | HALT)
    # Profile torque lets the torque go instead: the friction of the arm slows it down.
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    drives.period(500)
    rest = drives.read(0, ACTUAL)
    drives.period(500)
    moved = abs(drives.read(0, ACTUAL) - rest)
    assert moved < 20 or mode == TQ, "counts by which it still moves"
    assert drives.read(0, STATUS) & BIT12 == 0 or mode == PV, "it follows no command, or stands"
    if mode == TQ:
        assert drives.read(0, 0x6074) == 0, "torque demand"
    drives.write(0, CONTROL, ENABLE)
    at = drives.read(0, ACTUAL)
    go(400)
    assert drives.read(0, 0x606C) > 2000, "speed when it goes on [counts/s]"


def test_profile_velocity_and_torque_follow_their_slopes() -> None:
    drives = make()
    drives.write(0, 0x6083, 20000)
    drives.write(0, 0x6084, 40000)
    enable(drives, PV)
    drives.write(0, 0x60FF, 8000)
    up = until(drives, lambda: drives.read(0, 0x606B) == 8000)
    assert up == pytest.approx(8000 / 20000 / T, abs=1), "periods of speeding up"
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    drives.write(0, 0x60FF, -4000)
    down = until(drives, lambda: drives.read(0, 0x606B) == -4000)
    assert down == pytest.approx((8000 / 40000 + 4000 / 20000) / T, abs=1), "periods of turning"
    assert not drives.read(0, STATUS) & BIT12, "it does not stand"
    drives.write(0, CONTROL, ENABLE | HALT)
    until(drives, lambda: drives.read(0, 0x606B) == 0 and bool(drives.read(0, STATUS) & REACHED))
    until(drives, lambda: bool(drives.read(0, STATUS) & BIT12))
    drives.write(0, CONTROL, ENABLE)
    drives.write(0, MODE, TQ)
    drives.write(0, 0x6087, 500)
    drives.write(0, 0x6071, 100)
    begins = drives.read(0, 0x6074)
    drives.period()
    slope = until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    assert drives.read(0, MODE_DISPLAY) == TQ, "mode that is shown"
    assert slope == pytest.approx((100 - begins) / 500 / T, abs=2), "periods to the torque"


@pytest.mark.parametrize("seed", range(4))
def test_modes_change_without_a_jump_of_the_arm(seed: int) -> None:
    """Random modes in motion: the demand begins where the motor is, no fault, no wild current."""
    rng = random.Random(seed)
    drives = make()
    enable(drives, CSV)
    worst = 0.0
    for _ in range(30):
        mode = rng.choice((PP, PV, TQ, CSP, CSV, CST, 0))
        for j in range(N):
            drives.write(j, 0x60FF, rng.randrange(-3000, 3000))
            drives.write(j, 0x6071, rng.randrange(-20, 20))
            drives.write(j, TARGET, drives.read(j, ACTUAL))
            drives.write(j, MODE, mode)
        drives.period(2)
        assert {drives.read(j, MODE_DISPLAY) for j in range(N)} == {mode}, "mode that is shown"
        for _ in range(20):
            for j in range(N):
                drives.write(j, TARGET, drives.read(j, ACTUAL))
            drives.period()
            worst = max(worst, *np.abs(truth(drives, "current")))
        assert {state(drives, j) for j in range(N)} == {"operation enabled"}, "states"
    # A step of 6000 counts/s takes Kv * 37 rad/s = 11 A; a jump of the demand would take all 20 A.
    assert worst < 16.0, "largest current [A]"

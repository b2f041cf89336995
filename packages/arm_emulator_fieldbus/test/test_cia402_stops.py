"""Limits, stops, faults, brakes, homing and touch probes of drives behind field buses."""

import contextlib
import dataclasses
import math
import random

import numpy as np
import pytest
from cia402 import (
    ACTUAL,
    BIT12,
    BIT13,
    CLOSE,
    CONTROL,
    CSP,
    CST,
    CSV,
    ENABLE,
    ERROR,
    HALT,
    HM,
    INTERNAL_LIMIT,
    MODE,
    PLAIN,
    PP,
    PV,
    REACHED,
    RELEASE,
    RESET,
    RICH,
    SHUTDOWN,
    STATUS,
    SWITCH_ON,
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

from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator_fieldbus.object_dictionary import Aborted, list_entries

# -------------------------------------------------------------------------- limits, stops, faults


def test_torque_and_speed_stay_within_their_limits_and_state_so() -> None:
    drives = make()
    enable(drives, CSP)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    drives.write(0, 0x6072, 400)
    drives.write(0, 0x60E0, 300)
    drives.write(0, 0x60E1, 250)
    start, torques, limited = drives.read(0, ACTUAL), [], 0
    for k in range(1000):
        drives.write(0, TARGET, start + (2500 if k // 250 % 2 else -2500))
        drives.period()
        torques.append(truth(drives, "current")[0] / 0.02)
        limited += bool(drives.read(0, STATUS) & INTERNAL_LIMIT)
    # The limit is on what is asked for; speeds are observed through counts, see above.
    assert 250 < max(torques) < 312, "largest torque [0.1 %]"
    assert -262 < min(torques) < -220, "smallest torque [0.1 %]"
    assert limited > 200, "periods with the internal limit bit"
    drives = make()
    enable(drives, CSV)
    drives.write(0, 0x6080, 500)  # rpm
    drives.write(0, 0x60FF, 40000)
    drives.period(1500)
    rpm = truth(drives, "omega_m")[0] * 60 / (2 * math.pi)
    assert rpm == pytest.approx(500, rel=0.02), "speed, as limited"
    assert drives.read(0, STATUS) & INTERNAL_LIMIT, "the internal limit bit"
    drives.write(0, 0x6071, 200)
    drives.write(0, MODE, CST)
    drives.period(1500)
    # The torque goes as the speed comes near, see 0x6080 in docs/reference/drives.md.
    assert truth(drives, "omega_m")[0] * 60 / (2 * math.pi) < 510, "speed under a torque"


@pytest.mark.parametrize("mode", [PP, PV, TQ, CSP, CSV, CST])
def test_no_mode_leaves_the_software_limits(mode: int) -> None:
    drives = make()
    at = drives.read(0, ACTUAL)
    drives.write(0, 0x607D, at - 1500, 1)
    drives.write(0, 0x607D, at + 2000, 2)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    enable(drives, mode)
    for sign, limit in ((1, at + 2000), (-1, at - 1500)):
        drives.write(0, 0x60FF, sign * 12000)
        drives.write(0, 0x6071, sign * 60)
        if mode == PP:
            set_point(drives, sign * 10**6)
        farthest = 0
        for k in range(3000):
            step = min(10**6, 12 * k)
            drives.write(0, TARGET, at + sign * step)
            drives.period()
            farthest = max(farthest, sign * (drives.read(0, ACTUAL) - limit))
        # The arm swings when it is stopped: by 12000 counts/s for 10 ms where it is stopped dead,
        # by a third of that where it has slowed down before.
        max_counts = 130 if mode == CSP else 40
        assert -40 <= farthest <= max_counts, f"how far beyond the limit on side {sign} [counts]"
        if mode not in (PV, TQ, CST):
            assert drives.read(0, STATUS) & INTERNAL_LIMIT or mode == CSV, "internal limit"


def test_a_following_error_is_a_fault_after_its_time() -> None:
    drives = make()
    enable(drives, CSP)
    drives.write(0, 0x6065, 300)
    drives.write(0, 0x6066, 60)
    drives.write(0, 0x6085, 40000)
    target = drives.read(0, ACTUAL) + 40000
    drives.write(0, TARGET, target)
    drives.period()
    assert drives.read(0, STATUS) & BIT13, "following error"
    assert drives.read(0, STATUS) & 0x80, "warning"
    after = until(drives, lambda: state(drives) != "operation enabled")
    assert after == 60, "periods [ms] in which it is beyond its window"
    assert state(drives) == "fault reaction", "it slows down"
    assert drives.read(0, ERROR) == 0x8611, "error code"
    assert drives.read(0, 0x1001) == 0x21, "error register"
    speed = abs(drives.read(0, 0x606C))
    took = until(drives, lambda: state(drives) == "fault")
    assert took == pytest.approx(speed / 40000 / T, rel=0.1), "periods of slowing down"
    assert drives.read(0, 0x1003, 0) == 1, "errors that are kept"
    assert drives.read(0, 0x1003, 1) == 0x8611, "the newest of them"
    assert state(drives, 1) == "operation enabled", "the others go on"
    assert drives.plant.measured.applied[0] == 0.0, "the motor has no voltage"
    drives.write(0, CONTROL, RESET)
    drives.period()
    assert state(drives) == "switch on disabled", "after the reset"
    assert drives.read(0, ERROR) == drives.read(0, 0x1001) == 0, "no error"
    assert drives.read(0, 0x1003, 0) == 1, "the history stays"
    drives.write(0, 0x1003, 0)
    assert drives.read(0, 0x1003, 1) == 0, "until it is taken away"
    drives.write(0, MODE, CSV)  # the target is still far away
    command(drives, SHUTDOWN)
    command(drives, ENABLE, 2)
    assert state(drives) == "operation enabled", "enabled once more"


@pytest.mark.parametrize("option", range(9))
@pytest.mark.parametrize("mode", [PP, CSP, CSV, CST])
def test_a_quick_stop_ends_as_its_option_states(option: int, mode: int) -> None:
    drives = make()
    for j in range(N):
        drives.write(j, 0x605A, option)
    drives.write(0, 0x6084, 20000)
    drives.write(0, 0x6085, 60000)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    enable(drives, mode)
    at = drives.read(0, ACTUAL)
    drives.write(0, 0x60FF, 10000)
    drives.write(0, 0x6071, 50)
    drives.write(0, 0x6081, 10000)
    if mode == PP:
        set_point(drives, at + 50000)
    for k in range(800):
        if mode == CSP:
            drives.write(0, TARGET, at + 10 * k)
        drives.period()
    speed = drives.read(0, 0x606B)
    assert speed > 5000, "speed before [counts/s]"
    drives.write(0, CONTROL, 0x0B)
    drives.period()
    stays = option >= 5
    if option == 0:
        assert state(drives) == "switch on disabled", "no stop at all"
        return
    assert state(drives) == "quick stop", "it slows down"
    if not stays:
        drives.write(0, CONTROL, ENABLE)
        drives.period()
        assert state(drives) == "quick stop", "no way back"
        drives.write(0, CONTROL, 0x0B)
    if mode in (PP, CSP, CSV) and option % 4 in (1, 2):
        ramp = speed / (20000 if option % 4 == 1 else 60000) / T
        took = 2 - stays + until(drives, lambda: drives.read(0, 0x606B) == 0)
        assert took == pytest.approx(ramp, abs=2), "periods of slowing down"
    drives.period(3000)
    assert abs(drives.read(0, 0x606C)) < 300, "it stands, but for the swing of the arm"
    assert state(drives) == ("quick stop" if stays else "switch on disabled"), "where it ends"
    drives.write(0, CONTROL, ENABLE)
    drives.write(0, TARGET, drives.read(0, ACTUAL))
    drives.period()
    assert state(drives) == ("operation enabled" if stays else "switch on disabled"), "T16 or not"


@pytest.mark.parametrize("reaction", range(4))
def test_a_lost_master_leads_where_0x6007_states(reaction: int) -> None:
    drives = make()
    for j in range(N):
        drives.write(j, 0x6007, reaction)
        drives.write(j, 0x60FF, 5000)
    enable(drives, CSV)
    drives.period(500)
    drives.report_loss(error=0x821B)
    drives.period(2000)
    names = ("operation enabled", "fault", "switch on disabled", "switch on disabled")
    assert {state(drives, j) for j in range(N)} == {names[reaction]}, "states"
    assert drives.read(0, ERROR) == (0x821B if reaction == 1 else 0), "error code"
    if reaction:
        command(drives, RESET)
        command(drives, SHUTDOWN)
        assert state(drives) == "ready", "the master is back"


def test_without_power_the_drives_fail_and_wait() -> None:
    drives = make()
    enable(drives, CSP)
    assert drives.read(0, STATUS) & 0x10, "voltage is there"
    drives.plant.powered = False
    drives.period(2)
    assert state(drives) == "fault", "without voltage"
    assert drives.read(0, ERROR) == 0x3220, "undervoltage"
    assert drives.read(0, 0x6079) == 0, "DC link"
    assert not drives.read(0, STATUS) & 0x10, "no voltage"
    command(drives, RESET)
    command(drives, SHUTDOWN)
    command(drives, ENABLE, 5)
    assert state(drives) == "ready", "it waits for voltage"
    drives.plant.powered = True
    drives.period(3)
    assert state(drives) == "operation enabled", "it goes on by itself: the command is still there"


def test_a_machine_that_diverges_is_a_fault_that_stays_until_it_is_reset() -> None:
    drives = make()
    enable(drives, CSV)
    drives.plant.state = dataclasses.replace(drives.plant.state, v=np.full(N, 1e6))
    with pytest.raises(Diverged):
        drives.period(10)
    assert {state(drives, j) for j in range(N)} == {"fault"}, "states"
    assert drives.read(0, ERROR) == 0x6100, "error code"
    for j in range(N):
        drives.write(j, CONTROL, RESET)
    with pytest.raises(Diverged):
        drives.period()
    assert state(drives) == "fault", "the cause is still there"
    drives.plant.reset()
    drives.begin()
    command(drives, SHUTDOWN)
    assert state(drives) == "ready", "after a reset of the machine"


def test_a_hot_motor_is_a_fault_until_it_is_cool() -> None:
    drives = make(RICH)
    enable(drives, CSP)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    drives.write(0, 0x607D, 0, 1)
    drives.write(0, 0x607D, 0, 2)
    drives.write(0, TARGET, 200000)
    until(drives, lambda: state(drives) == "fault")  # at its stop, at full current
    assert drives.read(0, ERROR) == 0x4310, "motor too hot"
    assert drives.read(0, 0x1001) == 0x09, "error register"
    drives.write(0, CONTROL, RESET)
    drives.period()
    assert state(drives) == "fault", "it is still hot"
    drives.period(200)
    assert drives.read(0, 0x2004) == 1, "the brake"
    drives.write(0, CONTROL, 0)
    drives.period()
    drives.write(0, CONTROL, RESET)
    drives.period()
    assert state(drives) == "switch on disabled", "it has cooled down"


# ------------------------------------------------------------------- brakes, homing, touch probes


def test_brakes_open_before_and_close_behind_the_motion() -> None:
    """The arm does not sag under gravity while a brake is on its way."""
    drives = make(RICH)
    drives.period(60)  # closed by now
    assert drives.read(1, 0x2004) == 1, "a drive that is not enabled is braked"
    start = truth(drives, "theta_m").copy()
    for j in range(N):
        drives.write(j, MODE, CSP)
        drives.write(j, TARGET, drives.read(j, ACTUAL))
    command(drives, SHUTDOWN)
    command(drives, ENABLE)
    waited = until(drives, lambda: state(drives, 1) == "operation enabled")
    assert waited == pytest.approx(RELEASE / T, abs=2), "periods until the brake is open"
    drives.period(500)
    command(drives, SWITCH_ON)
    closed = until(drives, lambda: drives.read(1, 0x2004) == 1)
    assert closed == pytest.approx(CLOSE / T, abs=2), "periods until the brake is closed"
    drives.period(50)
    assert drives.plant.measured.applied[1] == 0.0, "the motor is let go once it is braked"
    turned = (truth(drives, "theta_m") - start) * 1024 / (2 * math.pi)
    # The weight moves from the brake to the motor, which finds it by its integral: some counts.
    assert np.abs(turned).max() < 12, "counts by which the motors have turned"
    enable(drives, CSP)
    drives.write(1, CONTROL, 0)  # disable voltage: at once, and it sags
    drives.period()
    assert drives.plant.measured.applied[1] == 0.0, "no voltage at once"


def test_homing_here_puts_the_zero_at_the_offset() -> None:
    drives = make()
    for j, method in enumerate((35, 37, 37)):
        drives.write(j, 0x6098, method)
        drives.write(j, 0x607C, 1000 * (j + 1))
    enable(drives, HM)
    assert not drives.read(0, STATUS) & BIT12, "home is not attained yet"
    command(drives, ENABLE | 0x10, 2)
    for j in range(N):
        assert drives.read(j, ACTUAL) == -1000 * (j + 1), "position at the home"
        assert drives.read(j, STATUS) & (BIT12 | BIT13 | REACHED) == BIT12 | REACHED, "attained"
    with pytest.raises(Aborted, match="06090030"):
        drives.write(0, 0x6098, 33)  # no index pulse here
    assert [drives.read(0, 0x60E3, k) for k in range(3)] == [2, 35, 37], "supported methods"


@pytest.mark.parametrize("method", [33, 34, -1, -2, -3, -4])
def test_homing_finds_index_pulses_and_stops(method: int) -> None:
    drives = make(RICH)
    enable(drives, HM)
    j = 0  # the waist, which gravity leaves alone
    drives.write(j, 0x6098, method)
    drives.write(j, 0x607C, 77)
    drives.write(j, 0x6099, 20000, 1)
    before = drives.read(j, 0x6063)
    drives.write(j, CONTROL, ENABLE | 0x10)
    drives.period(2)
    assert not drives.read(j, STATUS) & (BIT12 | REACHED), "it is under way"
    until(drives, lambda: bool(drives.read(j, STATUS) & BIT12), 20000)
    drives.period(300)
    home = drives.read(j, 0x6063) - (drives.read(j, ACTUAL) + 77)
    per_rad = 1024 / (2 * math.pi) / 0.01
    forward = method in (34, -1, -3)
    if method in (33, 34):
        pulse = 1024 * (before // 1024 + (1 if forward else 0))
        assert abs(home - pulse) <= 1, "the next index pulse"
    else:
        stop = (2.0 if forward else -2.0) * per_rad
        # Pressed by 30 % of 1 N m behind 1:100 into 3000 N/m rad, and the gear is wound up by it.
        pressed = 1.2 * (30.0 / 3000.0 + 30.0 / 1e4) * per_rad
        turn = 1024 if method >= -2 else 0
        if forward:
            assert stop - turn <= home <= stop + pressed, "home at the stop ahead"
        else:
            assert stop - pressed <= home <= stop + turn, "home at the stop behind"
        if turn:
            assert home % 1024 in (0, 1023), "an index pulse"


def test_homing_that_finds_nothing_or_is_broken_off_states_so() -> None:
    drives = make(RICH)
    enable(drives, HM)
    drives.write(0, 0x6098, 34)
    drives.write(0, 0x6072, 0)  # it cannot move
    drives.write(0, CONTROL, ENABLE | 0x10)
    drives.period(100)
    assert not drives.read(0, STATUS) & (BIT12 | REACHED), "it is looking"
    drives.write(0, CONTROL, ENABLE)
    drives.period(100)
    assert drives.read(0, STATUS) & (BIT12 | REACHED) == REACHED, "broken off"


def test_touch_probes_store_the_position_of_index_pulses() -> None:
    drives = make(RICH)
    enable(drives, CSV)
    drives.write(0, 0x60FF, 8000)
    drives.write(0, 0x60B8, 0x0015 | 0x17 << 8)  # 1: the first one, 2: every one
    drives.period()
    assert drives.read(0, 0x60B9) == 0x0101, "both are on"
    until(drives, lambda: drives.read(0, 0x60B9) == 0x0303)
    first = drives.read(0, 0x60BA)
    assert first % 1024 == 0, "position of an index pulse"
    until(drives, lambda: drives.read(0, 0x60BC) == first + 2048)
    assert drives.read(0, 0x60BA) == first, "the first one stays"
    drives.write(0, 0x60B8, 0)
    drives.period()
    assert drives.read(0, 0x60B9) == 0, "off"


@pytest.mark.parametrize("seed", range(4))
def test_a_master_that_writes_at_random_never_breaks_a_drive(seed: int) -> None:
    """Any value in any entry of the drive in motion: one state, no voltage unless it controls."""
    rng = random.Random(seed)
    drives = make(RICH if seed % 2 else PLAIN)
    entries = [entry for entry in list_entries() if entry.index >= 0x2000 and entry.access == "rw"]
    lively = [entry for entry in entries if entry.rx and entry.index != CONTROL]
    likely = [
        SHUTDOWN,
        SWITCH_ON,
        RESET,
        0x0B,
        *(ENABLE | bits for bits in (0, 0, 0x10, 0x30, HALT)),
    ]
    states, before = set(), [""] * N
    for k in range(1500):
        for j in range(N):
            if rng.random() < 0.05:
                drives.write(j, CONTROL, rng.choice(likely))
            target = rng.choice(lively if rng.random() < 0.8 else entries)
            value = rng.choice(
                (target.least, target.most, rng.randint(target.least, target.most), k % 128)
            )
            if target.index == TARGET:
                value = drives.read(j, ACTUAL) + rng.randrange(-2000, 2000)
            with contextlib.suppress(Aborted):
                content = value.to_bytes(9, "little", signed=True)[: target.bits // 8]
                drives.download_entry(j, target.index, target.sub, content)
        if k % 100 == 0:
            drives.report_loss(rng.randrange(-1, N))
        drives.period()
        for j in range(N):
            now = state(drives, j)
            states.add(now)
            # A fault comes at the end of a period. Brakes: the motor is held while they move.
            off = now in ("switch on disabled", "ready", "switched on", "fault")
            if off and before[j] == now and drives.plant.scene is PLAIN:
                assert drives.plant.measured.applied[j] == 0.0, f"command in {now}, period {k}"
            assert abs(drives.plant.measured.applied[j]) <= PLAIN.supply_voltage, (
                f"command, period {k}"
            )
            before[j] = now
    assert len(states) >= 4, f"states that were seen: {states}"
    assert "operation enabled" in states, "it was enabled"
    assert np.isfinite(drives.plant.state.q).all(), "the arm"

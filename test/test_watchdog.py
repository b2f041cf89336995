"""The watchdog of a servo: holds, then cuts, when targets or states fall silent."""

from __future__ import annotations

import math

import numpy as np
import pytest
from machines import CONFIG

from arm_emulator import load_servo_config
from arm_emulator.base.refusal import Refusal
from arm_emulator.servo.servo_arm import ServoArm
from arm_emulator.servo.watchdog import Watchdog, WatchdogState


def test_watchdog_holds_until_the_first_target_however_long() -> None:
    dog = Watchdog(0.2, 2.0)
    for now in (0.0, 1.0, 100.0):
        dog.state_came(now)
        assert dog.check(now) is WatchdogState.HOLD
    assert dog.reason == "no joint target has come yet"


@pytest.mark.parametrize("silent", ["joint target", "motor state"])
def test_watchdog_holds_then_cuts_when_either_falls_silent(silent: str) -> None:
    dog = Watchdog(0.25, 2.0)
    dog.state_came(10.0)
    dog.target_came(10.0)
    assert dog.check(10.25) is WatchdogState.OK
    for now in (11.0, 12.0, 12.25):
        (dog.state_came if silent == "joint target" else dog.target_came)(now)
        expected = WatchdogState.HOLD if now <= 12.0 else WatchdogState.CUT
        assert dog.check(now) is expected
        assert dog.reason.startswith(f"no {silent} for ")
        assert ("hold_after" in dog.reason) is (expected is WatchdogState.HOLD)


def test_watchdog_hold_ends_with_new_input_but_a_cut_only_with_a_reset() -> None:
    dog = Watchdog(0.2, 2.0)

    def both_came(now: float) -> WatchdogState:
        dog.target_came(now)
        dog.state_came(now)
        return dog.check(now)

    assert both_came(0.0) is WatchdogState.OK
    assert dog.check(1.0) is WatchdogState.HOLD
    assert both_came(1.0) is WatchdogState.OK
    assert dog.check(3.5) is WatchdogState.CUT
    assert both_came(3.5) is WatchdogState.CUT
    assert dog.reason.endswith("the power stays off until a reset")
    dog.reset()
    assert dog.check(3.6) is WatchdogState.HOLD
    assert both_came(3.6) is WatchdogState.OK


def test_watchdog_takes_a_clock_that_jumps_back() -> None:
    dog = Watchdog(0.2, 2.0)
    dog.target_came(50.0)
    dog.state_came(50.0)
    assert dog.check(0.0) is WatchdogState.OK
    assert dog.check(0.3) is WatchdogState.HOLD


@pytest.mark.parametrize(
    ("hold_after", "cut_after"), [(0.0, 1.0), (math.nan, 1.0), (0.2, 0.2), (0.2, math.nan)]
)
def test_watchdog_refuses_times_out_of_order(hold_after: float, cut_after: float) -> None:
    with pytest.raises(Refusal, match="watchdog: "):
        Watchdog(hold_after, cut_after)


def test_a_joint_that_holds_keeps_the_angle_at_which_it_began() -> None:
    """However far it is pushed away: the middle of the first count, seen at the link."""
    config = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    drives, still = ServoArm(config), np.zeros(len(config.joints))
    for tick in range(20):
        counts = still + 500.0 + 7.0 * tick
        drives.measure(round(tick * config.period * 1e9), counts, still, still)
        drives.command(True)
        began = [
            500.5 * 2.0 * math.pi / joint.counts_per_turn * joint.gear_ratio
            for joint in config.joints
        ]
        np.testing.assert_allclose(drives.servo.state["q_hold"], began, rtol=1e-12)

"""The watchdog of a servo: holds, then cuts, when targets or states fall silent."""

import math

import numpy as np
import pytest
from machines import CONFIG

from arm_emulator import load_servo_config
from arm_emulator.base.refusal import Refusal
from arm_emulator.servo.servo_arm import ServoArm
from arm_emulator.servo.servo_law import SERVO, servo_law
from arm_emulator.servo.watchdog import Watchdog, WatchdogState, count_nanoseconds


class ClockedWatchdog(Watchdog):
    """A watchdog without a servo, at times that a test states [s]."""

    def __init__(self, hold_after: float, cut_after: float) -> None:
        super().__init__(hold_after, cut_after, SERVO.make_struct("servo_watchdog"))
        self.reset()

    def reset(self) -> None:
        servo_law().servo_watchdog_reset(self._dog)

    def note_target(self, now: float) -> None:
        servo_law().servo_watchdog_target(self._dog, count_nanoseconds(now))

    def note_state(self, now: float) -> None:
        servo_law().servo_watchdog_state(self._dog, count_nanoseconds(now))

    def check(self, now: float) -> WatchdogState:
        servo_law().servo_watchdog_check(self._dog, count_nanoseconds(now))
        return self.state


def test_watchdog_holds_until_the_first_target_however_long() -> None:
    dog = ClockedWatchdog(0.2, 2.0)
    for now in (0.0, 1.0, 100.0):
        dog.note_state(now)
        assert dog.check(now) is WatchdogState.HOLD
    assert dog.reason == "no joint target has come yet"


@pytest.mark.parametrize("silent", ["joint target", "motor state"])
def test_watchdog_holds_then_cuts_when_either_falls_silent(silent: str) -> None:
    dog = ClockedWatchdog(0.25, 2.0)
    dog.note_state(10.0)
    dog.note_target(10.0)
    assert dog.check(10.25) is WatchdogState.OK
    for now in (11.0, 12.0, 12.25):
        (dog.note_state if silent == "joint target" else dog.note_target)(now)
        expected = WatchdogState.HOLD if now <= 12.0 else WatchdogState.CUT
        assert dog.check(now) is expected
        assert dog.reason.startswith(f"no {silent} for ")
        assert ("hold_after" in dog.reason) is (expected is WatchdogState.HOLD)


def test_watchdog_hold_ends_with_new_input_but_a_cut_only_with_a_reset() -> None:
    dog = ClockedWatchdog(0.2, 2.0)

    def receive_both(now: float) -> WatchdogState:
        dog.note_target(now)
        dog.note_state(now)
        return dog.check(now)

    assert receive_both(0.0) is WatchdogState.OK
    assert dog.check(1.0) is WatchdogState.HOLD
    assert receive_both(1.0) is WatchdogState.OK
    assert dog.check(3.5) is WatchdogState.CUT
    assert receive_both(3.5) is WatchdogState.CUT
    assert dog.reason.endswith("the power stays off until a reset")
    dog.reset()
    assert dog.check(3.6) is WatchdogState.HOLD
    assert receive_both(3.6) is WatchdogState.OK


def test_watchdog_takes_a_clock_that_jumps_back() -> None:
    dog = ClockedWatchdog(0.2, 2.0)
    dog.note_target(50.0)
    dog.note_state(50.0)
    assert dog.check(0.0) is WatchdogState.OK
    assert dog.check(0.3) is WatchdogState.HOLD


@pytest.mark.parametrize(
    ("hold_after", "cut_after"), [(0.0, 1.0), (math.nan, 1.0), (0.2, 0.2), (0.2, math.nan)]
)
def test_watchdog_refuses_times_out_of_order(hold_after: float, cut_after: float) -> None:
    with pytest.raises(Refusal, match="watchdog: "):
        ClockedWatchdog(hold_after, cut_after)


def test_a_joint_that_holds_keeps_the_angle_at_which_it_began() -> None:
    """However far it is pushed away: the middle of the first count, seen at the link."""
    config = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    drives, still = ServoArm(config), np.zeros(len(config.joints))
    for tick in range(20):
        counts = still + 500.0 + 7.0 * tick
        drives.take_measurement(round(tick * config.period * 1e9), counts, still, still)
        drives.compute_commands(True)
        began = [
            500.5 * 2.0 * math.pi / joint.counts_per_turn * joint.gear_ratio
            for joint in config.joints
        ]
        np.testing.assert_allclose(drives.servo.state["q_hold"], began, rtol=1e-12)

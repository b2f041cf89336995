"""The servo under its watchdog: voltages with and without joint targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from servo_node.servo import FloatArray, Servo, ServoConfig
from servo_node.watchdog import Watchdog, WatchdogState
from words.bound import POSITION

_NANOSECONDS = 1e9


@dataclass(frozen=True)
class Target:
    """Joint targets of one moment, (N,) each in the servo's order of joints."""

    q: FloatArray
    """Link angles [rad]."""
    v: FloatArray | None = None
    """Link speeds [rad/s], with which the angles go on; None: 0."""
    tau: FloatArray | None = None
    """Link torques known beforehand [N m]; None: 0."""


class Drives:
    """All drives of an arm: follow the newest target, hold without one, or give no voltage.

    Per servo period `measure` once, `aim` when a target comes, then `voltage`.

    A target that has a speed goes on with it until the next one comes, for one motion period at
    most: q + v (t - t_target). So the angles asked for are a line from target to target and no
    stairs. Without a motion period nobody knows when the next one comes, and the angles stand.

    Attributes:
        state: what the last `voltage` did.
        reason: the same in words.
    """

    def __init__(self, config: ServoConfig) -> None:
        self.servo = Servo(config)
        self._watchdog = Watchdog(config.hold_after, config.cut_after)
        self._off = np.zeros(len(config.joints))
        self._motion_period = config.motion_period
        self.reset()

    def reset(self) -> None:
        """Forget everything; power that was cut comes back."""
        self.servo.reset()
        self._watchdog.reset()
        self.state, self.reason = WatchdogState.HOLD, "starting"
        self._now: float | None = None  # logical time of the newest measurement [s]
        self._target: Target | None = None
        self._target_time = 0.0  # s
        self._hold: FloatArray | None = None

    def retune(self, config: ServoConfig) -> None:
        """Change gains, limits and timeouts, between two ticks.

        Raises:
            Refusal: see `Servo.retune`. Nothing has changed then.
        """
        self.servo.retune(config)
        self._watchdog.hold_after = config.hold_after
        self._watchdog.cut_after = config.cut_after

    def measure(
        self,
        time_ns: int,
        counts: npt.ArrayLike,
        current: npt.ArrayLike,
        voltage: npt.ArrayLike | None = None,
    ) -> None:
        """Take this period's measurement.

        Args:
            time_ns: logical time [ns].
            counts: see `Servo.observe`, as for the others.
            current: [A].
            voltage: applied in the period that ends now [V].

        Raises:
            Refusal: see `Servo.observe`. Nothing has changed then.
        """
        self.servo.observe(counts, current, voltage)
        self._now = time_ns / _NANOSECONDS
        self._watchdog.state_came(self._now)

    def aim(self, target: Target) -> None:
        """Take new joint targets, from this period on."""
        self._target = target
        if self._now is not None:
            self._target_time = self._now
            self._watchdog.target_came(self._now)

    def voltage(self, powered: bool) -> FloatArray:
        """Return the voltages for the period that began with the last measurement, (N,) [V].

        Args:
            powered: whether the drives have power; without it the motors turn no matter what.
        """
        assert self._now is not None, "measure first"
        state = self._watchdog.check(self._now)
        reason = self._watchdog.reason
        if state is not WatchdogState.CUT and not powered:
            state, reason = WatchdogState.CUT, "the drives' power is off"
        self.state, self.reason = state, reason
        target = self._target
        if state is WatchdogState.CUT:
            self._hold = None
            self.servo.release()
            return self._off
        if state is WatchdogState.HOLD or target is None:
            if self._hold is None:
                self._hold = self.servo.q_measured
            return self.servo.control(self._hold)
        self._hold = None
        return self.servo.control(self._q_now(target), target.v, target.tau)

    def _q_now(self, target: Target) -> FloatArray:
        if target.v is None:
            return target.q
        assert self._now is not None
        ahead = min(max(self._now - self._target_time, 0.0), self._motion_period)
        limit = POSITION.largest
        q: FloatArray = np.clip(target.q + ahead * target.v, -limit, limit)
        return q

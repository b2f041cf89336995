"""Joints that reach speeds with limited accelerations and jerks, and stop before their limits."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import ruckig

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.joint_reference import Reference

_BRAKES = 0.5  # part of the acceleration with which a joint stops before its limit
_HALTS = 1e-3  # share of a speed that counts as no motion
_ROUNDING = 1e-9  # rad or m
_FAR = 1e4  # rad or m: a place on one side of 0
_NOW = ("current_position", "current_velocity", "current_acceleration")


class JerkLimitedVelocity:
    """A reference of joint speeds that change together, along a line between two sets of speeds.

    Args:
        lower: positions (N,) that the joints stay above [rad or m]; infinite: not limited.
        upper: likewise.
        velocity: largest speeds (N,).
        acceleration: (N,).
        jerk: (N,).
        period: motion period [s].
    """

    def __init__(
        self,
        lower: Array,
        upper: Array,
        velocity: Array,
        acceleration: Array,
        jerk: Array,
        period: float,
    ) -> None:
        self._lower, self._upper, self._velocity = lower, upper, velocity
        self._acceleration, self._jerk, self._period = acceleration, jerk, period
        joints = len(lower)
        self._otg = ruckig.Ruckig(joints, period)
        self._in, self._out = ruckig.InputParameter(joints), ruckig.OutputParameter(joints)
        self._stop, self._ends = ruckig.InputParameter(joints), ruckig.Trajectory(joints)
        for motion in (self._in, self._stop):
            motion.control_interface = ruckig.ControlInterface.Velocity
            motion.max_acceleration, motion.max_jerk = acceleration.tolist(), jerk.tolist()
            motion.target_velocity = motion.target_acceleration = [0.0] * joints
        self._stop.synchronization = ruckig.Synchronization.No

    def __getstate__(self) -> tuple[tuple[Array | float, ...], Reference]:
        limits = self._lower, self._upper, self._velocity, self._acceleration, self._jerk
        return (*limits, self._period), self.now

    def __setstate__(self, state: tuple[tuple[Any, ...], Reference]) -> None:
        arguments, now = state
        JerkLimitedVelocity.__init__(self, *arguments)
        for name, values in zip(_NOW, (now.q, now.v, now.a), strict=True):
            setattr(self._in, name, values.tolist())

    def take_over(self, now: Reference) -> None:
        """Take over a motion."""
        self._in.current_position = now.q.tolist()
        self._in.current_velocity = now.v.tolist()
        limit = self._acceleration
        self._in.current_acceleration = np.clip(now.a, -limit, limit).tolist()

    @property
    def now(self) -> Reference:
        """The motion now."""
        return Reference(*(np.array(getattr(self._in, name)) for name in _NOW))

    @property
    def is_moving(self) -> bool:
        """Whether a joint moves."""
        now = self.now
        return bool(np.abs(now.v).max() > 1e-9 or np.abs(now.a).max() > 1e-6)

    def limit_shares(self, q: Array, v: Array) -> Array:
        """Return the permitted share of each joint's speed (N,) at q, 0 to 1."""
        to_limit = np.where(v > 0.0, self._upper - q, q - self._lower)
        fastest = np.minimum(
            self._velocity,
            _compute_stopping_speeds(to_limit, _BRAKES * self._acceleration, _BRAKES * self._jerk),
        )
        part = np.ones_like(v)
        fast = np.abs(v) > fastest
        part[fast] = fastest[fast] / np.abs(v[fast])
        return np.where(part < _HALTS, 0.0, part)

    def limit_brake_share(self, v: Array, seconds: float) -> float:
        """Return the share of speeds v (N,) that comes to rest within a time at v [s], 0 to 1."""
        moves = v != 0.0
        if not moves.any():
            return 1.0
        slows, grows = (
            np.array((_BRAKES * limit[moves] / np.abs(v[moves])).min())
            for limit in (self._acceleration, self._jerk)
        )
        share = float(_compute_stopping_speeds(np.array(seconds), slows, grows))
        return 0.0 if share < _HALTS else min(1.0, share)

    def sample_stop(self, then: Reference, pieces: Callable[[Array], int]) -> Array:
        """Return angles (K, N) on the way on which the joints come to rest, each independently.

        Args:
            then: the motion.
            pieces: in how many pieces to return a way of the joints (N,).
        """
        stop, limit = self._stop, self._acceleration
        stop.current_position, stop.current_velocity = then.q.tolist(), then.v.tolist()
        stop.current_acceleration = np.clip(then.a, -limit, limit).tolist()
        solve_with_ruckig(lambda: self._otg.calculate(stop, self._ends))
        duration = self._ends.duration
        end = np.array(self._ends.at_time(duration)[0])
        count = pieces(end - then.q) if duration > 0.0 else 0
        times = [duration * k / count for k in range(count)] if count else []
        return np.array([*(self._ends.at_time(t)[0] for t in times), end.tolist()])

    def stop_joints(self) -> Array:
        """Brake each joint independently for a period; return their mean speeds in it."""
        return self.advance_towards(np.zeros(len(self._lower)), alone=True, together=False)

    def advance_towards(
        self, v: Array, alone: bool, together: bool = True, a: Array | None = None
    ) -> Array:
        """Move the joints towards speeds v (N,) for a period; return their mean speeds in it.

        From where they are then every joint can stop before its limit. A joint that could not if it
        did as asked brakes instead, and so do the others unless each moves `alone`.
        Speeds that change `together` do so along a line. With accelerations `a` (N,) they are to
        be there at the end of the period, and go on to change so.
        """
        motion = self._in
        before = np.array(motion.current_position)
        kind = ruckig.Synchronization
        if a is None:
            self._advance_period(v, kind.Phase if together else kind.No)
        else:
            self._step_on(v, a)
        late = self._find_late(before)
        more = late.any()
        while more:
            v = np.where(late if alone else True, 0.0, v)
            self._advance_period(v, ruckig.Synchronization.No)
            newly_late = self._find_late(before) & (v != 0.0)
            late, more = late | newly_late, newly_late.any()
        self._out.pass_to_input(motion)
        mean: Array = (np.array(motion.current_position) - before) / self._period
        return mean

    def _find_extremes(self, stop: ruckig.InputParameter, at: float) -> Array:
        """Return the largest positions (N,) on the way to rest from positions `at` > 0, or least.

        Ruckig 0.19 has 0 among the positions of such a way.
        """
        stop.current_position = [at] * len(self._lower)
        solve_with_ruckig(lambda: self._otg.calculate(stop, self._ends))
        extrema = self._ends.position_extrema
        return np.array([extremum.max if at > 0.0 else extremum.min for extremum in extrema])

    def _step_on(self, v: Array, a: Array) -> None:
        """Step to speeds v that go on to change by a, as far as the limits let them."""
        motion, left = self._in, np.maximum(self._velocity - np.abs(v), 0.0)
        limit = np.minimum(_BRAKES * self._acceleration, np.sqrt(2.0 * self._jerk * left))
        motion.target_acceleration = np.clip(a, -limit, limit).tolist()
        motion.minimum_duration = self._period
        try:
            self._advance_period(v, ruckig.Synchronization.Time)
        finally:
            motion.target_acceleration, motion.minimum_duration = [0.0] * len(v), None

    def _advance_period(self, v: Array, together: ruckig.Synchronization) -> None:
        self._in.target_velocity, self._in.synchronization = v.tolist(), together
        self._otg.reset()
        try:
            solve_with_ruckig(lambda: self._otg.update(self._in, self._out))
        except ArithmeticError as error:
            raise ArithmeticError(f"no way to take up the speeds {v.tolist()}: {error}") from None

    def _find_late(self, before: Array) -> npt.NDArray[np.bool_]:
        """Return which joints cannot stop within their limits after the step, (N,).

        One that began outside may come back.
        """
        stop, step = self._stop, self._out
        stop.current_velocity, stop.current_acceleration = step.new_velocity, step.new_acceleration
        q = np.array(step.new_position)
        lowest = q + (self._find_extremes(stop, -_FAR) + _FAR)
        highest = q + (self._find_extremes(stop, _FAR) - _FAR)
        lower, upper = np.minimum(self._lower, before), np.maximum(self._upper, before)
        late: npt.NDArray[np.bool_] = (lowest < lower - _ROUNDING) | (highest > upper + _ROUNDING)
        return late


def _compute_stopping_speeds(distance: Array, acceleration: Array, jerk: Array) -> Array:
    """Return the speeds (N,) from which joints at no acceleration stop within distances.

    A joint reaches its largest acceleration a when it stops from v >= a^2 / j. Then it stops within
    v (v / a + a / j) / 2, else within v sqrt(v / j).
    """
    d = np.maximum(distance, 0.0)
    short = np.cbrt(d**2 * jerk)
    ramp = acceleration**2 / jerk
    with np.errstate(invalid="ignore", over="ignore"):
        long = np.sqrt(0.25 * ramp**2 + 2.0 * acceleration * d) - 0.5 * ramp
    return np.where(short <= ramp, short, long)


def solve_with_ruckig(call: Callable[[], ruckig.Result]) -> None:
    """Call ruckig for a motion.

    Raises:
        ArithmeticError: it finds none. Some of its results have no name in Python (-101, a motion
            of hours), which is a ValueError there; others are a RuckigError of many lines.
    """
    try:
        result = call()
    except (ruckig.RuckigError, ValueError) as error:
        line = next(line for line in f"{error}\n?".splitlines() if line.strip())
        raise ArithmeticError(line.strip()) from None
    if int(result) < 0:
        raise ArithmeticError(str(result))

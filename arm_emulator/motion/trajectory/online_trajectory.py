"""From any motion of the joints to rest: jerk-limited, by ruckig.

Where a new target comes while the arm moves no line of the tool leads on from there: the joints go
on as they move, and each comes to rest at its angle, all at the same time.
"""

import numpy as np
import ruckig

from arm_emulator.base.arrays import Array
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.trajectory.jerk_limited_velocity import solve_with_ruckig
from arm_emulator.motion.trajectory.timed_path import JointPathLimits

_MOMENT = 1e-7  # s, over which the jerk is measured: it is constant but for a few jumps


class OnlineTrajectory(SharedObject):
    """A motion of the joints to rest.

    Args:
        now: motion of the joints at its begin.
        end: position of rest (N,) [rad or m]; None: the nearest in time.
        limits: of the joints, except torques.
        lower: limits of position (N,) [rad or m].
        upper: (N,).

    Attributes:
        duration: [s].
        stops: whether they only come to rest: `end` was None, or the way there leaves the limits.
    """

    def __init__(
        self,
        now: Reference,
        end: Array | None,
        limits: JointPathLimits,
        lower: Array,
        upper: Array,
    ) -> None:
        low, high = np.minimum(lower, now.q) - 1e-9, np.maximum(upper, now.q) + 1e-9
        problem = ruckig.InputParameter(len(now.q))
        problem.current_position = now.q.tolist()
        problem.current_velocity = now.v.tolist()
        problem.current_acceleration = now.a.tolist()
        problem.max_velocity = limits.speed.tolist()
        problem.max_acceleration = limits.acceleration.tolist()
        problem.max_jerk = limits.jerk.tolist()
        self.stops = False
        if end is not None:
            problem.target_position = end.tolist()
            for together in (ruckig.Synchronization.Time, ruckig.Synchronization.No):
                problem.synchronization = together
                if self._is_solved(problem) and self._is_within(low, high):
                    return
        self.stops = True
        problem.control_interface = ruckig.ControlInterface.Velocity
        problem.synchronization = ruckig.Synchronization.No
        if not self._is_solved(problem):
            raise ArithmeticError(f"no way to rest was found from q = {now.q}, v = {now.v}")

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since the start [s]."""
        q, v, a = self._trajectory.at_time(min(max(0.0, time), self.duration))
        if time >= self.duration:
            return Reference.make_rest(np.array(q))
        later = self._trajectory.at_time(max(0.0, time) + _MOMENT)[2]
        jerk = (np.array(later) - np.array(a)) / _MOMENT
        return Reference(np.array(q), np.array(v), np.array(a), jerk)

    def _is_solved(self, problem: ruckig.InputParameter) -> bool:
        self._trajectory = ruckig.Trajectory(problem.degrees_of_freedom)
        law = ruckig.Ruckig(problem.degrees_of_freedom)
        try:
            solve_with_ruckig(lambda: law.calculate(problem, self._trajectory))
        except ArithmeticError:
            return False
        self.duration = float(self._trajectory.duration)
        return True

    def _is_within(self, low: Array, high: Array) -> bool:
        extremes = self._trajectory.position_extrema
        return all(
            extreme.min >= lowest and extreme.max <= highest
            for extreme, lowest, highest in zip(extremes, low, high, strict=True)
        )


class Rest:
    """Joints at rest, for a time [s]."""

    def __init__(self, q: Array, duration: float = 0.0) -> None:
        self._reference, self.duration = Reference.make_rest(q), duration

    def evaluate_at(self, time: float) -> Reference:
        """Return their position."""
        return self._reference

"""Joint angles that bring the tool to its target, or as near as possible."""

import math

import daqp
import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pose import Pose

REACHED = 1e-8  # rad (or m per reach): a tool this near to its target is there
_AT_REST = 1e-6  # rad: shorter steps lead nowhere
_LONGEST_STEP = 0.5  # rad
_LONGEST_POSTURE_STEP = 0.2  # rad
_LEEWAY = 1e-3  # rad: error that a step towards the posture may leave to the next
_POSTURE_STEPS = 100  # after a target came
_POSTURE_WEIGHT = 1e-4  # against the task, where a joint limit makes them rivals
_RETURN_STEPS = 12  # at once
_WHILE = 20  # steps
_HARDLY = 1e-5  # part of the tool error
_PROBE = 0.05  # rad
_SINGULAR = 0.1  # rad/rad: directions that are probed
_MAX_DAMPING = 1e9


class InverseKinematics:
    """Iteration from the arm's joint angles to those of its tool's target.

    A step D of the joints minimises, within the position limits,

        |S (J D - e)|^2 + sum_i l_i^2 (v_i' D)^2 + posture

    with the tool error e, the scale S of `Kinematics`, and the right singular vectors v_i of S J.
    The damping (Levenberg 1944, Marquardt 1963; proportional to the error: Sugihara 2011)
    is ``l_i^2 = max(0, k |S e| - s_i^2)``: none where the step's error of second order, at most of
    the size |S e| D^2, is small against s_i^2 D^2; and enough to never pass a stretched pose, where
    the way to a target beyond reach ends: its elbow stays on the side where it was.

    Joint motions that do not move the tool lead towards a posture. The angles are therefore a
    function of the target and do not drift over a cycle.

    Where no step leads nearer, motions of no effect in first order are tried by a finite one: an
    exactly stretched arm bends, to the side of the middle of its limits.

    All angles inside are scaled: a joint that slides counts per reach of the arm. A slow joint
    counts more, in proportion (`Kinematics.step_scale`), so that a redundant arm hardly waits for
    it. The angles are those of joints that move the tool; other joints do not move.

    Attributes:
        q: the angles found so far, (N,) [rad or m], within the position limits.
        error: tool error left there, scaled, (rows,) [rad].
        settled: whether no step leads nearer.
        returning: whether the target before was not reached.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._to_tool, self._rest = kinematics.to_tool, np.zeros(len(kinematics.joint_names))
        self.kinematics = kinematics = kinematics.of_tool
        self._low = kinematics.lower / kinematics.step_scale
        self._high = kinematics.upper / kinematics.step_scale
        finite = np.isfinite(self._low) & np.isfinite(self._high)
        self._middle = np.zeros(len(self._low))
        self._middle[finite] = 0.5 * (self._low[finite] + self._high[finite])
        self._scales = kinematics.scale[:, None] * kinematics.step_scale
        self.set_posture(self._rest)

    def set_posture(self, q: Array) -> None:
        """Take joint angles (N,) for the posture, and for the angles found."""
        self._posture = self._scale_angles(q)
        self._x = self._reached = self._posture
        self._target: Pose | None = None
        self.returning = False
        self.error = np.zeros(self.kinematics.rows)
        self.settled = True

    @property
    def q(self) -> Array:
        """The angles found so far."""
        return self._convert_angles(self._x)

    @property
    def posture(self) -> Array:
        """The posture of redundant joints (N,)."""
        return self._convert_angles(self._posture)

    def hold_joints(self, q: Array) -> None:
        """Take the angles of joints that do not move the tool from q (N,)."""
        self._rest = np.array(q, dtype=np.float64)

    def _scale_angles(self, q: Array) -> Array:
        """Take joint angles (N,), and return those that move the tool, scaled and inside."""
        self.hold_joints(q)
        return self._clamp_angles(q[self._to_tool] / self.kinematics.step_scale)

    def _convert_angles(self, x: Array) -> Array:
        q = self._rest.copy()
        q[self._to_tool] = x * self.kinematics.step_scale
        return q

    @property
    def is_reached(self) -> bool:
        """Whether the tool is at its target there."""
        return bool(_compute_size(self.error) <= REACHED)

    def set_target(self, target: Pose, q: Array) -> None:
        """Seek another target, from the angles found or from q (N,), whichever are nearer to it.

        After one that was not reached the arm is stretched, and could bend to either side. So a
        nearer one is first sought from the angles of the last target that was reached.
        """
        left = _compute_size(self.error)
        self.returning = self._target is not None and left > _LEEWAY
        self._target = target
        x = self._scale_angles(q)
        candidates = [(start_x, self._compute_error(start_x)) for start_x in (self._x, x)]
        start, error = min(candidates, key=lambda start_x: _compute_size(start_x[1]))
        self._start_from(start, error)
        if self.returning and _compute_size(self.error) < left:
            self._start_from(self._reached)
            for _ in range(_RETURN_STEPS):
                if self.settled or _compute_size(self.error) <= _LEEWAY:
                    break
                self._iterate_once()
            if _compute_size(self.error) > _LEEWAY:
                self._start_from(start)

    def _start_from(self, x: Array, error: Array | None = None) -> None:
        self._x, self.error = x, self._compute_error(x) if error is None else error
        self._damping = 1.0
        self._steps = 0
        self._size_before = math.inf
        self.settled = False

    def take_angles(self, q: Array) -> None:
        """Take joint angles (N,) that were found elsewhere for the target."""
        self._x = self._scale_angles(q)
        self.error = self._compute_error(self._x)
        self.settled = True
        self._reached = self._x

    def iterate_steps(self, steps: int) -> None:
        """Take at most this many steps."""
        for _ in range(steps):
            if self.settled:
                return
            self._iterate_once()

    def _iterate_once(self) -> None:
        e, J = self._compute_error_and_jacobian(self._x)
        size = _compute_size(e)
        self._steps += 1
        away = self._posture - self._x
        if self._steps > _POSTURE_STEPS:  # alternating limits could prevent an end
            away = np.zeros(len(away))
        free = _Free(J, e, away, size, self._damping)
        step = free.step
        x = self._x + step
        if ((x < self._low) | (x > self._high)).any():
            # Bounds no farther than a step goes: the solver's numbers stay of one size.
            low = np.maximum(self._low - self._x, -10.0)
            high = np.minimum(self._high - self._x, 10.0)
            step = solve_in_box(free.H, free.g, low, high)
            # With those at a limit held, posture must not cost the tool its place.
            inside = (step > low) & (step < high)
            while inside.any():
                rest = e - J[:, ~inside] @ step[~inside]
                free = _Free(J[:, inside], rest, away[inside], size, self._damping)
                step[inside] = free.step
                beyond = (step < low) | (step > high)
                if not beyond.any():
                    break
                step = np.minimum(np.maximum(step, low), high)
                inside &= ~beyond
        longest = float(np.abs(step).max())
        if longest > _LONGEST_STEP:
            step *= _LONGEST_STEP / longest
        x = self._clamp_angles(self._x + step)
        error = self._compute_error(x)
        if not _compute_size(error) <= max(size, min(free.aside, _LEEWAY)) + 1e-15:
            self._damping *= 4.0
            if self._damping > _MAX_DAMPING or self._is_stuck(size):
                self.settled = not self._try_probes(J)
            return
        self._x, self.error = x, error
        self._damping = max(1.0, 0.5 * self._damping)
        if _compute_size(error) <= REACHED:
            self.settled = free.aside < _AT_REST**2
            self._reached = self._x
        elif longest < _AT_REST or self._is_stuck(_compute_size(error)):
            self.settled = not self._try_probes(J)

    def _is_stuck(self, size: float) -> bool:
        """Whether recent steps have hardly reduced the tool error."""
        if self._steps % _WHILE != 0:
            return False
        if size <= _LEEWAY and self._steps <= _POSTURE_STEPS:
            return False
        before, self._size_before = self._size_before, size
        return before - size < _HARDLY * size

    def _try_probes(self, J: Array) -> bool:
        """Try finite steps in directions that have no effect in first order; whether one helped."""
        squares, V = compute_directions(J)
        best = _compute_size(self.error) * (1.0 - 1e-6)
        better = None
        for direction in V.T[squares < _SINGULAR**2]:
            side = float(direction @ (self._middle - self._x))
            if abs(side) < 1e-9:
                side = float(direction[int(np.argmax(np.abs(direction)))])
            for sign in (1.0, -1.0) if side >= 0.0 else (-1.0, 1.0):
                x = self._clamp_angles(self._x + sign * _PROBE * direction)
                size = _compute_size(self._compute_error(x))
                if size < best * (1.0 - 1e-12):
                    best, better = size, x
        if better is None:
            return False
        self._x, self.error = better, self._compute_error(better)
        return True

    def _clamp_angles(self, x: Array) -> Array:
        return np.minimum(np.maximum(x, self._low), self._high)

    def _compute_error(self, x: Array) -> Array:
        assert self._target is not None
        kinematics = self.kinematics
        return kinematics.scale * kinematics.tool_error(x * kinematics.step_scale, self._target)

    def _compute_error_and_jacobian(self, x: Array) -> tuple[Array, Array]:
        assert self._target is not None
        kinematics = self.kinematics
        e, J = kinematics.compute_error_and_jacobian(x * kinematics.step_scale, self._target)
        return kinematics.scale * e, self._scales * J


class _Free:
    """The step of joints without limits, damped, with what has no effect on the tool for posture.

    Args:
        J: scaled Jacobian (rows, n).
        e: scaled tool error (rows,).
        away: from the joints to their posture (n,).
        size: |e|, of all joints.
        damping: 1 or more; the steps become as much shorter.

    Attributes:
        step: (n,).
        aside: square of its part towards the posture, whose effect on the tool is of second order.
        H, g: nearly the same as the minimum of ``x' H x / 2 - g' x``.
    """

    def __init__(self, J: Array, e: Array, away: Array, size: float, damping: float) -> None:
        squares, V = compute_directions(J)
        self._V = V
        self._stiffness = np.maximum(squares, damping * size + 1e-15)
        self._pull = V.T @ (J.T @ e)
        self.aside = 0.0
        idle = len(squares) - len(e)  # directions that leave the tool where it is
        if idle > 0:
            posture = V[:, :idle].T @ away
            longest = float(np.abs(posture).max()) * damping
            if longest > _LONGEST_POSTURE_STEP:
                posture *= _LONGEST_POSTURE_STEP / longest
            self.aside = float(posture @ posture)
            self._stiffness[:idle] = _POSTURE_WEIGHT
            self._pull[:idle] = _POSTURE_WEIGHT * posture
        self.step: Array = V @ (self._pull / self._stiffness)

    @property
    def H(self) -> Array:
        # Better conditioned than the step itself, for the solver.
        return (self._V * np.maximum(self._stiffness, 1e-8)) @ self._V.T

    @property
    def g(self) -> Array:
        return self._V @ self._pull


def compute_directions(J: Array) -> tuple[Array, Array]:
    """Return the squares of J's singular values, smallest first (N,), and in columns the joint
    motions that belong to them, (N, N); with more joints than rows the first of them are 0.
    """
    try:
        # SciPy's dsyevd takes half the time, but each start of a node 0.3 s more to import it.
        squares, V = np.linalg.eigh(J.T @ J)
    except np.linalg.LinAlgError:
        raise ArithmeticError("the singular values of the Jacobian cannot be computed") from None
    return np.maximum(squares, 0.0), V


def _compute_size(error: Array) -> float:
    return math.sqrt(float(error @ error))


_SOLVED = 1


def solve_in_box(H: Array, g: Array, low: Array, high: Array) -> Array:
    """Return the x within [low, high] that makes ``x' H x / 2 - g' x`` smallest, (N,).

    Args:
        H: symmetric and positive definite, (N, N).
        g: (N,).
        low: lower bounds (N,), finite.
        high: upper bounds (N,), finite, none below its lower one.
    """
    n = len(g)
    x, _, flag, _ = daqp.solve(
        np.ascontiguousarray(H), -g, np.zeros((0, n)), high, low, np.zeros(n, dtype=np.int32)
    )
    if flag != _SOLVED:
        raise ArithmeticError(f"the quadratic program found no solution, exit flag {flag}")
    # The solver keeps bounds within its tolerance only.
    return np.clip(np.asarray(x, dtype=np.float64), low, high)

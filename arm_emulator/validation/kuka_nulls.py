"""Null models of the KUKA KR300: a comparison must distinguish them from our machine.

None of them models the arm. Their numbers, if any, come from run A, as the machine's do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from arm_emulator.identification.filtered import Filtered, smooth_motion
from arm_emulator.identification.free_run import Starts
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.machine.chain import Array

STEP = 1e-3  # s, of `PerAxis.free_run`


@dataclass(frozen=True)
class PerAxis:
    """Each axis by itself: inertia, viscous and dry friction, a weight that turns with the angle.

    tau = c0 + c1 sign(v) + c2 v + c3 a + c4 cos(q) + c5 sin(q)
    """

    coefficients: Array  # (N, 6)

    @classmethod
    def fitted(cls, data: Filtered) -> PerAxis:
        """Return the least-squares fit to a record, over its samples in motion."""
        rows = []
        for j in range(data.q.shape[1]):
            A, moving = _features(data, j), data.moving[:, j]
            rows.append(np.linalg.lstsq(A[moving], data.tau[moving, j], rcond=None)[0])
        return cls(np.array(rows))

    def torques(self, data: Filtered) -> Array:
        """Return the torques of a motion (K, N) [N m]."""
        axes = range(len(self.coefficients))
        return np.column_stack([_features(data, j) @ self.coefficients[j] for j in axes])

    def free_run(self, run: MeasuredRun, begin: Starts, seconds: float, ratio: Array) -> Array:
        """Return angles (S, N) [rad] after some time under the measured torques; gears (N,)."""
        c = self.coefficients.T
        q, v = begin.q.copy(), begin.v.copy()
        every = round(run.period / STEP)
        tau = run.tau / ratio
        for sample in range(round(seconds / run.period)):
            at = begin.at + sample
            torque = 0.5 * (tau[at] + tau[at + 1])
            for _ in range(every):
                rest = c[0] + c[1] * np.sign(v) + c[2] * v + c[4] * np.cos(q) + c[5] * np.sin(q)
                v += STEP * (torque - rest) / c[3]
                q += STEP * v
        end: Array = q
        return end


def constant_speed(run: MeasuredRun, begin: Starts, seconds: float) -> Array:
    """Return angles (S, N) [rad] after some time at the speed of the start."""
    return np.asarray(run.q_motor[begin.at] + seconds * begin.v)


def constant_acceleration(run: MeasuredRun, begin: Starts, seconds: float, low: float) -> Array:
    """Return angles (S, N) [rad] after some time at the acceleration of the start.

    Args:
        run: the record.
        begin: the starts.
        seconds: time of each.
        low: low-pass of the acceleration [Hz]; it looks ahead, so that this one knows more than the
            machine does.
    """
    a = smooth_motion(run.q_motor, run.period, low)[2][begin.at]
    ends: Array = constant_speed(run, begin, seconds) + 0.5 * seconds**2 * a
    return ends


def _features(data: Filtered, j: int) -> Array:
    q, v = data.q[:, j], data.v[:, j]
    one = np.ones(len(q))
    return np.column_stack([one, data.direction[:, j], v, data.a[:, j], np.cos(q), np.sin(q)])

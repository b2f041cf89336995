"""The servo law without its limits: one joint as a linear system, for the analysis of loops."""

from __future__ import annotations

import math

import numpy as np

from servo_node.servo import axis_of
from servo_node.servo_config import JointServo

STATES = ("theta", "omega", "load", "current", "integral")
INPUTS = ("theta", "current", "voltage", "q_target", "v_target", "tau_feedforward")


class LinearServo:
    """One joint's servo for an encoder without steps, and without limits.

    With x the `STATES` after a tick and u the `INPUTS` at the next one, `voltage` that of the
    period between,

        x' = A x + B u        V = C x + D u

    The numbers are those of the very law that runs: it is asked for unit states and inputs.

    Attributes:
        A: (5, 5).
        B: (5, 6).
        C: (5,).
        D: (6,).
        current_per_angle: by how much a jump of the measured angle changes the current asked for
            at once [A/rad].

    Args:
        joint: data sheet and gains.
        period: servo period [s].

    Raises:
        Refusal: as `Servo`.
    """

    def __init__(self, joint: JointServo, period: float) -> None:
        self._axis = axis = axis_of(joint, period, math.inf)
        axis.omega_limit = axis.current_limit = math.inf
        axis.count_angle = -1.0  # no target is within a count
        self.current_per_angle = axis.velocity_gain * (
            axis.position_gain * axis.theta_gain + abs(axis.omega_gain)
        )
        n = len(STATES)
        rows = np.eye(n + len(INPUTS)).tolist()
        whole = np.array([self._tick(row[:n], row[n:]) for row in rows]).T
        self.A, self.B = whole[:n, :n], whole[:n, n:]
        self.C, self.D = whole[n, :n], whole[n, n:]

    def _tick(self, states: list[float], inputs: list[float]) -> list[float]:
        axis = self._axis
        for name, value in zip(STATES, states, strict=True):
            setattr(axis, name, value)
        theta, current, voltage, *targets = inputs
        axis.take(theta, current, voltage)
        voltage = axis.control(*targets)
        return [*(getattr(axis, name) for name in STATES), voltage]

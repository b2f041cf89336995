"""The servo law without its limits: one joint as a linear system, for the analysis of loops."""

import enum
import math

import numpy as np

from arm_emulator.servo.servo_config import JointServo
from arm_emulator.servo.servo_law import CURRENT, POSITION, SERVO, SPEED, Rows, servo_law
from arm_emulator.servo.servo_numbers import make_servo_numbers

STATES = ("theta", "omega", "load", "current", "integral")
INPUTS = ("theta", "current", "applied", "target", "v_target", "tau_feedforward")


class Loop(enum.Enum):
    """Controlled quantity of a servo: enum servo_wants, and a torque at the speed limit."""

    POSITION = "position"
    SPEED = "speed"
    TORQUE = "torque"
    SPEED_LIMIT = "torque at the speed limit"


class LinearServo:
    """One joint's servo for an encoder without steps, and without limits.

    With x the `STATES` after a tick, u the `INPUTS` at the next one, and `applied` the command of
    the period between,

        x' = A x + B u        V = C x + D u

    The matrices are those of the actual law, which is evaluated for unit states and inputs.
    `target` is a link angle; a motor's speed, a current or the largest motor speed for other loops.

    Attributes:
        A: (5, 5).
        B: (5, 6).
        C: (5,).
        D: (6,).
        current_per_angle: change of the requested current per jump of the measured angle [A/rad].

    Args:
        joint: data sheet and gains.
        period: servo period [s].
        loop: the controlled quantity.

    Raises:
        Refusal: as `Servo`.
    """

    def __init__(self, joint: JointServo, period: float, loop: Loop = Loop.POSITION) -> None:
        numbers = make_servo_numbers((joint,), period, math.inf)
        for limit in ("omega_limit", "current_limit", "voltage_limit"):
            numbers[limit] = math.inf
        numbers["count_angle"] = -1.0  # no target counts as reached
        gains = numbers[0]
        self.current_per_angle = float(
            gains["velocity_gain"]
            * (gains["position_gain"] * gains["theta_gain"] + abs(gains["omega_gain"]))
        )
        n = len(STATES)
        rows = np.eye(n + len(INPUTS)).tolist()
        matrix = np.array([_advance_tick(numbers, loop, row[:n], row[n:]) for row in rows]).T
        self.A, self.B = matrix[:n, :n], matrix[:n, n:]
        self.C, self.D = matrix[n, :n], matrix[n, n:]


def _advance_tick(
    numbers: Rows, loop: Loop, states: list[float], inputs: list[float]
) -> list[float]:
    law, state = servo_law(), SERVO.make_rows("servo_state", 1)
    state["known"] = 1
    for name, value in zip(STATES, states, strict=True):
        state[name] = value
    places = SERVO.make_pointer("servo_joint", numbers), SERVO.make_pointer("servo_state", state)
    theta, current, applied, target, v_target, tau = inputs
    setpoint = SERVO.make_struct("servo_wish", v_target=v_target, tau=tau)
    setpoint.least_omega = setpoint.least_current = -math.inf
    setpoint.most_omega = setpoint.most_current = math.inf
    match loop:
        case Loop.POSITION:
            setpoint.wants, setpoint.q_target = POSITION, target
        case Loop.SPEED:
            setpoint.wants, setpoint.omega = SPEED, target
        case Loop.TORQUE:
            setpoint.wants, setpoint.current = CURRENT, target
        case Loop.SPEED_LIMIT:
            setpoint.wants, setpoint.least_omega, setpoint.most_omega = CURRENT, target, target
    law.servo_joint_take(*places, theta, current, applied)
    command = law.servo_joint_drive(*places, setpoint)
    return [*(float(state[name][0]) for name in STATES), command]

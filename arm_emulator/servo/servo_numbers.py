"""Numbers of the servo law, from data sheets and gains: the numbers of `servo_joint`."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.servo.held_motor import HeldMotor, Sum, held_motor
from arm_emulator.servo.servo_config import Commanded, JointServo
from arm_emulator.servo.servo_law import SERVO, Rows


def servo_numbers(joints: tuple[JointServo, ...], period: float, supply_voltage: float) -> Rows:
    """Return the numbers of joints, (N,) rows of ``servo_joint``.

    Raises:
        Refusal: coefficients that are not finite, or a winding and a rotor that swing together so
            fast that a voltage held for a period cannot control the current.
    """
    rows = [_row(joint, period, supply_voltage) for joint in joints]
    return np.array(rows, SERVO.dtype("servo_joint"))


@lru_cache(256)  # of an arm whose numbers vary one by one
def _row(joint: JointServo, period: float, supply_voltage: float) -> tuple[Any, ...]:
    numbers = _finite_numbers(joint, period)
    if numbers is None:
        rule = "have data that finite coefficients of the control law follow from"
        raise Refusal("servo", f"joint {joint.name}", rule, joint)
    if numbers.current_kept > _MOST_KEPT:
        rule = (
            f"have a winding and a rotor that do not swing together faster than a period of "
            f"{period:g} s can control"
        )
        winding = joint.commanded
        got = (
            f"L / R = {winding.inductance / winding.resistance:.3g} s, R Mm / (Kt Kb) = "
            f"{_time_constant(joint):.3g} s"
        )
        raise Refusal("servo", f"joint {joint.name}", rule, got, _period_that_holds(joint, period))
    row = numbers.row(joint, supply_voltage)
    return tuple(row[name] for name in SERVO.dtype("servo_joint").names or ())


_MOST_KEPT = 0.9  # of a current error over a period


def _finite_numbers(joint: JointServo, period: float) -> _Numbers | None:
    try:
        numbers = _Numbers(joint, period)
    except ArithmeticError:
        return None
    return numbers if all(math.isfinite(value) for value in numbers.coefficients()) else None


def _time_constant(joint: JointServo) -> float:
    """Return how fast the motor runs up by itself [s]."""
    winding = joint.commanded
    torque_per_speed = joint.torque_constant * winding.back_emf_constant / winding.resistance
    return joint.inertia / torque_per_speed if torque_per_speed else math.inf


def _period_that_holds(joint: JointServo, period: float) -> str:
    for _ in range(_HALVINGS):
        period /= 2.0
        numbers = _finite_numbers(joint, period)
        if numbers is not None and numbers.current_kept <= _MOST_KEPT:
            return f"a period of {period:.3g} s"
    return "another motor"


_HALVINGS = 30


class _Numbers:
    """Numbers that follow from one joint's data sheet, gains and period."""

    def __init__(self, joint: JointServo, period: float) -> None:
        self.ratio = joint.gear_ratio
        self.torque_constant = joint.torque_constant
        self.rotor = joint.inertia / joint.gear_ratio**2
        self.omega_limit = joint.velocity_limit / abs(joint.gear_ratio)
        # Link torque per link speed -> motor current per motor speed.
        self.velocity_gain = joint.velocity_gain * joint.gear_ratio**2 / joint.torque_constant
        self.reset_rate = period / joint.integral_time
        self.winding: Commanded = joint.commanded
        self.motor: HeldMotor = held_motor(
            self.winding.resistance,
            self.winding.inductance,
            joint.torque_constant,
            self.winding.back_emf_constant,
            joint.inertia,
            period,
        )
        self._set_current_loop(joint, period)
        self._set_observer(math.exp(-joint.observer_bandwidth * period))

    def row(self, joint: JointServo, supply_voltage: float) -> dict[str, Any]:
        """Return the fields of ``servo_joint``."""
        motor = self.motor
        return {
            "wrap": 2**joint.encoder_bits if joint.encoder_bits else 0,
            "unsensed": int(joint.torque_bandwidth > 0.0),
            "count_angle": 2.0 * math.pi / joint.counts_per_turn,
            "ratio": self.ratio,
            "motor_turns": 1.0 / self.ratio,
            "torque_constant": self.torque_constant,
            "current_per_tau": self.ratio / self.torque_constant,
            "emf": self.winding.back_emf_constant,
            "rotor": self.rotor,
            "omega_limit": self.omega_limit,
            "current_limit": joint.current_limit,
            "voltage_limit": joint.largest_command(supply_voltage),
            "position_gain": joint.position_gain,
            "velocity_gain": self.velocity_gain,
            "reset_rate": self.reset_rate,
            "end_current": motor.current,
            "end_speed": motor.speed,
            "turn": motor.turn,
            "mean_current": self.mean_current,
            "voltage_per_current": 1.0 / self.mean_current.voltage,
            "speed_per_surplus": motor.speed_per_surplus,
            "turn_per_surplus": motor.turn_per_surplus,
            "voltage_per_surplus": motor.voltage_per_surplus,
            "current_memory": self.current_memory,
            "winding": self.kept_voltage,
            "current_voltage": self.current_voltage,
            "theta_gain": self.theta_gain,
            "omega_gain": self.omega_gain,
            "load_gain": self.load_gain,
        }

    def _set_current_loop(self, joint: JointServo, period: float) -> None:
        """Set what the voltage follows from.

        Over one period the winding alone keeps the part z = exp(-R T / L) of a current error; the
        law keeps z / 2, which also stands one period of dead time (then the poles solve
        p^2 - z p + z / 2 = 0, |p| = sqrt(z / 2) < 0.71). The mean current of the period is then off
        by `current_memory` of the error at its start.
        """
        y = self.winding.inductance / self.winding.resistance / period
        z = math.exp(-1.0 / y) if y else 0.0
        start = (1.0 - z) * y  # share of the current at the start in the mean, at a given voltage
        share = 0.5 * z / (1.0 - z)
        self.current_memory = start - (1.0 - start) * share
        # The largest voltage that the current limit leaves, beside the back EMF and the current.
        self.kept_voltage = self.winding.resistance * share
        self.current_voltage = self.winding.resistance + self.kept_voltage
        # The mean current is the change of speed and the load that it has carried.
        speed, to_current = self.motor.speed, joint.inertia / joint.torque_constant / period
        self.mean_current = Sum(
            to_current * speed.current,
            to_current * (speed.speed - 1.0),
            to_current * speed.voltage,
            to_current * speed.load + 1.0 / joint.torque_constant,
        )
        # Remainder of a current error after a period: z / 2 for a slow motor.
        current, per_volt = self.motor.current, 1.0 / self.mean_current.voltage
        self.current_kept = abs(
            current.current
            + current.voltage * per_volt * (self.current_memory - self.mean_current.current)
        )

    def _set_observer(self, p: float) -> None:
        """Place the poles of the observer, p = exp(-observer_bandwidth T).

        Its errors in angle, speed and load go on by a matrix of rows (1, b, c), (0, a, d) and
        (0, 0, 1) and are then corrected by gains times the error in angle; the gains are those for
        which the characteristic polynomial is (z - p)^2 (z - r). A slow motor has a = 1, and r = p:
        this is the g-h-k filter with fading memory (Brookner, Tracking and Kalman Filtering Made
        Easy, 1998, section 1.3). The faster the motor, the more of an error in speed is gone by
        itself.
        """
        motor = self.motor
        a = motor.speed.speed - motor.speed_per_surplus * motor.current.speed
        b = motor.turn.speed - motor.turn_per_surplus * motor.current.speed
        c = motor.turn.load - motor.turn_per_surplus * motor.current.load
        d = motor.speed.load - motor.speed_per_surplus * motor.current.load
        kept = 1.0 - abs(a) * (1.0 - p)
        r = a * kept
        self.theta_gain = 1.0 - p * p * kept
        self.load_gain = (1.0 - p) ** 2 * (1.0 - r) / (b * d + c * (1.0 - a))
        self.omega_gain = (2.0 + a - 2.0 * p - r - self.theta_gain - c * self.load_gain) / b

    def coefficients(self) -> tuple[float, ...]:
        """Return what the law multiplies and divides by."""
        motor = self.motor
        sums = (motor.current, motor.speed, motor.turn, self.mean_current)
        return (
            self.ratio,
            1.0 / self.ratio,
            self.rotor,
            self.omega_limit,
            self.velocity_gain,
            self.reset_rate,
            self.current_kept,
            self.current_memory,
            self.current_voltage,
            1.0 / self.mean_current.voltage,
            self.theta_gain,
            self.omega_gain,
            self.load_gain,
            1.0 / self.torque_constant,
            self.ratio / self.torque_constant,
            motor.speed_per_surplus,
            motor.turn_per_surplus,
            motor.voltage_per_surplus,
            *(value for one in sums for value in one),
        )

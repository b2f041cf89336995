"""Numbers of the servo law, from data sheets and gains: the numbers of `servo_joint`."""

import math
from functools import lru_cache
from itertools import chain
from typing import Any

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.servo.servo_config import JointServo
from arm_emulator.servo.servo_law import SERVO, Rows
from arm_emulator.servo.zoh_motor import Sum, ZohMotor, compute_zoh_motor

_LARGEST_REMAINDER = 0.9  # of a current error over a period
_HALVINGS = 30  # of a period, in search of one that holds


def make_servo_numbers(
    joints: tuple[JointServo, ...], period: float, supply_voltage: float
) -> Rows:
    """Return the numbers of joints, (N,) rows of ``servo_joint``.

    Raises:
        Refusal: coefficients that are not finite; a winding and a rotor that swing together so fast
            that a voltage held for a period cannot control the current.
    """
    rows = [_compute_row(joint, period, supply_voltage) for joint in joints]
    return np.array(rows, SERVO.get_dtype("servo_joint"))


@lru_cache(256)  # of an arm whose numbers vary one by one
def _compute_row(joint: JointServo, period: float, supply_voltage: float) -> tuple[Any, ...]:
    result = _compute_coefficients(joint, period)
    if result is None:
        rule = "have data that finite coefficients of the control law follow from"
        raise Refusal("servo", f"joint {joint.name}", rule, joint)
    coefficients, remainder = result
    if remainder > _LARGEST_REMAINDER:
        rule = (
            f"have a winding and a rotor that do not swing together faster than a period of "
            f"{period:g} s can control"
        )
        winding = joint.commanded
        ratios = (
            f"L / R = {winding.inductance / winding.resistance:.3g} s, R Mm / (Kt Kb) = "
            f"{_compute_time_constant(joint):.3g} s"
        )
        raise Refusal(
            "servo", f"joint {joint.name}", rule, ratios, _find_stable_period(joint, period)
        )
    row = coefficients | {
        "wrap": 2**joint.encoder_bits if joint.encoder_bits else 0,
        "unsensed": int(joint.torque_bandwidth > 0.0),
        "current_limit": joint.current_limit,
        "voltage_limit": joint.compute_largest_command(supply_voltage),
    }
    return tuple(row[name] for name in SERVO.get_dtype("servo_joint").names or ())


def _compute_time_constant(joint: JointServo) -> float:
    """Return how fast the motor runs up by itself [s]."""
    winding = joint.commanded
    torque_per_speed = joint.torque_constant * winding.back_emf_constant / winding.resistance
    return joint.inertia / torque_per_speed if torque_per_speed else math.inf


def _find_stable_period(joint: JointServo, period: float) -> str:
    for _ in range(_HALVINGS):
        period /= 2.0
        result = _compute_coefficients(joint, period)
        if result is not None and result[1] <= _LARGEST_REMAINDER:
            return f"a period of {period:.3g} s"
    return "another motor"


def _compute_coefficients(joint: JointServo, period: float) -> tuple[dict[str, Any], float] | None:
    """Return what the law multiplies by, and the share of a current error that a period leaves.

    The former are the fields of ``servo_joint`` but for its word and its limits. None: they are not
    finite.
    """
    winding, ratio, torque_constant = joint.commanded, joint.gear_ratio, joint.torque_constant
    try:
        motor = compute_zoh_motor(
            winding.resistance,
            winding.inductance,
            torque_constant,
            winding.back_emf_constant,
            joint.inertia,
            period,
        )
        loop, remainder = _compute_current_loop(joint, motor, period)
        coefficients = {
            "count_angle": 2.0 * math.pi / joint.counts_per_turn,
            "ratio": ratio,
            "motor_turns": 1.0 / ratio,
            "torque_constant": torque_constant,
            "current_per_tau": ratio / torque_constant,
            "emf": winding.back_emf_constant,
            "rotor": joint.inertia / ratio**2,
            "omega_limit": joint.velocity_limit / abs(ratio),
            "position_gain": joint.position_gain,
            # Link torque per link speed -> motor current per motor speed.
            "velocity_gain": joint.velocity_gain * ratio**2 / torque_constant,
            "reset_rate": period / joint.integral_time,
            "end_current": motor.current,
            "end_speed": motor.speed,
            "turn": motor.turn,
            "speed_per_surplus": motor.speed_per_surplus,
            "turn_per_surplus": motor.turn_per_surplus,
            "voltage_per_surplus": motor.voltage_per_surplus,
            **loop,
            **_compute_observer(motor, math.exp(-joint.observer_bandwidth * period)),
        }
    except ArithmeticError:
        return None
    sums = [value for value in coefficients.values() if isinstance(value, Sum)]
    numbers = [value for value in coefficients.values() if not isinstance(value, Sum)]
    is_finite = all(map(math.isfinite, chain((remainder,), numbers, *sums)))
    return (coefficients, remainder) if is_finite else None


def _compute_current_loop(
    joint: JointServo, motor: ZohMotor, period: float
) -> tuple[dict[str, Any], float]:
    """Return what the voltage follows from, and the share of a current error that a period leaves.

    Over one period the winding alone keeps the part z = exp(-R T / L) of a current error; the
    law keeps z / 2, which also stands one period of dead time (then the poles solve
    p^2 - z p + z / 2 = 0, |p| = sqrt(z / 2) < 0.71). The mean current of the period is then off
    by `current_memory` of the error at its start.
    """
    winding = joint.commanded
    y = winding.inductance / winding.resistance / period
    z = math.exp(-1.0 / y) if y else 0.0
    start = (1.0 - z) * y  # share of the current at the start in the mean, at a given voltage
    share = 0.5 * z / (1.0 - z)
    memory = start - (1.0 - start) * share
    # The largest voltage that the current limit leaves, beside the back EMF and the current.
    holding_voltage = winding.resistance * share
    # The mean current is the change of speed and the load that it has carried.
    speed, to_current = motor.speed, joint.inertia / joint.torque_constant / period
    mean = Sum(
        to_current * speed.current,
        to_current * (speed.speed - 1.0),
        to_current * speed.voltage,
        to_current * speed.load + 1.0 / joint.torque_constant,
    )
    # Remainder of a current error after a period: z / 2 for a slow motor.
    current, per_volt = motor.current, 1.0 / mean.voltage
    remainder = abs(current.current + current.voltage * per_volt * (memory - mean.current))
    return {
        "mean_current": mean,
        "voltage_per_current": per_volt,
        "current_memory": memory,
        "winding": holding_voltage,
        "current_voltage": winding.resistance + holding_voltage,
    }, remainder


def _compute_observer(motor: ZohMotor, p: float) -> dict[str, float]:
    """Return the gains of the observer for the poles p = exp(-observer_bandwidth T).

    A matrix with the rows (1, b, c), (0, a, d) and (0, 0, 1) advances its errors in angle, speed
    and load. They are then corrected by gains times the error in angle. With these gains the
    characteristic polynomial is (z - p)^2 (z - r). A slow motor has a = 1, and r = p: this is the
    g-h-k filter with fading memory (Brookner, Tracking and Kalman Filtering Made Easy, 1998,
    section 1.3). The faster the motor, the faster an error in speed decays by itself.
    """
    a = motor.speed.speed - motor.speed_per_surplus * motor.current.speed
    b = motor.turn.speed - motor.turn_per_surplus * motor.current.speed
    c = motor.turn.load - motor.turn_per_surplus * motor.current.load
    d = motor.speed.load - motor.speed_per_surplus * motor.current.load
    remainder = 1.0 - abs(a) * (1.0 - p)
    r = a * remainder
    theta = 1.0 - p * p * remainder
    load = (1.0 - p) ** 2 * (1.0 - r) / (b * d + c * (1.0 - a))
    omega = (2.0 + a - 2.0 * p - r - theta - c * load) / b
    return {"theta_gain": theta, "omega_gain": omega, "load_gain": load}

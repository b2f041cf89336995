"""Prediction of the limit cycle of a joint at rest behind its encoder."""

from __future__ import annotations

import math

import numpy as np

from arm_emulator.analysis.sampled_loop import SampledPlant
from arm_emulator.servo.servo_config import JointServo
from arm_emulator.servo.servo_law import SERVO, servo_law
from arm_emulator.servo.servo_numbers import servo_numbers

_PLACES = (0.02, 0.2, 0.4, 0.6, 0.8, 0.98)  # of the target within its count
_TIMES = 60.0  # of 1 / position_gain, the second half is evaluated
_FEWEST, _MOST = 1000, 8000  # ticks


def swing_at_rest(joint: JointServo, plant: SampledPlant, supply_voltage: float) -> float:
    """Return the limit cycle of a link at rest, peak to peak [rad].

    The actual servo, with limits and counts, holds one joint that nothing else moves, at several
    positions of its target within a count; the worst result is returned. About one count remains
    behind any encoder, which cannot resolve drift within one. More is a limit cycle: each count
    changes the observed speed, and thus the current, by more than the joint can stand.

    Args:
        joint: data sheet, gains and limits.
        plant: one joint, sampled.
        supply_voltage: largest voltage [V].
    """
    period = plant.period
    law, numbers = servo_law(), servo_numbers((joint,), period, supply_voltage)
    ticks = round(_TIMES / joint.position_gain / period)
    ticks = min(max(ticks, _FEWEST), _MOST)
    count = 2.0 * math.pi / joint.counts_per_turn
    # The same joint at all places, side by side.
    states = SERVO.rows("servo_state", len(_PLACES))
    data = SERVO.pointer("servo_joint", numbers)
    servos = [
        (data, SERVO.pointer("servo_state", states[k : k + 1]), (5.0 + place) * joint.count_angle)
        for k, place in enumerate(_PLACES)
    ]
    seen = np.array([plant.current[0], plant.theta[0] / count])
    x, V = np.zeros((len(plant.F), len(servos))), np.zeros(len(servos))
    q = np.empty((ticks, len(servos)))
    for k in range(ticks):
        current, theta = seen @ x
        current += plant.current_by_command[0] * V
        counts = np.floor(theta).astype(int)
        now = zip(servos, counts.tolist(), current.tolist(), V.tolist(), strict=True)
        for j, ((data, state, target), at, one, given) in enumerate(now):
            law.servo_joint_observe(data, state, at, one, given)
            V[j] = law.servo_joint_control(data, state, target, 0.0, 0.0)
        x = plant.F @ x + plant.G[:, :1] * V
        q[k] = plant.q[0] @ x
    return float(np.ptp(q[ticks // 2 :], axis=0).max())

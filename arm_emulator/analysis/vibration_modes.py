"""Modes in which an arm under its servos swings, and how much each of them moves the tool.

The machine is linearised about rest in a pose, with gears wound up by the weight (`linearise`). The
linear model is sampled exactly, and the servo law that runs closes its loop (`LinearServo`).
"""

from dataclasses import dataclass

import numpy as np

from arm_emulator.analysis.linear_servo import LinearServo
from arm_emulator.analysis.linearised import linearise
from arm_emulator.analysis.sampled_loop import SampledLoop, SampledPlant
from arm_emulator.analysis.servo_loop import count_delay_periods
from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.motion.model.kinematics import POSITION_ROWS, Kinematics
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator.servo.zoh_motor import discretise_zoh

DAMPED = 0.7
_SLOWEST = 0.5  # Hz: what is slower is drift
_AT_ONCE = 1e-6  # a factor per servo period: what decays faster does not swing
_SINGULAR = 1e-2  # of the largest singular value of the Jacobian: no line is taken there


@dataclass(frozen=True)
class VibrationMode:
    """A mode of machine and servos."""

    frequency: float
    """Undamped frequency [Hz]."""
    damping: float
    """Damping ratio."""
    swing: float
    """Amplitude of the tool after its target, sent with its speed, has begun to accelerate at once
    along the line that excites the mode most, per acceleration [m/(m/s2)]. An elastic joint whose
    motor is held firmly has 1 / (2 pi frequency)^2."""


def find_vibration_modes(
    plant: Plant, servo: ServoConfig, q: Array, damped: float = DAMPED
) -> list[VibrationMode]:
    """Return the modes in a pose q (N,), those that swing the tool most first.

    Args:
        plant: the machine; every joint has a motor.
        servo: of the scene's joints.
        q: in the scene's order of joints [rad or m].
        damped: largest damping ratio; a mode with more does not swing.

    Raises:
        Refusal: see `linearise`, `LinearServo`.
    """
    from scipy import linalg  # takes long to import

    scene, period = plant.scene, servo.period
    kinematics = Kinematics(scene.true_urdf, scene.joint_names, scene.tool)
    linear = linearise(plant, q)
    by_name = {joint.name: joint for joint in servo.joints}
    joints = [by_name[name] for name in scene.joint_names]
    n = len(linear.A)
    counts = [joint.counts_per_turn for joint in scene.joints]
    scale = np.array([[a / b.counts_per_turn] for a, b in zip(counts, joints, strict=True)])
    sampled = SampledPlant(
        *discretise_zoh(linear.A, linear.B, period),
        scale * linear.theta_m,
        linear.current,
        np.diag(linear.current_by_u),
        np.eye(n)[linear.q],
        period,
    )
    loop = SampledLoop(
        sampled, [LinearServo(joint, period) for joint in joints], count_delay_periods(scene)
    )
    jacobian = kinematics.jacobian(q)
    tool = jacobian[:POSITION_ROWS]
    lines = np.linalg.pinv(jacobian, rcond=_SINGULAR)[:, :POSITION_ROWS]  # joints along the axes
    poles, left, right = linalg.eig(loop.A, left=True, right=True)
    modes = []
    for z, w, x in zip(poles, left.T, right.T, strict=True):
        if abs(z) < _AT_ONCE or z.imag <= 0.0:
            continue
        rate = np.log(z) / period
        frequency, damping = abs(rate) / (2.0 * np.pi), -rate.real / abs(rate)
        if frequency < _SLOWEST or damping > damped:
            continue
        # A target comes with its speed over the coming period: (z - 1) / period of it.
        by_target = w.conj() @ (loop.B[:, 0] + loop.B[:, 1] * (z - 1.0) / period) / (w.conj() @ x)
        by_step = np.linalg.norm(by_target @ lines / (1.0 - z))
        swing = 2.0 * np.linalg.norm(tool @ x[linear.q]) * by_step / abs(rate) ** 2
        modes.append(VibrationMode(float(frequency), float(damping), float(swing)))
    return sorted(modes, key=lambda mode: -mode.swing)

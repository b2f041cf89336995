"""Synthetic records of a scene by the emulator, with known truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene
from arm_emulator_identification.measured_run import MeasuredRun

WAVES = 4  # of the motion of each joint
SLOWEST, FASTEST = 0.1, 0.7  # Hz
AROUND = 0.6  # rad or m: amplitude of the joints


def make_record(scene: Scene, seed: int, seconds: float, angle_noise: float = 0.0,
                torque_noise: float = 0.0, numbers: Mapping[str, float] | None = None,
                drift: Callable[[float], Mapping[str, float]] | None = None,
                link_noise: float | None = None) -> MeasuredRun:  # fmt: skip
    """Drive a scene's torque motors along a smooth motion and record what drives would measure.

    A stiff controller of each motor's angle computes its torques, without knowledge of the
    machine.

    Args:
        scene: the truth; with torque-commanded motors.
        seed: of the motion and of the noise.
        seconds: of the record.
        angle_noise: standard deviation of motors' angles at the link [rad or m].
        torque_noise: of torques, as a share of their standard deviation.
        numbers: values of the scene's varied numbers.
        drift: of varied numbers, from 0 at the beginning to 1 at the end of the record.
        link_noise: standard deviation of encoders at the links [rad or m]; None: no encoder.
    """
    rng = np.random.default_rng(seed)
    N, period = len(scene.joints), scene.servo_period
    ratio = scene.gear_ratios
    t: Array = period * np.arange(round(seconds / period) + 1.0, dtype=np.float64)
    target = _make_motion(rng, t, scene.start)
    rate = np.gradient(target, period, axis=0)
    plant = Plant(scene)
    for name, value in (numbers or {}).items():
        plant.set_parameter(name, value)
    plant.reset(target[0], rate[0])
    stiff = _choose_gains(scene)
    q, tau, at_link = (np.zeros((len(t), N)) for _ in range(3))
    for k in range(len(t)):
        if drift is not None and k % 25 == 0:
            for name, value in drift(k / len(t)).items():
                plant.set_parameter(name, value)
        state = plant.state
        q[k], at_link[k] = state.theta_m * ratio, state.q
        position, speed = target[k] - q[k], rate[k] - state.omega_m * ratio
        tau[k] = ratio * (stiff[0] * position + stiff[1] * speed)
        plant.advance(tau[k], scene.steps_per_period)
    # Half of the command before an instant acts around it.
    applied = 0.5 * (tau + np.vstack([tau[:1], tau[:-1]]))
    deviation = applied.std(axis=0)
    return MeasuredRun(
        where=f"record {seed}",
        joints=scene.joint_names,
        t=t,
        q_motor=q + angle_noise * rng.standard_normal(q.shape),
        tau=applied + torque_noise * deviation * rng.standard_normal(q.shape),
        q_link=None if link_noise is None else at_link + link_noise * rng.standard_normal(q.shape),
    )


def _make_motion(rng: np.random.Generator, t: Array, start: Array) -> Array:
    """Return a sum of waves for each joint that begins at rest at the start (K, N)."""
    rows = np.tile(start, (len(t), 1))
    for j in range(len(start)):
        for f in rng.uniform(SLOWEST, FASTEST, WAVES):
            size = AROUND / WAVES * rng.uniform(0.5, 1.5) * rng.choice([-1.0, 1.0])
            rows[:, j] += size * (1.0 - np.cos(2.0 * np.pi * f * t)) * 0.5
    return rows


def _choose_gains(scene: Scene) -> tuple[Array, Array]:
    """Return gains of position and speed (N,), for 6 Hz at the inertia of each joint."""
    plant = Plant(scene)
    N, q = len(scene.joints), scene.start
    at_rest = np.zeros(N)
    base = plant.links.accelerations(q, at_rest, at_rest)
    inverse = [plant.links.accelerations(q, at_rest, row) - base for row in np.eye(N)]
    carried = [getattr(joint.motor, "rotor_inertia", 0.0) / joint.gear.ratio**2
               for joint in scene.joints]  # fmt: skip
    inertia = np.diag(np.linalg.inv(np.array(inverse))) + np.array(carried)
    w = 2.0 * np.pi * 6.0
    return inertia * w**2, 1.4 * inertia * w

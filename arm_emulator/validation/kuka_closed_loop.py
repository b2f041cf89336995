"""The identified KUKA under our own servo, which gets the command of the real machine.

No data of windings and encoders are published. They are assumed here because our servo commands
voltages; its current control hides them. The real controller is unknown: that ours needs the same
torques for the same motion depends on the machine, its lag behind the command on the gains.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from arm_emulator.design.joint_gains import design, joint_servo
from arm_emulator.design.tuned import data_of, link_inertias
from arm_emulator.identification.filtered import Filtered, filtered
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.torque_fit import explained
from arm_emulator.machine.chain import Array
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.machine.session import Session
from arm_emulator.servo.drives import Drives, Target
from arm_emulator.servo.servo_config import ServoConfig

PERIOD = 1e-3  # s, of the servo
COUNTS = 65536  # per turn of a motor, assumed
# Assumed: 450 V at the fastest motors' 450 rad/s, of 600 V; 10 ms of L/R.
WINDING = {"resistance": 0.2, "inductance": 2e-3, "torque_constant": 1.0, "back_emf_constant": 1.0}
VELOCITY_LIMIT = 5.0  # rad/s, beyond all axes' own


@dataclass(frozen=True)
class ClosedLoop:
    """A run under our servo, of each joint (N,)."""

    explained: Array  # % of the measured torque in motion, by the torque of our servo's motors
    lag: Array  # rad, root of mean square of command less motor
    measured_lag: Array  # rad, the same of the real machine


def closed_loop(run: MeasuredRun, data: Filtered, frequency: float) -> ClosedLoop | None:
    """Let the scene's machine follow a run's command; None: the run has no command.

    Args:
        run: the record.
        data: the record low-passed, every sample.
        frequency: of that low-pass [Hz].

    Raises:
        Diverged: the machine did.
    """
    if run.q_ref is None:
        return None
    scene = _with_windings(run.q_ref[0])
    command = CubicSpline(run.t, run.q_ref)
    speed = command.derivative()
    session, drives = Session(scene, "lockstep", "first_answer"), Drives(_servo(scene))
    ratio = scene.gear_ratios
    every, rows = round(run.period / PERIOD), list[Array]()
    torque_constant = WINDING["torque_constant"]
    for tick in range(every * len(run.t)):
        measured = session.measured
        counts, current = measured.encoder_counts, measured.current
        drives.measure(session.logical_ns, counts, current, session.measured.applied)
        t = min(run.t[0] + tick * PERIOD, run.t[-1])
        drives.aim(Target(command(t), speed(t)))
        if tick % every == 0:
            rows.append(np.array([session.state.theta_m * ratio, torque_constant * current]))
        applied = drives.command(session.powered).tolist()
        session.offer(tick, list(scene.joint_names), applied)
        session.advance()
        if session.fault is not None:
            raise session.fault
    q_motor, tau = np.moveaxis(np.array(rows), 1, 0)
    emulated = dataclasses.replace(run, q_motor=q_motor, tau=tau, q_link=None, v_motor=None)
    torques = filtered(emulated, ratio, frequency, every=1).tau
    lags = [np.sqrt(np.mean((run.q_ref - q) ** 2, axis=0)) for q in (q_motor, run.q_motor)]
    return ClosedLoop(explained(data.tau, torques - data.tau, data.moving), *lags)


def _with_windings(start: Array) -> Scene:
    """Return the machine with motors that take voltages, at the command's beginning."""
    known = load_scene("kuka_kr300")
    overrides = {f"joints.*.motor.{key}": value for key, value in WINDING.items()}
    at = {
        f"joints.{name}.start": float(q) for name, q in zip(known.joint_names, start, strict=True)
    }
    return load_scene(
        "kuka_kr300",
        {
            "joints.*.motor.kind": "dc",
            "joints.*.encoder": {"counts_per_turn": COUNTS},
            "servo_period": PERIOD,
            "integrator.dt": PERIOD,
            **overrides,
            **at,
        },
    )


def _servo(scene: Scene) -> ServoConfig:
    """Return our servo with computed gains; all axes have the position gain of the slowest."""
    joints = []
    for joint, inertia in zip(scene.joints, link_inertias([scene]), strict=True):
        motor, gear = data_of(joint)
        gains = design(motor, gear, inertia, PERIOD, joint.friction.viscous, scene.supply_voltage)
        one = joint_servo(motor, gear, gains, joint.name)
        joints.append(dataclasses.replace(one, velocity_limit=VELOCITY_LIMIT))
    slowest = min(joint.position_gain for joint in joints)
    same = tuple(dataclasses.replace(joint, position_gain=slowest) for joint in joints)
    return ServoConfig(PERIOD, PERIOD, 1.0, 2.0, scene.supply_voltage, same)

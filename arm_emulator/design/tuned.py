"""A set of gains, and what it does: linear, over the poses of an arm, and on the machine itself."""

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.analysis.sampled_loop import Margins
from arm_emulator.analysis.servo_loop import (
    ServoLoops,
    describe_lacking_margins,
    draw_poses,
    slow_loops,
)
from arm_emulator.analysis.stability import compute_rest
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.design.joint_gains import GearData, MotorData, compute_gains
from arm_emulator.design.sizing import round_figure
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.session.session import Session
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.servo.servo_config import JointServo, ServoConfig

Range = tuple[float, float]

POSES = 48  # over which link inertias are looked for
ROWS = 400  # of a step response
SETTLE, MOVE, REST = 1.0, 1.0, 6.0  # s of the run on the machine; what sticks creeps to rest
OBSERVED = 0.75  # s of the rest
TURN, SLIDE = 0.2, 0.05  # rad, m: the move
_SOFTER = 0.7  # where a whole arm leaves too little margin
# A joint that is so many times as fast as the slowest of a group begins another one.
_APART = 8.0
HOLDS = 2.0  # times the torque per angle with which a link falls, that a loop holds it
_NUDGE = 1e-4  # rad or m, over which that torque is taken
_ROUNDS = 8


@dataclass(frozen=True)
class Step:
    """A link's answer to a step of its target, at its worst over the poses."""

    rise: float  # s, from 10 to 90 %
    overshoot: float
    settling: float  # s, to 2 %


@dataclass(frozen=True)
class TuningRun:
    """A smooth move of all joints at once, on the machine itself."""

    off: Array  # (K, N) link less target, over the move
    swing: Array  # (N,) of the links at rest, from end to end
    period: float

    @property
    def worst(self) -> Array:
        """Largest tracking error (N,) [rad or m]."""
        out: Array = np.abs(self.off).max(axis=0)
        return out


@dataclass(frozen=True)
class Tuned:
    """One set of gains, and what it does."""

    servo: ServoConfig
    margins: list[Margins]
    bare: list[Margins] | None  # without the payload
    steps: list[Step]
    run: TuningRun
    loops: ServoLoops


def compute_link_inertias(scenes: list[Scene]) -> list[Range]:
    """Return what each joint moves over the poses of all scenes, least and largest [kg m2, kg].

    The least with all other joints free, 1 / (M^-1)_jj, the largest with the others held, M_jj.
    """
    smallest, largest = [], []
    for scene in scenes:
        scene.refuse_bearings("tuning")
        plant = Plant(scene)
        for q in draw_poses(scene, POSES):
            M_inverse, _ = compute_rest(plant, q)
            smallest.append(1.0 / np.diag(M_inverse))
            largest.append(np.diag(np.linalg.inv(M_inverse)))
    low, high = np.min(smallest, axis=0), np.max(largest, axis=0)
    return list(zip(low.tolist(), high.tolist(), strict=True))


def compute_falls(scene: Scene) -> Array:
    """Return the largest torque per angle with which each link falls over the poses of a scene.

    The weight of what stands over a joint grows with its angle, (N,) [N m/rad, N/m]; 0 where all
    that a joint moves hangs from it.
    """
    scene.refuse_bearings("tuning")
    plant, N = Plant(scene), len(scene.joints)
    still, unit, steepest = np.zeros((N, N)), np.eye(N), np.zeros(N)
    for q in draw_poses(scene, POSES):
        M_inverse, balancing = compute_rest(plant, q)
        M, at, weight = np.linalg.inv(M_inverse), np.tile(q, (N, 1)), np.tile(balancing, (N, 1))
        ahead, behind = (
            plant.links.accelerations(at + side * _NUDGE * unit, still, weight)
            for side in (1.0, -1.0)
        )
        steepest = np.maximum(steepest, np.diag(M @ (ahead - behind).T) / (2.0 * _NUDGE))
    return steepest


def compute_group_gains(gains: list[float]) -> list[float]:
    """Return the position gains of joints that keep together: in groups, that of the slowest.

    Args:
        gains: of each joint alone [1/s].
    """
    slowest, first = dict[float, float](), 0.0
    for gain in sorted(gains):
        first = gain if gain >= _APART * first else first
        slowest[gain] = first
    return [slowest[gain] for gain in gains]


def hold_falling_link(joint: JointServo, fall: float, alone: float) -> JointServo:
    """Return a joint's servo whose loop holds a link that falls [N m/rad]; itself if it does.

    The loop's stiffness, velocity_gain * position_gain, has to exceed `fall`. Where it does not, it
    is that of the joint alone beside the fall, so that the link is placed as without one. The
    remaining stiffness places the integral, as the whole stiffness does elsewhere: 5 /
    position_gain without a fall.

    Args:
        joint: its servo.
        fall: torque per angle with which its link falls [N m/rad].
        alone: position gain that the joint has without regard to others [1/s].
    """
    K = joint.velocity_gain
    if K * joint.position_gain >= HOLDS * fall:
        return joint
    stiffness = max(HOLDS * fall, K * alone + fall)
    left = stiffness - fall
    gain, time = round_figure(stiffness / K), round_figure(5.0 * K * stiffness / left**2)
    return dataclasses.replace(joint, position_gain=gain, integral_time=time)


def load_without_payload(file: Path, payload: float | None = None) -> tuple[Scene, Scene | None]:
    """Return a scene, and the same without its payload; None where it has none.

    Args:
        file: the scene's.
        payload: mass at the tool in place of the scene's [kg].
    """
    has = read_yaml(file).get("payload") is not None
    loaded = {} if payload is None else {"payload.mass": payload}
    without = load_scene(file, {"payload": None}) if has or payload is not None else None
    return load_scene(file, loaded), without


def tune_servo(file: Path, servo: ServoConfig) -> ServoConfig:
    """Return the servo with the gains that `tune` computes for a scene."""
    scene, without = load_without_payload(file)
    return compute_servo(
        scene, servo, compute_link_inertias([scene] if without is None else [scene, without])
    )


def compute_servo(scene: Scene, servo: ServoConfig, inertias: list[Range]) -> ServoConfig:
    """Return the servo with computed gains.

    Each joint is designed by itself (joint_gains.py). Then the joints of a group get the position
    gain of the slowest, so that the joints of a tool path keep together. A joint gets more where a
    link that stands over it would fall. Last, joints whose loop has too little margin in the whole
    arm are made slower, within that.
    """
    by_name = {joint.name: joint for joint in servo.joints}
    tuned: dict[str, JointServo] = {}
    for joint, inertia in zip(scene.joints, inertias, strict=True):
        motor, gear = make_joint_data(joint)
        own = by_name[joint.name]
        gains = compute_gains(
            motor,
            gear,
            inertia,
            scene.servo_period,
            joint.friction.viscous,
            servo.supply_voltage,
            own.current_limit,
        )
        tuned[joint.name] = dataclasses.replace(own, **dataclasses.asdict(gains))
    alone = {name: joint.position_gain for name, joint in tuned.items()}
    shared = dict(zip(tuned, compute_group_gains([*alone.values()]), strict=True))
    fall = dict(zip(scene.joint_names, compute_falls(scene).tolist(), strict=True))
    joints = [
        hold_falling_link(
            dataclasses.replace(tuned[name], position_gain=shared[name]), fall[name], alone[name]
        )
        for name in servo.joint_names
    ]
    for _ in range(_ROUNDS):
        config = dataclasses.replace(servo, joints=tuple(joints))
        loops = ServoLoops(scene, config)
        little = {
            name
            for name, margins in zip(scene.joint_names, loops.compute_margins(), strict=True)
            if describe_lacking_margins(margins)
        }
        if not little:
            break
        alone |= {name: _SOFTER * alone[name] for name in little}
        joints = [
            hold_falling_link(
                slow_loops(joint, _SOFTER, servo.period), fall[joint.name], alone[joint.name]
            )
            if joint.name in little
            else joint
            for joint in joints
        ]
    return config


def make_data_sheet(joint: Joint, supply_voltage: float) -> dict[str, Any]:
    """Return what `JointServo` takes of a scene's joint beside gains and a limit of its speed.

    Args:
        joint: the joint, with a motor.
        supply_voltage: of the scene [V].
    """
    motor, data = joint.motor, joint.servo_data
    assert motor is not None and data is not None, "check_joints has refused others"
    voltage = motor.compute_largest_command(supply_voltage) if joint.unit == "V" else None
    limits = {
        "current_limit": motor.command_limit,
        "voltage_limit": None if voltage == supply_voltage else voltage,
    }
    return {
        "gear_ratio": joint.gear.ratio,
        "counts_per_turn": joint.counts_per_turn,
        "encoder_bits": (joint.encoder.bits or 0) if joint.encoder else 0,
        "rotor_inertia": motor.inertia,
        **dataclasses.asdict(data),
        **{key: value for key, value in limits.items() if value is not None},
    }


def make_joint_data(joint: Joint) -> tuple[MotorData, GearData]:
    """Return a scene's joint as the design takes it."""
    motor, gear = joint.motor, joint.gear
    data = joint.servo_data
    assert motor is not None and data is not None, "check_joints has refused others"
    return (
        MotorData(
            data.resistance,
            data.inductance,
            data.torque_constant,
            data.back_emf_constant,
            motor.inertia,
            joint.counts_per_turn,
            data.current_bandwidth,
            0.0 if joint.rotor_friction is None else joint.rotor_friction.viscous,
            data.torque_bandwidth,
        ),
        GearData(gear.ratio, gear.stiffness, gear.damping),
    )


def examine_gains(scene: Scene, without: Scene | None, servo: ServoConfig) -> Tuned:
    """Return what gains do: linear, over the poses, and in a run of the machine."""
    loops = ServoLoops(scene, servo)
    return Tuned(
        servo,
        loops.compute_margins(),
        None if without is None else ServoLoops(without, servo).compute_margins(),
        [_compute_step(loops, j) for j in range(len(scene.joints))],
        run_move(scene, servo),
        loops,
    )


def _compute_step(loops: ServoLoops, joint: int) -> Step:
    period = loops.servo.period
    every = max(1, round(12.0 / loops.joints[joint].position_gain / period / ROWS))
    worst = Step(0.0, 0.0, 0.0)
    for loop in loops.loops:
        q = loop.compute_step_response(joint, ROWS, every)[:, joint]
        off = np.flatnonzero(~(np.abs(q - 1.0) <= 0.02))
        settled = math.inf if off[-1] == ROWS - 1 else float(off[-1] + 1) * every * period
        rise = float(np.argmax(q >= 0.9) - np.argmax(q >= 0.1)) * every * period
        over = float(q.max()) - 1.0
        worst = Step(
            max(worst.rise, rise), max(worst.overshoot, over), max(worst.settling, settled)
        )
    return worst


def run_move(scene: Scene, servo: ServoConfig) -> TuningRun:
    """Move all joints of the machine at once, smoothly (jerk without jumps), and let it rest."""
    session, drives = Session(scene, "lockstep", "first_answer"), ServoArm(servo)
    order = [scene.joint_names.index(name) for name in servo.joint_names]
    by_name = {joint.name: joint for joint in servo.joints}
    kinds = [by_name[joint.name] for joint in scene.joints]
    distance = np.array(
        [SLIDE if joint.kind == "prismatic" else TURN for joint in scene.chain.joints]
    )
    # The peak speed of the quintic is 1.875 way / time: half of what the servos may ask for.
    limits = np.array([joint.velocity_limit for joint in kinds])
    time = max(MOVE, float((1.875 * distance / (0.5 * limits)).max()))
    period = servo.period
    every = max(1, round(servo.motion_period / period))
    ticks = round((SETTLE + time + REST) / period)
    begin, end = round(SETTLE / period), round((SETTLE + time) / period)
    off, q_late = [], []
    for tick in range(ticks):
        state, measured = session.state, session.measured
        counts, current = measured.encoder_counts[order], measured.current[order]
        drives.take_measurement(
            session.logical_ns, counts, current, session.measured.applied[order]
        )
        s, rate = _compute_quintic((tick - begin) * period / time)
        if tick % every == 0:
            q = scene.start + s * distance
            drives.set_target(Target(q[order], (rate / time * distance)[order]))
        command = drives.compute_commands(session.powered)
        if begin <= tick < end:
            off.append(state.q - scene.start - s * distance)
        if tick >= ticks - round(OBSERVED / period):
            q_late.append(state.q)
        session.offer(tick, list(servo.joint_names), command.tolist())
        session.advance()
        if session.fault is not None:
            raise session.fault
    return TuningRun(np.array(off), np.ptp(np.array(q_late), axis=0), period)


def _compute_quintic(s: float) -> tuple[float, float]:
    """Return how far along a smooth way from 0 to 1 is, and its rate."""
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) ** 2

"""Our servo on every kind of motor: steps against the linear prediction, without a network and over
a field bus, gains that are computed, and refusals of what does not fit."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from draws import FULL, some, with_slow
from machines import CONFIG

from arm_emulator import (
    OfflineRun,
    Plant,
    Pose,
    Refusal,
    Scene,
    Session,
    load_scene,
    load_servo_config,
)
from arm_emulator.analysis.servo_loop import ServoLoops
from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.design.tuned import (
    compute_link_inertias,
    compute_servo,
    make_data_sheet,
    run_move,
)
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.scene.known_parts import MOTORS, SIZED_MOTORS
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.runs.gains import check_joints
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator_fieldbus.drives import Drives as FieldBus
from arm_emulator_fieldbus.drives_unit import ETHERCAT
from oracles.part_truths import draw_part

ROTOR = {"rotor_inertia": 1.0e-4}
DC = {"resistance": 1.5, "inductance": 3e-3, "torque_constant": 0.1, "back_emf_constant": 0.1}
KINDS: dict[str, dict[str, Any]] = {
    "dc": {**DC, **ROTOR},
    "dc with a current loop": {
        **DC, **ROTOR, "current_limit": 20.0, "current_loop": {"bandwidth": 800.0}
    },
    "pmsm": {
        "kind": "pmsm", "resistance": 1.0, "inductance_d": 2e-3, "inductance_q": 3e-3,
        "flux": 0.02, "pole_pairs": 4, **ROTOR,
    },
    "torque": {"kind": "torque", "torque_limit": 3.0, "bandwidth": 200.0, **ROTOR},
    "torque at once": {"kind": "torque", "torque_limit": 3.0, **ROTOR},
    "current": {
        "kind": "current", "torque_constant": 0.1, "current_limit": 30.0, "bandwidth": 200.0,
        **ROTOR,
    },
    "current at once": {
        "kind": "current", "torque_constant": 0.1, "current_limit": 30.0, **ROTOR
    },
    "pmsm with current loops": {
        "kind": "pmsm", "resistance": 1.0, "inductance_d": 2e-3, "inductance_q": 3e-3,
        "flux": 0.02, "pole_pairs": 4, **ROTOR,
        "current_limit": 30.0, "current_loop": {"bandwidth": 800.0},
    },
}  # fmt: skip
# Kinds that have a file and no line above, as they are sized.
KINDS |= {
    kind.kind: {"kind": kind.kind, **ROTOR, **draw_part(kind, np.random.default_rng(1))}
    for kind in SIZED_MOTORS
    if kind.kind not in {value.get("kind", "dc") for value in KINDS.values()}
}
CASES = some(
    ["torque", "pmsm with current loops", "current at once", *KINDS], 3
)  # all kinds in full
STEP = 2e-3  # rad
ROWS = 300  # servo periods


def machine(kind: str) -> Scene:
    """The paper's arm with other motors, and encoders that are as good as ideal."""
    encoder = {"counts_per_turn": 2**24}
    motor = {"joints.*.motor": KINDS[kind], "joints.*.encoder": encoder}
    return load_scene("three_axis", {**motor, "joints.*.friction.coulomb": None})


def servo_of(scene: Scene) -> ServoConfig:
    """Gains that are computed for it, from the data sheet in its scene."""
    return compute_servo(scene, describe(scene), compute_link_inertias([scene]))


def describe(scene: Scene) -> ServoConfig:
    """The data sheet in its scene, with gains for another machine."""
    servo = load_servo_config(find_beside(find_scene("three_axis"), "servo"))
    servo_joints = {joint.name: joint for joint in servo.joints}
    joints = tuple(
        dataclasses.replace(
            servo_joints[joint.name], **make_data_sheet(joint, scene.supply_voltage)
        )
        for joint in scene.joints
    )
    return dataclasses.replace(servo, joints=joints)


def test_every_kind_states_the_numbers_that_a_servo_needs() -> None:
    for kind in MOTORS:
        for name in (
            "servo_data",
            "torque_per_command",
            "compute_largest_command",
            "reflect_to_link",
        ):
            assert name in vars(kind), f"{kind.__name__} states no {name}"


OTHERS = [kind for kind in MOTORS if kind not in SIZED_MOTORS]


@pytest.mark.parametrize("kind", OTHERS, ids=lambda kind: kind.kind)
def test_a_motor_that_is_not_sized_is_refused_with_our_servo(kind: type[Motor]) -> None:
    good = load_scene("three_axis")
    motor = {"kind": kind.kind, **ROTOR, **draw_part(kind, np.random.default_rng(1))}
    scene = load_scene("three_axis", {"joints.elbow.motor": motor})
    with pytest.raises(Refusal, match=r"elbow\.motor\.kind must be one that our servo drives"):
        check_joints(scene, describe(good))
    with pytest.raises(Refusal, match=r"elbow\.motor\.kind must be one that our servo drives"):
        FieldBus(Plant(scene), describe(good), ETHERCAT)


def predicted(scene: Scene, servo: ServoConfig, joint: int) -> np.ndarray:
    (loop,) = ServoLoops(scene, servo, at=[scene.start]).loops
    return loop.compute_step_response(joint, ROWS + 1)


@pytest.mark.parametrize("kind", with_slow(dict.fromkeys(CASES), 1))
def test_a_step_is_the_linear_prediction(kind: str) -> None:
    """Of the joint that steps and of those that feel it. The step is small, so that what is not
    linear (angles, speeds times currents) is below a hundredth."""
    scene = machine(kind)
    servo = servo_of(scene)
    check_joints(scene, servo)
    for joint in range(3) if FULL else (1,):
        session, drives = Session(scene, "lockstep", "first_answer"), ServoArm(servo)
        q = [session.state.q]
        target = scene.start.copy()
        target[joint] += STEP
        measured = session.measured
        # The angle that the encoders show is the middle of a count.
        drives.servo.observe(measured.encoder_counts, measured.current)
        offset = drives.servo.q_measured - scene.start
        drives.reset()
        for tick in range(ROWS):
            measured = session.measured
            drives.take_measurement(
                session.logical_ns, measured.encoder_counts, measured.current, measured.applied
            )
            drives.set_target(Target(target + offset))
            command = drives.compute_commands(session.powered)
            session.offer(tick, list(scene.joint_names), command.tolist())
            session.advance()
            q.append(session.state.q)
        moved = (np.array(q) - scene.start) / STEP
        expected = predicted(scene, servo, joint)
        off = float(np.abs(moved - expected).max())
        assert off < 0.02, f"{kind}, joint {joint}: off by {off:.3g} of the step"
        assert moved[-1, joint] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("kind", dict.fromkeys(CASES))
def test_a_drive_on_a_field_bus_does_the_same(kind: str) -> None:
    """Cyclic synchronous position: a step of the target, in counts."""
    scene = machine(kind)
    servo = servo_of(scene)
    drives = FieldBus(Plant(scene), servo, ETHERCAT)
    N, joint = 3, 1
    for j in range(N):
        drives.write(j, 0x6060, 8)
        drives.write(j, 0x2001, 0)  # the jump's speed is not fed forward
    drives.period(3)
    for word in (6, 7, 15):
        for j in range(N):
            drives.write(j, 0x607A, drives.read(j, 0x6064))
            drives.write(j, 0x6040, word)
        drives.period(3)
    assert all(drives.read(j, 0x6041) & 0x6F == 0x27 for j in range(N)), "enabled"
    began = drives.plant.state.q
    count = scene.joints[joint].gear.ratio * 2.0 * math.pi / 2**24
    counts = round(STEP / count)
    drives.write(joint, 0x607A, drives.read(joint, 0x6064) + counts)
    q = [began]
    for _ in range(ROWS):
        drives.period()
        q.append(drives.plant.state.q)
    moved = (np.array(q) - began) / (counts * count)
    expected = predicted(scene, servo, joint)
    late = [float(np.abs(moved[k:] - expected[: ROWS + 1 - k]).max()) for k in range(3)]
    assert min(late) < 0.02, f"{kind}: off by {late} of the step with so many periods of delay"


@pytest.mark.parametrize("kind", dict.fromkeys(CASES))
def test_an_arm_is_moved_by_its_motion_controller(kind: str) -> None:
    """The offline run, which does what the nodes do: 5 mm of the tool, and at rest there."""
    scene = machine(kind)
    motion = load_motion_config(find_beside(find_scene("three_axis"), "motion"))
    offline = OfflineRun(scene, servo_of(scene), motion)
    kinematics = offline.controller.kinematics
    pose = kinematics.forward(scene.start)
    goal = pose[1] + np.array([0.0, 0.005, 0.0])
    offline.instructor.add(0, Pose(goal, pose[0]))
    offline.advance(1500)
    off = np.linalg.norm(kinematics.forward(offline.session.state.q)[1] - goal)
    assert off < 1e-4, f"{kind}: {off:.3g} m"


@pytest.mark.slow
def test_gains_hold_the_machine_in_motion() -> None:
    """A smooth move of all joints at once: torques and currents follow it as voltages do."""
    errors = {}
    for kind in dict.fromkeys(CASES):
        scene = machine(kind)
        errors[kind] = float(run_move(scene, servo_of(scene)).worst.max())
    assert max(errors.values()) < 3.0 * min(errors.values()), errors


@pytest.mark.parametrize(
    ("kind", "change", "words"),
    [
        ("torque", {"torque_bandwidth": 0.0, "resistance": 1.0},
         "torque_bandwidth must be given: the scene's motor takes a torque, got nothing"),
        ("pmsm", {"torque_bandwidth": 100.0, "torque_constant": 1.0},
         "torque_bandwidth must be absent: the scene's motor takes a voltage, got 100 Hz"),
        ("torque", {"torque_bandwidth": 0.0, "current_bandwidth": 100.0},
         "current_bandwidth must be absent: the scene's motor takes a torque, got 100 Hz"),
        ("current at once", {"current_bandwidth": 0.0, "resistance": 1.0},
         "current_bandwidth must be given: the motor's drive closes a current loop, got nothing"),
    ],
)  # fmt: skip
def test_a_servo_for_another_command_is_refused(
    kind: str, change: dict[str, float], words: str
) -> None:
    scene = machine(kind)
    servo = describe(scene)
    joints = tuple(dataclasses.replace(joint, **change) for joint in servo.joints)
    with pytest.raises(Refusal, match=words):
        check_joints(scene, dataclasses.replace(servo, joints=joints))


def test_a_drive_without_limits_is_refused_on_a_field_bus() -> None:
    unlimited = {"joints.*.motor": {"kind": "torque", **ROTOR}}
    scene = load_scene("three_axis", unlimited)
    servo = describe(scene)
    joints = tuple(dataclasses.replace(joint, current_limit=math.inf) for joint in servo.joints)
    with pytest.raises(Refusal, match=r"current_limit must be given: the rated torque of its"):
        FieldBus(Plant(scene), dataclasses.replace(servo, joints=joints), ETHERCAT)


def test_files_refuse_contradictory_data() -> None:
    good = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    plain = {
        **{key: getattr(good, key) for key in
           ("period", "motion_period", "hold_after", "cut_after", "supply_voltage")},
        "joint_names": ["waist"],
    }  # fmt: skip
    fields = {key: value for key, value in dataclasses.asdict(good.joints[0]).items()
             if key != "name" and value != math.inf}  # fmt: skip
    for change, words in (
        ({"resistance": 0.0}, "resistance must be a number > 0 ohm where the command is a voltage"),
        ({"torque_bandwidth": 5.0}, "torque_constant must be 1 with a torque_bandwidth"),
        ({"torque_bandwidth": 5.0, "torque_constant": 1.0, "current_bandwidth": 5.0},
         "torque_bandwidth must be absent together with a current_bandwidth"),
    ):  # fmt: skip
        with pytest.raises(Refusal, match=words):
            ServoConfig.from_mapping({**plain, "joints": {"waist": fields | change}}, "x.yaml")

"""Gears whose link turns against the motor: the mirror image of those whose link turns with it."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import MOTOR, list_moving_joints, write_random_chain, write_scene

from arm_emulator import Plant, Refusal, Scene, Session, load_gains, load_scene
from arm_emulator.analysis.servo_loop import ServoLoops, check_loops
from arm_emulator.base.io.config_files import find_config
from arm_emulator.design.joint_gains import GearData, MotorData, compute_gains
from arm_emulator.machine.schemes.known import SCHEMES
from arm_emulator.runs.gains import check_fit, check_joints
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.servo.servo_config import ServoConfig

ELASTIC = {"stiffness": 3e3, "damping": 3.0}
# Gears and rotors of three joints.
KINDS: dict[str, list[dict[str, Any]]] = {
    "gears": [
        {"gear": {**ELASTIC, "cubic_stiffness": 1e6}},
        {"gear": {**ELASTIC, "backlash": 0.01}},
        {"motor": {"friction": {"coulomb": 0.01, "breakaway": 0.02}}},
    ],
    "rotors": [
        {"gear": ELASTIC,
         "motor": {"friction": {"coulomb": 0.01, "breakaway": 0.02, "stribeck": 3.0}}},
        {"gear": ELASTIC, "motor": {"friction": {"coulomb": 0.01, "load": 0.2}}},
        {"gear": {"stiffness": 3e3}, "motor": {"current_limit": 3.0}},
    ],
    "both": [
        {"gear": {**ELASTIC, "cubic_stiffness": 1e6},
         "motor": {"friction": {"coulomb": 0.01, "breakaway": 0.02, "stribeck": 3.0}}},
        {"gear": {"stiffness": 3e3, "backlash": 0.01},
         "motor": {"friction": {"coulomb": 0.01, "load": 0.2}}},
        {"motor": {"friction": {"coulomb": 0.01, "breakaway": 0.02}, "current_limit": 3.0}},
    ],
}  # fmt: skip


def pair(folder: Path, rng: np.random.Generator, kind: str, scheme: str) -> list[Scene]:
    """Three random joints, and the same machine with gears the other way round."""
    urdf = write_random_chain(rng, 3)
    ratios = rng.uniform(0.01, 0.04, 3)
    scenes = []
    for sign in (1.0, -1.0):
        joints = {}
        for name, ratio, parts in zip(list_moving_joints(urdf), ratios, KINDS[kind], strict=True):
            gear = {"ratio": float(sign * ratio), **parts.get("gear", {})}
            motor = {**MOTOR, **parts.get("motor", {})}
            joints[name] = {"motor": motor, "gear": gear,
                            "friction": {"viscous": 0.2, "coulomb": 0.5}}  # fmt: skip
        place = folder / str(sign)
        place.mkdir()
        file = write_scene(
            place, urdf, joints, gravity=[0.0, 0.0, -9.81],
            integrator={"scheme": scheme, "dt": 2e-4},
        )  # fmt: skip
        scenes.append(load_scene(file))
    return scenes


@pytest.mark.parametrize(
    ("kind", "scheme"),
    some(
        [("both", "rosenbrock"), *((kind, scheme) for kind in KINDS for scheme in SCHEMES)], 1,
    ),
)  # fmt: skip
def test_turned_round_the_machine_moves_as_in_a_mirror(
    tmp_path: Path, kind: str, scheme: str
) -> None:
    rng = np.random.default_rng([len(kind), SCHEMES.index(scheme)])
    forward, mirrored = map(Plant, pair(tmp_path, rng, kind, scheme))
    for V in rng.uniform(-20.0, 20.0, (60, 3)):
        forward.advance(V, 7)
        mirrored.advance(-V, 7)
    x, y = forward.state, mirrored.state
    # The same operations with other signs.
    for name, sign in (("q", 1.0), ("v", 1.0), ("gear_torque", 1.0), ("current", -1.0),
                       ("theta_m", -1.0), ("omega_m", -1.0)):  # fmt: skip
        values, expected = sign * getattr(y, name), getattr(x, name)
        np.testing.assert_allclose(values, expected, rtol=1e-11, atol=1e-11, err_msg=name)
    assert mirrored.energy == pytest.approx(forward.energy, rel=1e-12), "energies"
    assert np.abs(x.q).max() > 1e-3, "the arm moves"


def turned_round() -> tuple[Scene, ServoConfig]:
    """Return three_axis and its servo, the gear of the shoulder the other way round."""
    scene = load_scene("three_axis", {"joints.shoulder.gear.ratio": -0.01})
    servo = load_gains(find_config("three_axis", ".yaml")).servo
    joints = tuple(
        dataclasses.replace(joint, gear_ratio=-joint.gear_ratio)
        if joint.name == "shoulder"
        else joint
        for joint in servo.joints
    )
    return scene, dataclasses.replace(servo, joints=joints)


@pytest.mark.slow
def test_a_servo_with_the_sign_of_the_gear_brings_the_arm_to_its_target() -> None:
    scene, servo = turned_round()
    motion = load_gains(find_config("three_axis", ".yaml")).motion
    check_fit(scene, servo, motion)
    assert check_loops(scene, servo) == [], "its loops have margins"
    plain = load_scene("three_axis")
    own = load_gains(find_config("three_axis", ".yaml")).servo
    for margin, plain_margin in zip(
        ServoLoops(scene, servo).compute_margins(),
        ServoLoops(plain, own).compute_margins(),
        strict=True,
    ):
        # Margins are sought over frequencies.
        assert margin.phase == pytest.approx(plain_margin.phase, rel=1e-6), (
            "margins either way round"
        )
    session, drives = Session(scene, "lockstep", "first_answer"), ServoArm(servo)
    goal = scene.start + np.array([0.1, -0.1, 0.2])
    for tick in range(3000):
        measured = session.measured
        drives.take_measurement(
            session.logical_ns, measured.encoder_counts, measured.current, measured.applied
        )
        drives.set_target(Target(goal))
        session.offer(tick, scene.joint_names, drives.compute_commands(powered=True).tolist())
        session.advance()
    # Within two counts at the link.
    off = np.abs(session.state.q - goal)
    assert (off < 2.0 * np.array([joint.count_angle for joint in servo.joints])).all(), off


def test_gains_do_not_depend_on_the_direction() -> None:
    motor = MotorData(0.5, 5e-4, 0.05, 0.05, 1e-4, 4096)
    for stiffness, damping in ((None, 0.0), (1e4, 10.0)):
        forward, backward = (
            compute_gains(motor, GearData(ratio, stiffness, damping), (0.2, 0.6), 1e-3)
            for ratio in (0.01, -0.01)
        )
        for name, value in dataclasses.asdict(forward).items():
            assert getattr(backward, name) == pytest.approx(value, rel=1e-9), name


def test_a_servo_of_the_opposite_sign_is_refused() -> None:
    """Its loops would be stable, and the arm go the other way."""
    scene, servo = turned_round()
    plain = load_gains(find_config("three_axis", ".yaml")).servo
    for machine, wrong in ((scene, plain), (load_scene("three_axis"), servo)):
        with pytest.raises(
            Refusal, match=r"shoulder\.gear_ratio must have the sign of the scene's"
        ):
            check_joints(machine, wrong)

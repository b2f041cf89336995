"""`new --motor`: arms with motors of every kind."""

from pathlib import Path

import numpy as np
import pytest
from draws import FULL, some
from torque_modes import enabled, faults

from arm_emulator import Kinematics, Refusal, load_gains, load_scene
from arm_emulator.analysis.mode_loops import list_withheld_modes
from arm_emulator.cli.commands.check_scene import check_scene
from arm_emulator.cli.commands.tune import tune_scene
from arm_emulator.design.new_scene import write_new
from arm_emulator.design.sizing import Demand, size_drives
from arm_emulator.machine.parts.motors.dc_motor import DcMotor
from arm_emulator.machine.parts.motors.motor import Motor
from arm_emulator.machine.scene.known_parts import SIZED_MOTORS
from arm_emulator.runs.gains import check_fit
from arm_emulator_fieldbus.object_dictionary import modes
from oracles.any_arm import draw_reachable, list_arms, move_arm
from oracles.own_robots import OWN

KINDS = {kind.kind: kind for kind in SIZED_MOTORS}
CASES = [(arm, kind) for arm in ("scara", "ur5_robot", "panda") for kind in KINDS]
CASES = CASES if FULL else some([("scara", kind) for kind in KINDS if kind != "dc"], 1)


@pytest.mark.parametrize("kind", SIZED_MOTORS, ids=lambda kind: kind.kind)
def test_every_kind_gives_the_requested_torque(kind: type[Motor]) -> None:
    """At its limit, and at full speed within its supply: by what it declares of itself."""
    rng = np.random.default_rng(2)
    for _ in range(50):
        demand = Demand(
            name="j", kind="revolute", start=0.0, inertia=(0.5, 2.0), coupling=(2.0,),
            gravity_torque=10.0, bare_torque=5.0, tool_weight=11.0, tool_inertia=2.1,
            effort=float(rng.uniform(30.0, 200.0)), velocity=float(rng.uniform(1.0, 6.0)),
        )  # fmt: skip
        supply, (drive,) = size_drives([demand], kind)
        joint = drive.joint
        motor = joint.motor
        assert type(motor) is kind and drive.peak_torque == demand.effort
        assert motor.command_limit is not None, "a drive on a field bus has a rated torque"
        # Three digits of each number.
        torque = motor.command_limit * joint.torque_per_command
        assert torque == pytest.approx(drive.peak_torque, rel=0.02)
        data = joint.servo_data
        assert data is not None and (data.current_bandwidth or data.torque_bandwidth) == 1000.0
        volts = motor.compute_largest_command(supply)
        if joint.decorators and volts is not None:
            speed = drive.speed / joint.gear.ratio
            used = data.back_emf_constant * speed + data.resistance * motor.command_limit
            assert used == pytest.approx(0.85 * volts, rel=0.02), "15 % are left for control"


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "kind"), CASES)
def test_an_arm_with_it_goes_where_it_is_sent_and_takes_torques(
    arm: str, kind: str, tmp_path: Path
) -> None:
    robot = list_arms().get(arm)
    if not isinstance(robot, Path):
        robot = tmp_path / f"{arm}.urdf"
        robot.write_text(OWN[arm]())
    written = write_new(robot, tmp_path / "new", motor=kind)
    scene, gains = load_scene(written.file), load_gains(written.file)
    check_fit(scene, gains.servo, gains.motion)
    assert {type(joint.motor) for joint in scene.joints} == {KINDS[kind]}
    assert all(rule in written.file.read_text() for rule in KINDS[kind].rules)
    check_scene(str(written.file))
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    rng = np.random.default_rng(3)
    for _ in range(2):
        pair = draw_reachable(kinematics, 0.05, rng)
        assert pair is not None
        motion = move_arm(scene, gains, "50 mm", *pair)
        assert not motion.words, motion.words
    assert list_withheld_modes(scene, gains.servo, modes()) == []
    if FULL:
        assert list(faults(scene, gains.servo)) == []
        assert tune_scene(str(written.file), write=True) == 0
        assert load_gains(written.file).servo == gains.servo, "new and tune agree"
    else:
        enabled(scene, gains.servo)


def test_an_unknown_kind_is_refused_with_the_valid_kinds(tmp_path: Path) -> None:
    robot = tmp_path / "scara.urdf"
    robot.write_text(OWN["scara"]())
    valid = ", ".join(KINDS)
    line = f"new: --motor must be a kind of motor that our servo drives, got steam; valid: {valid}"
    with pytest.raises(Refusal) as refusal:
        write_new(robot, tmp_path / "new", motor="steam")
    assert str(refusal.value) == line
    assert not (tmp_path / "new").exists()
    assert DcMotor.kind == SIZED_MOTORS[0].kind, "what `new` takes without the option"

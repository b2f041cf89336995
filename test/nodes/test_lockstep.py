"""Lock-step: the same bits on every run, under every load, and without a network."""

import dataclasses
import re
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from in_process import in_process
from network import (
    JOINTS,
    SharedNetwork,
    User,
    assert_same_bits,
    bits_of,
    kill,
    network,
    node,
    offline_states,
)
from sensor_msgs.msg import JointState

from arm_emulator import OfflineRun, Plant, Pose, Refusal, load_scene, load_servo_config
from arm_emulator.base.cpu_load import load_processors
from arm_emulator.base.io.config_files import find_config
from arm_emulator.cli.commands.run import run_scene as run_command
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.ros.messages.time_stamp import NANOSECONDS, convert_to_stamp
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_msgs.msg import EmulatorStatus, MotorCommand

TARGET_AT = 0.1  # s
TICKS = {"three_axis": 400, "ur5": 300}


@pytest.fixture(scope="module")
def three_nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedNetwork]:
    log = tmp_path_factory.mktemp("three_nodes")
    with closing(SharedNetwork(log, timeout=0.5, forked=False)) as shared:
        yield shared


@pytest.fixture(scope="module")
def without_motion_controller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedNetwork]:
    with closing(
        SharedNetwork(
            tmp_path_factory.mktemp("without_motion_controller"),
            start="first_answer",
            only=("emulator", "servo"),
        )
    ) as shared:
        yield shared


def target_of(scene_name: str) -> Pose:
    run = load_offline_run(scene_name)
    R_WT, p_WT = run.controller.kinematics.forward(run.session.scene.start)
    # By way of the quaternion, as in a message: the rotation has the same rounding then.
    orientation = Pose(p_WT, R_WT).quaternion()
    return Pose.from_quaternion(p_WT + np.array([0.0, 0.01, 0.0]), orientation)


def recorded(user: User, scene: str) -> dict[int, bytes]:
    """Run three processes toward the target and return their motor states."""
    user.joint_names = list(load_scene(scene).joint_names)
    begin(user, target_of(scene))
    user.wait("the run", lambda: user.tick >= TICKS[scene])
    return user.motor_states()


def begin(user: User, target: Pose) -> None:
    user.await_start()
    before = int(user.value("motion_controller", "tool targets") or 0)
    x, y, z, w = map(float, target.quaternion())
    user.send_tool_target(tuple(map(float, target.p_WT)), TARGET_AT, (x, y, z, w))
    taken = str(before + 1)
    user.wait("the target", lambda: user.value("motion_controller", "tool targets") == taken)
    assert user.call("emulator/pause", False).success


def offline(scene: str, ticks: int = 0) -> dict[int, bytes]:
    """Return the states up to a tick, at least `TICKS`."""
    run = load_offline_run(scene)
    run.instructor.add(round(TARGET_AT * 1e9), target_of(scene))
    return offline_states(run, max(ticks, TICKS[scene]))


@pytest.mark.slow
def test_three_processes_give_the_same_bits_twice_and_under_load(
    three_nodes: SharedNetwork,
) -> None:
    with three_nodes() as (user, _):
        once = recorded(user, "three_axis")
    with load_processors(2), three_nodes() as (user, _):
        again = recorded(user, "three_axis")
    assert_same_bits(once, again, TICKS["three_axis"])
    assert_same_bits(once, offline("three_axis"), TICKS["three_axis"])
    # The arm did move: otherwise equal bits would mean nothing.
    assert len(set(once.values())) > TICKS["three_axis"] // 2


@pytest.mark.slow
@pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data"
)
def test_a_run_without_a_network_gives_the_bits_of_three_processes(tmp_path: Path) -> None:
    with network(tmp_path, scene="ur5") as (user, _):
        assert_same_bits(recorded(user, "ur5"), offline("ur5"), TICKS["ur5"])


def test_the_order_of_joints_in_messages_means_nothing(tmp_path: Path) -> None:
    gains = find_config("three_axis", ".yaml", "servo").read_text()
    turned = tmp_path / "servo.yaml"
    in_order = "joint_names: [waist, shoulder, elbow]"
    assert in_order in gains
    turned.write_text(gains.replace(in_order, "joint_names: [elbow, waist, shoulder]"))
    target, expected = target_of("three_axis"), offline("three_axis")
    with in_process(servo=turned) as nodes:
        aim = PoseStamped()
        aim.header.stamp = convert_to_stamp(round(TARGET_AT * NANOSECONDS))
        p, o = aim.pose.position, aim.pose.orientation
        p.x, p.y, p.z = map(float, target.p_WT)
        o.x, o.y, o.z, o.w = map(float, target.quaternion())
        nodes.send("tool_target", aim)
        nodes.run_to(300)
        assert list(nodes.newest("joint_states").name) == ["elbow", "waist", "shoulder"]
        assert_same_bits(nodes.states, expected, 300)
    scene, motion = load_scene("three_axis"), find_config("three_axis", ".yaml", "motion")
    run = OfflineRun(scene, load_servo_config(turned), load_motion_config(motion))
    run.instructor.add(round(TARGET_AT * 1e9), target)
    assert offline_states(run, 300) == {k: v for k, v in expected.items() if k <= 300}


@pytest.mark.slow
def test_two_servos_at_once(three_nodes: SharedNetwork) -> None:
    """Two servos answer each tick: commands of the first one count until it is killed."""
    with three_nodes() as (user, nodes):
        begin(user, target_of("three_axis"))
        user.wait("the run", lambda: user.tick >= 60)
        first = nodes.get_process("servo")
        nodes.start_node("servo")
        second = nodes.get_process("servo")
        user.wait("the second", lambda: user.value("servo", "another servo"))

        def commands_of_second() -> int:
            counted = "motor_commands of another node of the same name"
            return int(user.value("emulator", counted) or 0)

        before = commands_of_second()
        user.wait("two answers", lambda: commands_of_second() >= before + 100)
        tick = user.tick
        user.wait("the run to go on", lambda: user.tick >= tick + 200)
        first.kill()
        first.wait()
        user.forget_listeners("servo")
        tick = user.tick
        user.wait("the run to go on", lambda: user.tick >= tick + 200)
        assert second.poll() is None


def test_late_responses_are_counted_and_no_fault() -> None:
    """A question that was repeated is answered twice; one reset comes before an answer."""
    with in_process() as nodes:
        health, targets = nodes.nodes["servo"]._diagnostics, []
        nodes.run_to(120)

        def sent_again(changed: float = 0.0) -> None:
            targets[:] = [nodes.newest("joint_targets")]
            targets[0].position[0] += changed

        period = 50  # ticks
        for _ in range(3):
            begin = -(-nodes.tick // period) * period
            sent_again()
            while nodes.newest("joint_states").header.stamp == targets[0].header.stamp or (
                nodes.tick < begin
            ):
                assert nodes.deliver()
            nodes.send(
                "joint_targets", targets[0]
            )  # the servo waits for the answer to the next ones
            nodes.run_to(nodes.tick + 60)
        assert health.values["joint_targets repeated"] == 3 and health.refused == 0
        # Others with that stamp answer nothing.
        begin = -(-nodes.tick // period) * period
        sent_again(changed=0.1)
        while nodes.tick < begin:
            assert nodes.deliver()
        nodes.send("joint_targets", targets[0])
        assert health.refused == 1 and "that of the joint states it answers" in str(
            health._newest_refusal
        )
        before = health.refused
        nodes.run_to(nodes.tick + 60)
        sent_again()
        assert nodes.call("emulator/reset").success
        while nodes.newest("joint_states").header.stamp.nanosec:
            assert nodes.deliver()
        nodes.send("joint_targets", targets[0])
        assert health.values["joint_targets before the reset"] == 1 and health.refused == before


@pytest.mark.slow
def test_a_killed_servo_is_waited_for_and_the_next_continues(three_nodes: SharedNetwork) -> None:
    with three_nodes() as (user, nodes):
        begin(user, target_of("three_axis"))
        user.wait("the run", lambda: user.tick >= 120)
        kill(user, nodes, "servo")

        def reported() -> bool:
            """Whether status and words agree; both may be of a tick that was waited for before."""
            words = f"waiting for the motor command that answers tick {user.status.tick}, for "
            return user.status.waiting_time > 0.5 and bool(user.printed("emulator", words))

        user.wait("the wait to be reported", reported)
        assert user.status.phase == EmulatorStatus.PHASE_WAITING and not user.status.answered
        tick = user.status.tick
        nodes.start_node("servo")
        user.wait("the run to go on", lambda: user.tick >= tick + 150)
        # Up to there nothing was lost: it waited, it did not step.
        assert_same_bits(user.motor_states(), offline("three_axis", tick), tick)


@pytest.mark.slow
def test_a_killed_motion_controller_is_waited_for_and_the_next_continues(
    three_nodes: SharedNetwork,
) -> None:
    with three_nodes() as (user, nodes):
        begin(user, target_of("three_axis"))
        user.wait("the run", lambda: user.tick >= 120)
        kill(user, nodes, "motion_controller")

        def reported() -> bool:
            words = f"waiting for the joint targets that answer t = {user.status.tick / 1000:g} s"
            return user.status.waiting_time > 0.5 and bool(user.printed("servo", words))

        user.wait("the wait to be reported", reported)
        tick = user.status.tick
        assert tick % 50 == 0  # at the start of a motion period
        nodes.start_node("motion_controller")
        user.wait("the run to go on", lambda: user.tick >= tick + 150)
        assert_same_bits(user.motor_states(), offline("three_axis", tick), tick)
        # The new motion controller has no tool target, and holds the arm until it receives one.
        user.wait(
            "it to hold", lambda: user.printed("motion_controller", "holding, no tool target")
        )
        target = target_of("three_axis")
        user.send_tool_target(tuple(map(float, target.p_WT)))
        user.wait("the tool", lambda: user.printed("motion_controller", "moving the tool"))


@pytest.mark.slow
def test_a_new_emulator_restarts_with_the_old_partners(three_nodes: SharedNetwork) -> None:
    with three_nodes() as (user, nodes):
        begin(user, target_of("three_axis"))
        user.wait("the run", lambda: user.tick >= 120)
        kill(user, nodes, "emulator")
        user.wait("the servo to notice", lambda: user.printed("servo", "no motor state for "))
        assert (
            nodes.get_process("servo").poll()
            is nodes.get_process("motion_controller").poll()
            is None
        )
        user.forget()
        nodes.start_node("emulator")
        begin(user, target_of("three_axis"))
        user.wait("the new run", lambda: user.tick >= 300)
        assert user.printed("servo", "the emulator began anew")
        assert_same_bits(user.motor_states(), offline("three_axis"), 300)


@pytest.mark.slow
def test_a_motion_controller_that_comes_last_still_gets_the_robot(
    without_motion_controller: SharedNetwork,
) -> None:
    with without_motion_controller() as (user, _):
        words = "waiting for the joint targets that answer t = 0 s"
        user.wait("the servo to wait", lambda: words in user.words["servo"])
        user.wait("tick 0", lambda: user.tick == 0)
        gains = find_config("three_axis", ".yaml", "motion")
        with node("motion_controller_node.node", "--params-file", str(gains)):
            user.wait("the run", lambda: user.tick >= 100)
        user.wait("the robot", lambda: user.description)
        assert user.description == load_scene("three_axis").urdf
        run = load_offline_run("three_axis")
        assert_same_bits(user.motor_states(), offline_states(run, 100), 100)


@pytest.mark.slow
def test_a_reset_while_the_servo_waits_for_targets(
    without_motion_controller: SharedNetwork,
) -> None:
    """The user takes the motion controller's place."""
    with without_motion_controller() as (user, _):

        def answer(time: float) -> None:
            message = JointState(name=JOINTS, position=[0.0, 0.5, 0.8])
            message.header.stamp = convert_to_stamp(round(time * NANOSECONDS))
            user.publish(user.targets, message)

        waiting = "waiting for the joint targets that answer t = "
        user.wait("t = 0", lambda: f"{waiting}0 s" in user.words["servo"])
        user.wait("the first state, stated again for late-comers", lambda: 0 in user.motor_states())
        answer(0.0)
        user.wait("t = 0.05", lambda: f"{waiting}0.05 s" in user.words["servo"])
        user.wait("tick 50", lambda: user.tick == 50)
        first = user.motor_states()
        user.forget()
        assert user.call("emulator/reset").success
        user.wait("t = 0", lambda: user.diagnostics["servo"].message == f"{waiting}0 s")
        user.wait("tick 0", lambda: user.tick == 0)
        before = user.refused("servo", "joint_targets")
        answer(0.05)  # too late: what the servo has asked for before the reset
        late = "joint_targets before the reset"
        user.wait("the count", lambda: user.value("servo", late) == "1")
        assert user.refused("servo", "joint_targets") == before
        answer(0.1)  # what nobody has asked for
        user.wait("the refusal", lambda: user.refused("servo", "joint_targets") == before + 1)
        assert user.value("servo", "newest refusal") == (
            "joint_targets: header.stamp must be that of the joint states it answers, 0 s, "
            "got 0.1 s"
        )
        assert user.tick == 0
        answer(0.0)
        user.wait("t = 0.05", lambda: user.tick == 50)
        assert_same_bits(user.motor_states(), first, 50)


def test_free_run_ends_with_the_first_answer(tmp_path: Path) -> None:
    """The user takes the servo's place."""
    with network(tmp_path, start="free_run", only=("emulator",)) as (user, _):
        user.wait("the free run", lambda: user.tick >= 20)
        user.wait("the status", lambda: user.status)
        assert user.status.phase == EmulatorStatus.PHASE_FREE_RUNNING
        user.publish(user.commands, MotorCommand(tick=3, joint_names=JOINTS, command=[0.0] * 3))
        user.wait("the end", lambda: user.status.phase == EmulatorStatus.PHASE_WAITING)
        tick = user.status.tick
        user.wait("the last state", lambda: user.tick == tick)
        volts = [3.0, 1.0, 2.0]
        elbow_first = ["elbow", "waist", "shoulder"]
        user.publish(user.commands, MotorCommand(tick=tick, joint_names=elbow_first, command=volts))
        user.wait("the next tick", lambda: user.tick == tick + 1)
        scene = load_scene("three_axis")
        plant = Plant(scene)
        plant.advance([0.0] * 3, scene.steps_per_period * tick)
        expected = bits_of(plant.measured.encoder_counts, plant.measured.current)
        assert user.motor_states()[tick] == expected
        plant.advance([1.0, 2.0, 3.0], scene.steps_per_period)
        expected = bits_of(plant.measured.encoder_counts, plant.measured.current)
        assert user.motor_states()[tick + 1] == expected
        # The same answer once more is no fault; another one to a tick that was left is.
        again = MotorCommand(tick=tick, joint_names=elbow_first, command=volts)
        user.publish(user.commands, again)
        repeated = "motor_commands repeated"
        user.wait("the count", lambda: user.value("emulator", repeated) == "1")
        assert user.refused("emulator", "motor_commands") == 0
        assert user.diagnostics["emulator"].level == DiagnosticStatus.OK
        again.command[0] += 1.0
        user.publish(user.commands, again)
        user.wait("the refusal", lambda: user.refused("emulator", "motor_commands") == 1)
        assert f"got {tick} (stale)" in user.value("emulator", "newest refusal")
        assert user.value("emulator", repeated) == "1"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"period": 2e-3, "motion_period": 0.05}, "servo.period must be the scene's servo_period"),
        ({"motion_period": 0.04}, "servo.motion_period must be motion_controller.period, 0.05 s"),
    ],
)
def test_offline_refuses_periods_that_do_not_fit(change: dict[str, float], words: str) -> None:
    servo = load_servo_config(find_config("three_axis", ".yaml", "servo"))
    motion = load_motion_config(find_config("three_axis", ".yaml", "motion"))
    with pytest.raises(Refusal, match=words):
        OfflineRun(load_scene("three_axis"), dataclasses.replace(servo, **change), motion)


def test_the_run_command_reports(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command("three_axis", seconds=3.0, displacement=(0.0, 0.01, 0.0)) == 0
    printed = capsys.readouterr().out
    assert "scene three_axis: 3 s of logical time in " in printed
    x, y, z = (float(mm) for mm in re.findall(r"[xyz] ([-+][\d.]+)", printed))
    assert max(abs(x), abs(y), abs(z)) < 0.1  # of 10 mm; the encoders' residual is 0.07 mm
    with pytest.raises(Refusal, match="run: seconds must be at least"):
        run_command("three_axis", seconds=float("nan"))
    with pytest.raises(Refusal, match="a move of the tool: position must be numbers within"):
        run_command("three_axis", seconds=1.0, displacement=(0.0, float("inf"), 0.0))

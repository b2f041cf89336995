"""No number that comes from outside ends a node, spoils its state, or passes silently."""

import math
import random
import time
from pathlib import Path

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from draws import FULL, some
from geometry_msgs.msg import PoseStamped
from in_process import InProcess, in_process
from network import JOINTS, PATIENCE, assert_same_bits, logs, network, offline_states
from random_messages import RECEIVER, TOPICS, bad_message, huge, random_message
from rosgraph_msgs.msg import Clock

from arm_emulator.motion.model.pose import Pose
from arm_emulator.runs.offline import OfflineRun, load_offline_run
from arm_emulator.view.rerun_stream import RerunStream
from arm_emulator_msgs.msg import EmulatorStatus

# A warning of NumPy's would be printed among what the nodes state.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

TICKS = 400
AIM_NS = 100_000_000


@pytest.fixture(scope="module")
def reference() -> dict[int, bytes]:
    """An undisturbed run: the tool goes aside from 0.1 s on."""
    run = load_offline_run("three_axis")
    run.instructor.add(AIM_NS, aside(run))
    return offline_states(run, TICKS)


def aside(run: OfflineRun) -> Pose:
    _, p_WT = run.controller.kinematics.forward(run.session.scene.start)
    return Pose(p_WT + np.array([0.0, 0.02, 0.0]), np.eye(3))


def aim(nodes: InProcess) -> None:
    target, p_WT = PoseStamped(), aside(load_offline_run("three_axis")).p_WT
    p = target.pose.position
    p.x, p.y, p.z = map(float, p_WT)
    target.pose.orientation.w = 1.0
    target.header.stamp.nanosec = AIM_NS
    nodes.send("tool_target", target)


@pytest.mark.parametrize("seed", some(range(3), 1))
def test_bad_messages_leave_every_bit_of_a_run(seed: int, reference: dict[int, bytes]) -> None:
    rng, printed = random.Random(seed), dict.fromkeys(RECEIVER.values(), 0)
    with in_process() as nodes:
        nodes.run_to(1)  # the motion controller knows its robot
        aim(nodes)

        def abuse() -> None:
            topic = rng.choice(TOPICS)
            name = RECEIVER[topic]
            message = bad_message(rng, topic, JOINTS, nodes.tick + rng.randrange(3))
            nodes.send(topic, message)
            printed[name] += 1
            assert nodes.refused(name) == printed[name], f"not refused on {topic}: {message}"

        nodes.run_to(TICKS, abuse)
        assert sum(printed.values()) > TICKS
        assert_same_bits(nodes.states, reference, TICKS)


def test_no_time_on_the_clock_ends_a_node_that_follows_it() -> None:
    rng = random.Random(2)
    with in_process() as nodes:
        servo = nodes.nodes["servo"]
        follow = servo._time_source.clock_callback  # as rclpy calls it with `use_sim_time`
        follow(Clock(clock=Time(sec=5)))
        for count in range(1, 500):
            follow(bad_message(rng, "clock", JOINTS, 0))
            assert servo._diagnostics.refused == count
            assert servo._time_source._last_time_set.nanoseconds == 5 * 10**9
        for _ in range(500):
            follow(random_message(rng, "clock", JOINTS, 0))
            servo._diagnostics.publish_now()


def test_the_viewer_gets_no_target_beyond_the_bound(tmp_path: Path) -> None:
    rng, run = random.Random(4), load_offline_run("three_axis")
    scene = run.session.scene
    stream = RerunStream(scene.urdf, scene.joint_names, tool=scene.tool, file=tmp_path / "a.rrd")
    for count in range(1, 200):
        stream.offer_target(rng.randrange(2**61), (0.1, huge(rng), 0.1))
        assert stream.dropped == count
    state = run.session.state
    for tick in range(3):
        stream.offer_target(tick, (1e6, -1e6, 5e-324))
        stream.show_state(tick * 10**6, state.q, state.v, state.gear_torque, state.current, state.v)
    assert stream.close(), stream.trouble
    assert stream.trouble is None and stream.dropped == count


@pytest.mark.parametrize("name", ["servo", "motion_controller"])
def test_a_controller_that_is_not_finite_reports_it_and_restarts(
    name: str, reference: dict[int, bytes]
) -> None:
    with in_process() as nodes:
        nodes.run_to(20)
        if name == "servo":
            nodes.nodes["servo"]._drives.servo.state["integral"][0] = math.nan
        else:
            nodes.nodes[name]._motion._hold = np.full(3, math.nan)
        printed = ""
        while nodes.tick < 60 and "began anew" not in printed:
            nodes.deliver()
            printed = nodes.nodes[name]._diagnostics._message
        reason = (
            "no longer finite" if name == "servo" else "must be numbers within +-1e+06 rad, got"
        )
        assert reason in printed and "began anew" in printed and "\n" not in printed
        nodes.run_to(120)
        assert nodes.nodes[name]._diagnostics.values["began anew"] == 1
        assert "began anew" not in nodes.nodes[name]._diagnostics._message, "it works again"
        assert np.isfinite(nodes.nodes["emulator"]._session.measured.applied).all()
        restart(nodes)
        nodes.run_to(TICKS)
        assert_same_bits(nodes.states, reference, TICKS)


def test_the_motion_controller_forgets_its_targets_when_it_is_reset() -> None:
    still = offline_states(load_offline_run("three_axis"), TICKS)
    with in_process() as nodes:
        nodes.run_to(1)
        aim(nodes)
        nodes.run_to(60)
        reset = nodes.call("motion_controller/reset")
        assert reset.success
        assert reset.message == "all tool targets are dropped, the arm holds its position"
        nodes.run_to(TICKS)
        assert_same_bits(nodes.states, still, TICKS)


@pytest.mark.parametrize("seed", some(range(3), 1))
def test_after_any_messages_a_reset_gives_every_bit_of_a_run(
    seed: int, reference: dict[int, bytes]
) -> None:
    """Sound ones among them may be taken; what they led to is forgotten with the resets."""
    rng = random.Random(seed)
    with in_process() as nodes:
        any_messages(nodes, rng, 2000 if FULL else 500)
        restart(nodes)
        nodes.run_to(TICKS)
        assert_same_bits(nodes.states, reference, TICKS)


@pytest.mark.slow
def test_after_any_messages_in_real_time_the_nodes_still_work() -> None:
    with in_process("realtime") as nodes:
        any_messages(nodes, random.Random(5), 2000 if FULL else 500)
        restart(nodes)
        deadline = time.monotonic() + PATIENCE
        drives = nodes.nodes["servo"]._drives
        sound = "targets and states come"
        while nodes.tick < TICKS or drives.reason != sound:
            assert time.monotonic() < deadline, (
                f"at tick {nodes.tick} the servo states {drives.reason}"
            )
            nodes.deliver()


def any_messages(nodes: InProcess, rng: random.Random, count: int) -> None:
    for turn in range(count):
        topic = rng.choice(TOPICS)
        nodes.send(topic, random_message(rng, topic, JOINTS, max(0, nodes.tick + 1)))
        nodes.deliver()
        if turn % 100 == 0:
            nodes.timers()
    for name in nodes.nodes:
        assert nodes.refused(name) > 0, f"{name} took everything"


def restart(nodes: InProcess) -> None:
    """Reset all three, and give them back their robot and the tool target of the reference."""
    assert nodes.call("emulator/pause", True).success
    while nodes.deliver():
        pass
    nodes.send("robot_description", nodes.newest("robot_description"))
    for name in ("servo", "motion_controller"):
        assert nodes.call(f"{name}/reset").success
    aim(nodes)
    nodes.forget()
    assert nodes.call("emulator/reset").success


# ---------------------------------------------------------------------------- among processes


@pytest.mark.slow
@pytest.mark.parametrize("clock", some(["realtime", "lockstep"], 1))
def test_bad_messages_do_not_disturb_three_processes(
    clock: str, tmp_path: Path, reference: dict[int, bytes]
) -> None:
    rng = random.Random(clock)
    with network(tmp_path, clock=clock) as (user, _):
        publish = {
            "motor_commands": user.commands,
            "joint_targets": user.targets,
            "motor_states": user.states,
            "tool_target": user.tool_targets,
            "joint_states": user.measured,
        }
        user.wait("the nodes to meet", lambda: user.status and user.status.answered)
        p_WT = aside(load_offline_run("three_axis")).p_WT
        user.send_tool_target(tuple(map(float, p_WT)), at=AIM_NS / 1e9)
        user.wait("it", lambda: user.value("motion_controller", "tool targets") == "1")
        for publisher in publish.values():
            user.await_listener(publisher)
        assert user.call("emulator/pause", False).success
        deadline = time.monotonic() + PATIENCE
        # Not all are read: where they come faster than that, the newest ten are kept. So they go on
        # until one of each has been read.
        while (
            waiting := [t for t in publish if not user.refused(RECEIVER[t], t)]
        ) or user.tick < TICKS:
            assert time.monotonic() < deadline, f"not refused: {waiting}; at tick {user.tick}"
            topic = rng.choice(waiting or list(publish))
            message = bad_message(rng, topic, JOINTS, 10**6 + max(0, user.tick))
            user.publish(publish[topic], message)
            user.spin(0.005)
        user.wait("the tool target to hold", lambda: user.printed("motion_controller", "moving"))
        assert user.value("motion_controller", "tool targets") == "1"
        if clock == "lockstep":
            assert_same_bits(user.motor_states(), reference, TICKS)
        else:
            user.wait(
                "the servo to follow", lambda: user.diagnostics["servo"].message == "following"
            )
            # The status is published once in a second, the run was shorter.
            user.wait(
                "the status of a running machine",
                lambda: user.status.phase == EmulatorStatus.PHASE_RUNNING,
            )
        for name in ("servo", "motion_controller"):
            assert user.value(name, "began anew") == "", f"{name} had lost its state"
    assert "Traceback" not in logs(tmp_path) and "Warning" not in logs(tmp_path)

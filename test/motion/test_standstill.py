"""Arms whose joints cannot move for a while, by power or brakes: the reference waits, and goes on.

Everything is judged on the true links along the whole way, from the moment when all joints can move
on: nothing is made up for at a jump.
"""

import contextlib
import dataclasses
import threading
import time
from typing import Any

import numpy as np
import pytest
import rclpy
from draws import some
from network import PATIENCE
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from arm_emulator import OfflineRun, Pose, load_gains, load_scene
from arm_emulator.base.io.config_files import find_config, find_scene
from arm_emulator.motion.executor.controllers import make_joint_limits
from arm_emulator.motion.executor.goal_status import GoalState
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.motion.trajectory.time_scaling import Resumed
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds, convert_to_stamp
from arm_emulator.ros.node.lean_executor import LeanExecutor
from arm_emulator.ros.node.node_shell import DESCRIPTION_QOS
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator_msgs.msg import ServoState
from motion_controller_node.node import MotionControllerNode

SECOND = 1000  # ticks
PAST = 1.5e-3  # m; three_axis, whose gears feed-forward does not know, 1.42 mm without a standstill
OVER = 1.02  # of a limit of speed: links swing a little on their gears
TOOL_LINE = np.array([0.0, 0.1, -0.2])  # m, from where the tool begins
JOINT_TRAVEL = 0.6  # rad
PERIOD_NS = 50_000_000  # of three_axis' motion


class Stopped:
    """A run of an arm with brakes, and what was commanded and done while its joints could move."""

    def __init__(self, scene: str, brakes: dict[str, object], **motion: object) -> None:
        file = find_scene(scene)
        gains = load_gains(file)
        self.scene = load_scene(file, brakes)
        config = dataclasses.replace(gains.motion, **motion)  # type: ignore[arg-type]
        self.run = OfflineRun(self.scene, gains.servo, config)
        self.kinematics = self.run.controller.kinematics
        self.limits = make_joint_limits(self.kinematics, config)
        self.top = np.minimum(self.kinematics.velocity_limit, config.velocity_limit)
        self.links: list[np.ndarray] = []
        self.asked: list[tuple[int, Reference]] = []  # tick and motion of the links
        self.ready = 0  # the first tick since the interruption at which all joints could move
        self.waited = 0  # the last tick at which it stood still, or came to rest
        instruct = self.run.instructor.compute_setpoint

        def store(*arguments: Any) -> JointSetpoint:
            answer = instruct(*arguments)
            if answer.now is not None:
                self.asked.append((len(self.links), answer.now))
            return answer

        self.run.instructor.compute_setpoint = store  # type: ignore[method-assign, assignment]
        self.run.advance(200)

    @property
    def can(self) -> bool:
        """Whether all joints can move."""
        return bool(self.run.drives.movable(self.run.session.powered).all())

    def advance(self, ticks: int) -> None:
        """Go on, and keep angles, speeds and targets of every tick."""
        for _ in range(ticks):
            self.run.advance(1)
            state = self.run.session.state
            speed = state.v if self.can else np.full_like(state.v, np.nan)
            self.links.append(np.concatenate([state.q, speed]))
            if self.run.instructor.waits_for:
                self.waited = len(self.links) - 1
                self.ready = self.ready if self.can else len(self.links)

    def interrupted(self, off: int, away: int, until: int) -> None:
        """Take the power away at a tick for so many ticks, and go on until a tick."""
        self.advance(off)
        self.run.session.powered = False
        self.advance(away)
        self.run.session.powered = True
        self.advance(until - off - away)

    @property
    def last(self) -> GoalState:
        """State of the newest order."""
        return self.run.instructor.reports.take_reports()[-1].state

    def tool(self) -> np.ndarray:
        """The true tool at every tick (K, 3) [m]."""
        return np.array([self.kinematics.forward(link[: len(link) // 2])[1] for link in self.links])

    def fastest(self, since: int) -> float:
        """The largest true speed over its limit from a tick on, while the joints could move."""
        v = np.array(self.links[since:])[:, len(self.top) :]
        return float(np.nanmax(np.abs(v) / self.top))

    def hardest(self) -> tuple[float, float]:
        """The largest commanded acceleration since all joints can move, over its limit, and how far
        the commanded speeds change beyond what the accelerations give.
        """
        period = self.run.motion_ticks
        references = [reference for tick, reference in self.asked if tick > self.ready + period]
        a, v = (np.array([getattr(reference, name) for reference in references]) for name in "av")
        limits = self.limits.acceleration
        return float((np.abs(a) / limits).max()), float(
            (np.abs(np.diff(v, axis=0)) * SECOND / period / limits).max()
        )


def draw(seed: int) -> tuple[Stopped, np.random.Generator, int, int]:
    """Return an arm some or all of whose joints have brakes with delays, and when power is away."""
    rng = np.random.default_rng(seed)
    name = ("three_axis", "ur5", "panda")[seed % 3 if seed > 1 else 0]
    names = load_scene(name).joint_names
    braked = [name for name in names if rng.random() < 0.7] or [names[-1]]
    brakes: dict[str, object] = {
        f"joints.{name}.brake": {
            "torque": 300.0,
            "close_delay": round(rng.uniform(0.0, 0.1), 3),
            "release_delay": round(rng.uniform(0.0, 0.5), 3),
        }
        for name in braked
    }
    feedforward = {"feedforward": "torque"} if name == "three_axis" else {}  # else of its file
    arm = Stopped(name, brakes, method="way", **feedforward)
    return arm, rng, int(rng.integers(0, 900)), int(rng.integers(1, 700))


@pytest.mark.parametrize("seed", some(range(30), 1))
def test_a_target_waits_for_the_brakes_and_is_reached_within_limits(seed: int) -> None:
    """Never past the target, never faster than the limits, and there in the end."""
    arm, _, off, away = draw(seed)
    R_WT, p_WT = arm.kinematics.forward(arm.scene.start)
    arm.run.instructor.add(0, Pose(p_WT + TOOL_LINE, R_WT))
    arm.interrupted(off, away, 4 * SECOND)
    released = off + away
    along = (arm.tool() - p_WT) @ TOOL_LINE / np.linalg.norm(TOOL_LINE)
    # Without power an arm falls as it likes; from when it has come to rest the way is ours.
    past = along[arm.waited :] - np.linalg.norm(TOOL_LINE)
    assert past.max() < max(0.0, past[0]) + PAST
    assert arm.fastest(released + 50) < OVER
    assert max(arm.hardest()) < 1.001
    assert arm.last is GoalState.REACHED


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(102, 114), 1))
def test_a_path_and_a_trajectory_go_on_from_where_they_were(seed: int) -> None:
    """Within the limits, through all of their ends, after the time that they stood."""
    for trajectory in (False, True):
        arm, rng, off, away = draw(seed)
        off = 300 + off % 500
        R_WT, p_WT = arm.kinematics.forward(arm.scene.start)
        start = arm.scene.start
        if trajectory:
            names = arm.kinematics.joint_names
            displacement = rng.uniform(-JOINT_TRAVEL, JOINT_TRAVEL, len(names))
            points = [
                TrajectoryPoint(
                    k * 400_000_000,
                    list(start + displacement * k / 4),
                    list(displacement / 1.6 * (0 < k < 4)),
                )
                for k in range(5)
            ]
            arm.run.instructor.add_trajectory(arm.run.controller, names, points)
            end = arm.kinematics.forward(start + displacement)[1]
        else:
            steps = (0.0, 0.5, 1.0)
            poses = [Pose(p_WT + part * TOOL_LINE, R_WT) for part in steps]
            # An arm that falls leaves its path, and would be stopped for it.
            config = dataclasses.replace(arm.run.instructor._config, tool_path_tolerance=0.0)
            arm.run.instructor.set_parameters(config)
            arm.run.instructor.add_path(arm.run.controller, poses)
            end = p_WT + TOOL_LINE
        arm.interrupted(off, away, 6 * SECOND)
        assert arm.fastest(off + away + 50) < OVER
        assert max(arm.hardest()) < 1.06  # as of trajectories
        assert arm.last is GoalState.REACHED
        assert np.linalg.norm(arm.tool()[-1] - end) < 2e-3


@pytest.mark.parametrize("seed", some(range(60), 4))
def test_a_resumed_motion_keeps_its_limits_and_its_end(seed: int) -> None:
    """Drawn ways, interrupted anywhere, with the joints beside them."""
    rng = np.random.default_rng(seed)
    N = int(rng.integers(1, 8))
    limits = JointPathLimits(
        rng.uniform(0.5, 4.0, N),
        rng.uniform(1.0, 20.0, N),
        rng.uniform(20.0, 400.0, N),
        np.inf * np.ones(N),
    )
    begin, end = rng.uniform(-2.0, 2.0, (2, N))
    planned = TimedPath(JointCurve.make_line(begin, end), limits)
    since = rng.uniform(0.0, 1.05) * planned.duration
    now = Reference.make_rest(planned.evaluate_at(since).q + rng.normal(0.0, 0.05, N))
    on = Resumed(planned, since, now, limits)
    times = np.linspace(0.0, on.duration, 800)
    moves = [on.evaluate_at(float(t)) for t in times]
    q, v, a = (np.array([getattr(move, name) for move in moves]) for name in "qva")
    assert np.abs(q[0] - now.q).max() < 1e-9 and np.abs(q[-1] - end).max() < 1e-6
    assert np.abs(v[[0, -1]]).max() < 1e-6
    assert (np.abs(v) <= limits.speed * 1.001).all()
    assert (np.abs(a) <= limits.acceleration * 1.001).all()
    # Speeds are those of the angles: nothing jumps.
    h = times[1] - times[0]
    between = 0.5 * (v[1:] + v[:-1]) * h
    assert np.abs(np.diff(q, axis=0) - between).max() <= limits.jerk.max() * h**3
    assert on.duration < planned.duration - since + 2.0


def test_a_servo_that_reports_its_state_is_waited_for_and_a_silent_servo_is_not() -> None:
    """The kind of servo is an event of the network: no state asks the graph for it."""
    files = ["--ros-args", "--params-file", str(find_config("three_axis", ".yaml", "motion"))]
    with own_domain() as domain:
        rclpy.init(args=files, domain_id=domain)
        node, servo = MotionControllerNode(), rclpy.create_node("servo")

        def serve() -> None:
            with contextlib.suppress(ExternalShutdownException):
                LeanExecutor(node).spin()

        own = threading.Thread(target=serve)
        own.start()
        try:

            def refused(*_: object) -> int:
                raise AssertionError("the graph was asked")

            node.count_publishers = node.count_subscribers = refused  # type: ignore[method-assign]
            executor = SingleThreadedExecutor()
            executor.add_node(servo)
            answered_stamps: list[int] = []

            def on_targets(message: Any) -> None:
                answered_stamps.append(convert_to_nanoseconds(message.header.stamp))

            servo.create_subscription(JointState, "joint_targets", on_targets, 10)
            states = servo.create_publisher(JointState, "joint_states", 10)
            description = servo.create_publisher(String, "robot_description", DESCRIPTION_QOS)
            scene = load_scene("three_axis")
            description.publish(String(data=scene.urdf))

            def answered(period: int, seconds: float) -> bool:
                message = JointState(name=scene.joint_names, position=scene.start)
                message.header.stamp = convert_to_stamp(period * PERIOD_NS)
                end = time.monotonic() + seconds
                while time.monotonic() < end and period * PERIOD_NS not in answered_stamps:
                    states.publish(message)
                    executor.spin_once(0.02)
                return period * PERIOD_NS in answered_stamps

            assert answered(1, PATIENCE), "a servo that publishes no state moves all joints"
            reports = servo.create_publisher(ServoState, "servo_states", 10)
            end = time.monotonic() + PATIENCE
            while not node._servo_reports and time.monotonic() < end:
                executor.spin_once(0.02)
            assert not answered(2, 0.5)
            report = ServoState(joint_names=scene.joint_names, movable=[1] * 3)
            report.header.stamp = convert_to_stamp(2 * PERIOD_NS)
            reports.publish(report)
            assert answered(2, PATIENCE)
            servo.destroy_publisher(reports)
            assert answered(3, PATIENCE), "it has gone"
        finally:
            rclpy.try_shutdown()
            own.join()
            node.close()
            node.destroy_node()
            servo.destroy_node()


def test_speeds_without_a_path_to_rest_hold_the_arm() -> None:
    """A motion of hours is a result of ruckig that Python has no name for."""
    scene, gains = load_scene("three_axis"), load_gains("three_axis")
    run = OfflineRun(scene, gains.servo, gains.motion)
    q, v = scene.start, np.array([-2.3, 247106.0, -1.5])
    can = np.array([True, False, True])
    for k, movable in enumerate((can, ~can, can)):
        setpoint = run.instructor.compute_setpoint(run.controller, k * PERIOD_NS, q, v, movable)
        np.testing.assert_array_equal(setpoint.q, q)
    assert run.instructor.restarts > 0 and "no way to take up the speeds" in run.instructor.trouble
    assert "\n" not in run.instructor.trouble

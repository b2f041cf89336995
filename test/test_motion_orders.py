"""Tool targets, joint trajectories and tool paths in a row: what holds, what is reported."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped
from in_process import InProcess, in_process
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator.base.config_files import find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.scene import load_scene
from arm_emulator.motion.follow_goal import result_of, tolerances_of
from arm_emulator.motion.instruction import Instruction
from arm_emulator.motion.instructor import Instructor
from arm_emulator.motion.joint_trajectory import TrajectoryPoint
from arm_emulator.motion.link_torques import LinkTorques
from arm_emulator.motion.motion_report import Kind, MotionReport, State
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.tolerances import Allowed, Tolerances
from arm_emulator.ros.node_shell import stamp
from arm_emulator.runs.gains import load_gains, warn_of_gravity
from arm_emulator.runs.offline import OfflineRun, load_offline_run
from arm_emulator_msgs.msg import MotionStatus
from motion_controller_node.follow_action import installed

SECOND = 1_000_000_000


class Ideal:
    """An arm that is where it was asked to be, one motion period after the other."""

    def __init__(self, scene: str = "ur5") -> None:
        run = load_offline_run(scene)
        self.controller, self.start = run.controller, run.session.scene.start
        # Motion of the links; with `full` the servo would get that of the motors.
        motion = load_gains(find_scene(scene)).motion
        self.config = dataclasses.replace(motion, feedforward="torque")
        self.instructor = Instructor(self.config)
        self.period_ns = round(self.config.period * SECOND)
        self.now_ns, self.q = 0, self.start
        self.printed: list[Instruction] = []

    def advance(self, seconds: float) -> None:
        for _ in range(math.ceil(seconds * SECOND / self.period_ns)):
            one = self.instructor.instruct(self.controller, self.now_ns, self.q)
            self.printed.append(one)
            v = np.zeros_like(one.q) if one.v is None else one.v
            self.q = one.q + self.period_ns / SECOND * v
            self.now_ns += self.period_ns

    def pose(self, shift: Any = (0.0, 0.0, 0.0)) -> Pose:
        R, p = self.controller.kinematics.forward(self.start)
        return Pose(p + np.array(shift), R)

    def states(self) -> list[tuple[str, int, str]]:
        return [(r.kind.name, r.number, r.state.name) for r in self.instructor.reports.waiting]

    def point(self, seconds: float, shift: float, **more: Any) -> TrajectoryPoint:
        return TrajectoryPoint(round(seconds * SECOND), self.start + shift, **more)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.controller.kinematics.joint_names)


# The order in force


@pytest.mark.parametrize("seed", range(6))
def test_no_reference_jumps_when_one_order_replaces_another(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = Ideal()
    limit = arm.controller.kinematics.velocity_limit
    for _ in range(8):
        kind = rng.integers(0, 3)
        if kind == 0:
            arm.instructor.add(0, arm.pose(rng.uniform(-0.1, 0.1, 3)))
        elif kind == 1:
            still = np.zeros(6)
            points = [
                arm.point(t, rng.uniform(-0.3, 0.3), velocities=still, accelerations=still)
                for t in np.cumsum(rng.uniform(1.0, 2.0, 2))
            ]
            arm.instructor.add_trajectory(arm.controller, arm.names, points)
        else:
            poses = [arm.pose(rng.uniform(-0.1, 0.1, 3)) for _ in range(2)]
            arm.instructor.add_path(arm.controller, poses)
        arm.advance(rng.uniform(0.1, 2.0))
    for before, after in pairwise(arm.printed):
        assert before.v is not None or np.array_equal(before.q, after.q)
        v = 0.0 if before.v is None else before.v
        expected = before.q + arm.period_ns / SECOND * v
        # Targets go on with their speed; where a trajectory is left between two periods the chord
        # of its spline is nearer than 1e-12.
        np.testing.assert_allclose(after.q, expected, atol=1e-9, err_msg="the next target")
        if after.v is not None:
            step = np.abs(after.v - v)
            # 10 rad/s2 of a way; a quintic of 0.6 rad in a second, from any speed,
            # has less than 40.
            assert (step <= 40.0 * arm.config.period).all(), "no step of speed"
            assert (np.abs(after.v) <= 1.05 * limit).all(), "the speed limits"


@pytest.mark.parametrize("seed", range(4))
def test_paths_that_begin_where_the_tool_rests_follow_one_another(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    arm = Ideal()
    first = arm.pose()
    for number in range(1, 6):
        poses = [first, *(arm.pose(rng.uniform(-0.05, 0.05, 3)) for _ in range(2))]
        arm.instructor.add_path(arm.controller, poses)
        while ("TOOL_PATH", number, "REACHED") not in arm.states():
            assert arm.now_ns < 200 * SECOND, "it is reached"
            arm.advance(0.1)
        # The pose that was asked for, or the one in which the tool is: they differ by rounding.
        R, p = arm.controller.kinematics.forward(arm.q)
        first = poses[-1] if rng.random() < 0.5 else Pose(p, R)


@pytest.mark.parametrize("kind", ["TOOL_TARGET", "JOINT_TRAJECTORY", "TOOL_PATH", "TIMED_PATH"])
@pytest.mark.parametrize("known", [False, True], ids=["before any angles", "while it runs"])
def test_a_stamp_of_the_wall_clock_is_refused(kind: str, known: bool) -> None:
    """A stamp of the wall clock would mean a wait of decades."""
    arm = Ideal()
    wall = 1_790_000_000 * SECOND
    if known:
        arm.advance(5.0)

    def send(stamp_ns: int) -> None:
        one = arm.instructor
        if kind == "TOOL_TARGET":
            one.add(stamp_ns, arm.pose([0.01, 0.0, 0.0]))
        elif kind == "JOINT_TRAJECTORY":
            points = [arm.point(3.0, 0.05)]
            one.add_trajectory(arm.controller, arm.names, points, stamp_ns)
        elif kind == "TOOL_PATH":
            one.add_path(arm.controller, [arm.pose([0.01, 0.0, 0.0])], stamp_ns)
        else:
            poses = [arm.pose(), arm.pose([0.01, 0.0, 0.0])]
            one.add_path(arm.controller, poses, 0, [stamp_ns + k * 4 * SECOND for k in (1, 2)])

    if known:
        with pytest.raises(Refusal, match="at most 3600 s after logical time"):
            send(wall)
    else:
        send(wall)
        arm.advance(0.1)
    name = kind.replace("TIMED", "TOOL")
    (refused,) = [r for r in arm.instructor.reports.waiting if r.state is State.REFUSED]
    assert refused.kind.name == name and "got 17900000" in refused.reason
    send(arm.now_ns + SECOND)  # a second ahead is as it always was
    arm.advance(15.0)
    assert (name, 2, "REACHED") in arm.states()


def test_the_newest_holds_and_every_one_is_answered() -> None:
    arm = Ideal()
    arm.advance(0.05)
    arm.instructor.add(0, arm.pose((0.02, 0.0, 0.0)))
    arm.advance(0.05)
    arm.instructor.add_trajectory(arm.controller, arm.names, [arm.point(1.0, 0.1)])
    arm.advance(0.05)
    arm.instructor.add_path(arm.controller, [arm.pose()])
    arm.instructor.add(0, arm.pose((0.0, 0.02, 0.0)))  # before the path began
    arm.advance(3.0)
    assert arm.states() == [
        ("TOOL_TARGET", 1, "ACCEPTED"),
        ("TOOL_TARGET", 1, "MOVING"),
        ("JOINT_TRAJECTORY", 1, "ACCEPTED"),
        ("TOOL_TARGET", 1, "REPLACED"),
        ("JOINT_TRAJECTORY", 1, "MOVING"),
        ("TOOL_PATH", 1, "ACCEPTED"),
        ("TOOL_TARGET", 2, "ACCEPTED"),
        ("TOOL_PATH", 1, "REPLACED"),
        ("JOINT_TRAJECTORY", 1, "REPLACED"),
        ("TOOL_TARGET", 2, "MOVING"),
        ("TOOL_TARGET", 2, "REACHED"),
    ]
    replaced = [r.reason for r in arm.instructor.reports.waiting if r.state is State.REPLACED]
    assert replaced == ["by joint trajectory 1", "by tool target 2", "by tool target 2"]


@pytest.mark.parametrize("seed", range(10))
def test_no_request_is_lost_in_silence(seed: int) -> None:
    """For any orders in any sequence: accepted ones get one final answer, refused ones too."""
    rng = np.random.default_rng([seed, 1])
    arm = Ideal("three_axis" if seed % 2 else "ur5")
    asked = {kind: 0 for kind in Kind}
    for _ in range(30):
        time_ns = int(rng.choice([0, arm.now_ns + rng.integers(0, 2 * SECOND)]))
        kind = Kind(int(rng.integers(1, 4)))
        asked[kind] += 1
        bad = rng.random() < 0.3
        try:
            if kind is Kind.TOOL_TARGET:
                if bad:
                    raise Refusal("tool_target", "orientation", "be a quaternion", 0)
                arm.instructor.add(time_ns, arm.pose(rng.uniform(-0.05, 0.05, 3)))
            elif kind is Kind.JOINT_TRAJECTORY:
                names = ("nobody",) if bad else arm.names
                points = [arm.point(rng.uniform(0.1, 2.0), rng.uniform(-0.2, 0.2))]
                arm.instructor.add_trajectory(arm.controller, names, points, time_ns)
            else:
                poses = [] if bad else [arm.pose(rng.uniform(-0.05, 0.05, 3))]
                arm.instructor.add_path(arm.controller, poses, time_ns)
        except Refusal as reason:
            if kind is Kind.TOOL_TARGET:
                arm.instructor.reports.refuse(kind, time_ns, reason)
        arm.advance(rng.uniform(0.0, 0.5))
    arm.instructor.start_over("test")
    for kind, count in asked.items():
        for number in range(1, count + 1):
            reported = [
                r.state
                for r in arm.instructor.reports.waiting
                if (r.kind, r.number) == (kind, number)
            ]
            final = [state for state in reported if state.final]
            assert len(final) == 1 or final == [State.UNREACHABLE, State.REACHED], (
                f"{kind.name} {number} was answered by {reported}"
            )
            assert reported[-1] is final[-1], "nothing comes after the last word"
            assert reported[0] in (State.ACCEPTED, State.REFUSED), "the first word"


@pytest.mark.parametrize("scene", ["ur5", "three_axis", "panda"])
def test_targets_beyond_reach_are_reported_as_such_with_the_distance(scene: str) -> None:
    arm = Ideal(scene)
    far = arm.pose((0.0, 0.0, 3.0))
    arm.instructor.add(0, far)
    arm.advance(15.0)
    last = arm.instructor.reports.waiting[-1]
    _, p_WT = arm.controller.kinematics.forward(arm.q)
    assert last.state is State.UNREACHABLE, "it is reported"
    if scene != "three_axis":  # eq. (6) goes to and fro there
        left = float(np.linalg.norm(far.p_WT - p_WT))
        assert last.distance == pytest.approx(left, rel=1e-3), "how far"
    arm.instructor.add(0, arm.pose())
    arm.advance(10.0)
    assert arm.instructor.reports.waiting[-1].state is State.REACHED, "the way back"


def test_a_trajectory_waits_for_its_stamp_and_then_keeps_its_times() -> None:
    arm = Ideal()
    still = np.zeros(6)
    points = [arm.point(t, by, velocities=still) for t, by in ((0.5, 0.1), (1.0, 0.0))]
    arm.instructor.add_trajectory(arm.controller, arm.names, points, stamp_ns=SECOND)
    arm.advance(2.5)
    at = {i * arm.period_ns: one.q for i, one in enumerate(arm.printed)}
    np.testing.assert_allclose(at[SECOND], arm.start, atol=1e-12, err_msg="not before its stamp")
    np.testing.assert_allclose(at[3 * SECOND // 2], arm.start + 0.1, atol=1e-9)
    np.testing.assert_allclose(at[2 * SECOND], arm.start, atol=1e-9, err_msg="the end")
    assert arm.states()[-1] == ("JOINT_TRAJECTORY", 1, "REACHED")


def test_a_trajectory_that_cannot_begin_is_refused_and_the_one_before_goes_on() -> None:
    arm = Ideal()
    arm.instructor.retune(dataclasses.replace(arm.config, trajectory_limits="refuse"))
    arm.instructor.add(0, arm.pose((0.05, 0.0, 0.0)))
    arm.advance(0.1)
    arm.instructor.add_trajectory(arm.controller, arm.names, [arm.point(0.02, 1.0)])
    arm.advance(4.0)
    reported = [r for r in arm.instructor.reports.waiting if r.kind is Kind.JOINT_TRAJECTORY]
    assert [one.state for one in reported] == [State.ACCEPTED, State.REFUSED]
    assert "the way to the first point must keep the limits" in reported[-1].reason
    assert arm.states()[-1] == ("TOOL_TARGET", 1, "REACHED"), "it goes on"


def test_an_empty_trajectory_stops_a_path() -> None:
    arm = Ideal()
    arm.instructor.add_path(arm.controller, [arm.pose((0.0, 0.2, 0.0))])
    arm.advance(0.7)
    assert np.abs(arm.printed[-1].v).max() > 0.05, "it moves"
    arm.instructor.add_trajectory(arm.controller, (), ())
    arm.advance(1.0)
    assert not arm.printed[-1].v.any(), "it rests"
    assert arm.states()[-1] == ("JOINT_TRAJECTORY", 1, "REACHED")
    assert ("TOOL_PATH", 1, "REPLACED") in arm.states()


@pytest.mark.parametrize(("allowed", "state"), [(0.05, State.ABORTED), (0.5, State.REACHED)])
def test_an_arm_that_does_not_follow_ends_the_trajectory_where_it_is(
    allowed: float, state: State
) -> None:
    arm = Ideal()
    arm.instructor.retune(type(arm.config)(**{**vars(arm.config), "path_tolerance": allowed}))
    arm.instructor.add_trajectory(arm.controller, arm.names, [arm.point(1.0, 0.15)])
    for tick in range(150):  # the arm does not move at all
        arm.printed.append(arm.instructor.instruct(arm.controller, tick * arm.period_ns, arm.start))
    last = arm.instructor.reports.waiting[-1]
    assert last.state is state
    if state is State.ABORTED:
        assert "path tolerance: shoulder_pan_joint is off by" in last.reason
        np.testing.assert_array_equal(arm.printed[-1].q, arm.start, "held where it is")


def test_the_goal_tolerance_is_waited_for_as_long_as_is_allowed() -> None:
    for time, state in ((0.5, State.ABORTED), (0.0, State.MOVING)):
        arm = Ideal()
        change = {"goal_tolerance": 0.01, "goal_time": time}
        arm.instructor.retune(type(arm.config)(**{**vars(arm.config), **change}))
        arm.instructor.add_trajectory(arm.controller, arm.names, [arm.point(0.5, 0.05)])
        for tick in range(300):
            q = arm.start if tick < 200 or state is State.ABORTED else arm.start + 0.045
            arm.instructor.instruct(arm.controller, tick * arm.period_ns, q)
            if tick == 199:
                assert arm.instructor.reports.waiting[-1].state is state, f"goal_time {time} s"
        expected = State.ABORTED if state is State.ABORTED else State.REACHED
        assert arm.instructor.reports.waiting[-1].state is expected


# Torques


@pytest.mark.parametrize("seed", range(3))
def test_the_torques_given_are_those_of_gravity_at_the_links(seed: int) -> None:
    """Against the gradient of the potential energy, by differences."""
    import pinocchio as pin

    rng = np.random.default_rng([seed, 2])
    scene = load_scene("ur5")
    gravity = rng.normal(size=3) * 5.0
    torques = LinkTorques(scene.urdf, scene.joint_names, gravity)
    model = pin.buildModelFromXML(scene.urdf)
    model.gravity.linear = gravity
    data, q = model.createData(), rng.uniform(-2, 2, 6)
    h = 1e-6
    for j in range(6):
        high, low = (
            pin.computePotentialEnergy(model, data, q + side * h * np.eye(6)[j])
            for side in (1.0, -1.0)
        )
        # Central differences of some 10 J: rounding 1e-15 / 1e-6.
        assert torques.at(q, np.zeros(6))[j] == pytest.approx((high - low) / (2 * h), abs=1e-6)


def test_feedforward_is_given_as_it_is_configured() -> None:
    scene = load_scene("ur5")
    gravity = LinkTorques(scene.urdf, scene.joint_names, (0.0, 0.0, -9.81))
    for given, speed, torque in (
        ("none", False, False),
        ("speed", True, False),
        ("torque", True, True),
    ):
        arm = Ideal()
        arm.instructor = Instructor(type(arm.config)(**{**vars(arm.config), "feedforward": given}))
        arm.advance(0.1)
        if torque:
            np.testing.assert_allclose(arm.printed[0].tau, gravity.at(arm.start, np.zeros(6)))
        arm.instructor.add(0, arm.pose((0.1, 0.0, 0.0)))
        arm.advance(0.2)
        assert (arm.printed[-1].v is not None, arm.printed[-1].tau is not None) == (
            speed,
            torque,
        ), given


# The nodes


@pytest.fixture(scope="module")
def nodes() -> Iterator[InProcess]:
    with in_process() as one:
        one.run_to(5)  # the description has come
        yield one


def statuses(nodes: InProcess) -> list[MotionStatus]:
    """Collect the messages on the motion controller's status topic, from now on."""
    heard: list[MotionStatus] = []
    nodes.listen_alone("motion/status", MotionStatus, heard.append)
    return heard


def trajectory(at_ns: int, names: list[str], *points: tuple[float, list[float]]) -> JointTrajectory:
    message = JointTrajectory(joint_names=names)
    message.header.stamp = stamp(at_ns)
    message.points = [
        JointTrajectoryPoint(
            positions=q, time_from_start=Duration(sec=int(t), nanosec=round(t % 1 * 1e9))
        )
        for t, q in points
    ]
    return message


def path(at_ns: int, poses: list[Pose]) -> Path:
    message = Path()
    message.header.stamp = stamp(at_ns)
    for pose in poses:
        one = PoseStamped()
        p, o = one.pose.position, one.pose.orientation
        p.x, p.y, p.z = map(float, pose.p_WT)
        o.x, o.y, o.z, o.w = map(float, pose.quaternion())
        message.poses.append(one)
    return message


def offline() -> OfflineRun:
    return load_offline_run("three_axis")


def test_nodes_and_offline_run_follow_a_trajectory_and_a_path_with_the_same_bits(
    nodes: InProcess,
) -> None:
    run = offline()
    names = list(run.controller.kinematics.joint_names)
    start = run.session.scene.start
    R, p = run.controller.kinematics.forward(start)
    goal = (start + 0.05).tolist()
    # By way of the quaternion, as in the message: the rotation has the same rounding then.
    poses = [
        Pose.from_quaternion(p + shift, Pose(p, R).quaternion())
        for shift in (np.array([0.0, 0.02, 0.0]), np.array([0.02, 0.02, 0.0]))
    ]
    heard = statuses(nodes)
    nodes.run_to(20)
    nodes.send("joint_trajectory", trajectory(SECOND // 10, names, (0.3, goal)))
    nodes.send("tool_path", path(SECOND, poses))
    nodes.run_to(1400)
    run.instructor.add_trajectory(
        run.controller, names, [TrajectoryPoint(3 * SECOND // 10, goal)], SECOND // 10
    )
    run.instructor.add_path(run.controller, poses, SECOND)
    for tick in range(1400):
        state = run.session.measured
        bits = np.asarray(state.encoder_counts, dtype=np.int64).tobytes() + state.current.tobytes()
        assert nodes.states[tick] == bits, f"the first other bit at tick {tick}"
        run.advance(1)
    for one, report in zip(heard, run.instructor.reports.waiting, strict=False):
        assert (one.kind, one.number, one.state) == (report.kind, report.number, report.state)
    printed = [(one.kind, one.state) for one in heard]
    assert (2, MotionStatus.STATE_REACHED) in printed and (3, MotionStatus.STATE_MOVING) in printed
    assert nodes.newest("joint_targets").velocity, "speeds reach the servo"


BAD: list[tuple[str, str, Any]] = [
    ("joint_trajectory", "joint_names must be joints of the arm, got nobody", ["nobody"]),
    ("joint_trajectory", "points[1].time_from_start must be later", [(0.5, 0.0), (0.5, 0.1)]),
    ("joint_trajectory", "must be numbers within", [(0.5, math.nan)]),
    ("joint_trajectory", "must be numbers within +-1e+06 rad", [(0.5, 1e7)]),
    ("joint_trajectory", "header.stamp must be a logical time", -1),
    ("tool_path", "poses must be from 1", []),
    ("tool_path", "header.frame_id must be the arm's base, got elsewhere", "elsewhere"),
    ("tool_path", "orientation must be a quaternion of length 1", "quaternion"),
    ("tool_path", "poses[1].header.stamp must be later", "stamps"),
    ("tool_target", "header.frame_id must be the arm's base, got elsewhere", "elsewhere"),
]


@pytest.mark.parametrize(("topic", "words", "what"), BAD, ids=[f"{t}: {w}" for t, w, _ in BAD])
def test_refused_orders_are_reported_with_their_reason(
    nodes: InProcess, topic: str, words: str, what: Any
) -> None:
    controller = nodes.nodes["motion_controller"]._controller
    names = list(controller.kinematics.joint_names)
    R, p = controller.kinematics.forward(np.zeros(len(names)))
    heard, before = statuses(nodes), nodes.refused("motion_controller")
    if topic == "joint_trajectory":
        message: Any = trajectory(0, names, (1.0, [0.0] * len(names)))
        if what == ["nobody"]:
            message.joint_names = [*names[1:], "nobody"]
        elif what == -1:
            message.header.stamp.sec = -1
        else:
            message = trajectory(0, names, *((t, [q] * len(names)) for t, q in what))
    else:
        message = path(0, [Pose(p, R), Pose(p, R), Pose(p, R)])
        if topic == "tool_target":
            message = message.poses[0]
        if what == "elsewhere":
            message.header.frame_id = "elsewhere"
        elif what == "quaternion":
            message.poses[1].pose.orientation.w = 7.0
        elif what == "stamps":
            message.poses[0].header.stamp = stamp(5)
            message.poses[1].header.stamp = stamp(5)
            message.poses[2].header.stamp = stamp(9)
        else:
            message.poses = []
    nodes.send(topic, message)
    nodes.deliver()
    while nodes._wires.waiting and not heard:
        nodes.deliver()
    [status] = heard
    assert status.state == MotionStatus.STATE_REFUSED and words in status.reason
    assert status.kind == Kind[topic.upper()] and status.number > 0
    assert nodes.refused("motion_controller") == before + 1


def test_a_reset_reports_what_it_has_forgotten(nodes: InProcess) -> None:
    heard = statuses(nodes)
    pose = path(0, [Pose(np.array([0.3, 0.0, 0.5]), np.eye(3))]).poses[0]
    pose.header.stamp = stamp(1000 * SECOND)
    nodes.send("tool_target", pose)
    nodes.call("motion_controller/reset")
    wanted = [MotionStatus.STATE_ACCEPTED, MotionStatus.STATE_ABORTED]
    while [one.state for one in heard if one.kind == Kind.TOOL_TARGET] != wanted:
        assert nodes.deliver(), f"nothing more is reported after {heard}"
    assert heard[-1].reason == "the motion controller was reset"


# The action


def goal(**given: Any) -> Any:
    """A goal of FollowJointTrajectory, as far as it states something."""
    empty = {
        "path_tolerance": [],
        "goal_tolerance": [],
        "goal_time_tolerance": Duration(),
    }
    return SimpleNamespace(**{**empty, **given})


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0) -> Any:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=0.0)


def test_a_goal_states_what_it_allows_beside_the_parameters() -> None:
    names = ("a", "b")
    default = Tolerances(Allowed.alike(2, 0.1), Allowed.alike(2, 0.2), 3.0)
    one = tolerances_of(
        goal(
            path_tolerance=[tolerance("b", 0.5, 2.0)],
            goal_tolerance=[tolerance("a", -1.0)],
            goal_time_tolerance=Duration(sec=1, nanosec=500_000_000),
        ),
        names,
        default,
    )
    assert one.path.q.tolist() == [0.1, 0.5] and one.path.v.tolist() == [0.0, 2.0]
    assert one.goal.q.tolist() == [0.0, 0.2], "-1 allows anything"
    assert one.goal_time == 1.5
    assert tolerances_of(goal(), names, default).goal_time == 3.0, "0 leaves it"
    erased = goal(goal_time_tolerance=Duration(sec=-1))
    assert tolerances_of(erased, names, default).goal_time == 0.0
    for wrong, words in (
        (goal(path_tolerance=[tolerance("x", 0.1)]), "be of joints of the arm, got x; valid: a, b"),
        (goal(goal_tolerance=[tolerance("a", -2.0)]), "be >= 0 rad, or -1 for any, got -2.0"),
        (goal(path_tolerance=[tolerance("a", math.nan)]), "be >= 0 rad, or -1 for any, got nan"),
        (goal(goal_time_tolerance=Duration(sec=-3)), "be >= 0 s, or -1 for any, got -3 s"),
    ):
        with pytest.raises(Refusal) as refusal:
            tolerances_of(wrong, names, default)
        assert words in str(refusal.value)


@pytest.mark.parametrize(
    ("state", "reason", "code"),
    [
        (State.REACHED, "", 0),
        (State.REFUSED, "joint_trajectory: ...", -1),
        (State.REPLACED, "by tool target 3", -1),
        (State.ABORTED, "cancelled", -1),
        (State.ABORTED, "path tolerance: a is off by 1 rad", -4),
        (State.ABORTED, "goal tolerance after 1 s: a is off by 1 rad", -5),
    ],
)
def test_a_goal_ends_with_the_code_of_its_last_word(state: State, reason: str, code: int) -> None:
    got, words = result_of(MotionReport(Kind.JOINT_TRAJECTORY, 1, 0, state, reason))
    assert got == code and reason in words


@pytest.mark.parametrize("waiting", [True, False])
def test_a_cancelled_trajectory_stops_or_never_begins(waiting: bool) -> None:
    arm = Ideal()
    arm.advance(0.1)
    points = [arm.point(1.0, 0.3), arm.point(2.0, -0.3)]
    stamp_ns = 5 * SECOND if waiting else 0
    number = arm.instructor.add_trajectory(arm.controller, arm.names, points, stamp_ns)
    arm.advance(0.5)
    arm.instructor.cancel(number)
    arm.instructor.cancel(number + 7)  # nobody's
    arm.advance(6.0)
    assert arm.states()[-1] == ("JOINT_TRAJECTORY", 1, "ABORTED")
    assert arm.instructor.reports.waiting[-1].reason == "cancelled"
    assert not np.any(arm.printed[-1].v), "it rests"
    far = np.abs(arm.q - arm.start).max()
    assert far == 0.0 if waiting else 0.1 < far < 0.2, "it stopped where it was"


def test_the_action_is_there_only_where_control_msgs_is(nodes: InProcess) -> None:
    has_it = importlib.util.find_spec("control_msgs") is not None
    assert installed() == has_it
    assert (nodes.nodes["motion_controller"]._action is not None) == has_it


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.0, 9.81, 0.0), None])
def test_torques_for_another_gravity_than_the_scenes_are_warned_of(
    gravity: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, motion = load_scene("ur5"), load_gains(find_scene("ur5")).motion
    warn_of_gravity(dataclasses.replace(scene, gravity=gravity), motion)
    printed = capsys.readouterr().err
    assert ("gives torques for a gravity of (0.0, 0.0, -9.81)" in printed) == (
        gravity != (0.0, 0.0, -9.81)
    )
    assert printed.count("\n") <= 1, "one line"


@pytest.mark.parametrize("far", [(3.0, 0.0, 0.3), (0.5, 2.0, 1.0)])
def test_out_of_reach_means_that_the_machine_rests(far: tuple[float, ...]) -> None:
    """Eq. (6) would try for ever: 19.8 A and 1.29 rad/s."""
    run = load_offline_run("three_axis")
    run.advance(500)
    run.instructor.add(run.session.logical_ns, Pose(np.array(far), np.eye(3)))
    while run.instructor.reports.waiting[-1].state is not State.UNREACHABLE:
        assert run.session.logical_ns < 30 * SECOND, "it is reported"
        run.advance(50)
    for _ in range(40):
        run.advance(50)
        assert np.abs(run.session.state.v).max() < 0.02, "it rests when it is reported to"

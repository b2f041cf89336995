"""Tool targets, joint trajectories and tool paths in a row: what holds, what is reported."""

import dataclasses
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from ideal_arm import SECOND, Ideal

from arm_emulator import Pose, Refusal, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.executor.goal_status import GoalState, Kind
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.model.link_torques import LinkTorques
from arm_emulator.runs.gains import warn_of_gravity
from arm_emulator.runs.offline import load_offline_run

# The order in force


@pytest.mark.parametrize("seed", with_slow(range(6), 2))
def test_no_reference_jumps_when_an_order_replaces_another(seed: int) -> None:
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


@pytest.mark.parametrize("seed", with_slow(range(4), 1))
def test_paths_that_begin_where_the_tool_rests_run_in_sequence(seed: int) -> None:
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
@pytest.mark.parametrize(
    "running", with_slow([False, True], 1), ids=["before any angles", "while it runs"]
)
def test_a_stamp_of_the_wall_clock_is_refused(kind: str, running: bool) -> None:
    """A stamp of the wall clock would mean a wait of decades."""
    arm = Ideal()
    wall = 1_790_000_000 * SECOND
    if running:
        arm.advance(5.0)

    def send(stamp_ns: int) -> None:
        executor = arm.instructor
        if kind == "TOOL_TARGET":
            executor.add(stamp_ns, arm.pose([0.01, 0.0, 0.0]))
        elif kind == "JOINT_TRAJECTORY":
            points = [arm.point(3.0, 0.05)]
            executor.add_trajectory(arm.controller, arm.names, points, stamp_ns)
        elif kind == "TOOL_PATH":
            executor.add_path(arm.controller, [arm.pose([0.01, 0.0, 0.0])], stamp_ns)
        else:
            poses = [arm.pose(), arm.pose([0.01, 0.0, 0.0])]
            executor.add_path(arm.controller, poses, 0, [stamp_ns + k * 4 * SECOND for k in (1, 2)])

    if running:
        with pytest.raises(Refusal, match="at most 3600 s after logical time"):
            send(wall)
    else:
        send(wall)
        arm.advance(0.1)
    name = kind.replace("TIMED", "TOOL")
    (refused,) = [r for r in arm.instructor.reports.waiting if r.state is GoalState.REFUSED]
    assert refused.kind.name == name and "got 17900000" in refused.reason
    send(arm.now_ns + SECOND)  # a second ahead is as it always was
    arm.advance(15.0)
    assert (name, 2, "REACHED") in arm.states()


def test_the_newest_holds_and_each_is_answered() -> None:
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
    replaced = [r.reason for r in arm.instructor.reports.waiting if r.state is GoalState.REPLACED]
    assert replaced == ["by joint trajectory 1", "by tool target 2", "by tool target 2"]


@pytest.mark.parametrize("seed", with_slow(range(10), 3))
def test_no_request_is_lost_in_silence(seed: int) -> None:
    """For any orders in any sequence: accepted ones get one final answer, refused ones too."""
    rng = np.random.default_rng([seed, 1])
    arm = Ideal("three_axis" if seed % 2 else "ur5")
    requested = {kind: 0 for kind in Kind}
    for _ in range(30):
        time_ns = int(rng.choice([0, arm.now_ns + rng.integers(0, 2 * SECOND)]))
        kind = Kind(int(rng.integers(1, 4)))
        requested[kind] += 1
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
                arm.instructor.reports.refuse_goal(kind, time_ns, reason)
        arm.advance(rng.uniform(0.0, 0.5))
    arm.instructor.start_over("test")
    for kind, count in requested.items():
        for number in range(1, count + 1):
            reported = [
                r.state
                for r in arm.instructor.reports.waiting
                if (r.kind, r.number) == (kind, number)
            ]
            final = [state for state in reported if state.is_final]
            assert len(final) == 1 or final == [GoalState.UNREACHABLE, GoalState.REACHED], (
                f"{kind.name} {number} was answered by {reported}"
            )
            assert reported[-1] is final[-1], "nothing comes after the last word"
            assert reported[0] in (GoalState.ACCEPTED, GoalState.REFUSED), "the first word"


@pytest.mark.parametrize("scene", with_slow(["ur5", "three_axis", "panda"], 1))
def test_targets_beyond_reach_are_reported_as_such_with_the_distance(scene: str) -> None:
    arm = Ideal(scene)
    far = arm.pose((0.0, 0.0, 3.0))
    arm.instructor.add(0, far)
    arm.advance(15.0)
    last = arm.instructor.reports.waiting[-1]
    _, p_WT = arm.controller.kinematics.forward(arm.q)
    assert last.state is GoalState.UNREACHABLE, "it is reported"
    if scene != "three_axis":  # eq. (6) goes to and fro there
        left = float(np.linalg.norm(far.p_WT - p_WT))
        assert last.distance == pytest.approx(left, rel=1e-3), "how far"
    arm.instructor.add(0, arm.pose())
    arm.advance(10.0)
    assert arm.instructor.reports.waiting[-1].state is GoalState.REACHED, "the way back"


def test_a_trajectory_waits_for_its_stamp_and_then_keeps_its_times() -> None:
    arm = Ideal()
    still = np.zeros(6)
    points = [arm.point(t, by, velocities=still) for t, by in ((0.5, 0.1), (1.0, 0.0))]
    arm.instructor.add_trajectory(arm.controller, arm.names, points, stamp_ns=SECOND)
    arm.advance(2.5)
    at = {i * arm.period_ns: setpoint.q for i, setpoint in enumerate(arm.printed)}
    np.testing.assert_allclose(at[SECOND], arm.start, atol=1e-12, err_msg="not before its stamp")
    np.testing.assert_allclose(at[3 * SECOND // 2], arm.start + 0.1, atol=1e-9)
    np.testing.assert_allclose(at[2 * SECOND], arm.start, atol=1e-9, err_msg="the end")
    assert arm.states()[-1] == ("JOINT_TRAJECTORY", 1, "REACHED")


def test_a_trajectory_that_cannot_begin_is_refused_and_its_predecessor_goes_on() -> None:
    arm = Ideal()
    arm.instructor.set_parameters(dataclasses.replace(arm.config, trajectory_limits="refuse"))
    arm.instructor.add(0, arm.pose((0.05, 0.0, 0.0)))
    arm.advance(0.1)
    arm.instructor.add_trajectory(arm.controller, arm.names, [arm.point(0.02, 1.0)])
    arm.advance(4.0)
    reported = [r for r in arm.instructor.reports.waiting if r.kind is Kind.JOINT_TRAJECTORY]
    assert [report.state for report in reported] == [GoalState.ACCEPTED, GoalState.REFUSED]
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


@pytest.mark.parametrize(
    ("allowed", "state"), [(0.05, GoalState.ABORTED), (0.5, GoalState.REACHED)]
)
def test_an_arm_that_does_not_follow_ends_the_trajectory_where_it_is(
    allowed: float, state: GoalState
) -> None:
    arm = Ideal()
    arm.instructor.set_parameters(
        type(arm.config)(**{**vars(arm.config), "path_tolerance": allowed})
    )
    arm.instructor.add_trajectory(arm.controller, arm.names, [arm.point(1.0, 0.15)])
    for tick in range(150):  # the arm does not move at all
        arm.printed.append(
            arm.instructor.compute_setpoint(arm.controller, tick * arm.period_ns, arm.start)
        )
    last = arm.instructor.reports.waiting[-1]
    assert last.state is state
    if state is GoalState.ABORTED:
        assert "path tolerance: shoulder_pan_joint is off by" in last.reason
        np.testing.assert_array_equal(arm.printed[-1].q, arm.start, "held where it is")


def test_the_goal_tolerance_is_waited_for_as_long_as_is_allowed() -> None:
    for time, state in ((0.5, GoalState.ABORTED), (0.0, GoalState.MOVING)):
        arm = Ideal()
        change = {"goal_tolerance": 0.01, "goal_time": time}
        arm.instructor.set_parameters(type(arm.config)(**{**vars(arm.config), **change}))
        arm.instructor.add_trajectory(arm.controller, arm.names, [arm.point(0.5, 0.05)])
        for tick in range(300):
            q = arm.start if tick < 200 or state is GoalState.ABORTED else arm.start + 0.045
            arm.instructor.compute_setpoint(arm.controller, tick * arm.period_ns, q)
            if tick == 199:
                assert arm.instructor.reports.waiting[-1].state is state, f"goal_time {time} s"
        expected = GoalState.ABORTED if state is GoalState.ABORTED else GoalState.REACHED
        assert arm.instructor.reports.waiting[-1].state is expected


# Torques


@pytest.mark.parametrize("seed", range(3))
def test_the_torques_sent_are_those_of_gravity_at_the_links(seed: int) -> None:
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
        assert torques.compute_torques(q, np.zeros(6))[j] == pytest.approx(
            (high - low) / (2 * h), abs=1e-6
        )


def test_feedforward_is_sent_as_it_is_configured() -> None:
    scene = load_scene("ur5")
    gravity = LinkTorques(scene.urdf, scene.joint_names, (0.0, 0.0, -9.81))
    for kind, speed, torque in (
        ("none", False, False),
        ("speed", True, False),
        ("torque", True, True),
    ):
        arm = Ideal()
        arm.instructor = MotionExecutor(
            type(arm.config)(**{**vars(arm.config), "feedforward": kind})
        )
        arm.advance(0.1)
        if torque:
            np.testing.assert_allclose(
                arm.printed[0].tau, gravity.compute_torques(arm.start, np.zeros(6))
            )
        arm.instructor.add(0, arm.pose((0.1, 0.0, 0.0)))
        arm.advance(0.2)
        assert (arm.printed[-1].v is not None, arm.printed[-1].tau is not None) == (
            speed,
            torque,
        ), kind


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
    """Eq. (6) would try indefinitely: 19.8 A and 1.29 rad/s."""
    run = load_offline_run("three_axis")
    run.advance(500)
    run.instructor.add(run.session.logical_ns, Pose(np.array(far), np.eye(3)))
    while run.instructor.reports.waiting[-1].state is not GoalState.UNREACHABLE:
        assert run.session.logical_ns < 30 * SECOND, "the target is reported as unreachable"
        run.advance(50)
    for _ in range(40):
        run.advance(50)
        assert np.abs(run.session.state.v).max() < 0.02, "the arm rests after its report"

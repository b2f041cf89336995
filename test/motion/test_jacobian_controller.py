"""Eq. (6): kinematics against first principles, the law against what it promises, the residual."""

import math
from typing import Any

import numpy as np
import pytest
from kinematic_arms import NAMES, START, THREE_AXIS, arm, bent, moved, pose_at, three_axis

from arm_emulator import JacobianController, Kinematics, Pose, Refusal


@pytest.mark.parametrize(("controller", "q"), [(three_axis(), START), (arm(6), bent(6))])
def test_an_instruction_halves_a_small_error(controller: JacobianController, q: np.ndarray) -> None:
    """With w = 1/2, and joints that stand where they are asked to."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        twist = 1e-6 * rng.normal(size=6)
        target = moved(pose_at(controller, q), twist)
        before = controller.kinematics.tool_error(q, target)
        after = controller.kinematics.tool_error(controller.update(q, target).q, target)
        # The neglected term is quadratic: 1e-12 over a smallest singular value of 0.1.
        assert np.allclose(after, 0.5 * before, rtol=0, atol=1e-10)
        assert np.array_equal(controller.error, before)
        assert controller.notices == ()


@pytest.mark.parametrize("weight", [0.1, 0.5, 1.0])
def test_away_from_singular_poses_it_is_exactly_eq_6(weight: float) -> None:
    controller, q = arm(6, weight=weight, step_limit=1.0), bent(6)
    twist = np.array([1e-3, -2e-3, 3e-3, -1e-2, 2e-2, 1e-2])
    target = moved(pose_at(controller, q), twist)
    expected = q + weight * np.linalg.solve(controller.kinematics.jacobian(q), twist)
    assert np.allclose(controller.update(q, target).q, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("joints", [6, 7])
def test_instructions_reach_a_far_pose(joints: int) -> None:
    controller, q = arm(joints), bent(joints)
    target = pose_at(controller, q + 0.2 * np.cos(np.arange(joints)))
    for _ in range(40):
        q = controller.update(q, target).q
    # 2^-40 of an error of about 0.3.
    assert np.abs(controller.kinematics.tool_error(q, target)).max() < 1e-11


def test_seven_joints_take_the_step_of_minimum_norm() -> None:
    controller, q = arm(7), bent(7)
    twist = np.array([1e-3, -2e-3, 3e-3, -1e-2, 2e-2, 1e-2])
    J = controller.kinematics.jacobian(q)
    step = controller.update(q, moved(pose_at(controller, q), twist)).q - q
    null = np.linalg.svd(J)[2][-1]  # the joint motion that leaves the tool where it is
    assert np.abs(J @ null).max() < 1e-14
    assert abs(step @ null) < 1e-15
    assert np.allclose(J @ step, 0.5 * twist, rtol=0, atol=1e-14)
    assert np.allclose(step, 0.5 * np.linalg.pinv(J) @ twist, rtol=0, atol=1e-13)


def test_far_rotation_takes_the_short_path() -> None:
    controller, q = arm(6), bent(6)
    target = moved(pose_at(controller, q), np.array([0, 0, 0, 0, 0, 1.75 * math.pi]))
    error = controller.kinematics.tool_error(q, target)
    assert np.allclose(error, [0, 0, 0, 0, 0, -0.25 * math.pi], rtol=0, atol=1e-12)


def test_singular_pose_stays_finite_and_is_reported() -> None:
    """Stretched, no joint moves the tool along the arm; above the waist, none moves it aside."""
    controller = three_axis(step_limit=10.0)
    for q in ([0.3, 0.5, 0.0], [0.3, 0.0, 0.0], [0.3, 0.4, math.pi]):
        R_WT, p_WT = controller.kinematics.forward(q)
        for direction in np.vstack([np.eye(3), R_WT.T]):
            q_target = controller.update(q, Pose(p_WT + 0.01 * direction, R_WT)).q
            # w |e| / reach times the largest gain of the damped inverse, 1.16 / singular_below,
            # times sqrt(3) for three directions.
            bound = (
                0.5
                * 0.01
                / controller.kinematics.reach
                * 1.16
                / controller.singular_below
                * math.sqrt(3)
            )
            assert np.abs(q_target - q).max() < bound
            assert controller.notices[0].startswith("near a singular pose, damped")


def test_damping_begins_continuously_and_is_bounded() -> None:
    controller = three_axis()
    e = controller.singular_below
    s = np.linspace(0.0, 2 * e, 200001)
    gain = controller._invert_values(s)
    assert gain[0] == 0.0
    assert gain.max() <= 1.16 / e
    assert np.allclose(gain[s >= e], 1.0 / s[s >= e], rtol=1e-15, atol=0)  # rounding
    assert np.abs(np.diff(gain)).max() < 1e-3 * gain.max()  # steps of 1e-5 e: no jump


def test_regular_directions_are_not_damped() -> None:
    """At a stretched arm only the motion along it is lost; across it, eq. (6) holds exactly."""
    controller = three_axis()
    q = np.array([0.0, 0.5, 1e-4])
    R_WT, p_WT = controller.kinematics.forward(q)
    across = R_WT[:, 0] * 1e-4
    q_target = controller.update(q, Pose(p_WT + across, R_WT)).q
    assert controller.notices
    J = controller.kinematics.jacobian(q)
    # Off by the angle of 1e-4 / 2 between the arm and the direction that is lost.
    assert np.allclose(J @ (q_target - q), 0.5 * across, rtol=0, atol=1e-4 * 1e-4)


def test_long_step_is_shortened_in_all_joints() -> None:
    free, limited = three_axis(step_limit=10.0), three_axis(step_limit=0.01)
    target = Pose(free.kinematics.forward(START)[1] + np.array([0.05, 0.05, -0.02]), np.eye(3))
    step = free.update(START, target).q - START
    assert free.notices == ()
    short = limited.update(START, target).q - START
    assert np.allclose(short, step * 0.01 / np.abs(step).max(), rtol=0, atol=1e-15)
    assert "shortened to 0.01 rad" in limited.notices[0]


def test_joint_limits_hold_and_are_reported_in_words() -> None:
    controller = arm(6, singular_below=1e-6)  # the poses here are not far from singular ones
    q = bent(6)
    q[2] = 1.999
    J = controller.kinematics.jacobian(q)
    outward = moved(pose_at(controller, q), J @ (0.01 * np.eye(6)[2]))
    q_target = controller.update(q, outward).q
    assert q_target[2] == 2.0
    assert controller.notices == ("j2 held at 2: its limits are [-2, 2]",)
    # Outside already: not farther, but back.
    q[2] = 2.1
    J = controller.kinematics.jacobian(q)
    outward = moved(pose_at(controller, q), J @ (0.01 * np.eye(6)[2]))
    assert controller.update(q, outward).q[2] == 2.1
    inward = moved(pose_at(controller, q), J @ (-0.01 * np.eye(6)[2]))
    # Half of 0.01, and what is quadratic in it.
    assert controller.update(q, inward).q[2] == pytest.approx(2.095, abs=1e-4)


def test_continuous_joints_turn_without_limit() -> None:
    controller = three_axis()
    q = START + np.array([20 * math.pi, 0.0, 0.0])
    target = Pose(controller.kinematics.forward(START)[1] + np.array([0.0, 1e-3, 0.0]), np.eye(3))
    step = controller.update(q, target).q - q
    # Angles of 63 rad are rounded at 1e-14.
    assert np.allclose(step, controller.update(START, target).q - START, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"urdf_xml": "<robot"}, "robot_description: file must be well-formed XML"),
        ({"urdf_xml": ""}, "robot_description: file must be well-formed XML"),
        (
            {"joint_names": ["waist", "hip"]},
            "moving joints of the robot description, got hip; valid",
        ),
        ({"joint_names": ["tool_mount"]}, "be moving joints of the robot description"),
        ({"joint_names": []}, "joint_names must be different names"),
        ({"joint_names": ["waist", "waist"]}, "joint_names must be different names"),
        ({"tool": "hand"}, "tool must be a link of the robot description, got hand; valid: base"),
        ({"weight": 0.0}, "weight must be a number > 0 and <= 1"),
        ({"weight": 1.5}, "weight must be a number > 0 and <= 1"),
        ({"weight": "heavy"}, "weight must be a number > 0 and <= 1"),
        ({"step_limit": -1.0}, "step_limit must be a number > 0 rad"),
        ({"step_limit": math.nan}, "step_limit must be a number > 0 rad"),
        ({"singular_below": 0.0}, "singular_below must be a number > 0 and <= 1"),
        ({"task": "dance"}, "task must be known, got dance; valid: auto, position, pose"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, object], words: str) -> None:
    robot: dict[str, Any] = {"urdf_xml": THREE_AXIS, "joint_names": NAMES, "tool": "tool"}
    of_robot = {key: arguments[key] for key in arguments if key in (*robot, "task")}
    of_law: dict[str, Any] = {key: arguments[key] for key in arguments if key not in of_robot}
    with pytest.raises(Refusal) as refusal:
        JacobianController(Kinematics(**{**robot, **of_robot}), **of_law)
    assert words in str(refusal.value)


def test_bad_input_is_refused_and_changes_nothing() -> None:
    controller = three_axis()
    R_WT, p_WT = controller.kinematics.forward(START)
    target = Pose(p_WT + 0.01, R_WT)
    controller.update(START, target)
    error = controller.error
    for q, words in (
        (START[:2], "q must have 3 values"),
        ([0.0, math.nan, 0.0], "q must be numbers within"),
    ):
        with pytest.raises(Refusal, match=words):
            controller.update(q, target)
        assert controller.error is error
    with pytest.raises(Refusal, match="Pose: position must be numbers within"):
        Pose(p_WT * math.nan, R_WT)

"""Goals of `follow_joint_trajectory`: tolerances, results, cancelling."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from ideal_arm import SECOND, Ideal

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.executor.goal_status import GoalState, GoalStatus, Kind
from arm_emulator.motion.trajectory.tolerances import Allowed, Tolerances
from motion_controller_node.follow_action import check_points, make_result, read_tolerances


def goal(**inputs: Any) -> Any:
    """A goal of FollowJointTrajectory, as far as it states something."""
    empty = {
        "path_tolerance": [],
        "goal_tolerance": [],
        "goal_time_tolerance": Duration(),
    }
    return SimpleNamespace(**{**empty, **inputs})


def tolerance(name: str, position: float = 0.0, velocity: float = 0.0) -> Any:
    return SimpleNamespace(name=name, position=position, velocity=velocity, acceleration=0.0)


def test_tolerances_of_a_goal_override_the_parameters() -> None:
    names = ("a", "b")
    default = Tolerances(Allowed.make_equal(2, 0.1), Allowed.make_equal(2, 0.2), 3.0)
    tolerances = read_tolerances(
        goal(
            path_tolerance=[tolerance("b", 0.5, 2.0)],
            goal_tolerance=[tolerance("a", -1.0)],
            goal_time_tolerance=Duration(sec=1, nanosec=500_000_000),
        ),
        names,
        default,
    )
    assert tolerances.path.q.tolist() == [0.1, 0.5] and tolerances.path.v.tolist() == [0.0, 2.0]
    assert tolerances.goal.q.tolist() == [0.0, 0.2], "-1 allows anything"
    assert tolerances.goal_time == 1.5
    assert read_tolerances(goal(), names, default).goal_time == 3.0, "0 leaves it"
    erased = goal(goal_time_tolerance=Duration(sec=-1))
    assert read_tolerances(erased, names, default).goal_time == 0.0
    for wrong, words in (
        (
            goal(path_tolerance=[tolerance("x", 0.1)]),
            "joint must be one of the arm, got x; valid: a, b",
        ),
        (goal(goal_tolerance=[tolerance("a", -2.0)]), "be >= 0 rad, or -1 for any, got -2.0"),
        (goal(path_tolerance=[tolerance("a", math.nan)]), "be >= 0 rad, or -1 for any, got nan"),
        (goal(goal_time_tolerance=Duration(sec=-3)), "be >= 0 s, or -1 for any, got -3 s"),
    ):
        with pytest.raises(Refusal) as refusal:
            read_tolerances(wrong, names, default)
        assert words in str(refusal.value)


def test_a_goal_without_points_is_refused() -> None:
    check_points(goal(trajectory=SimpleNamespace(points=[object()])))
    with pytest.raises(Refusal, match="points must be some in a goal, got none"):
        check_points(goal(trajectory=SimpleNamespace(points=[])))


@pytest.mark.parametrize(
    ("state", "reason", "code"),
    [
        (GoalState.REACHED, "", 0),
        (GoalState.REFUSED, "joint_trajectory: ...", -1),
        (GoalState.REPLACED, "by tool target 3", -1),
        (GoalState.ABORTED, "cancelled", 0),
        (GoalState.ABORTED, "path tolerance: a is off by 1 rad", -4),
        (GoalState.ABORTED, "goal tolerance after 1 s: a is off by 1 rad", -5),
    ],
)
def test_a_goal_ends_with_the_code_of_its_last_word(
    state: GoalState, reason: str, code: int
) -> None:
    actual, words = make_result(
        GoalStatus(state, reason, kind=Kind.JOINT_TRAJECTORY, number=1, stamp_ns=0)
    )
    assert actual == code and reason in words


@pytest.mark.parametrize("waiting", [True, False])
def test_a_cancelled_trajectory_stops_or_never_begins(waiting: bool) -> None:
    arm = Ideal()
    arm.advance(0.1)
    points = [arm.point(1.0, 0.3), arm.point(2.0, -0.3)]
    stamp_ns = 5 * SECOND if waiting else 0
    number = arm.instructor.add_trajectory(arm.controller, arm.names, points, stamp_ns)
    arm.advance(0.5)
    arm.instructor.cancel_trajectory(number)
    arm.instructor.cancel_trajectory(number + 7)  # nobody's
    arm.advance(6.0)
    assert arm.states()[-1] == ("JOINT_TRAJECTORY", 1, "ABORTED")
    assert arm.instructor.reports.waiting[-1].reason == "cancelled"
    assert not np.any(arm.printed[-1].v), "it rests"
    far = np.abs(arm.q - arm.start).max()
    assert far == 0.0 if waiting else 0.1 < far < 0.2, "it stopped where it was"

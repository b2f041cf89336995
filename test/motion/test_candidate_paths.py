"""Ways to a target where the first one is not gone: slow searches, far ends, collisions."""

import math
from functools import partial

import numpy as np
import pytest
from draws import some, with_slow
from kinematic_arms import turning_chain
from scipy.spatial.transform import Rotation
from test_ways import PERIOD, draw_configuration, law_of, needs_robots, pose_of, random_arm

from arm_emulator import Kinematics, Pose, load_scene
from arm_emulator.motion.collision.collisions import Collisions
from arm_emulator.motion.ik.inverse_kinematics import InverseKinematics
from arm_emulator.motion.model.arm_tree import ArmTree
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import PlanningError
from arm_emulator.motion.model.obstacles import Obstacle
from arm_emulator.motion.planner.candidate_paths import find_joint_arc, measure_overshoot
from arm_emulator.motion.planner.collision_guard import CollisionGuard
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.tool_line import trace_line


def sets_out(controller: TargetPlanner, target: Pose) -> np.ndarray:
    """The joints along the way on which the arm sets out from rest (K, N)."""
    for _ in range(800):
        controller.update(controller.coming.q, target)
        if controller.path_text:
            break
    assert controller.path_text
    motion = controller.motion
    return np.array([motion.evaluate_at(t).q for t in np.linspace(0.0, motion.duration, 200)])


@pytest.mark.parametrize("seed", [0, 3, 25])
def test_angles_that_converge_slowly_are_no_goal_while_others_reach_the_target(seed: int) -> None:
    """120 steps of the search, as many as the arm waits for, have not found the angles."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, int(rng.integers(6, 8)), slide=0.0)
    start, end = draw_configuration(rng, arm), draw_configuration(rng, arm)
    target = pose_of(arm, end)
    goal = InverseKinematics(arm)
    goal.set_posture(start)
    goal.set_target(target, start)
    goal.iterate_steps(120)
    assert not goal.settled and not goal.is_reached, "another seed"
    controller = law_of(arm, PERIOD)
    controller.begin(start)
    path = sets_out(controller, target)
    assert np.linalg.norm(arm.tool_error(path[-1], target)) < 1e-6, controller.path_text


@pytest.mark.parametrize("seed", with_slow(some(range(12), 4), 1))
def test_no_tool_goes_far_past_its_end(seed: int) -> None:
    """Random targets all over the limits, by the tool's place on the whole way.

    Where the joints' line leads past the end, an arc beside it is found in most cases, within the
    position limits; the others go another way, or are refused. No arc leads more than 1 mm past
    the end, no way more than 3 mm.
    """
    rng = np.random.default_rng(seed)
    lines = arcs = 0
    while lines < 6:
        arm = random_arm(rng, 6, slide=0.2)
        tree = ArmTree(arm, (0.0, 0.0, 0.0))
        start, end = draw_configuration(rng, arm), draw_configuration(rng, arm)
        line = JointCurve.make_line(start, end)
        if measure_overshoot(tree, line) < 10.0e-3:
            continue
        lines += 1
        arc = find_joint_arc(tree, start, end)
        if arc is not None:
            arcs += 1
            q = arc.compute_derivatives(np.linspace(0.0, 1.0, 500))[0]
            np.testing.assert_allclose(q[[0, -1]], [start, end], atol=1e-12)
            assert (q > arm.lower - 1e-9).all() and (q < arm.upper + 1e-9).all()
            assert past(arm, q) < 1.1e-3  # between its looks
        controller = law_of(arm, PERIOD)
        controller.begin(start)
        try:
            path = sets_out(controller, pose_of(arm, end))
        except PlanningError as refused:
            assert "mm past its end" in str(refused)
            assert np.array_equal(controller.coming.q, start), "it began"
            continue
        assert past(arm, path) < 3e-3 + 1e-4, controller.path_text
    assert arcs >= lines / 2


def angles(curve: JointCurve, parts: np.ndarray) -> np.ndarray:
    return np.asarray(curve.compute_derivatives(parts)[0])


def past(arm: Kinematics, path: np.ndarray) -> float:
    """Largest distance of the tool past its end, along the line to it [m]."""
    p = np.array([arm.forward(q)[1] for q in path])
    line = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
    return float(((p - p[-1]) @ line).max())


@pytest.mark.slow
@needs_robots
def test_a_tool_rotates_in_the_opposite_sense_before_it_is_refused() -> None:
    """A box where the wrist would be in the middle of its turn, and is not in the other sense."""
    scene = load_scene("ur5")
    arm = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    wrist = Kinematics(scene.urdf, scene.joint_names, "wrist_1_link")
    rng, tree, turned = np.random.default_rng(0), ArmTree(arm, (0.0, 0.0, 0.0)), 0
    middle = np.array([0.5])
    while turned < len(some(range(12), 2)):
        q = scene.start + rng.uniform(-0.8, 0.8, 6)
        axis = rng.normal(size=3)
        angle = rng.uniform(0.75, 1.0) * math.pi
        turn = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        home = pose_of(arm, q)
        target = Pose(home.p_WT, turn @ home.R_WT)
        both = [trace_line(tree, q, home, target, None, True, reverse) for reverse in (False, True)]
        paths = [curve for curve in both if isinstance(curve, JointCurve)]
        if len(paths) < 2:
            continue
        at = wrist.forward(paths[0].compute_derivatives(middle)[0][0])[1]
        box = Obstacle("box", size=(0.1, 0.1, 0.1), at=tuple(at))
        guard = CollisionGuard(arm, MotionConfig(tool=arm.tool, obstacles=(box,)))
        touched = [guard.find_contact_along(partial(angles, curve)) for curve in paths]
        if touched[0] is None or touched[1] is not None or guard.collisions.find_first_contact(q):
            continue
        turned += 1
        controller = law_of(arm, PERIOD)
        controller.begin(q)
        controller.guard = guard
        q_path = sets_out(controller, target)
        assert np.linalg.norm(arm.tool_error(q_path[-1], target)) < 1e-6, controller.path_text
        truth = Collisions(scene.urdf, scene.joint_names, (box,), 0.0)
        assert not any(truth.find_first_contact(curve) for curve in q_path), controller.path_text


@pytest.mark.parametrize("seed", with_slow(some(range(20), 2), 1))
def test_a_redundant_arm_does_not_wait_for_a_slow_joint(seed: int) -> None:
    """Of eight joints one is a hundred times slower: it moves a quarter as far at most."""
    rng = np.random.default_rng(seed)
    joints, slow = 8, int(rng.integers(1, 7))
    names = [f"j{j}" for j in range(joints)]
    pieces = turning_chain(joints).split('velocity="1"')
    pieces[slow] += 'velocity="0.01"' + pieces.pop(slow + 1)
    alike, spared = (
        Kinematics(text, names, "tool")
        for text in (turning_chain(joints), 'velocity="1"'.join(pieces))
    )
    moved, result = np.zeros(2), 0
    for _ in range(20):
        q = rng.uniform(-1.5, 1.5, joints)
        target = pose_of(alike, q + 0.1 * rng.normal(size=joints))
        goals = [InverseKinematics(arm) for arm in (alike, spared)]
        for goal in goals:
            goal.set_posture(q)
            goal.set_target(target, q)
            goal.iterate_steps(300)
        if goals[0].is_reached and goals[1].is_reached:
            result += 1
            moved += [abs(goal.q[slow] - q[slow]) for goal in goals]
    assert result >= 18, "of 20; other configurations are tried for the rest"
    assert moved[1] < 0.25 * moved[0]

"""Method way: limits hold for any target, and ways pass the singular places of kinematics."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from draws import some, with_slow
from scipy.spatial.transform import Rotation

from arm_emulator import Kinematics, Pose, load_scene
from arm_emulator.base.io.config_files import find_config_folder
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.ik.inverse_kinematics import compute_directions
from arm_emulator.motion.model.arm_tree import ArmTree
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import PlanningError
from arm_emulator.motion.planner.target_planner import LOST, TargetPlanner
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.tool_line import trace_line

THREE_AXIS = (find_config_folder() / "urdf" / "three_axis.urdf").read_text()
NAMES = ("waist", "shoulder", "elbow")
PERIOD = 0.01  # s
needs_robots = pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data"
)


def random_arm(rng: np.random.Generator, joints: int, slide: float = 0.2) -> Kinematics:
    """Joints of every kind about random axes, with limits of position, speed and acceleration."""
    parts, parent = ['<robot name="arm"><link name="base"/>'], "base"
    for j in range(joints):
        kind = "prismatic" if rng.random() < slide else "revolute"
        if kind == "revolute" and rng.random() < 0.3:
            kind = "continuous"
        axis, place = rng.normal(size=3), rng.normal(size=3) * 0.15
        low, high = -rng.uniform(0.3, 3.0), rng.uniform(0.3, 3.0)
        if kind == "prismatic":
            low, high = 0.2 * low, 0.2 * high
        span = "" if kind == "continuous" else f'lower="{low}" upper="{high}"'
        speed = rng.uniform(0.3, 6.0)
        more = f'acceleration="{rng.uniform(2.0, 20.0)}"' if rng.random() < 0.5 else ""
        parts.append(
            f'<joint name="j{j}" type="{kind}"><parent link="{parent}"/><child link="l{j}"/>'
            f'<origin xyz="{place[0]} {place[1]} {place[2]}"/>'
            f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
            f'<limit {span} effort="1" velocity="{speed}" {more}/></joint><link name="l{j}"/>'
        )
        parent = f"l{j}"
    parts.append(
        f'<joint name="mount" type="fixed"><parent link="{parent}"/><child link="tool"/>'
        '<origin xyz="0.1 0 0.1"/></joint><link name="tool"/></robot>'
    )
    return Kinematics("".join(parts), [f"j{j}" for j in range(joints)], "tool")


def pose_of(kinematics: Kinematics, q: np.ndarray) -> Pose:
    R_WT, p_WT = kinematics.forward(q)
    return Pose(p_WT, R_WT)


def draw_configuration(rng: np.random.Generator, kinematics: Kinematics) -> np.ndarray:
    return rng.uniform(np.maximum(kinematics.lower, -3.0), np.minimum(kinematics.upper, 3.0))


def law_of(arm: Kinematics, period: float, **more: float) -> TargetPlanner:
    return TargetPlanner(arm, MotionConfig(tool=arm.tool, period=period, **more))  # type: ignore[arg-type]


def run(
    controller: TargetPlanner,
    q: np.ndarray,
    target: Pose,
    seconds: float,
    observe: Callable[[np.ndarray], None] = lambda q: None,
) -> np.ndarray:
    """Joints that stand where they are asked to; return where they end."""
    for _ in range(round(seconds / controller.period)):
        instruction = controller.update(q, target)
        assert instruction.v is not None
        q = instruction.q + controller.period * instruction.v
        observe(q)
    return q


# Limits


@pytest.mark.parametrize("seed", with_slow(some(range(8), 5), 1))
def test_limits_hold_for_any_target(seed: int) -> None:
    """Targets near, far and nowhere, at any time, in mid-motion, also moving ones."""
    rng = np.random.default_rng(seed)
    arm = random_arm(rng, int(rng.integers(1, 10)))
    period = float(rng.choice([0.002, 0.01, 0.05]))
    controller = law_of(arm, period, velocity_limit=4.0, acceleration_limit=10.0)
    limits = controller.limits
    assert (limits.speed <= np.minimum(arm.velocity_limit, 4.0)).all()
    assert (limits.acceleration <= np.minimum(arm.acceleration_limit, 10.0)).all()
    q = draw_configuration(rng, arm)
    controller.begin(q)
    target, twist = pose_of(arm, q), np.zeros(3)
    for k in range(200):
        if rng.random() < 0.1:
            far = Pose(rng.normal(size=3) * 3.0, Rotation.random(random_state=k).as_matrix())
            target = far if rng.random() < 0.3 else pose_of(arm, draw_configuration(rng, arm))
            twist = rng.normal(size=3) * rng.choice([0.0, 0.5])
        target = Pose(target.p_WT + period * twist, target.R_WT)
        now = controller.update(q, target).now
        assert now is not None and now.jerk is not None
        np.testing.assert_allclose(now.q, q, atol=1e-9, err_msg="the reference jumped")
        # Between periods, too: the motion that was promised at this one.
        for t in np.linspace(0.0, 1.0, 5):
            reference = controller._motion.evaluate_at(controller._time - period + t * period)
            for quantity in ("speed", "acceleration"):
                share = np.abs(reference.v if quantity == "speed" else reference.a) / getattr(
                    limits, quantity
                )
                assert share.max() <= 1.0 + 1e-6, f"{quantity}: {share.max()}"
            # Ruckig's jumps of jerk are met within 1e-7 s.
            assert reference.jerk is not None
            assert (np.abs(reference.jerk) <= limits.jerk * (1.0 + 1e-3)).all(), "jerk"
            low, high = arm.lower - 1e-8, arm.upper + 1e-8
            assert ((reference.q >= low) & (reference.q <= high)).all(), "position"
        q = controller.coming.q


@pytest.mark.parametrize("seed", with_slow(some(range(20), 4), 1))
def test_a_line_keeps_position_limits_between_its_nodes(seed: int) -> None:
    """A limit between what the nodes reach and what the curve through them reaches."""
    rng = np.random.default_rng(seed)
    tried = 0
    for _ in range(20):
        arm = random_arm(rng, 6, slide=0.0)
        start = draw_configuration(rng, arm)
        end = np.clip(start + rng.normal(size=6) * 0.3, arm.lower, arm.upper)
        tree, ends = ArmTree(arm, (0.0, 0.0, 0.0)), (pose_of(arm, start), pose_of(arm, end))
        curve = trace_line(tree, start, *ends, None)
        if not isinstance(curve, JointCurve):
            continue
        nodes = curve.compute_derivatives(curve.breaks)[0]
        dense = curve.compute_derivatives(np.linspace(0.0, 1.0, 20_001))[0]
        for j in np.flatnonzero(dense.max(axis=0) > nodes.max(axis=0) + 1e-6):
            before = arm.upper[j]
            arm.upper[j] = 0.5 * (dense[:, j].max() + nodes[:, j].max())
            assert curve.find_exit(arm.lower, arm.upper) is not None
            again = trace_line(tree, start, *ends, None)
            if isinstance(again, JointCurve):  # of more nodes
                highest = again.compute_derivatives(np.linspace(0.0, 1.0, 20_001))[0][:, j].max()
                assert highest <= arm.upper[j] + 2e-9
            arm.upper[j] = dense[:, j].max() + 1e-7  # between the samples
            assert curve.find_exit(arm.lower, arm.upper) is None
            arm.upper[j] = before
            tried += 1
    assert tried, "no curve had an extreme between its nodes"


# Arriving


@pytest.mark.parametrize("joints", with_slow(some([3, 9, 1, 6, 2, 4, 5, 7], 4), 2))
def test_reachable_poses_are_reached_and_not_passed(joints: int) -> None:
    rng = np.random.default_rng(joints)
    reached = 0
    arms = some(range(8), 4)
    for _ in arms:
        arm = random_arm(rng, joints)
        start = draw_configuration(rng, arm)
        end = np.clip(start + rng.normal(size=joints) * 0.3, arm.lower, arm.upper)
        target = pose_of(arm, end)
        controller = law_of(arm, 0.02)
        controller.begin(start)
        positions: list[np.ndarray] = []
        run(controller, start, target, 8.0, positions.append)
        left = [float(np.linalg.norm(arm.scale * arm.tool_error(q, target))) for q in positions]
        if left[-1] < 1e-6:
            reached += 1
            there = int(np.argmax(np.array(left) < 1e-4))
            assert max(left[there:]) < 1e-3, "it went past its target"
        else:
            assert any("unreachable" in words for words in controller.notices), "no word"
    # A narrow joint limit may leave no way.
    assert reached >= len(arms) - 1, f"{reached} of {len(arms)}"


@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(12), 3))
def test_a_tool_that_cannot_turn_evenly_goes_straight_all_the_same(seed: int) -> None:
    """To other configurations and by singular poses: where it goes is announced before."""
    rng = np.random.default_rng(seed)
    free = 0
    for _ in range(20):
        arm = random_arm(rng, int(rng.integers(6, 8)), slide=0.0)
        start, end = draw_configuration(rng, arm), draw_configuration(rng, arm)
        target = pose_of(arm, end)
        controller = law_of(arm, PERIOD)
        controller.begin(start)
        try:
            for _ in range(100):
                controller.update(controller.coming.q, target)
                if controller.path_text:
                    break
        except PlanningError as refused:
            assert "past its end" in str(refused) and not controller.path_text
            continue
        assert controller.path_text
        times = np.linspace(0.0, controller.motion.duration, 400)
        p = np.array([arm.forward(controller.motion.evaluate_at(t).q)[1] for t in times])
        line = (p[-1] - p[0]) / np.linalg.norm(p[-1] - p[0])
        past = float(((p - p[-1]) @ line).max())
        off = np.linalg.norm(p - p[0] - np.outer((p - p[0]) @ line, line), axis=1).max()
        if "turning as the joints do" in controller.path_text:
            free += 1
            assert past < 1e-9 and off < 2e-5 * arm.reach, f"{past} {off}: {controller.path_text}"
        elif controller.path_text.startswith("along the joints' line"):
            announced = "past its end" in controller.path_text
            assert announced or past < 1.1e-3, f"{past}: {controller.path_text}"
            assert past > 0.9e-3 or not announced, f"{past}: {controller.path_text}"
            assert past < 3.1e-3
        elif controller.path_text.startswith("along an arc of the joints"):
            assert past < 1.1e-3, f"{past}: {controller.path_text}"
        else:
            assert past < 1e-9, f"{past}: {controller.path_text}"
    assert free


def test_the_same_requests_have_the_same_results_to_the_last_bit() -> None:
    rng = np.random.default_rng(2)
    arm = random_arm(rng, 7)
    start = draw_configuration(rng, arm)
    targets = [pose_of(arm, draw_configuration(rng, arm)) for _ in range(5)]
    ends = []
    for _ in range(2):
        controller, q = law_of(arm, PERIOD), start
        controller.begin(q)
        for target in targets:
            q = run(controller, q, target, 0.5)
        ends.append(q)
    assert np.array_equal(*ends)


def test_an_arm_that_is_moved_by_others_is_met_where_it_is() -> None:
    arm = Kinematics(THREE_AXIS, NAMES, "tool")
    controller = law_of(arm, PERIOD)
    q = np.array([0.0, 0.5, 0.8])
    controller.begin(q)
    target = pose_of(arm, q + 0.1)
    run(controller, q, target, 0.1)
    elsewhere = q - 2.0 * LOST
    instruction = controller.update(elsewhere, target)
    np.testing.assert_allclose(instruction.q, elsewhere, atol=0.1)
    assert "began anew" in controller.notices[0]
    assert controller.update(elsewhere, target).q is not elsewhere and not controller.notices


# Hard places


@pytest.mark.parametrize("seed", with_slow(range(5), 1))
def test_beyond_reach_the_nearest_point_is_reported_and_the_return_keeps_the_elbow(
    seed: int,
) -> None:
    """The three-axis arm, whose reach is known: 0.6 m about the shoulder at 0.3 m."""
    rng = np.random.default_rng(seed)
    arm = Kinematics(THREE_AXIS, NAMES, "tool")
    start = np.array([rng.uniform(-3, 3), rng.uniform(-1, 1), rng.uniform(0.3, 2.5)])
    start[2] *= rng.choice([-1.0, 1.0])
    direction = rng.normal(size=3)
    direction[2] = abs(direction[2])
    away = rng.uniform(0.01, 2.0)
    far = [0.0, 0.0, 0.3] + direction / np.linalg.norm(direction) * (0.6 + away)
    controller = law_of(arm, PERIOD)
    controller.begin(start)
    side = np.sign(start[2])
    elbows: list[float] = []
    q = run(controller, start, Pose(far, np.eye(3)), 6.0, lambda q: elbows.append(side * q[2]))
    left = np.linalg.norm(arm.tool_error(q, Pose(far, np.eye(3))))
    # An elbow bent by 1e-3 rad is 1e-7 m short of the reach.
    assert left == pytest.approx(away, abs=1e-5), "not the nearest point"
    assert f"unreachable: the nearest point is {away:.3g} m" in controller.notices[-1]
    home = pose_of(arm, start)
    q = run(controller, q, home, 6.0, lambda q: elbows.append(side * q[2]))
    assert np.linalg.norm(arm.tool_error(q, home)) < 1e-6, "it did not come back"
    assert np.abs(q - start).max() < 1e-5, "another configuration"
    assert min(elbows) > -1e-3, "the elbow went through"  # rad: straight, and no farther


@pytest.mark.parametrize("seed", with_slow(range(3), 1))
def test_a_stretched_arm_gets_away(seed: int) -> None:
    """Exactly singular, and the target on the line that no joint moves the tool along."""
    rng = np.random.default_rng(seed)
    arm = Kinematics(THREE_AXIS, NAMES, "tool")
    start = np.array([rng.uniform(-3, 3), rng.uniform(-1.5, 1.5), 0.0])
    _, p_WT = arm.forward(start)
    shoulder = np.array([0.0, 0.0, 0.3])
    target = Pose(shoulder + rng.uniform(0.3, 0.95) * (p_WT - shoulder), np.eye(3))
    controller = law_of(arm, PERIOD)
    controller.begin(start)
    q = run(controller, start, target, 4.0)
    assert np.linalg.norm(arm.tool_error(q, target)) < 1e-6
    assert not controller.notices


@needs_robots
def test_a_line_through_the_wrists_singular_pose_is_completed() -> None:
    loaded = load_scene("ur5")
    arm = Kinematics(loaded.urdf, loaded.joint_names, loaded.tool)
    rng, lines = np.random.default_rng(7), 0
    while lines < len(some(range(5), 3)):
        singular = loaded.start + rng.uniform(-0.3, 0.3, 6)
        singular[4] = 0.0
        middle = pose_of(arm, singular)
        J = arm.jacobian(singular)
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        # Only lines that the joints can follow there begin and end within reach.
        if np.linalg.norm(J @ np.linalg.pinv(J, 1e-3) @ [*direction, 0, 0, 0]) < 0.9:
            continue
        ends = [Pose(middle.p_WT + s * direction, middle.R_WT) for s in (-0.15, 0.15)]
        controller = law_of(arm, PERIOD)
        controller.begin(singular)
        q = run(controller, singular, ends[0], 5.0)
        if controller.notices:
            continue
        lines += 1
        q = run(controller, q, ends[1], 5.0)
        error = arm.tool_error(q, ends[1])
        assert np.linalg.norm(error[:3]) < 1e-6, f"{controller.notices}"


@needs_robots
@pytest.mark.parametrize("scene", with_slow(["ur5", "panda"], 1))
def test_half_rotations_are_executed(scene: str) -> None:
    """About any axis, by exactly pi, where the logarithm is not continuous."""
    loaded = load_scene(scene)
    arm = Kinematics(loaded.urdf, loaded.joint_names, loaded.tool)
    rng, home = np.random.default_rng(8), pose_of(arm, loaded.start)
    for k in some([3, 2, 1, 0], 2):
        axis = np.eye(3)[k] if k < 3 else rng.normal(size=3)
        turn = Rotation.from_rotvec(math.pi * axis / np.linalg.norm(axis)).as_matrix()
        target = Pose(home.p_WT, turn @ home.R_WT)
        controller = law_of(arm, PERIOD)
        controller.begin(loaded.start)
        q = run(controller, loaded.start, target, 8.0)
        error = arm.tool_error(q, target)
        reported = any("unreachable" in words for words in controller.notices)
        assert np.linalg.norm(error) < 1e-6 or reported, f"{error} about {axis}"
        assert scene == "panda" or not reported, "the ur5 can"


@pytest.mark.parametrize("seed", with_slow(range(2), 1))
def test_redundant_arms_do_not_drift_over_circles(seed: int) -> None:
    rng = np.random.default_rng(seed)
    while True:
        arm = random_arm(rng, 7, slide=0.0)
        start = draw_configuration(rng, arm)
        squares, _ = compute_directions(arm.jacobian(start) * arm.scale[:, None])
        if squares[1] > 0.1**2:  # the first is that of the joint motion that moves no tool
            break
    home = pose_of(arm, start)
    u, v = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2] * 0.05 * arm.reach
    controller, q = law_of(arm, 0.02), start
    controller.begin(q)
    for k in range(10 * 50):
        turn = 2.0 * math.pi * k / 50
        at = home.p_WT + u * (math.cos(turn) - 1.0) + v * math.sin(turn)
        instruction = controller.update(q, Pose(at, home.R_WT))
        q = instruction.q + controller.period * instruction.v
    q = run(controller, q, home, 3.0)
    assert np.abs(q - start).max() < 1e-4


def limited_arm(**limits: tuple[float, float]) -> Kinematics:
    """The three-axis arm whose joints turn between limits."""
    urdf = THREE_AXIS
    for name, (lower, upper) in limits.items():
        urdf = urdf.replace(
            f'<joint name="{name}" type="continuous">',
            f'<joint name="{name}" type="revolute">'
            f'<limit lower="{lower}" upper="{upper}" effort="9" velocity="9"/>',
        )
    return Kinematics(urdf, NAMES, "tool")


def assert_reached(arm: Kinematics, start: np.ndarray, end: np.ndarray) -> None:
    controller = law_of(arm, PERIOD)
    controller.begin(start)
    q = run(controller, start, pose_of(arm, end), 8.0)
    assert np.linalg.norm(arm.tool_error(q, pose_of(arm, end))) < 1e-6, f"{start} {end}"


def test_a_joint_limit_in_the_path_is_circumvented() -> None:
    """An elbow that bends to one side only: from a pose on the other side of the base."""
    arm, rng = limited_arm(elbow=(0.2, 2.5), waist=(-2.8, 2.8)), np.random.default_rng(3)
    for _ in some(range(10), 5):
        start, end = rng.uniform((-2.7, -1.5, 0.3), (2.7, 1.5, 2.4), (2, 3))
        assert_reached(arm, start, end)


def test_a_joint_at_its_limit_goes_a_turn_back() -> None:
    """Waist from -pi to pi: the short way to the other side leads through the limit."""
    arm, rng = limited_arm(waist=(-3.14159, 3.14159)), np.random.default_rng(5)
    for _ in some(range(10), 4):
        side, bend = rng.choice([-1.0, 1.0]), rng.uniform((0.2, 0.3), (0.8, 1.5))
        start, end = (np.array([way * rng.uniform(2.6, 3.0), *bend]) for way in (side, -side))
        assert_reached(arm, start, end)

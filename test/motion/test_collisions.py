"""No part of an arm touches another or an obstacle: known before, and stopped before."""

import dataclasses
import math
from pathlib import Path as File

import numpy as np
import pytest
import yaml
from draws import some, with_slow
from scipy.spatial import ConvexHull

from arm_emulator import Kinematics, OfflineRun, Pose, Refusal, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.collision import collisions
from arm_emulator.motion.collision.collisions import OWN_SHARE, Collisions
from arm_emulator.motion.executor.goal_status import GoalState, GoalStatus
from arm_emulator.motion.executor.jog import JogStatus, make_joint_command, make_twist_command
from arm_emulator.motion.model.config import MotionConfig, load_motion_config
from arm_emulator.motion.model.obstacles import Obstacle
from arm_emulator.motion.planner.collision_guard import CollisionGuard
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint

MARGIN = 0.01  # m

TWO_LINKS = """<robot name="two"><link name="base"/>
{links}
<joint name="a" type="revolute"><parent link="base"/><child link="first"/>
  <origin xyz="0 0 1"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
<joint name="b" type="revolute"><parent link="first"/><child link="second"/>
  <origin xyz="1 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
<joint name="c" type="fixed"><parent link="second"/><child link="tool"/>
  <origin xyz="1 0 0"/></joint></robot>"""
BALL = """<link name="{}"><collision><origin xyz="{} 0 0"/>
  <geometry><sphere radius="{}"/></geometry></collision></link>"""


def two_links() -> str:
    """A ball of 0.1 m in the middle of the first link, one of 0.05 m at the end of the second."""
    return TWO_LINKS.format(
        links=BALL.format("first", 0.5, 0.1)
        + BALL.format("second", 1.0, 0.05)
        + '<link name="tool"/>'
    )


@pytest.mark.parametrize("seed", with_slow(some(range(200), 40), 10))
def test_balls_touch_where_their_distance_is_that_of_the_radii(seed: int) -> None:
    """Against the closed form: a floor, and a box that a ball meets on its flat side."""
    rng = np.random.default_rng(seed)
    q, height = rng.uniform(-2.5, 2.5, 2), rng.uniform(-1.0, 0.8)
    result = Collisions(
        two_links(), ("a", "b"), [Obstacle("floor", height)], MARGIN
    ).find_first_contact(q)
    first = 1.0 - 0.5 * math.sin(q[0])
    second = 1.0 - math.sin(q[0]) - math.sin(q[0] + q[1])
    lowest = min(first - 0.1, second - 0.05)
    if abs(lowest - MARGIN - height) > 1e-6:
        assert bool(result) == (lowest < height + MARGIN), (lowest, height)
    if result:
        assert result.endswith("and floor")


def test_pairs_that_belong_together_are_left_out() -> None:
    """Neighbours overlap by design; a folded ur5 touches itself."""
    scene = load_scene("ur5")
    checker = Collisions(scene.urdf, scene.joint_names, (), MARGIN)
    assert checker.find_first_contact(scene.start) == ""
    folded = scene.start.copy()
    folded[2] = 2.9
    assert checker.find_first_contact(folded) != ""
    bare = Collisions(two_links(), ("a", "b"), (), MARGIN)
    assert bare.pairs == 0 and bare.find_first_contact(np.zeros(2)) == ""


@pytest.mark.parametrize("margin", [0.0, MARGIN, 5.0 * MARGIN])
@pytest.mark.parametrize("name", with_slow(["panda", "ur5"], 1))
def test_no_pair_is_tested_that_touches_at_rest(name: str, margin: float) -> None:
    scene = load_scene(name)
    arm = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    rest = np.where((arm.lower > 0.0) | (arm.upper < 0.0), 0.5 * (arm.lower + arm.upper), 0.0)
    assert Collisions(scene.urdf, scene.joint_names, (), margin).find_first_contact(rest) == ""


PLATES = """<robot name="plates">
<link name="base"><collision><geometry><mesh filename="file://{mesh}"/></geometry></collision></link>
<joint name="a" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="1 0 0"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/></joint><link name="slide"/>
<joint name="b" type="prismatic"><parent link="slide"/><child link="ball"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
{ball}</robot>"""


def test_a_part_may_enter_a_hollow_part(tmp_path: File) -> None:
    """A ball between two plates of one mesh, whose convex hull fills the gap: closed form."""
    corners = np.array([(x, z) for x in (-0.5, 0.5) for z in (-0.5, 0.5)])
    text = "solid plates\n"
    for side in (-1.0, 1.0):
        plate = [(x, side * y, z) for y in (0.2, 0.25) for x, z in corners]
        for face in ConvexHull(plate).simplices:
            rows = "".join("vertex {} {} {}\n".format(*plate[k]) for k in face)
            text += f"facet normal 0 0 0\nouter loop\n{rows}endloop\nendfacet\n"
    mesh = tmp_path / "plates.stl"
    mesh.write_text(text + "endsolid plates\n")
    urdf = PLATES.format(mesh=mesh, ball=BALL.format("ball", 0.0, 0.05))
    tested, rng, touched = Collisions(urdf, ("a", "b"), (), MARGIN), np.random.default_rng(0), 0
    for _ in range(200):
        q = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.19, 0.19)])
        apart = 0.2 - abs(q[1]) - 0.05 - OWN_SHARE * MARGIN
        if abs(apart) > 1e-4:
            assert bool(tested.find_first_contact(q)) == (apart < 0.0), q
            touched += apart < 0.0
    assert 0 < touched < 200


@pytest.mark.parametrize("name", with_slow(["panda", "ur5"], 1))
def test_boxes_first_change_nothing(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the arm's own parts, a floor and a turned box, in random poses and in a row of them."""
    scene, rng = load_scene(name), np.random.default_rng(3)
    box = Obstacle("box", size=(0.3, 0.3, 0.6), at=(0.5, 0.1, 0.3), rpy=(0.3, 0.1, 0.5))
    both = []
    for many in (0, 10_000):
        monkeypatch.setattr(collisions, "_MANY", many)
        obstacles = (Obstacle("floor", -0.05), box)
        both.append(Collisions(scene.urdf, scene.joint_names, obstacles, MARGIN))
    q = scene.start + rng.normal(0.0, 0.8, (150, len(scene.start)))
    first = [[checker.find_first_contact(row) for row in q] for checker in both]
    assert first[0] == first[1]
    touching = [k for k, words in enumerate(first[0]) if words]
    assert [*both[0].find_touching(q)] == [*both[1].find_touching(q)] == touching
    assert 0 < len(touching) < 150


@pytest.mark.parametrize("seed", with_slow(some(range(60), 20), 6))
def test_no_part_moves_farther_than_the_bound(seed: int) -> None:
    """Against the balls' own centres, and the corners of panda's boxes of shapes."""
    rng = np.random.default_rng(seed)
    tested = Collisions(two_links(), ("a", "b"), [Obstacle("floor", -9.0)], MARGIN)
    q = rng.uniform(-2.0, 2.0, 2)
    step = rng.normal(0.0, 10.0 ** rng.uniform(-3.0, 0.0), 2)

    def balls(a: float, b: float) -> np.ndarray:
        outer = [math.cos(a) + math.cos(a + b), -math.sin(a) - math.sin(a + b)]
        return np.array([[0.5 * math.cos(a), -0.5 * math.sin(a)], outer])

    moved = np.linalg.norm(balls(*(q + step)) - balls(*q), axis=1)
    assert (moved <= tested.bound_motions(step) * (1.0 + 1e-9)).all()
    # A turn of the outer joint alone leads the outer ball's far side by 1.05 m/rad.
    assert tested.bound_motions(np.array([0.0, 1.0])) == pytest.approx([0.0, 1.05], abs=0.04)


def test_parts_that_are_near_by_design_may_be() -> None:
    """1.5 mm between two balls with all joints at 0, less than the margin: only touch counts."""
    third = (
        '<joint name="d" type="revolute"><parent link="second"/><child link="third"/>'
        '<origin xyz="-0.6 0 0.03"/><axis xyz="1 0 0"/>'
        '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    )
    radius = math.hypot(0.1, 0.03) - 0.1 - 1.5e-3  # of the third; the first has 0.1 m
    urdf = two_links().replace("</robot>", f"{third}{BALL.format('third', 0.0, radius)}</robot>")
    tested = Collisions(urdf, ("a", "b", "d"), [], MARGIN)
    assert tested.pairs == 1
    for b in np.linspace(-0.2, 0.2, 81):
        place = np.array([[math.cos(b), math.sin(b)], [-math.sin(b), math.cos(b)]]) @ [-0.6, 0.03]
        apart = float(np.linalg.norm(place - [-0.5, 0.0])) - 0.1 - radius
        if abs(apart) > 1e-6:
            assert bool(tested.find_first_contact(np.array([0.0, b, 0.0]))) == (apart < 0.0), b


class Arm:
    """An arm with a floor, or a box, 0.2 m below where its tool starts: the whole machine."""

    def __init__(self, name: str = "ur5", box: bool = False, **parameters: object) -> None:
        file = find_scene(name)
        scene, gains = load_scene(file), load_gains(file)
        kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
        self.R_WT, self.p_WT = kinematics.forward(scene.start)
        x, y, z = self.p_WT.tolist()
        obstacles = (Obstacle("floor", z - 0.2),)
        if box:
            obstacles = (Obstacle("floor", size=(0.3, 0.3, 0.1), at=(x, y, z - 0.25)),)
        motion = dataclasses.replace(
            gains.motion,
            obstacles=obstacles,
            jog_command_in_type="speed_units",
            **parameters,  # type: ignore[arg-type]
        )
        self.run = OfflineRun(scene, gains.servo, motion)
        self.kinematics = self.run.controller.kinematics
        self.truth = Collisions(scene.urdf, scene.joint_names, obstacles, 0.0)
        self.run.advance(1000)

    def advance(self, seconds: float) -> None:
        """Go on; the true links never touch anything."""
        for _ in range(round(seconds / 0.01)):
            self.run.advance(self.run.motion_ticks)
            assert self.truth.find_first_contact(self.run.session.state.q) == ""

    @property
    def height(self) -> float:
        """Of the true tool over where it began [m]."""
        return float(self.kinematics.forward(self.run.session.state.q)[1][2] - self.p_WT[2])


def test_without_obstacles_the_same_move_is_executed() -> None:
    """The floor, not another obstacle, stops the arm."""
    arm = Arm(collisions="off")
    arm.run.instructor.add(0, Pose(arm.p_WT - np.array([0.0, 0.0, 0.4]), arm.R_WT))
    arm.run.advance(2000)
    assert arm.height < -0.35


@pytest.mark.parametrize("seed", with_slow(some([2, 0, 1, *range(3, 20)], 3), 1))
def test_a_jog_halts_before_a_collision_and_leaves(seed: int) -> None:
    """Drawn twists downwards and joint speeds: the true arm never touches the floor or itself."""
    rng = np.random.default_rng(seed)
    arm = Arm(jog_scale_linear=0.6, jog_scale_rotational=2.0)
    codes = set()
    for k in range(6):
        if k % 2 == 0:
            down = rng.normal(0.0, 0.1, 6) - [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
            command = make_twist_command(0, down, "", arm.kinematics, arm.run.instructor._config)
        else:
            names = arm.kinematics.joint_names
            speeds = rng.normal(0.0, 1.5, 6)
            config = arm.run.instructor._config
            command = make_joint_command(0, names, speeds, arm.kinematics, config)
        for _ in range(12):
            now = dataclasses.replace(command, time_ns=arm.run.session.logical_ns)
            arm.run.instructor.take_jog(now)
            arm.advance(0.08)
            jog = arm.run.instructor.jogging
            codes.add(None if jog is None else jog.status)
    assert JogStatus.HALT_FOR_COLLISION in codes


def test_a_path_is_checked_before_it_begins() -> None:
    """The place of the first touch of a ball and a floor, within the pieces of the search."""
    config = MotionConfig(tool="tool", obstacles=(Obstacle("floor", 0.0),))
    kinematics = Kinematics(two_links(), ("a", "b"), "tool", "position")
    guard = CollisionGuard(kinematics, config)
    result = guard.find_contact_along(lambda part: np.outer(part, [2.0, 0.0]))
    assert result is not None
    # The outer ball: 1 - 2 sin(q) - 0.05 = 0.01.
    assert result[0] == pytest.approx(math.asin(0.47) / 2.0, abs=0.015)
    assert result[1] == "second and floor"
    assert guard.find_contact_along(lambda part: np.outer(part, [-0.8, 0.0])) is None


@pytest.mark.parametrize("margin", with_slow([MARGIN, 2e-3, 0.0], 1))
def test_thin_plates_are_detected_wherever_they_are(margin: float) -> None:
    """Plates from 0.5 mm on, and balls of 4 mm on ways of any length, against 3000 looks.

    Looks every 5 cm pass by two thirds of them at a margin of 2 mm.
    """
    thin = TWO_LINKS.format(
        links=BALL.format("first", 0.5, 4e-3)
        + BALL.format("second", 1.0, 4e-3)
        + '<link name="tool"/>'
    )
    kinematics, met, places = Kinematics(thin, ("a", "b"), "tool", "position"), 0, 3000
    for seed in some(range(200), 12):
        rng = np.random.default_rng(seed)
        size = 10.0 ** rng.uniform([-1.5, -0.5, -3.3], [0.0, -0.5, -2.5])
        nodes = rng.uniform(-2.0, 2.0, 2) + np.cumsum(rng.normal(0.0, 0.5, (5, 2)), axis=0)
        curve = JointCurve.fit_spline(nodes)

        def angles(part: np.ndarray, curve: JointCurve = curve) -> np.ndarray:
            return np.asarray(curve.compute_derivatives(part)[0])

        p = kinematics.forward(angles(rng.uniform(0.2, 0.8, 1))[0])[1]
        at, turn = p + rng.normal(0.0, [0.0, 0.0, 0.01]), (0.0, rng.uniform(-3.0, 3.0), 0.0)
        plate = Obstacle("plate", size=tuple(size), at=tuple(at), rpy=turn)
        config = MotionConfig(tool="tool", obstacles=(plate,), collision_margin=margin)
        result = CollisionGuard(kinematics, config).find_contact_along(angles)
        q = angles(np.linspace(0.0, 1.0, places + 1))
        near, touching = (Collisions(thin, ("a", "b"), [plate], m) for m in (margin, 0.0))
        if near.find_first_contact(q[0]):
            continue
        if next(touching.find_touching(q), None) is not None:
            met += 1
            assert result is not None and result[1].endswith("and plate"), seed
        if result is not None:
            first = next(near.find_touching(q), None)
            assert first is not None and result[0] >= first / places - 1e-3, seed
    assert met >= 6


KINDS = ("target", "path", "trajectory", "stream", "jog")


def sent_down(arm: Arm, kind: str) -> list[GoalStatus]:
    """Send the tool 0.4 m down by one kind of order; return the reports."""
    executor, controller = arm.run.instructor, arm.run.controller
    below = [Pose(arm.p_WT - np.array([0.0, 0.0, z]), arm.R_WT) for z in (0.0, 0.4)]
    if kind == "target":
        executor.add(0, below[1])
    elif kind == "path":
        executor.add_path(controller, below)
    elif kind == "trajectory":
        names, q = arm.kinematics.joint_names, arm.run.session.state.q.copy()
        for _ in range(60):  # to the joint angles of that place
            J = arm.kinematics.jacobian(q)
            q = q + 0.2 * np.linalg.pinv(J) @ arm.kinematics.tool_error(q, below[1])
        point = TrajectoryPoint(2_000_000_000, q.tolist(), [0.0] * len(q))
        executor.add_trajectory(controller, names, [point])
    reports = []
    for k in range(160):
        if kind == "stream":
            depth = min(0.4, 0.3e-2 * k)
            executor.add(0, Pose(arm.p_WT - np.array([0.0, 0.0, depth]), arm.R_WT))
        elif kind == "jog":
            down, config = [0.0, 0.0, -0.3, 0.0, 0.0, 0.0], executor._config
            now = arm.run.session.logical_ns
            executor.take_jog(make_twist_command(now, down, "", arm.kinematics, config))
        arm.advance(0.01)
        reports += executor.reports.take_reports()
    return reports


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "box"), with_slow([("panda", True), ("ur5", False)], 1))
def test_each_kind_of_order_is_refused_or_stopped_before(name: str, kind: str, box: bool) -> None:
    """The pair is named; the true arm never touches, comes near, and can leave again."""
    arm = Arm(name, box)
    refused = [report for report in sent_down(arm, kind) if "would touch" in report.reason]
    jog = arm.run.instructor.jogging
    if kind == "jog":
        assert jog is not None and jog.status is JogStatus.HALT_FOR_COLLISION
        assert "and floor" in jog.words
    else:
        assert refused and "and floor would touch" in refused[0].reason
        state = GoalState.ABORTED if kind == "stream" else GoalState.REFUSED
        assert refused[0].state is state
    stopped = kind in ("jog", "stream")
    assert (arm.height < -0.05) == stopped, "what is refused has not begun"
    arm.advance(0.5)
    assert np.abs(arm.run.session.state.v).max() < 2e-3
    arm.run.instructor.add(0, Pose(arm.p_WT + np.array([0.0, 0.0, 0.03]), arm.R_WT))
    arm.advance(2.0)
    assert arm.run.instructor.reports.take_reports()[-1].state is GoalState.REACHED


def test_obstacles_need_shapes_that_meet_them() -> None:
    """A description without shapes is no arm that is watched: refused, not passed silently."""
    scene, config = load_scene("three_axis"), load_gains(find_scene("three_axis")).motion
    config = dataclasses.replace(config, obstacles=(Obstacle("floor", -1.0),))
    words = r"obstacles must be met by shapes .* got no collision shapes of moving links"
    with pytest.raises(Refusal, match=words):
        make_controller(scene.urdf, scene.joint_names, config)


@pytest.mark.parametrize("seed", with_slow(some(range(40), 4), 1))
def test_a_move_that_would_collide_is_refused_before_it_begins(seed: int) -> None:
    """Drawn targets, paths and trajectories to the floor: refused with the pair, the arm rests.

    What is not refused arrives, and touches nothing on its way.
    """
    rng = np.random.default_rng(seed)
    arm = Arm()
    executor, start = arm.run.instructor, arm.run.session.state.q
    down = np.array([*rng.uniform(-0.15, 0.15, 2), -rng.uniform(0.05, 0.45)])
    kind, target = seed % 3, Pose(arm.p_WT + down, arm.R_WT)
    if kind == 0:
        executor.add(0, target)
    elif kind == 1:
        executor.add_path(arm.run.controller, [Pose(arm.p_WT, arm.R_WT), target])
    else:
        names = arm.kinematics.joint_names
        end = list(arm.run.session.scene.start + rng.uniform(-0.9, 0.9, 6))
        still = [0.0] * 6
        point = TrajectoryPoint(2_000_000_000, end, still)
        executor.add_trajectory(arm.run.controller, names, [point])
    arm.advance(4.0)
    last = executor.reports.take_reports()[-1]
    assert last.state in (GoalState.REFUSED, GoalState.REACHED), last
    if last.state is GoalState.REFUSED:
        assert "would touch at" in last.reason and "the tool at [" in last.reason
        assert np.abs(arm.run.session.state.q - start).max() < 1e-3, "it began"
    if kind == 0 and down[2] < -0.2:
        assert last.state is GoalState.REFUSED


def test_parts_that_touch_already_do_not_hide_others() -> None:
    """The ball in the middle is within the floor from the beginning; the outer one is not."""
    config = MotionConfig(tool="tool", obstacles=(Obstacle("floor", 0.85),))
    kinematics = Kinematics(two_links(), ("a", "b"), "tool", "position")
    guard = CollisionGuard(kinematics, config)
    begin = np.array([0.2, -0.8])  # 1 - 0.5 sin(0.2) - 0.1 < 0.85
    assert guard.collisions.find_first_contact(begin) == "first and floor"
    result = guard.find_contact_along(lambda part: begin + np.outer(part, [0.0, 2.0]))
    assert result is not None and result[1] == "second and floor"
    # The outer ball: 1 - sin(0.2) - sin(0.2 + b) - 0.05 = 0.86.
    touch = math.asin(0.09 - math.sin(0.2)) - 0.2 + 0.8
    assert result[0] == pytest.approx(touch / 2.0, abs=0.015)


def test_obstacles_are_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    for table, words in (
        ({"floor": {"hight": 0.0}}, r"obstacles\.floor\.hight must be a known key"),
        ({"floor": {"height": "low"}}, r"obstacles\.floor\.height must be a number"),
        ({"box": {"size": [1.0, 1.0]}}, r"obstacles\.box\.size must have 3 values"),
        ({"box": {"size": [1.0, -1.0, 1.0]}}, r"obstacles\.box\.size must be numbers > 0"),
        (
            {"box": {"at": [0.0, 0.0, 0.0]}},
            r"obstacles\.box must have a height \(a floor\) or a size",
        ),
        ({"box": 1.0}, r"obstacles\.box must be a mapping"),
    ):
        file = tmp_path / "motion.yaml"
        node = {"motion_controller": {"ros__parameters": {"tool": "tool0", "obstacles": table}}}
        file.write_text(yaml.safe_dump(node))
        with pytest.raises(Refusal, match=words):
            load_motion_config(file)
    broken = two_links().replace('<sphere radius="0.1"/>', '<mesh filename="package://no/x.stl"/>')
    with pytest.raises(Refusal, match="readable shapes"):
        Collisions(broken, ("a", "b"), (), MARGIN)

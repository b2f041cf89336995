"""Tool paths against geometry and finite differences: speeds, accelerations and jerks held."""

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest
from draws import some, with_slow

from arm_emulator import Kinematics, Pose, Refusal, load_scene
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.motion.planner.tool_path_planner import MotionSequence, plan_path
from arm_emulator.motion.trajectory.tool_path import (
    LONGEST,
    MAX_POSES,
    ToolCurve,
    ToolLimits,
    ToolPath,
)

SECOND = 1_000_000_000
LIMITS = ToolLimits(speed=0.25, turn_speed=1.0, acceleration=1.0, jerk=10.0)


def pose(p: object, turn: object = (0.0, 0.0, 0.0)) -> Pose:
    return Pose(np.array(p, dtype=float), pin.exp3(np.array(turn, dtype=float)))


def random_pose(rng: np.random.Generator, size: float = 0.5) -> Pose:
    return pose(rng.normal(size=3) * size, rng.normal(size=3))


# Curves


@pytest.mark.parametrize("seed", range(8))
def test_a_curve_goes_through_its_poses_and_its_change_is_its_derivative(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    poses = [random_pose(rng) for _ in range(int(rng.integers(2, 8)))]
    curve = ToolCurve(poses, per_turn=0.25, arcs=bool(seed % 2))
    assert len(curve) == len(poses) - 1
    met = curve.draw_poses(curve.at_poses)
    np.testing.assert_allclose(met.p, [target.p_WT for target in poses], atol=1e-9)
    np.testing.assert_allclose(met.R, [target.R_WT for target in poses], atol=1e-9)
    h = 1e-6
    x = rng.uniform(h, curve.ends[-1] - h, 30)
    x = x[np.abs(curve.ends - x[:, None]).min(axis=1) > 2 * h]
    before, after = curve.draw_poses(x - h), curve.draw_poses(x + h)
    # Central differences over 1e-6 m: rounding 1e-16 / 1e-6.
    travelled = np.linalg.norm(after.p - before.p, axis=1) / (2 * h)
    turned = [pin.log3(b @ a.T) for a, b in zip(before.R, after.R, strict=True)]
    turning = np.linalg.norm(turned, axis=1) / (2 * h)
    np.testing.assert_allclose(np.maximum(travelled, 0.25 * turning), 1.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_three_poses_on_a_circle_are_an_arc_of_it(seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    R, center, radius = pin.exp3(rng.normal(size=3)), rng.normal(size=3), 10.0 ** rng.uniform(-2, 0)
    begin, arc = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.1, 2 * np.pi - 0.1)
    via = rng.uniform(0.1, 0.9) * arc

    def on(phi: float) -> np.ndarray:
        return np.asarray(center + radius * R @ [math.cos(begin + phi), math.sin(begin + phi), 0.0])

    curve = ToolCurve([pose(on(phi)) for phi in (0.0, via, arc)], 0.25, arcs=True)
    assert curve.ends[-1] == pytest.approx(radius * arc), "the length of the arc"
    assert curve.measure_kinks().max() < 1e-6, "no corner at the pose between"
    np.testing.assert_allclose(curve.compute_curvature(), 1.0 / radius, rtol=1e-6)
    parts = rng.uniform(0.0, 1.0, 20)
    expected = [on(part * arc) for part in parts]
    np.testing.assert_allclose(
        curve.draw_poses(parts * curve.ends[-1]).p, expected, atol=1e-7 * radius
    )


@pytest.mark.parametrize("seed", range(8))
def test_rounded_corners_are_smooth_and_stay_near(seed: int) -> None:
    rng = np.random.default_rng([seed, 3])
    poses = [pose(rng.normal(size=3)) for _ in range(4)]
    blend = 10.0 ** rng.uniform(-3, 0)
    curve = ToolCurve(poses, 0.25, blend=blend)
    assert curve.measure_kinks().max() < 1e-6, "no corner is left"
    assert len(curve) >= 5 or blend > 0.1, "three lines and two arcs"
    sharp = ToolCurve(poses, 0.25)
    lines = sharp.draw_poses(np.linspace(0.0, sharp.ends[-1], 1001)).p
    for p in curve.draw_poses(np.linspace(0.0, curve.ends[-1], 50)).p:
        near = np.linalg.norm(lines - p, axis=1).min()
        assert near <= blend + 1e-2, "no farther from the lines than where the arc begins"
    for end, at in ((0.0, 0), (float(curve.ends[-1]), -1)):
        np.testing.assert_allclose(
            curve.draw_poses(np.array([end])).p[0], poses[at].p_WT, atol=1e-9
        )


def test_flat_corners_are_rounded_and_passed_near_by() -> None:
    """A polygon of a circle has no corner left, and passes its poses within 50 um."""
    turn = np.linspace(0.0, 2 * np.pi, 101)
    points = [pose([0.1 * math.cos(t), 0.1 * math.sin(t), 0.0]) for t in turn]
    path = ToolPath(points, LIMITS)
    assert len(path.stops) == 2, "it stops nowhere between"
    points_on_path = path.curve.draw_poses(np.linspace(0.0, path.curve.ends[-1], 20000)).p
    for point in points:
        assert np.linalg.norm(points_on_path - point.p_WT, axis=1).min() < 1.1 * 5e-5


# Paths of an arm


class Arm:
    """An arm of six joints whose robot description is ours, with no limit that is near."""

    def __init__(self, **more: float) -> None:
        scene = load_scene("manutec_r3")
        self.kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
        config = MotionConfig(tool=scene.tool, period=0.01, **more)  # type: ignore[arg-type]
        self.law = TargetPlanner(self.kinematics, config)
        self.q = np.array([-0.5, 0.6, 1.4, 0.3, -1.2, 0.2])
        self.law.begin(self.q)
        R_WT, p_WT = self.kinematics.forward(self.q)
        self.home = Pose(p_WT, R_WT)

    def pose(self, shift: object, turn: object = (0.0, 0.0, 0.0)) -> Pose:
        R = pin.exp3(np.array(turn, dtype=float)) @ self.home.R_WT
        return Pose(self.home.p_WT + np.array(shift, dtype=float), R)

    def drawn(self, rng: np.random.Generator, size: float = 0.1) -> Pose:
        return self.pose(rng.uniform(-size, size, 3), rng.uniform(-0.3, 0.3, 3))

    def plan(
        self, path: ToolPath, now: Reference | None = None, scaled: bool = False
    ) -> MotionSequence:
        return plan_path(self.law, path, now or Reference.make_rest(self.q), 0, scaled)

    def tools(self, motion: MotionSequence, times: np.ndarray) -> np.ndarray:
        return np.array([self.kinematics.forward(motion.evaluate_at(t).q)[1] for t in times])

    def judge(self, motion: MotionSequence, times: np.ndarray) -> None:
        """Limits over all of the way, and that derivatives are those of the angles."""
        limits = self.law.limits
        references = [motion.evaluate_at(t) for t in times]
        q, v, a = (np.array([getattr(reference, k) for reference in references]) for k in "qva")
        jerk = np.array([reference.jerk for reference in references])
        assert (np.abs(v) <= limits.speed * (1 + 1e-6)).all(), "speed"
        assert (np.abs(a) <= limits.acceleration * (1 + 1e-6)).all(), "acceleration"
        assert (np.abs(jerk) <= limits.jerk * (1 + 1e-3)).all(), "jerk"
        tau = self.law.arm.compute_torques(q, v, a)
        assert (np.abs(tau) <= limits.torque * (1 + 1e-6)).all(), "torque"
        # Trapezoids over h: off by h^3 / 12 of the third derivative, of which the jerk bounds one.
        h = np.diff(times)[:, None]
        step = 0.5 * h * (v[1:] + v[:-1])
        off = np.abs(np.diff(q, axis=0) - step)
        assert (off <= h**3 / 12.0 * limits.jerk * 1.1 + 1e-12).all(), "speeds are those of q"


@pytest.mark.parametrize("seed", with_slow(some(range(9), 3), 1))
def test_a_path_keeps_limits_and_place_throughout(seed: int) -> None:
    rng = np.random.default_rng([seed, 4])
    arm = Arm()
    poses = [arm.drawn(rng) for _ in range(int(rng.integers(2, 5)))]
    path = ToolPath(poses, LIMITS, arcs=seed % 3 == 1, blend=0.02 * (seed % 3 == 2))
    motion = arm.plan(path)
    times = np.linspace(0.0, motion.duration, 4000)
    arm.judge(motion, times)
    p = arm.tools(motion, times)
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / np.diff(times)
    assert speed.max() <= LIMITS.speed * (1 + 1e-3), "tool speed"
    np.testing.assert_allclose(p[0], arm.home.p_WT, atol=1e-9, err_msg="where the tool is")
    np.testing.assert_allclose(p[-1], poses[-1].p_WT, atol=1e-8)
    curve = path.curve.draw_poses(np.linspace(0.0, path.curve.ends[-1], 20000)).p
    for at in p[times > motion.begins[2]][::20]:
        # Between samples of the curve half a step of it is left.
        assert np.linalg.norm(curve - at, axis=1).min() < 1e-4, "beside its path"
    if seed % 3 != 2:
        for target in poses:
            assert np.linalg.norm(p - target.p_WT, axis=1).min() < 1e-3, "on its way"


@pytest.mark.parametrize("seed", some(range(4), 2))
def test_a_path_takes_a_moving_arm_over_without_a_jump(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    arm = Arm()
    running = arm.plan(ToolPath([arm.drawn(rng) for _ in range(3)], LIMITS))
    now = running.evaluate_at(rng.uniform(0.1, 0.9) * running.duration)
    motion = arm.plan(ToolPath([arm.drawn(rng) for _ in range(2)], LIMITS), now)
    first = motion.evaluate_at(0.0)
    for key in "qva":
        np.testing.assert_allclose(getattr(first, key), getattr(now, key), atol=1e-9)
    arm.judge(motion, np.linspace(0.0, motion.duration, 3000))


def test_points_within_a_path_cost_no_time() -> None:
    """However finely a line is cut, it is one line: cameras and planners give many points."""
    arm = Arm()
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]]) * 0.1
    lengths = []
    for count in (1, 10, 50):
        steps = np.arange(count) / count
        points = [a + s * (b - a) for a, b in itertools.pairwise(corners) for s in steps]
        path = ToolPath([arm.pose(p) for p in [*points, corners[-1]]], LIMITS)
        lengths.append(arm.plan(path).duration)
    np.testing.assert_allclose(lengths, lengths[0], rtol=0.01)


def test_a_circle_of_many_points_is_as_fast_as_its_arc() -> None:
    arm = Arm()
    turn = np.linspace(0.0, 2 * np.pi, 101)
    points = [arm.pose([0.1 * math.cos(t) - 0.1, 0.1 * math.sin(t), 0.0]) for t in turn]
    fine = arm.plan(ToolPath(points, LIMITS)).duration
    arc = arm.plan(ToolPath([points[i] for i in range(0, 101, 25)], LIMITS, arcs=True)).duration
    assert 0.95 * arc < fine < 1.1 * arc, f"{fine} s, {arc} s"


@pytest.mark.parametrize("shift", [(0.0, 0.0, 3.0), (5.0, 0.0, 0.0)])
def test_a_path_out_of_reach_is_refused_with_its_place(shift: tuple[float, ...]) -> None:
    arm = Arm()
    path = ToolPath([arm.home, arm.pose(shift)], LIMITS)
    with pytest.raises(Refusal, match=r"m after poses\[0\]"):
        arm.plan(path)


def test_stamped_poses_are_met_at_their_times() -> None:
    rng = np.random.default_rng(6)
    arm = Arm()
    poses = [arm.drawn(rng) for _ in range(4)]
    poses[1] = poses[2]  # it waits there
    times = [5 * SECOND, 8 * SECOND, 9 * SECOND, 12 * SECOND]
    motion = arm.plan(ToolPath(poses, LIMITS, times_ns=times))
    assert motion.duration == pytest.approx(12.0)
    for time, target in zip(times, poses, strict=True):
        p = arm.kinematics.forward(motion.evaluate_at(time * 1e-9).q)[1]
        np.testing.assert_allclose(p, target.p_WT, atol=1e-6, err_msg="at its time")


def test_stamps_that_the_joints_cannot_keep_are_refused_or_take_longer() -> None:
    arm = Arm()
    poses = [arm.home, arm.pose((0.0, 0.4, 0.0)), arm.home]
    times = [0, 250_000_000, 500_000_000]
    with pytest.raises(Refusal, match=r"times its (speed|acceleration) .* m after poses"):
        arm.plan(ToolPath(poses, LIMITS, times_ns=times))
    motion = arm.plan(ToolPath(poses, LIMITS, times_ns=times), scaled=True)
    assert motion.duration > 0.5
    arm.judge(motion, np.linspace(0.0, motion.duration, 2000))
    far = ToolPath([arm.pose((0.2, 0, 0)), arm.home], LIMITS, times_ns=[SECOND // 10, 9 * SECOND])
    with pytest.raises(Refusal, match=r"first pose must leave the tool .* to reach it, got 0.1 s"):
        arm.plan(far)


# Degenerate ones


def test_a_tool_that_is_there_has_nothing_to_do() -> None:
    arm = Arm()
    motion = arm.plan(ToolPath([arm.home] * 3, LIMITS))
    assert motion.duration == 0.0
    np.testing.assert_array_equal(motion.evaluate_at(1.0).q, arm.q)


@pytest.mark.parametrize("blend", [0.0, 0.05])
def test_repeated_poses_change_nothing(blend: float) -> None:
    rng = np.random.default_rng(8)
    arm = Arm()
    poses = [arm.drawn(rng) for _ in range(3)]
    once = arm.plan(ToolPath(poses, LIMITS, blend=blend))
    again = arm.plan(ToolPath([target for target in poses for _ in range(3)], LIMITS, blend=blend))
    assert again.duration == pytest.approx(once.duration)


def test_a_tool_can_turn_on_the_spot() -> None:
    arm = Arm()
    motion = arm.plan(ToolPath([arm.home, arm.pose((0, 0, 0), (0.0, 0.6, 0.3))], LIMITS))
    p = arm.tools(motion, np.linspace(0.0, motion.duration, 300))
    np.testing.assert_allclose(p, arm.home.p_WT + 0.0 * p, atol=2e-5, err_msg="it stays")


@pytest.mark.parametrize("seed", some(range(10), 4))
def test_no_path_leads_to_numbers_that_are_not_finite(seed: int) -> None:
    rng = np.random.default_rng([seed, 9])
    arm = Arm()
    size = 10.0 ** rng.uniform(-12, -1)
    rotations = rng.choice([0.0, 1e-9, 0.3], 6)
    points = np.cumsum(rng.choice([0.0, 0.0, 1.0, -1.0], (6, 3)) * size, axis=0)
    axes = rng.normal(size=(6, 3))
    axes *= (rotations / np.linalg.norm(axes, axis=1))[:, None]
    poses = [arm.pose(p, axis) for p, axis in zip(points, axes, strict=True)]
    for arcs in (False, True):
        for blend in (0.0, 10.0 ** rng.uniform(-9, 1)):
            motion = arm.plan(ToolPath(poses, LIMITS, arcs=arcs, blend=blend))
            for t in rng.uniform(0.0, motion.duration + 0.1, 20):
                reference = motion.evaluate_at(t)
                assert np.isfinite([reference.q, reference.v, reference.a, reference.jerk]).all()
            p = arm.tools(motion, np.array([motion.duration]))[0]
            np.testing.assert_allclose(p, poses[-1].p_WT, atol=1e-7)


def test_malformed_paths_are_refused() -> None:
    here, far = pose([0.0, 0, 0]), pose([2 * LONGEST, 0, 0])
    for words, make in (
        (f"poses must be from 1 to {MAX_POSES}, got 0", lambda: ToolPath([], LIMITS)),
        (f"poses must be from 1 to {MAX_POSES}", lambda: ToolPath([here] * 5001, LIMITS)),
        ("the path must be at most 1000 m long, got 2000", lambda: ToolPath([here, far], LIMITS)),
        (
            r"poses\[1\].header.stamp must be later than the previous pose's, 1 s, got 1 s",
            lambda: ToolPath([here, here], LIMITS, times_ns=[SECOND, SECOND]),
        ),
        (r"poses\[0\] must be where a way leads to", lambda: Arm().plan(ToolPath([far], LIMITS))),
    ):
        with pytest.raises(Refusal, match=f"^tool_path: {words}") as refusal:
            make()
        assert "\n" not in str(refusal.value), "one line"

"""Trajectories faster than the limits: slower along the same angles, or refused."""

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator import Kinematics, Refusal, load_scene
from arm_emulator.motion.executor.controllers import make_joint_limits
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.planner.limited_joint_trajectory import StretchedTrajectory, fit_trajectory
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.motion.trajectory.joint_trajectory import (
    JointMotion,
    JointTrajectory,
    TrajectoryPoint,
)

SECOND = 1_000_000_000
START = np.array([-0.5, 0.6, 1.4, 0.3, -1.2, 0.2])


def law(**more: float) -> TargetPlanner:
    """An arm whose description has no limit of acceleration."""
    scene = load_scene("manutec_r3")
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    assert not np.isfinite(kinematics.acceleration_limit).any()
    return TargetPlanner(kinematics, config(**more))


def config(**more: float) -> MotionConfig:
    return MotionConfig(tool="link_6", period=0.01, **more)  # type: ignore[arg-type]


def planned(
    planner: TargetPlanner,
    points: list[TrajectoryPoint],
    scaled: bool = True,
    now: Reference | None = None,
    **more: float,
) -> JointMotion | StretchedTrajectory:
    names = planner.kinematics.joint_names
    limits = make_joint_limits(planner.kinematics, config(**more))
    trajectory = JointTrajectory(names, limits, names, points)
    return fit_trajectory(planner, trajectory, 0, 0, now or Reference.make_rest(START), scaled)


def judge(planner: TargetPlanner, motion: JointMotion | StretchedTrajectory) -> np.ndarray:
    times = np.linspace(0.0, motion.duration, 4001)
    observed = [motion.evaluate_at(float(t)) for t in times]
    q, v, a = (np.array([getattr(row, key) for row in observed]) for key in "qva")
    assert (np.abs(v) <= planner.limits.speed * (1 + 1e-6)).all(), "speed"
    assert (np.abs(a) <= planner.limits.acceleration * (1 + 1e-6)).all(), "acceleration"
    h = np.diff(times)[:, None]
    # By a mean of speeds; an acceleration that steps is off by h^2 a / 4 at most.
    off = np.abs(np.diff(q, axis=0) - 0.5 * h * (v[1:] + v[:-1]))
    assert (off <= 0.25 * h**2 * 2.0 * planner.limits.acceleration + 1e-12).all(), (
        "speeds are those of q"
    )
    return q


def test_a_trajectory_within_the_limits_keeps_its_times() -> None:
    still = np.zeros(6)
    points = [
        TrajectoryPoint(t * SECOND, START + by, velocities=still, accelerations=still)
        for t, by in ((1, 0.2), (2, -0.1))
    ]
    motion = planned(law(), points)
    assert isinstance(motion, JointMotion) and motion.end_ns == 2 * SECOND
    np.testing.assert_allclose(motion.evaluate_at(1.0).q, START + 0.2, atol=1e-12)


@pytest.mark.parametrize("seed", with_slow(some(range(12), 4), 1))
@pytest.mark.parametrize("kind", ["positions", "velocities", "accelerations"])
def test_a_trajectory_that_is_too_fast_takes_longer_along_the_same_angles(
    kind: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    planner = law()
    still = np.zeros(6)
    times = np.cumsum(rng.uniform(0.1, 0.4, 4))
    angles = START + rng.uniform(-0.3, 0.3, (4, 6))
    v = rng.uniform(-1.0, 1.0, (4, 6)) * (kind != "positions")
    v[-1] = 0.0
    points = [
        TrajectoryPoint(
            round(t * SECOND),
            at,
            velocities=() if kind == "positions" else speed,
            accelerations=still if kind == "accelerations" else (),
        )
        for t, at, speed in zip(times, angles, v, strict=True)
    ]
    motion = planned(planner, points)
    assert isinstance(motion, StretchedTrajectory) and motion.duration > points[-1].time_ns * 1e-9
    assert (
        "instead of" in motion.path_text
        and planner.kinematics.joint_names[0][:4] in motion.path_text
    )
    q = judge(planner, motion)
    for at in angles:
        # At 3 rad/s a four-thousandth of the duration is a few mrad at most.
        assert np.abs(q - at).max(axis=1).min() < 5e-3, "through every point"
    np.testing.assert_allclose(q[-1], angles[-1], atol=1e-9)
    with pytest.raises(Refusal, match=r"^joint_trajectory: the points must keep the limits"):
        planned(planner, points, scaled=False)


def test_a_trajectory_from_motion_comes_to_rest_first_where_it_must_be_slower() -> None:
    planner = law()
    now = Reference(START, np.full(6, 0.5), np.zeros(6), np.zeros(6))
    motion = planned(planner, [TrajectoryPoint(SECOND // 5, START + 0.5)], now=now)
    first = motion.evaluate_at(0.0)
    np.testing.assert_allclose(first.v, now.v, atol=1e-9)
    q = judge(planner, motion)
    np.testing.assert_allclose(q[-1], START + 0.5, atol=1e-9)


def test_the_parameter_counts_where_the_description_has_no_limit() -> None:
    still = np.zeros(6)
    points = [TrajectoryPoint(SECOND, START + 0.5, velocities=still, accelerations=still)]
    assert isinstance(planned(law(), points), JointMotion)
    slow = {"acceleration_limit": 0.5}
    motion = planned(law(**slow), points, **slow)
    # From rest to rest within an acceleration: 2 sqrt(d / a), and the jerk's share.
    assert isinstance(motion, StretchedTrajectory) and 2.0 <= motion.duration < 2.2

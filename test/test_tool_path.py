"""Tool paths against geometry and finite differences: speeds, accelerations and jerks held."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pinocchio as pin
import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.speed_profile import SpeedProfile
from arm_emulator.motion.tool_curve import ToolCurve
from arm_emulator.motion.tool_path import (
    LONGEST,
    MOST_POSES,
    ToolLimits,
    ToolMotion,
    ToolPath,
    ToolState,
)

SECOND = 1_000_000_000
LIMITS = ToolLimits(speed=0.25, turn_speed=1.0, acceleration=1.0, jerk=10.0, period=0.05)


def pose(p: object, turn: object = (0.0, 0.0, 0.0)) -> Pose:
    return Pose(np.array(p, dtype=float), pin.exp3(np.array(turn, dtype=float)))


def random_pose(rng: np.random.Generator, size: float = 0.5) -> Pose:
    return pose(rng.normal(size=3) * size, rng.normal(size=3))


def angle(a: Pose, b: Pose) -> float:
    return float(np.linalg.norm(pin.log3(a.R_WT @ b.R_WT.T)))


# Speed along a path


@pytest.mark.parametrize("seed", range(16))
def test_a_speed_profile_keeps_all_limits_and_stops_where_it_must(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    lengths = 10.0 ** rng.uniform(-4, 1, count)
    speeds = 10.0 ** rng.uniform(-2, 1, count)
    meeting = rng.choice([0.0, 1.0, math.inf], count - 1) * 10.0 ** rng.uniform(-2, 0.5, count - 1)
    meeting = np.where(np.isnan(meeting), 0.0, meeting)
    acceleration, jerk = 10.0 ** rng.uniform(-1, 1, 2) * (1.0, 10.0)
    profile = SpeedProfile(lengths.tolist(), speeds.tolist(), meeting.tolist(), acceleration, jerk)
    ends = np.cumsum(lengths)
    assert profile.length == pytest.approx(ends[-1]), "the whole length"
    for at in (0.0, profile.duration):
        assert profile.sample(at)[1:] == (0.0, 0.0), "at rest at both ends"
    times = np.linspace(0.0, profile.duration, 4000)
    s, v, a = np.array([profile.sample(t) for t in times]).T
    step = times[1]
    rounding = 1e-9 * max(1.0, ends[-1])
    assert (np.diff(s) >= -rounding).all(), "it never goes back"
    assert (np.abs(a) <= acceleration * (1.0 + 1e-9)).all(), "acceleration"
    assert (np.abs(np.diff(a)) <= jerk * step * (1.0 + 1e-6) + 1e-9).all(), "jerk"
    # Trapezoidal rule: off by at most jerk times the cube of the step, twelve to the share.
    np.testing.assert_allclose(np.diff(v), 0.5 * (a[1:] + a[:-1]) * step, atol=jerk * step**2)
    np.testing.assert_allclose(
        np.diff(s), 0.5 * (v[1:] + v[:-1]) * step, atol=jerk * step**3 + rounding
    )
    on = np.minimum(np.searchsorted(ends, s - rounding), count - 1)
    assert (v <= speeds[on] * (1.0 + 1e-9)).all(), "the speed of the stretch"
    for i, most in enumerate(meeting):
        before, after = 0.0, profile.duration
        for _ in range(100):  # when it is there
            middle = 0.5 * (before + after)
            if profile.sample(middle)[0] < ends[i]:
                before = middle
            else:
                after = middle
        # Near a stop a distance of 1e-15 m, rounding, takes (6e-15 / j)^(1/3) s.
        assert profile.sample(after)[1] <= most + 1e-6, "the speed where two meet"


def test_a_speed_profile_takes_no_longer_than_it_must() -> None:
    # 300 mm at 250 mm/s, 1 m/s2, 10 m/s3: v / a + a / j = 0.35 s to get going, 87.5 mm for both.
    profile = SpeedProfile([0.3], [0.25], [], 1.0, 10.0)
    assert profile.duration == pytest.approx(2 * 0.35 + (0.3 - 0.35 * 0.25) / 0.25)
    # So short that only the jerk counts: four phases of (s / 2 j)^(1/3).
    assert SpeedProfile([1e-3], [0.25], [], 1.0, 10.0).duration == pytest.approx(
        4.0 * (1e-3 / 20.0) ** (1.0 / 3.0)
    )
    # Cut in two where nothing slows it down, the top speed is the same; without acceleration where
    # they meet it takes longer, but not much.
    assert 1.55 <= SpeedProfile([0.15, 0.15], [0.25] * 2, [0.25], 1.0, 10.0).duration < 1.6


# Curves


@pytest.mark.parametrize("seed", range(8))
def test_a_curve_goes_through_its_poses_and_its_change_is_its_derivative(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    poses = [random_pose(rng) for _ in range(int(rng.integers(2, 8)))]
    curve = ToolCurve(poses, per_turn=0.25, arcs=bool(seed % 2))
    assert len(curve) == len(poses) - 1
    for x, wanted in zip(curve.at_poses, poses, strict=True):
        p, R, _, _ = curve.sample(float(x))
        np.testing.assert_allclose(p, wanted.p_WT, atol=1e-9, err_msg="position at a pose")
        np.testing.assert_allclose(R, wanted.R_WT, atol=1e-9, err_msg="orientation at a pose")
    h = 1e-6
    for x in rng.uniform(h, curve.ends[-1] - h, 30):
        if np.abs(curve.ends - x).min() < 2 * h:
            continue
        before, now, after = (curve.sample(float(x) + shift) for shift in (-h, 0.0, h))
        # Central differences over 1e-6 m: rounding 1e-16 / 1e-6, curvature below 1e3/m.
        np.testing.assert_allclose((after[0] - before[0]) / (2 * h), now[2], atol=1e-6)
        np.testing.assert_allclose(pin.log3(after[1] @ before[1].T) / (2 * h), now[3], atol=1e-6)
        assert max(np.linalg.norm(now[2]), 0.25 * np.linalg.norm(now[3])) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(8))
def test_three_poses_on_a_circle_are_an_arc_of_it(seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    R, center, radius = pin.exp3(rng.normal(size=3)), rng.normal(size=3), 10.0 ** rng.uniform(-2, 0)
    begin, whole = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.1, 2 * np.pi - 0.1)
    via = rng.uniform(0.1, 0.9) * whole

    def on(phi: float) -> np.ndarray:
        return np.asarray(center + radius * R @ [math.cos(begin + phi), math.sin(begin + phi), 0.0])

    curve = ToolCurve([pose(on(phi)) for phi in (0.0, via, whole)], 0.25, arcs=True)
    assert curve.ends[-1] == pytest.approx(radius * whole), "the length of the arc"
    assert curve.kinks().max() < 1e-6, "no corner at the pose between"
    np.testing.assert_allclose(curve.curvature(), 1.0 / radius, rtol=1e-6)
    for part in rng.uniform(0.0, 1.0, 20):
        np.testing.assert_allclose(
            curve.sample(part * curve.ends[-1])[0], on(part * whole), atol=1e-7 * radius
        )


def test_two_arcs_are_a_full_circle() -> None:
    circle = [pose([0.1 * math.cos(t), 0.1 * math.sin(t), 0.5]) for t in np.arange(5) * np.pi / 2]
    curve = ToolCurve(circle, 0.25, arcs=True)
    assert curve.ends[-1] == pytest.approx(0.2 * np.pi) and curve.kinks().max() < 1e-6


@pytest.mark.parametrize("seed", range(8))
def test_rounded_corners_are_smooth_and_stay_near(seed: int) -> None:
    rng = np.random.default_rng([seed, 3])
    poses = [pose(rng.normal(size=3)) for _ in range(4)]
    blend = 10.0 ** rng.uniform(-3, 0)
    curve = ToolCurve(poses, 0.25, blend=blend)
    assert curve.kinks().max() < 1e-6, "no corner is left"
    assert len(curve) >= 5 or blend > 0.1, "three lines and two arcs"
    sharp = ToolCurve(poses, 0.25)
    lines = np.array([sharp.sample(x)[0] for x in np.linspace(0.0, sharp.ends[-1], 1001)])
    for x in np.linspace(0.0, curve.ends[-1], 50):
        near = np.linalg.norm(lines - curve.sample(x)[0], axis=1).min()
        assert near <= blend + 1e-2, "no farther from the lines than where the arc begins"
    for end, at in ((0.0, 0), (float(curve.ends[-1]), -1)):
        np.testing.assert_allclose(curve.sample(end)[0], poses[at].p_WT, atol=1e-9)


# Paths


def along(motion: ToolMotion, begin_ns: int, step_ns: int) -> tuple[np.ndarray, ...]:
    """Times, positions, velocities, angular velocities, and how the orientation turned."""
    times = np.arange(begin_ns, motion.end_ns + 2 * step_ns, step_ns)
    states = [motion.sample(int(t)) for t in times]
    turned = [
        pin.log3(after.pose.R_WT @ before.pose.R_WT.T)
        for before, after in itertools.pairwise(states)
    ]
    return (
        times * 1e-9,
        np.array([one.pose.p_WT for one in states]),
        np.array([one.v for one in states]),
        np.array([one.omega for one in states]),
        np.array(turned),
    )


@pytest.mark.parametrize("seed", range(10))
def test_a_path_keeps_its_speeds_and_states_how_the_tool_moves(seed: int) -> None:
    rng = np.random.default_rng([seed, 4])
    poses = [random_pose(rng, 0.2) for _ in range(int(rng.integers(1, 6)))]
    path = ToolPath(poses, LIMITS, arcs=seed % 3 == 1, blend=0.02 * (seed % 3 == 2))
    start = ToolState.at_rest(random_pose(rng, 0.2))
    motion = path.begin(3 * SECOND, start)
    step = 2_000_000
    _, p, v, omega, turned = along(motion, 3 * SECOND, step)
    h = step * 1e-9
    assert np.linalg.norm(v, axis=1).max() <= LIMITS.speed * (1 + 1e-6), "tool speed"
    assert np.linalg.norm(omega, axis=1).max() <= LIMITS.turn_speed * (1 + 1e-6), "turning speed"
    # A corner's step aside (at most a T, once within a step), it accelerates by at most a along and
    # a across; half a step of that is the difference of mean and end.
    corner = LIMITS.acceleration * LIMITS.period
    steps = np.linalg.norm(np.diff(v, axis=0), axis=1)
    assert steps.max() <= corner + 1.5 * h * LIMITS.acceleration, "no larger step of velocity"
    mean = 0.5 * (v[1:] + v[:-1])
    off = np.linalg.norm(np.diff(p, axis=0) / h - mean, axis=1)
    assert off.max() <= 0.5 * corner + h * LIMITS.acceleration, (
        "the velocity is that of the position"
    )
    assert np.median(off) < 1e-4, "and so nearly everywhere"
    spin = np.linalg.norm(turned / h - 0.5 * (omega[1:] + omega[:-1]), axis=1)
    assert spin.max() <= (0.5 * corner + h) / LIMITS.per_turn + 1e-3 and np.median(spin) < 1e-3
    end = motion.sample(motion.end_ns)
    assert not end.v.any() and not end.omega.any(), "it rests at the end"
    np.testing.assert_allclose(end.pose.p_WT, poses[-1].p_WT, atol=1e-9)
    assert angle(end.pose, poses[-1]) < 1e-7 and angle(path.last, poses[-1]) < 1e-7
    first = motion.sample(3 * SECOND)
    np.testing.assert_allclose(first.pose.p_WT, start.pose.p_WT, atol=1e-9)
    assert angle(first.pose, start.pose) < 1e-7, "it begins where the tool is"
    if seed % 3 != 2:
        for wanted in poses:
            assert np.linalg.norm(p - wanted.p_WT, axis=1).min() <= LIMITS.speed * h, "on its way"


@pytest.mark.parametrize("seed", range(6))
def test_a_path_takes_a_moving_tool_over_without_a_jump(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    first = ToolPath([random_pose(rng, 0.2) for _ in range(3)], LIMITS)
    running = first.begin(0, ToolState.at_rest(random_pose(rng, 0.2)))
    now = int(rng.integers(0, running.end_ns))
    state = running.sample(now)
    second = ToolPath([random_pose(rng, 0.2) for _ in range(2)], LIMITS)
    motion = second.begin(now, state)
    taken = motion.sample(now)
    np.testing.assert_allclose(taken.pose.p_WT, state.pose.p_WT, atol=1e-9, err_msg="position")
    np.testing.assert_allclose(taken.v, state.v, atol=1e-9, err_msg="velocity")
    np.testing.assert_allclose(taken.omega, state.omega, atol=1e-6, err_msg="angular velocity")
    assert angle(taken.pose, state.pose) < 1e-7, "orientation"
    h = 1e-3
    _, p, v, _, turned = along(motion, now, round(h * 1e9))
    # While it turns around, each of three axes has the limits for itself.
    assert np.linalg.norm(np.diff(v, axis=0), axis=1).max() <= max(
        math.sqrt(3.0) * LIMITS.acceleration * h, LIMITS.acceleration * LIMITS.period
    ) * (1 + 1e-6)
    assert (
        np.linalg.norm(np.diff(p, axis=0), axis=1).max() <= math.sqrt(3.0) * LIMITS.speed * h * 1.01
    )
    assert np.linalg.norm(turned, axis=1).max() <= 3.0 * LIMITS.turn_speed * h, "no sudden turn"


def square(side: float, count: int) -> list[Pose]:
    """A square in so many steps per side."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]]) * side
    steps = np.arange(count) / count
    points = [a + s * (b - a) for a, b in itertools.pairwise(corners) for s in steps]
    return [pose(p) for p in [*points, corners[-1]]]


@pytest.mark.parametrize("count", [1, 2, 10, 100])
def test_points_on_the_way_cost_no_time(count: int) -> None:
    """However finely a line is cut, it is one line: cameras and planners give many points."""
    whole = ToolPath(square(0.3, 1), LIMITS).duration
    # Near a corner points are nearer than what the tool goes in a period: it is taken for a bend of
    # that length, and passed more slowly.
    assert whole <= ToolPath(square(0.3, count), LIMITS).duration * (1 + 1e-9) < 1.15 * whole


def test_a_circle_of_many_points_is_as_fast_as_its_arc() -> None:
    for count, radius, factor in ((20, 0.1, 1.5), (100, 0.1, 1.02), (400, 0.02, 1.1)):
        turn = np.linspace(0.0, 2 * np.pi, count + 1)
        points = [pose([radius * math.cos(t), radius * math.sin(t), 0.0]) for t in turn]
        arcs = [points[i] for i in (0, count // 4, count // 2, 3 * count // 4, count)]
        fine, arc = ToolPath(points, LIMITS).duration, ToolPath(arcs, LIMITS, arcs=True).duration
        assert 0.95 * arc < fine < factor * arc, f"{count} points at {radius} m: {fine} s, {arc} s"


@pytest.mark.parametrize("seed", range(6))
def test_stamped_poses_are_met_at_their_times(seed: int) -> None:
    rng = np.random.default_rng([seed, 6])
    count = int(rng.integers(2, 8))
    poses = [random_pose(rng, 0.2) for _ in range(count)]
    if seed % 3 == 0 and count > 2:
        poses[1] = poses[2]  # it waits there
    times = (20 * SECOND + np.cumsum(rng.integers(SECOND // 10, 3 * SECOND, count))).tolist()
    path = ToolPath(poses, LIMITS, times_ns=times, blend=0.1)
    motion = path.begin(0, ToolState.at_rest(random_pose(rng, 0.2)))
    assert motion.end_ns == times[-1]
    for time, wanted in zip(times, poses, strict=True):
        got = motion.sample(time)
        np.testing.assert_allclose(got.pose.p_WT, wanted.p_WT, atol=1e-8, err_msg="at its time")
        assert angle(got.pose, wanted) < 1e-7
    way = np.array([path.at(t).pose.p_WT for t in np.linspace(0.0, path.duration, 1000)])
    for a, b in itertools.pairwise(poses):
        assert np.linalg.norm(way - 0.5 * (a.p_WT + b.p_WT), axis=1).min() < 0.02, "along the lines"
    for at in (times[0], times[-1]):
        assert not motion.sample(at).v.any(), "at rest at both ends"


def test_a_stamped_pose_that_comes_too_soon_is_refused() -> None:
    path = ToolPath([pose([1.0, 0, 0]), pose([2.0, 0, 0])], LIMITS, times_ns=[SECOND, 9 * SECOND])
    with pytest.raises(
        Refusal, match=r"first pose must leave the tool 4.35 s to reach it, got 1 s"
    ):
        path.begin(0, ToolState.at_rest(pose([0.0, 0, 0])))
    assert path.begin(0, ToolState.at_rest(pose([0.9, 0, 0]))).end_ns == 9 * SECOND


# Degenerate ones


def test_one_pose_is_a_way_to_it() -> None:
    path = ToolPath([pose([0.3, 0, 0], [0, 0, 1])], LIMITS)
    assert path.duration == 0.0
    motion = path.begin(0, ToolState.at_rest(pose([0.0, 0, 0])))
    middle = motion.sample(motion.end_ns // 2)
    np.testing.assert_allclose(middle.pose.p_WT, [0.15, 0, 0], atol=1e-6, err_msg="on the line")
    assert angle(motion.sample(motion.end_ns).pose, path.first) < 1e-9


def test_a_tool_that_is_there_has_nothing_to_do() -> None:
    here = pose([0.3, 0.1, 0], [0, 0, 1])
    motion = ToolPath([here, here, here], LIMITS).begin(7, ToolState.at_rest(here))
    assert motion.end_ns == 7
    for at in (0, 7, SECOND):
        state = motion.sample(at)
        np.testing.assert_allclose(state.pose.p_WT, here.p_WT, atol=1e-12)
        assert not state.v.any() and not state.omega.any()


@pytest.mark.parametrize("arcs", [False, True])
@pytest.mark.parametrize("blend", [0.0, 0.05])
def test_repeated_poses_change_nothing(arcs: bool, blend: float) -> None:
    rng = np.random.default_rng(8)
    poses = [random_pose(rng, 0.2) for _ in range(3)]
    once = ToolPath(poses, LIMITS, blend=blend)
    again = ToolPath([one for one in poses for _ in range(3)], LIMITS, arcs=arcs, blend=blend)
    if not arcs:
        assert again.duration == pytest.approx(once.duration), "repeated poses take no time"
    np.testing.assert_allclose(again.last.p_WT, once.last.p_WT, atol=1e-9)


@pytest.mark.parametrize("blend", [0.0, 0.05])
def test_a_sharp_reversal_is_nearly_a_stop(blend: float) -> None:
    there, back = pose([0.3, 0, 0]), pose([0.0, 0, 0])
    path = ToolPath([back, there, back], LIMITS, blend=blend)
    fastest = LIMITS.acceleration * LIMITS.period / 2.0
    times = np.linspace(0.0, path.duration, 2000)
    states = [path.at(t) for t in times]
    near = [abs(one.v[0]) for one in states if one.pose.p_WT[0] > 0.3 - 1e-4]
    assert near and max(near) <= 1.3 * fastest, "it turns at 25 mm/s"
    assert max(one.pose.p_WT[0] for one in states) == pytest.approx(0.3, abs=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_a_tool_can_turn_on_the_spot(seed: int) -> None:
    rng = np.random.default_rng([seed, 7])
    p, turn = rng.normal(size=3), rng.normal(size=3)
    turn *= rng.uniform(0.1, 3.0) / np.linalg.norm(turn)
    path = ToolPath([pose(p), Pose(p, pin.exp3(turn))], LIMITS)
    for t in np.linspace(0.0, path.duration, 200):
        state = path.at(t)
        np.testing.assert_allclose(state.pose.p_WT, p, atol=1e-12, err_msg="it stays")
        assert np.linalg.norm(state.omega) <= LIMITS.turn_speed * (1 + 1e-9)
        np.testing.assert_allclose(np.cross(state.omega, turn), 0.0, atol=1e-9, err_msg="one axis")
    # As a line that is as long as the angle times the speed per turning speed.
    line = ToolPath([pose([0, 0, 0]), pose([0.25 * np.linalg.norm(turn), 0, 0])], LIMITS)
    assert path.duration == pytest.approx(line.duration)


@pytest.mark.parametrize("seed", range(10))
def test_no_path_leads_to_numbers_that_are_not_finite(seed: int) -> None:
    rng = np.random.default_rng([seed, 9])
    size = 10.0 ** rng.uniform(-12, 2)
    turns = rng.choice([0.0, 1e-9, 1.0, np.pi], 6)
    points = np.cumsum(rng.choice([0.0, 0.0, 1.0, -1.0], (6, 3)) * size, axis=0)
    axes = rng.normal(size=(6, 3))
    poses = [
        pose(p, a / np.linalg.norm(a) * t) for p, a, t in zip(points, axes, turns, strict=True)
    ]
    for arcs in (False, True):
        for blend in (0.0, 10.0 ** rng.uniform(-9, 1)):
            path = ToolPath(poses, LIMITS, arcs=arcs, blend=blend)
            motion = path.begin(0, ToolState.at_rest(random_pose(rng)))
            for at in rng.integers(0, motion.end_ns + 10, 40):
                state = motion.sample(int(at))  # whose pose refuses what is no rotation
                assert np.isfinite([*state.v, *state.omega]).all()
                assert np.linalg.norm(state.v) <= LIMITS.speed * (1 + 1e-6)
            np.testing.assert_allclose(path.last.p_WT, points[-1], atol=1e-7 * max(1.0, size))


def test_what_cannot_be_a_path_is_refused() -> None:
    here, far = pose([0.0, 0, 0]), pose([2 * LONGEST, 0, 0])
    for words, make in (
        (f"poses must be from 1 to {MOST_POSES}, got 0", lambda: ToolPath([], LIMITS)),
        (f"poses must be from 1 to {MOST_POSES}", lambda: ToolPath([here] * 5001, LIMITS)),
        ("the path must be at most 1000 m long, got 2000", lambda: ToolPath([here, far], LIMITS)),
        (
            r"poses\[1\].header.stamp must be later than the previous pose's, 1 s, got 1 s",
            lambda: ToolPath([here, here], LIMITS, times_ns=[SECOND, SECOND]),
        ),
        (
            r"poses\[0\] must be within 1000 m, got 2000 m away",
            lambda: ToolPath([here], LIMITS).begin(0, ToolState.at_rest(far)),
        ),
    ):
        with pytest.raises(Refusal, match=f"^tool_path: {words}") as refusal:
            make()
        assert "\n" not in str(refusal.value), "one line"

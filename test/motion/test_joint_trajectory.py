"""Joint trajectories against splines of SciPy, and the rules of their door."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from scipy.interpolate import BPoly, CubicHermiteSpline, make_interp_spline

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.trajectory.joint_trajectory import (
    MAX_POINTS,
    SPEED_BETWEEN_POINTS,
    JointLimits,
    JointMotion,
    JointTrajectory,
    TrajectoryPoint,
    plan_rest,
)

SECOND = 1_000_000_000
NAMES = ("a", "b", "c", "d")
KINDS = ("linear", "cubic", "quintic")


def sample(motion: JointMotion, time_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    now = motion.evaluate_at(time_ns * 1e-9)
    return now.q, now.v, now.a


def limits(n: int = 4, speed: float = 1e3, reach: float = 1e3) -> JointLimits:
    ones = np.ones(n)
    return JointLimits(
        -reach * ones, reach * ones, speed * ones, 10.0 * ones, np.zeros(n, dtype=bool)
    )


def draw(rng: np.random.Generator, kind: str, count: int, n: int) -> list[TrajectoryPoint]:
    """Random points, of which the last one is at rest."""
    times = np.cumsum(rng.integers(10_000_000, SECOND, count))
    q, v, a = rng.normal(size=(3, count, n))
    v[-1] = 0.0
    return [
        TrajectoryPoint(
            int(times[i]),
            q[i],
            v[i] if kind != "linear" else (),
            a[i] if kind == "quintic" else (),
        )
        for i in range(count)
    ]


def truth(kind: str, t: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Any:
    if kind == "linear":
        return make_interp_spline(t, q, k=1)
    if kind == "cubic":
        return CubicHermiteSpline(t, q, v, axis=0)
    return BPoly.from_derivatives(t, np.stack([q, v, a], axis=1))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(10))
def test_the_spline_and_its_derivatives_are_those_of_scipy(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = draw(rng, kind, int(rng.integers(1, 8)), 4)
    trajectory = JointTrajectory(NAMES, limits(), NAMES, points)
    q0, v0, a0 = rng.normal(size=(3, 4))
    start = int(rng.integers(0, SECOND))
    motion = trajectory.begin_motion(start, start, Reference(q0, v0, a0))
    t = np.array([0, *trajectory.times_ns]) * 1e-9
    expected = truth(
        kind,
        t,
        np.vstack([q0, trajectory.q]),
        np.vstack([v0, trajectory.v]),
        np.vstack([a0, trajectory.a]),
    )
    for at in rng.uniform(0.0, t[-1], 30):
        time_ns = round(at * 1e9)
        actual, s = sample(motion, time_ns), time_ns * 1e-9
        # Two ways to write one polynomial of degree 5: rounding, times the cube of 1/T <= 100/s
        # and 1/T for each derivative.
        for order, bound in enumerate((1e-9, 1e-7, 1e-5) if kind != "linear" else (1e-9, 1e-7)):
            want = expected(s, order) if order else expected(s)
            np.testing.assert_allclose(
                actual[order], want, atol=bound, err_msg=f"derivative {order} of the {kind} spline"
            )


@pytest.mark.parametrize("seed", range(30))
def test_a_trajectory_takes_over_from_another_without_a_jump(seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    first = JointTrajectory(NAMES, limits(), NAMES, draw(rng, "quintic", 4, 4))
    running = first.begin_motion(0, 0, Reference(*np.zeros((3, 4))))
    kind = KINDS[seed % 3]
    some = rng.permutation(4)[: rng.integers(1, 5)]
    second = JointTrajectory(
        NAMES, limits(), [NAMES[i] for i in some], draw(rng, kind, 3, len(some))
    )
    # It may have started before: then points are past.
    now = int(rng.integers(0, running.end_ns))
    start = now - int(rng.integers(0, second.times_ns[-1]))
    state = sample(running, now)
    motion = second.begin_motion(now, start, Reference(*state))
    q, v, _ = sample(motion, 0)
    np.testing.assert_allclose(q, state[0], atol=1e-12, err_msg="angles at the moment of change")
    others = np.setdiff1d(np.arange(4), some)
    smooth = others if kind == "linear" else np.arange(4)
    np.testing.assert_allclose(v[smooth], state[1][smooth], atol=1e-9, err_msg="speeds")
    for time, point in zip(second.times_ns, second.q, strict=True):
        if start + time > now:
            actual = sample(motion, start + time - now)[0][second.moved]
            np.testing.assert_allclose(actual, point, atol=1e-9, err_msg="a point that is to come")
    # Joints that are not named brake by 10 rad/s2 and stay there.
    rest = plan_rest(*state[:2], limits().acceleration)
    for at in (1, rest.end_ns // 2, rest.end_ns, motion.end_ns, motion.end_ns + 1):
        np.testing.assert_allclose(
            sample(motion, at)[0][others], sample(rest, at)[0][others], atol=1e-9, err_msg="others"
        )
    q_end, v_end, a_end = sample(motion, motion.end_ns + 5)
    np.testing.assert_allclose(q_end[second.moved], second.q[-1], atol=1e-9, err_msg="the end")
    assert not v_end.any() and not a_end.any(), "what is over rests"


@pytest.mark.parametrize("seed", range(10))
def test_coming_to_rest_keeps_the_acceleration_and_goes_straight(seed: int) -> None:
    rng = np.random.default_rng([seed, 3])
    q, v = rng.normal(size=(2, 3))
    largest = rng.uniform(0.5, 20.0, 3)
    motion = plan_rest(q, v, largest)
    _, v_start, a = sample(motion, 0)
    np.testing.assert_allclose(v_start, v, err_msg="the speed at the start")
    assert (np.abs(a) <= largest * (1.0 + 1e-9)).all() and np.isclose(
        np.abs(a / largest).max(), 1.0
    )
    displacement = sample(motion, motion.end_ns)[0] - q
    np.testing.assert_allclose(
        np.cross(displacement, v), 0.0, atol=1e-9, err_msg="it stays on its line"
    )


def test_without_points_the_joints_come_to_rest() -> None:
    stop = JointTrajectory(NAMES, limits(), (), ())
    v = np.array([1.0, -2.0, 0.0, 0.5])
    motion = stop.begin_motion(5, 5, Reference(np.zeros(4), v, np.zeros(4)))
    assert stop.is_stop and motion.end_ns == 200_000_000, "2 rad/s at 10 rad/s2 take 0.2 s"
    np.testing.assert_allclose(sample(motion, SECOND)[0], 0.1 * v, atol=1e-9, err_msg="v T / 2")


def test_a_continuous_joint_takes_the_short_path() -> None:
    infinite, ten = np.full(1, np.inf), np.full(1, 10.0)
    turning = JointLimits(-infinite, infinite, ten, ten, np.ones(1, bool))
    points = [TrajectoryPoint(SECOND, [0.1]), TrajectoryPoint(2 * SECOND, [0.3])]
    trajectory = JointTrajectory(("a",), turning, ("a",), points)
    motion = trajectory.begin_motion(0, 0, Reference.make_rest(np.array([4.0 * np.pi - 0.2])))
    for time, q in ((SECOND, 4.0 * np.pi + 0.1), (3 * SECOND, 4.0 * np.pi + 0.3)):
        assert sample(motion, time)[0][0] == pytest.approx(q), f"two turns on, at {time} ns"


@pytest.mark.parametrize("seed", range(10))
def test_efforts_go_straight_between_points(seed: int) -> None:
    rng = np.random.default_rng([seed, 4])
    times = np.cumsum(rng.integers(1, SECOND, 4))
    tau = rng.normal(size=(4, 2))
    points = [
        TrajectoryPoint(int(t), [0.0, 0.0], effort=e) for t, e in zip(times, tau, strict=True)
    ]
    trajectory = JointTrajectory(NAMES, limits(), ("c", "a"), points)
    for at in rng.integers(0, times[-1] + SECOND, 10):
        actual = trajectory.compute_effort(int(at))
        assert actual is not None and actual[1] == actual[3] == 0.0, "joints not named get none"
        for place, column in ((2, 0), (0, 1)):
            want = np.interp(at, times, tau[:, column])
            assert actual[place] == pytest.approx(want), f"the effort at {at} ns"
    none = [TrajectoryPoint(1, [0.0]), TrajectoryPoint(2, [0.0], effort=[1.0])]
    assert JointTrajectory(NAMES, limits(), ("a",), none).compute_effort(1) is None, (
        "none is given there"
    )


@pytest.mark.parametrize("seed", with_slow(range(40), 12))
def test_accepted_trajectories_keep_the_limits_and_refused_ones_do_not(seed: int) -> None:
    rng = np.random.default_rng([seed, 5])
    kind = KINDS[seed % 3]
    points = draw(rng, kind, 4, 2)
    loose = JointTrajectory(("a", "b"), limits(2), ("a", "b"), points)
    since_first = [time - loose.times_ns[0] for time in loose.times_ns]
    motion = JointMotion(since_first[:-1], since_first[-1], loose._pieces)
    times = np.linspace(0, motion.end_ns - 1, 1500).astype(int)
    q, v = (np.array(x) for x in zip(*(sample(motion, int(t))[:2] for t in times), strict=True))
    knots = np.abs(loose.v[~np.isnan(loose.v)]).max(initial=0.0)
    # The fastest it really goes; with a limit just above it is accepted, just below refused. (The
    # samples, 2 ms apart, miss a peak by less than 1e-3 of it.)
    fastest = max(float(np.abs(v).max()) / SPEED_BETWEEN_POINTS, float(knots))
    farthest = float(np.abs(q).max())
    for factor, accepted in ((1.002, True), (0.99, False)):
        for tight in (limits(2, speed=factor * fastest), limits(2, reach=factor * farthest)):
            try:
                JointTrajectory(("a", "b"), tight, ("a", "b"), points)
            except Refusal as refusal:
                assert not accepted, f"{kind}, limits {factor} of what it needs: {refusal}"
            else:
                assert accepted, f"{kind} beyond its limits by {1.0 / factor:g} was accepted"


def test_a_first_point_that_cannot_be_reached_in_time_is_refused_and_nothing_changes() -> None:
    trajectory = JointTrajectory(NAMES, limits(speed=1.0), ("b",), [TrajectoryPoint(SECOND, [2.0])])
    with pytest.raises(
        Refusal, match=r"the way to the first point must keep the limits of b, \+-1 "
    ):
        trajectory.begin_motion(0, 0, Reference.make_rest(np.zeros(4)))
    motion = trajectory.begin_motion(0, 0, Reference.make_rest(np.full(4, 1.5)))
    assert sample(motion, SECOND)[0].tolist() == [1.5, 2.0, 1.5, 1.5], "from nearer it is taken"
    with pytest.raises(
        Refusal, match="time of the last point must be still to come, got 1 s, at 1"
    ):
        trajectory.begin_motion(SECOND, 0, Reference.make_rest(np.zeros(4)))


def point(time: int = SECOND, **fields: Any) -> TrajectoryPoint:
    return TrajectoryPoint(time, **{"positions": [0.0, 0.0], **fields})


WRONG: list[tuple[str, dict[str, Any]]] = [
    ("joint must be one of the arm, got x; valid: a, b, c, d", {"names": ("a", "x")}),
    ("joint_names must name some joints, each once, got a, a", {"names": ("a", "a")}),
    ("joint_names must name some joints, each once, got none", {"names": ()}),
    (r"points\[0\].positions must have 2 values", {"points": [point(positions=[0.0])]}),
    (r"points\[0\].positions must have 2 values", {"points": [point(positions=[])]}),
    (r"points\[0\].positions must be numbers within", {"points": [point(positions=[math.nan, 0])]}),
    (r"points\[0\].positions must be numbers within", {"points": [point(positions=[1e7, 0])]}),
    (r"points\[0\].velocities must have 2", {"points": [point(velocities=[0.0] * 3)]}),
    (r"points\[0\].velocities must be numbers within", {"points": [point(velocities=[math.inf, 0])]}),
    (r"points\[0\].velocities must be 0 rad/s at the end", {"points": [point(velocities=[0.1, 0])]}),
    (r"points\[0\].velocities must be given", {"points": [point(accelerations=[0.0, 0.0])]}),
    (r"points\[0\].accelerations must have 2", {"points": [point(velocities=[0.0] * 2, accelerations=[0.0])]}),
    (r"points\[0\].effort must have 2", {"points": [point(effort=[0.0])]}),
    (r"points\[0\].effort must be numbers within", {"points": [point(effort=[math.nan, 0.0])]}),
    (r"points\[0\].time_from_start must be >= 0 s", {"points": [point(-1)]}),
    (r"points\[1\].time_from_start must be later than", {"points": [point(5), point(5)]}),
    (r"points\[2\].time_from_start must be later than", {"points": [point(5), point(9), point(8)]}),
    ("time_from_start must be > 0 s in the last point", {"points": [point(0)]}),
    (f"points must be at most {MAX_POINTS}, got {MAX_POINTS + 1}", {"points": [point()] * (MAX_POINTS + 1)}),
    (r"points\[0\].positions must keep the limits of a, \[-3, 3\] rad, got 3.1", {"points": [point(positions=[3.1, 0.0])]}),
    (r"points\[0\].velocities must keep the limits of b, \+-2 rad/s, got 2.1", {"points": [point(1, velocities=[0.0, 2.1]), point()]}),
    (r"the spline must keep the limits of a, \+-2 rad/s, got 4", {"points": [point(), point(SECOND + 10**9 // 2, positions=[2.0, 0.0])]}),
    (r"the spline must keep the limits of b, \[-3, 3\] rad, got 3.", {"points": [point(1, positions=[0.0, 2.9], velocities=[0.0, 1.0]), point(2 * SECOND, positions=[0.0, 2.9], velocities=[0.0, 0.0])]}),
]  # fmt: skip


@pytest.mark.parametrize(("words", "change"), WRONG, ids=[words for words, _ in WRONG])
def test_malformed_trajectories_are_refused_in_a_line(words: str, change: dict[str, Any]) -> None:
    inputs = {"names": ("a", "b"), "points": [point()], **change}
    with pytest.raises(Refusal, match=f"^joint_trajectory: {words}") as refusal:
        JointTrajectory(NAMES, limits(4, 2.0, 3.0), **inputs)
    assert "\n" not in str(refusal.value), "one line"


def test_the_end_may_move_where_that_is_allowed() -> None:
    points = [point(velocities=[0.1, 0.0])]
    make: Callable[..., JointTrajectory] = JointTrajectory
    assert make(NAMES, limits(), ("a", "b"), points, may_end_moving=True).v[-1][0] == 0.1


@pytest.mark.parametrize("seed", range(20))
def test_random_numbers_are_refused_or_lead_to_finite_angles(seed: int) -> None:
    rng = np.random.default_rng([seed, 6])
    for _ in range(50):
        n, count = int(rng.integers(1, 5)), int(rng.integers(0, 5))
        size = 10.0 ** rng.uniform(-300, 308, (3, count, n)) * rng.choice([-1, 0, 1], (3, count, n))
        times = np.cumsum(10 ** rng.integers(0, 14, count))
        fields = [size[0], size[1] if rng.random() < 0.5 else None, size[2]]
        points = [
            TrajectoryPoint(
                int(times[i]),
                np.clip(fields[0][i], -1e6, 1e6),
                () if fields[1] is None else np.clip(fields[1][i], -1e6, 1e6),
                () if fields[1] is None or rng.random() < 0.5 else np.clip(fields[2][i], -1e9, 1e9),
            )
            for i in range(count)
        ]
        huge = limits(n, speed=np.inf, reach=np.inf)
        try:
            trajectory = JointTrajectory(NAMES[:n], huge, NAMES[:n], points, may_end_moving=True)
            motion = trajectory.begin_motion(0, 0, Reference.make_rest(np.zeros(n)))
        except Refusal:
            continue
        for at in rng.integers(0, motion.end_ns + 2, 5):
            assert np.isfinite(sample(motion, int(at))).all(), f"at {at} ns of {points}"

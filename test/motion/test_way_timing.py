"""The timing of a way: within limits all along any curve, and hardly longer than needed."""

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator.motion.trajectory import timed_path
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath, ToolPathLimits


@pytest.mark.parametrize("case", with_slow(some(range(40), 8), 3))
def test_limits_hold_where_the_third_derivative_of_their_curve_steps(case: int) -> None:
    """Splines through random nodes, whose jerk steps in each of them, with ramps of any length.

    So wild a curve exceeds an acceleration between two checks now and then: 2 of 60, by 0.64 %.
    """
    rng = np.random.default_rng(case)
    nodes, joints = int(rng.integers(4, 50)), int(rng.integers(1, 8))
    curve = JointCurve.fit_spline(np.cumsum(rng.normal(size=(nodes + 1, joints)), axis=0))
    speed, acceleration = rng.uniform(0.3, 6.0, (2, joints))
    unlimited = np.full(joints, np.inf)
    limits = JointPathLimits(speed, acceleration, acceleration / rng.uniform(0.02, 0.5), unlimited)
    along = None
    if case % 2:
        ends = np.sort(rng.random(3)) + np.array([0.0, 0.0, 1.0])
        length, top, deceleration, jerk = rng.uniform(0.3, 3.0, 4)
        along = ToolPathLimits(length, top, deceleration, jerk, ends, rng.uniform(0.0, 5.0, 3))
    planned = TimedPath(curve, limits, along=along)
    rows = [planned.evaluate_at(t) for t in np.linspace(0.0, planned.duration, 4000)]
    for key, limit in (("v", speed), ("a", acceleration), ("jerk", limits.jerk)):
        assert (np.abs([getattr(row, key) for row in rows]) / limit).max() <= 1.0 + 1e-2
    if along is not None:
        places = np.array(
            [planned.compute_distance(t) for t in np.linspace(0.0, planned.duration, 4000)]
        )
        rate = np.gradient(places, planned.duration / 3999)
        assert rate.max() * along.length <= along.speed * (1.0 + 1e-3)


def test_a_sharp_bend_costs_hardly_more_time_than_with_many_pieces(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Curves that bend up to 50 times as much in places, against timings of 300 pieces.

    Of 300 the worst takes 1.13 of their time; slowed down as a whole for what exceeds a limit in
    one place it takes up to 1.80.
    """
    ratios = []
    for case in some(range(300), 75):
        rng = np.random.default_rng(case)
        joints, sharp = int(rng.integers(2, 7)), 10.0 ** rng.uniform(-1.7, -0.7)
        s = np.linspace(0.0, 1.0, int(rng.choice([33, 129])))[:, None]
        at = rng.uniform(0.03, 0.97, joints if case % 2 else 1)
        slope, turn = rng.normal(size=(2, joints))
        curve = JointCurve.fit_spline(
            slope * s + turn * sharp * np.logaddexp(0.0, (s - at) / sharp)
        )
        a = rng.uniform(2.0, 15.0, joints)
        jerk = a / rng.choice([0.05, 0.07])
        limits = JointPathLimits(rng.uniform(0.5, 3.0, joints), a, jerk, np.full(joints, np.inf))
        durations = []
        for pieces in (timed_path.FEWEST_PIECES, 300):
            with monkeypatch.context() as patch:
                patch.setattr(timed_path, "FEWEST_PIECES", pieces)
                durations.append(TimedPath(curve, limits).duration)
        ratios.append(durations[0] / durations[1])
    assert max(ratios) <= 1.15

"""Ways close beside an obstacle: gone to their end, and stopped on themselves."""

import dataclasses

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator import Kinematics, OfflineRun, Pose, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.collision.collisions import Collisions
from arm_emulator.motion.executor.goal_status import GoalState
from arm_emulator.motion.executor.jog import make_joint_command, make_twist_command
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.model.obstacles import Obstacle
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.motion.trajectory.time_scaling import TimeScaled
from arm_emulator.motion.trajectory.timed_path import JointPathLimits, TimedPath

SECOND = 1_000_000_000
SPARE = 0.5e-3  # m from the way to where the margin ends: joints that brake singly go farther
BETWEEN = 0.3e-3  # m less between two looks, which are up to twice the margin apart
FAST = {
    "tool_speed": 1.0,
    "tool_acceleration": 10.0,
    "tool_jerk": 200.0,
    "tool_turn_speed": 6.0,
    "jog_command_in_type": "speed_units",
}


class LowArm:
    """An arm that goes down, along a box with little space left, and up again."""

    def __init__(self, name: str, drop: float, blend: float) -> None:
        file = find_scene(name)
        scene, gains = load_scene(file), load_gains(file)
        kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
        self.R_WT, self.p_WT = kinematics.forward(scene.start)
        x, y, high = self.p_WT.tolist()
        margin = gains.motion.collision_margin

        def box(top: float) -> tuple[Obstacle]:
            return (Obstacle("box", size=(0.2, 0.9, 0.1), at=(x, y, top - 0.05)),)

        def meeting(top: float, margin: float) -> Collisions:
            return Collisions(scene.urdf, scene.joint_names, box(top), margin)

        far = meeting(high - 0.1, 0.0)
        at_start = np.broadcast_to(scene.start, (len(far.foreign), len(scene.start)))
        gap = min(far.measure_gaps(far.foreign, at_start).values())
        top = high - 0.1 + gap - margin - drop - SPARE
        obstacles = box(top)
        config = dataclasses.replace(gains.motion, obstacles=obstacles, path_blend=blend, **FAST)
        self.run = OfflineRun(scene, gains.servo, config)
        self.kinematics, self.instructor = self.run.controller.kinematics, self.run.instructor
        self.config = config
        self.links, self.commanded = meeting(top, 0.0), meeting(top, margin - BETWEEN)
        self.poses = [
            self.moved(0.0, 0.0, 0.0),
            self.moved(0.0, 0.0, -drop),
            self.moved(0.0, 0.25, -drop),
            self.moved(0.0, 0.25, 0.0),
        ]
        self.run.advance(1000)

    def moved(self, *by: float) -> Pose:
        return Pose(self.p_WT + np.array(by), self.R_WT)

    def period(self) -> None:
        """Go on for a motion period: no link touches, no command is nearer than the margin."""
        self.run.advance(self.run.motion_ticks)
        assert self.links.find_first_contact(self.run.session.state.q) == ""
        active = self.instructor._active
        assert active is not None
        reference = active.order.evaluate_reference(self.run.session.logical_ns)
        if reference is not None:
            assert self.commanded.find_first_contact(reference.q) == ""

    def periods(self, seconds: float) -> list[tuple[GoalState, str]]:
        for _ in range(round(seconds / self.config.period)):
            self.period()
        return [(report.state, report.reason) for report in self.instructor.reports.take_reports()]

    def set_out(self, kind: str) -> None:
        """Begin the path, or the same as a joint trajectory."""
        self.instructor.add_path(self.run.controller, self.poses)
        if kind != "trajectory":
            return
        self.period()
        motion = self.run.controller.motion  # type: ignore[attr-defined]
        times = np.arange(0.02, motion.duration, 0.02)
        moves = [(t, motion.evaluate_at(t)) for t in (*times.tolist(), motion.duration)]
        points = [
            TrajectoryPoint(
                round(t * 1e9), reference.q.tolist(), reference.v.tolist(), reference.a.tolist()
            )
            for t, reference in moves
        ]
        self.number = self.instructor.add_trajectory(
            self.run.controller, self.kinematics.joint_names, points
        )

    def until_bound(self, times: int) -> bool:
        """Go on until braking joints would touch for so many periods."""
        for _ in range(500):
            self.period()
            times -= self.instructor._only is not None
            if times <= 0:
                return True
        return False


@pytest.mark.parametrize("kind", ["path", "trajectory"])
@pytest.mark.parametrize(
    ("name", "drop", "blend"), with_slow([("ur5", 0.2, 0.06), ("panda", 0.1, 0.03)], 1)
)
def test_a_free_path_is_taken_however_near_an_obstacle_is(
    name: str, drop: float, blend: float, kind: str
) -> None:
    """Each joint that braked by itself would touch beside the way, in some periods of it."""
    arm = LowArm(name, drop, blend)
    arm.set_out(kind)
    assert arm.until_bound(1)
    assert arm.periods(2.5)[-1][0] is GoalState.REACHED


ENDS = ("twist", "joints", "cancel", "target below", "target above", "stream")


@pytest.mark.parametrize("end", with_slow(ENDS, 3))
@pytest.mark.parametrize("seed", some(range(12), 1))
def test_a_motion_that_is_ended_stops_on_its_path(seed: int, end: str) -> None:
    """Anything that comes on the way, at a drawn moment: nothing touches, and the arm goes on."""
    rng = np.random.default_rng(seed)
    arm = LowArm("panda", 0.1, 0.03)
    arm.set_out("trajectory" if end == "cancel" or rng.random() < 0.3 else "path")
    assert arm.until_bound(int(rng.integers(1, 12)))
    below = arm.moved(0.0, 0.1, -0.2)
    if end == "cancel":
        arm.instructor.cancel_trajectory(arm.number)
    elif end == "target below":
        arm.instructor.add(0, below)
    elif end == "target above":
        arm.instructor.add(0, arm.moved(0.0, 0.1, 0.0))
    else:
        for k in range(30):
            now = arm.run.session.logical_ns
            if end == "stream":
                arm.instructor.add(0, arm.moved(0.0, 0.1, -0.1 - 2e-3 * k))
            elif end == "twist":
                down = [0.0, 0.0, -0.5, 0.0, 0.0, 0.0]
                arm.instructor.take_jog(
                    make_twist_command(now, down, "", arm.kinematics, arm.config)
                )
            else:
                names, v = arm.kinematics.joint_names, rng.normal(0.0, 1.0, 7)
                arm.instructor.take_jog(
                    make_joint_command(now, names, v, arm.kinematics, arm.config)
                )
            arm.period()
    reports = arm.periods(1.2)
    assert np.abs(arm.run.session.state.v).max() < 2e-3
    if end == "target above":
        assert reports[-1][0] is GoalState.REACHED
    if end == "target below":
        assert reports[-1][0] is GoalState.ABORTED and "box would touch" in reports[-1][1]
    arm.instructor.add(0, arm.moved(0.0, 0.1, 0.05))
    assert arm.periods(1.8)[-1][0] is GoalState.REACHED


class Swing:
    """Joints that swing, with all derivatives in closed form."""

    duration = 10.0
    _size, _rate = np.array([0.3, -1.1]), np.array([1.7, 0.6])

    def evaluate_at(self, time: float) -> Reference:
        size, rate, angle = self._size, self._rate, self._rate * time
        return Reference(
            size * np.sin(angle),
            size * rate * np.cos(angle),
            -size * rate**2 * np.sin(angle),
            -size * rate**3 * np.cos(angle),
        )


@pytest.mark.parametrize("then", [0.0, 0.4, 1.5])
def test_derivatives_at_another_pace_are_those_of_finite_differences(then: float) -> None:
    """Speed, acceleration and jerk have terms of the derivatives of a pace that changes."""
    none = np.full(2, 1e9)
    paced = TimeScaled(Swing(), 1.0, 1.0, then, JointPathLimits(none, none, none, none))
    ramp = 0.05  # s, the shortest change of a pace: no limit needs more
    h = 1e-3 * ramp
    for t in np.linspace(0.1, 0.9, 7) * ramp:
        low, here, high = (paced.evaluate_at(t + k * h) for k in (-1, 0, 1))
        pairs = (low.q, high.q, here.v), (low.v, high.v, here.a), (low.a, high.a, here.jerk)
        for before, after, rate in pairs:
            # Differences are off by h^2 / 6 times the third derivative of what they are of.
            np.testing.assert_allclose(
                (after - before) / (2.0 * h), rate, rtol=1e-4, atol=1e-5 / ramp**2
            )
    with_change = paced.evaluate_at(0.3 * ramp)
    assert with_change.jerk is not None and np.abs(with_change.a).max() > 1.0, "it changes the pace"


@pytest.mark.parametrize("seed", some(range(60), 6))
def test_a_motion_slows_down_within_its_limits(seed: int) -> None:
    """Drawn ways at drawn moments: angles of the way at each time, at a pace that falls to 0."""
    rng = np.random.default_rng(seed)
    N = int(rng.integers(1, 8))
    v_limit, a_limit, jerk_limit = (
        rng.uniform(low, high, N) for low, high in ((0.5, 4.0), (1.0, 20.0), (20.0, 400.0))
    )
    limits = JointPathLimits(v_limit, a_limit, jerk_limit, np.full(N, np.inf))
    begin, end = rng.uniform(-2.0, 2.0, (2, N))
    planned = TimedPath(JointCurve.make_line(begin, end), limits)
    since = rng.uniform(0.0, 1.0) * planned.duration
    slow = TimeScaled(planned, since, 1.0, 0.0, limits)
    times = np.linspace(0.0, slow.duration, 400)
    moves = [slow.evaluate_at(float(t)) for t in times]
    q, v, a = (np.array([getattr(move, name) for move in moves]) for name in "qva")
    first = planned.evaluate_at(since)
    assert np.abs(q[0] - first.q).max() < 1e-9 and np.abs(v[0] - first.v).max() < 1e-9
    assert np.abs(v[-1]).max() < 1e-6 and slow.evaluate_at(slow.duration + 1.0).q == pytest.approx(
        q[-1]
    )
    assert (np.abs(v) <= v_limit * 1.001).all() and (np.abs(a) <= a_limit * 1.001).all()
    # On the line, and forwards.
    part = (q - begin) @ (end - begin) / ((end - begin) @ (end - begin))
    assert np.abs(begin + np.outer(part, end - begin) - q).max() < 1e-9
    assert (np.diff(part) >= -1e-12).all()
    # Speeds are those of the angles: nothing jumps.
    h = times[1] - times[0]
    assert np.abs(np.diff(q, axis=0) - 0.5 * (v[1:] + v[:-1]) * h).max() <= jerk_limit.max() * h**3

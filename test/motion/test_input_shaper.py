"""Input shaping against closed forms and the equation of an elastic joint, solved by SciPy."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from draws import with_slow
from kinematic_arms import NAMES, THREE_AXIS
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from arm_emulator import Kinematics, OfflineRun, Refusal, load_gains, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.executor.goal_status import GoalState
from arm_emulator.motion.executor.jog import JogCommand
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.executor.shaped_reference import ShapedReference
from arm_emulator.motion.model.config import MotionConfig, load_motion_config
from arm_emulator.motion.model.input_shaper import InputShaper, ShapedMode
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint

PERIOD = 0.01  # s
SECOND = 1_000_000_000


def draw_mode(rng: np.random.Generator) -> ShapedMode:
    return ShapedMode(float(10 ** rng.uniform(0.0, 1.5)), float(rng.uniform(0.0, 0.4)))


def residual(shaper: InputShaper, mode: ShapedMode) -> float:
    """Vibration that impulses leave in a mode, as a share of that by one impulse at their end."""
    w = 2.0 * math.pi * mode.frequency
    phase = w * math.sqrt(1.0 - mode.damping**2) * shaper.times
    grown = shaper.shares * np.exp(mode.damping * w * shaper.times)
    together = math.hypot(float(grown @ np.cos(phase)), float(grown @ np.sin(phase)))
    return math.exp(-mode.damping * w * shaper.delay) * together


@pytest.mark.parametrize("seed", range(20))
def test_impulses_leave_no_vibration_of_any_of_their_modes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    modes = [draw_mode(rng) for _ in range(int(rng.integers(1, 4)))]
    for kind in ("zv", "zvd"):
        shaper = InputShaper.compute_shaper(kind, modes)
        assert (shaper.shares > 0.0).all() and shaper.shares.sum() == pytest.approx(1.0, abs=1e-14)
        assert shaper.times[0] == 0.0 and (np.diff(shaper.times) > 0.0).all()
        for mode in modes:
            assert residual(shaper, mode) < 1e-12, kind  # rounding


@pytest.mark.parametrize("off", [-0.2, -0.1, 0.05, 0.1, 0.2])
def test_a_wrong_frequency_leaves_the_swing_of_the_closed_form(off: float) -> None:
    """Undamped: |cos(pi r / 2)| after ZV and its square after ZVD, r of true by assumed."""
    rng = np.random.default_rng(3)
    for frequency in 10 ** rng.uniform(0.0, 2.0, 10):
        true = ShapedMode(float(frequency * (1.0 + off)))
        for power, kind in enumerate(("zv", "zvd"), 1):
            left = residual(InputShaper.compute_shaper(kind, [ShapedMode(float(frequency))]), true)
            expected = abs(math.cos(0.5 * math.pi * (1.0 + off))) ** power
            assert left == pytest.approx(expected, abs=1e-12)


def run_bang(rng: np.random.Generator, top: float, period: float) -> list[Reference]:
    """Two joints that accelerate and brake at once, each period known exactly; then a rest."""
    q, v = np.zeros(2), np.zeros(2)
    up, cruise = int(rng.integers(3, 12)), int(rng.integers(0, 15))
    a_0 = rng.uniform(-top, top, 2)
    motion = []
    for sign in (1.0,) * up + (0.0,) * cruise + (-1.0,) * up:
        a = sign * a_0
        motion.append(Reference(q, v, a, np.zeros(2)))
        q, v = q + period * v + 0.5 * period**2 * a, v + period * a
    return [*motion, *[Reference.make_rest(q)] * 60]


def shape(motion: list[Reference], shaper: InputShaper, period: float) -> list[JointSetpoint]:
    shaped, still = ShapedReference(shaper, period), Reference.make_rest(motion[0].q)
    shaped.filter_setpoint(JointSetpoint(still.q, still.v, None, still, still))
    instructions = []
    for now, then in zip(motion, [*motion[1:], motion[-1]], strict=True):
        end = Reference(then.q, then.v, now.a)  # the acceleration jumps at the end of the period
        instructions.append(
            shaped.filter_setpoint(JointSetpoint(now.q, (then.q - now.q) / period, None, now, end))
        )
    return instructions


def swing(rows: list[Reference], period: float, mode: ShapedMode) -> float:
    """Swing at the end of a link whose motor moves so, by its equation [rad].

    M q'' + D (q' - x') + K (q - x) = 0 with s = q - x: s'' + 2 z w s' + w^2 s = -x''.
    """
    w = 2.0 * math.pi * mode.frequency
    wd = w * math.sqrt(1.0 - mode.damping**2)
    t = period * np.arange(len(rows))
    speeds = CubicHermiteSpline(t, [row.v[0] for row in rows], [row.a[0] for row in rows])
    a = speeds.derivative()

    def rates(at: float, s: Array) -> list[float]:
        return [s[1], -2.0 * mode.damping * w * s[1] - w**2 * s[0] - float(a(at))]

    s = solve_ivp(
        rates, (0.0, t[-1]), np.zeros(2), "DOP853", rtol=1e-8, atol=1e-12, max_step=period
    ).y[:, -1]  # fmt: skip
    return math.hypot(s[0], (s[1] + mode.damping * w * s[0]) / wd)


@pytest.mark.parametrize("kind", ["zv", "zvd"])
@pytest.mark.parametrize("seed", with_slow(range(4), 1))
def test_a_shaped_motion_shakes_an_elastic_joint_as_its_impulses_state(
    kind: str, seed: int
) -> None:
    """The swing after the end, shaped by unshaped, at right and wrong frequencies."""
    rng, period = np.random.default_rng(seed), 2e-3
    mode = ShapedMode(float(rng.uniform(3.0, 15.0)), float(rng.uniform(0.0, 0.2)))
    motion = run_bang(rng, 5.0, period)
    motion += [motion[-1]] * 200
    unshaped = swing(motion, period, mode)
    w = 2.0 * math.pi * mode.frequency
    rate = complex(mode.damping * w, w * math.sqrt(1.0 - mode.damping**2))
    for factor in (1.0, 0.8, 0.9, 1.1, 1.2):
        shaper = InputShaper.compute_shaper(
            kind, [ShapedMode(factor * mode.frequency, mode.damping)]
        )
        rows = [instruction.now for instruction in shape(motion, shaper, period)]
        relative_swing = swing([row for row in rows if row is not None], period, mode) / unshaped
        expected = abs(shaper.shares @ np.exp(rate * shaper.times))
        # The acceleration of a copy that begins within a period is known at its ends alone:
        # (w period)^2 / 8, 0.5 % at 15 Hz.
        assert relative_swing == pytest.approx(expected, abs=5e-3, rel=5e-3), (mode, factor)


START = np.array([0.0, 0.5, 0.8])
SHAPED = {"shaper": "zvd", "modes": (ShapedMode(6.3, 0.1), ShapedMode(14.0, 0.05))}


class IdealArm:
    """An arm that is exactly where its targets are."""

    def __init__(self, **more: object) -> None:
        config = MotionConfig(
            tool="tool", task="position", method="way", period=PERIOD, feedforward="speed", **more
        )  # type: ignore[arg-type]
        self.config, self.executor = config, MotionExecutor(config)
        self.planner = TargetPlanner(Kinematics(THREE_AXIS, NAMES, "tool", "position"), config)
        self.q, self.v, self.k = START, np.zeros(3), 0
        self.instruct()

    @property
    def now_ns(self) -> int:
        return self.k * round(PERIOD * SECOND)

    def move(self, goal: Array) -> None:
        points = [TrajectoryPoint(SECOND, goal, np.zeros(3))]
        self.executor.add_trajectory(self.planner, NAMES, points)

    def instruct(self, movable: Array | None = None) -> JointSetpoint:
        answer = self.executor.compute_setpoint(self.planner, self.now_ns, self.q, self.v, movable)
        self.v = np.zeros(3) if answer.v is None else answer.v
        self.q, self.k = answer.q + PERIOD * self.v, self.k + 1
        return answer


@pytest.mark.parametrize("seed", range(5))
def test_a_shaped_motion_keeps_limits_lines_and_end_and_is_reached_by_its_delay_later(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    goal = START + rng.uniform(-0.8, 0.8, 3)
    motions = {}
    for name, more in (("raw", {}), ("shaped", SHAPED)):
        arm = IdealArm(**more)
        arm.move(goal)
        instructions, states = [], []
        for _ in range(260):
            instructions.append(arm.instruct())
            states.append(arm.executor.progress.state)
        rows = [
            instruction.now or Reference.make_rest(instruction.q) for instruction in instructions
        ]
        motion = (np.array([getattr(row, key) for row in rows]) for key in "qva")
        motions[name] = (*motion, states.index(GoalState.REACHED))
    delay = arm.config.design_shaper().delay
    raw, shaped = motions["raw"], motions["shaped"]
    assert np.array_equal(raw[0][-1], shaped[0][-1]), "the end, to the bit"
    for order in (1, 2):
        limits = np.abs(raw[order]).max(axis=0)
        assert (np.abs(shaped[order]).max(axis=0) <= limits * (1.0 + 1e-9)).all(), order
    # Jerks of a motion are means over a period: those of a copy that begins within one, too.
    jerks = [np.abs(np.diff(motion[2], axis=0)).max(axis=0) for motion in (raw, shaped)]
    assert (jerks[1] <= jerks[0] * 1.01).all(), jerks
    along = (goal - START) / np.linalg.norm(goal - START)
    beside = (shaped[0] - START) - np.outer((shaped[0] - START) @ along, along)
    assert np.abs(beside).max() < 1e-12, "on the straight line of the joints"
    later = (shaped[3] - raw[3]) * PERIOD
    assert delay - PERIOD <= later <= delay + 2 * PERIOD
    assert (np.abs(np.diff(shaped[0], axis=0)) > 0.0)[: shaped[3] - 3].any(axis=1).all()


def test_the_delay_is_reported_and_tolerances_judge_the_shaped_motion() -> None:
    """An arm exactly on its targets is within a path tolerance that the delay alone exceeds."""
    arm = IdealArm(path_tolerance=1e-3, **SHAPED)
    arm.move(START + 0.5)
    words = []
    for _ in range(200):
        arm.instruct()
        words += [str(report) for report in arm.executor.reports.take_reports()]
    delay = arm.config.design_shaper().delay
    assert any(f"{delay:.3g} s more by the shaper" in word for word in words), words
    assert arm.executor.progress.state is GoalState.REACHED and "aborted" not in " ".join(words)


def test_a_motion_replaced_while_moving_stays_smooth() -> None:
    """Goals and jogs that come at any time: the targets never jump, and come to rest."""
    rng = np.random.default_rng(8)
    arm = IdealArm(**SHAPED)
    for k in range(900):
        if k % 37 == 5 and k < 500:
            goal = START + rng.uniform(-0.5, 0.5, 3)
            match int(rng.integers(3)):
                case 0:
                    R_WT, p_WT = arm.planner.kinematics.forward(goal)
                    arm.executor.add(arm.now_ns, Pose(p_WT, R_WT))
                case 1:
                    arm.move(goal)
                case _:
                    arm.executor.take_jog(JogCommand(arm.now_ns, joints=goal - START))
        expected = arm.q
        assert np.abs(arm.instruct().q - expected).max() < 1e-9, k
    assert arm.executor.restarts == 0 and not arm.v.any()


def test_a_joint_that_cannot_move_meets_no_delayed_reference() -> None:
    """A brake closes on the way: its joint is commanded where it is, the others do not jump."""
    arm = IdealArm(**SHAPED)
    arm.move(START + 0.6)
    zoh_angle, before = 0.0, START
    for k in range(400):
        can = np.array([True, not 40 <= k < 120, True])
        if k == 40:
            zoh_angle = arm.q[1]
        if not can[1]:
            arm.q, arm.v = np.array([arm.q[0], zoh_angle, arm.q[2]]), arm.v * can
        answer = arm.instruct(can)
        assert can[1] or answer.q[1] == pytest.approx(zoh_angle, abs=1e-12), k
        assert np.abs(answer.q - before)[[0, 2]].max() < 3.0 * PERIOD, k  # 3 rad/s at most
        before = answer.q
    assert np.abs(arm.q - START - 0.6).max() < 1e-9, "it goes on to the end"


def test_another_shaper_is_taken_over_at_rest() -> None:
    arm = IdealArm(**SHAPED)
    arm.move(START + 0.6)
    delays = []
    for k in range(200):
        if k == 40:
            arm.executor.set_parameters(dataclasses.replace(arm.config, shaper="none"))
        expected = arm.q
        assert np.abs(arm.instruct().q - expected).max() < 1e-9, k
        delays.append(arm.executor._controllers.shaped.delay)  # type: ignore[union-attr]
    has_delay = np.array(delays) > 0.0
    assert has_delay[:100].all() and not has_delay[-1], "the shaper stays until the arm rests"


def test_a_run_goes_on_from_a_saved_moment_to_the_last_bit() -> None:
    file = find_scene("three_axis")
    gains = load_gains(file)
    motion = dataclasses.replace(gains.motion, method="way", **SHAPED)  # type: ignore[arg-type]
    run = OfflineRun(load_scene(file), gains.servo, motion)
    run.advance(100)
    R_WT, p_WT = run.controller.kinematics.forward(run.session.state.q)
    run.instructor.add(0, Pose(np.add(p_WT, [0.0, 0.05, 0.0]), R_WT))
    run.advance(300)
    saved, rows = run.save(), []
    for _ in range(2):
        run.restore(saved)
        run.advance(1500)
        rows.append(run.session.state.q.tobytes())
    assert rows[0] == rows[1]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("shaper: zv", "parameter shaper must come with modes"),
        ("shaper: zvdd", "parameter shaper must be known"),
        ("shaper: zv\n    method: paper\n    modes: {a: {frequency: 5.0}}",
         "be none with the method paper"),
        ("modes: {a: {frequency: 0.0}}", "modes.a.frequency must be a number > 0"),
        ("modes: {a: {frequency: -3.0}}", "modes.a.frequency must be a number > 0"),
        ("modes: {a: {frequency: .nan}}", "modes.a.frequency must be a number > 0"),
        ("modes: {a: {frequency: 5.0, damping: 1.0}}", "modes.a.damping must be a number"),
        ("modes: {a: {frequency: 5.0, damping: -0.1}}", "modes.a.damping must be a number"),
        ("modes: {a: {damping: 0.1}}", "modes.a.frequency must be given"),
        ("modes: {a: {frequency: 5.0, mass: 1.0}}", "modes.a.mass must be a known key"),
        ("modes: {a: 5.0}", "modes.a must be a mapping"),
        ("modes: 5.0", "section modes must be a mapping"),
        ("shaper: zvd\n    modes: {a: {frequency: 0.05}}", "delay a motion by at most 5 s"),
        ("modes: {" + ", ".join(f"m{k}: {{frequency: 5.0}}" for k in range(5)) + "}",
         "modes must be at most 4"),
    ],
)  # fmt: skip
def test_a_shaper_that_makes_no_sense_is_refused_in_a_line(
    tmp_path: Path, lines: str, words: str
) -> None:
    file = tmp_path / "motion.yaml"
    text = f"/**/motion_controller:\n  ros__parameters:\n    tool: tool\n    {lines}\n"
    file.write_text(text)
    with pytest.raises(Refusal) as refusal:
        load_motion_config(file)
    assert words in str(refusal.value) and "\n" not in str(refusal.value), refusal.value


def test_the_file_of_parameters_gives_modes_and_shaper(tmp_path: Path) -> None:
    file = tmp_path / "motion.yaml"
    file.write_text(
        "/**/motion_controller:\n  ros__parameters:\n    tool: tool\n    shaper: zv\n"
        "    modes:\n      first: {frequency: 7.5, damping: 0.2}\n"
    )
    config = load_motion_config(file)
    assert config.modes == (ShapedMode(7.5, 0.2),)
    half = 0.5 / (7.5 * math.sqrt(1.0 - 0.04))
    assert config.design_shaper().delay == pytest.approx(half, rel=1e-12)


def test_a_shaper_without_modes_is_refused_by_the_controllers_constructor() -> None:
    file = find_scene("three_axis")
    gains = load_gains(file)
    motion = dataclasses.replace(gains.motion, method="way", shaper="zv")
    with pytest.raises(Refusal, match="parameter shaper must come with modes"):
        OfflineRun(load_scene(file), gains.servo, motion)

"""The servo against motors integrated exactly, and everything that it refuses."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import yaml

from arm_emulator.base.bound import POSITION, VELOCITY
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.motion_config import load_motion_config
from arm_emulator.servo.drives import Drives, Target
from arm_emulator.servo.servo import JointServo, Servo, ServoConfig, load_servo_config
from arm_emulator.servo.watchdog import Watchdog, WatchdogState

CONFIG = Path(__file__).resolve().parents[1] / "config"
PERIOD = 1e-3
JOINT = JointServo(
    name="joint",
    gear_ratio=0.01,
    counts_per_turn=1024,
    resistance=1.0,
    inductance=1e-3,
    torque_constant=0.05,
    back_emf_constant=0.05,
    rotor_inertia=1e-4,
    current_limit=20.0,
    voltage_limit=100.0,  # more than there is
    velocity_limit=3.0,
    position_gain=30.0,
    velocity_gain=150.0,
    integral_time=0.2,
    observer_bandwidth=300.0,
)


def servo_of(joint: JointServo = JOINT, supply_voltage: float = 48.0) -> Servo:
    return Servo(ServoConfig(PERIOD, 0.05, 0.2, 2.0, supply_voltage, (joint,)))


class Drivetrain:
    """Motor, elastic gear and link of one joint; exact for voltages and torques held over a period.

    Written from eq. (1), (2) and (4) of the paper: L di/dt = V - R i - Kb wm and so on, as one
    linear system whose transition matrix is a matrix exponential.
    """

    def __init__(
        self,
        joint: JointServo,
        link_inertia: float = 0.4,
        stiffness: float = 1e4,
        damping: float = 10.0,
        viscous: float = 0.5,
        load: float = 0.0,
        q: float = 0.0,
    ) -> None:
        R, Kt = joint.resistance, joint.torque_constant
        L = joint.inductance or 1e-6 * R * PERIOD  # as good as at once
        Kb, Mm, Ng = joint.back_emf_constant, joint.rotor_inertia, joint.gear_ratio
        Kg, Dg, J = stiffness, damping, link_inertia
        A = np.zeros((7, 7))  # current, theta_m, omega_m, q, v; held: voltage, load
        A[0, [0, 2, 5]] = -R / L, -Kb / L, 1 / L
        A[1, 2] = 1.0
        A[2, :5] = Kt / Mm, -Ng * Ng * Kg / Mm, -Ng * Ng * Dg / Mm, Ng * Kg / Mm, Ng * Dg / Mm
        A[3, 4] = 1.0
        A[4, 1:5] = Ng * Kg / J, Ng * Dg / J, -Kg / J, -(Dg + viscous) / J
        A[4, 6] = 1 / J
        self._transition = scipy.linalg.expm(A * PERIOD)
        self._counts_per_rad = joint.counts_per_turn / (2 * math.pi)
        self.Ng = Ng
        self.x = np.array([0.0, q / Ng, 0.0, q, 0.0, 0.0, load])

    @property
    def counts(self) -> int:
        return math.floor(self.x[1] * self._counts_per_rad)

    @property
    def q_motor(self) -> float:
        return float(self.x[1] * self.Ng)

    def advance(self, voltage: float) -> None:
        self.x[5] = voltage
        self.x = self._transition @ self.x


def run(
    servo: Servo,
    machine: Drivetrain,
    q_target: float,
    ticks: int,
    dead_time: int = 0,
    **control: Any,
) -> np.ndarray:
    """Return per tick: motor angle times Ng, link angle, voltage, current, v_measured."""
    rows, late, applied = [], [0.0] * dead_time, 0.0
    for _ in range(ticks):
        measured = [machine.counts], [machine.x[0]]
        voltage = servo.update(*measured, [q_target], applied=[applied], **control)[0]
        rows.append((machine.q_motor, machine.x[3], voltage, machine.x[0], servo.v_measured[0]))
        late.append(voltage)
        applied = late.pop(0)
        machine.advance(applied)
    return np.array(rows)


def at_rest_within(joint: JointServo, q_motor: np.ndarray, target: float) -> None:
    """The motor stands in the count of its target; at the edge it may cross by a tenth of one."""
    cell = math.floor(target / joint.count_angle)
    in_counts = q_motor / joint.count_angle - cell
    assert in_counts.min() > -0.1
    assert in_counts.max() < 1.1


# Closed loop


@pytest.mark.parametrize("dead_time", [0, 1, 2])
@pytest.mark.parametrize("link_inertia", [0.025, 0.1, 0.35, 0.83])
def test_step_settles_for_every_pose_and_dead_time(link_inertia: float, dead_time: int) -> None:
    """Link inertias of all poses of three_axis; up to two periods from measurement to voltage."""
    machine = Drivetrain(JOINT, link_inertia)
    step = 0.02  # rad; 326 counts, and 0.6 rad/s asked for, far from any limit
    rows = run(servo_of(), machine, step, 2500, dead_time)
    link = rows[:, 1]
    assert link.max() < 1.10 * step  # the linear loop overshoots by 6 % at the largest inertia
    assert np.abs(link[200:] - step).max() < 0.04 * step  # and is within 2 % after 110 ms
    at_rest_within(JOINT, rows[2000:, 0], step)


@pytest.mark.parametrize("seed", range(5))
def test_rests_in_the_count_of_the_target_under_load_and_wrong_data_sheets(seed: int) -> None:
    """Integral action does not ask for exact values: +-20 % in each, and a load of +-20 N m."""
    rng = np.random.default_rng(seed)
    names = ("resistance", "torque_constant", "rotor_inertia")
    values = {name: getattr(JOINT, name) * rng.uniform(0.8, 1.2) for name in names}
    real = dataclasses.replace(JOINT, **values)
    machine = Drivetrain(real, load=float(rng.uniform(-20, 20)))
    target = float(rng.uniform(-0.02, 0.02))
    rows = run(servo_of(), machine, target, 4000)
    at_rest_within(JOINT, rows[3500:, 0], target)


def test_first_update_is_bumpless() -> None:
    """At rest at the target nothing is asked for; a current that flows keeps flowing."""
    machine = Drivetrain(JOINT, q=0.7)
    assert servo_of().update([machine.counts], [0.0], [0.7])[0] == 0.0
    assert servo_of().update([machine.counts], [3.0], [0.7])[0] == pytest.approx(
        3.0 * JOINT.resistance, rel=1e-15
    )


def test_feed_forward_of_a_known_load_leaves_no_sag() -> None:
    """Without it the load moves the motor until the integral has taken it up."""
    sag = {}
    for name, control in {"without": {}, "with": {"tau_feedforward": [20.0]}}.items():
        machine = Drivetrain(JOINT, load=-20.0, q=0.5)
        sag[name] = np.abs(run(servo_of(), machine, 0.5, 1000, **control)[:, 0] - 0.5).max()
    # The gear is unloaded at first, so the motor still answers its 2 mrad of wind-up.
    assert sag["with"] < 1.5e-3
    assert sag["without"] > 2.0 * sag["with"]


def test_feed_forward_of_the_speed_leaves_no_lag() -> None:
    """A ramp of 0.5 rad/s: position control alone lags by v / Kp once the integral is out."""
    speed, lag = 0.5, {}
    for name, v_target in {"without": 0.0, "with": speed}.items():
        servo, machine = servo_of(), Drivetrain(JOINT)
        for tick in range(1500):
            q = speed * PERIOD * tick
            machine.advance(servo.update([machine.counts], [machine.x[0]], [q], [v_target])[0])
        lag[name] = speed * PERIOD * 1500 - machine.q_motor
    assert lag["without"] == pytest.approx(speed / JOINT.position_gain, rel=0.05)
    assert abs(lag["with"]) < 0.05 * lag["without"]


@pytest.mark.parametrize("seed", range(5))
def test_targets_go_on_with_their_speed_for_a_motion_period_at_most(seed: int) -> None:
    """Targets of the control law in every tick, against q + v (t - t_target)."""
    rng = np.random.default_rng(seed)
    motion_period = float(rng.choice([0.0, 0.01, 0.05]))
    config = ServoConfig(PERIOD, motion_period, 0.3, 2.0, 48.0, (JOINT,))
    drives, twin = Drives(config), Servo(config)
    q, v, at = 0.0, 0.0, 0
    for tick in range(200):
        count, current = int(rng.integers(-3, 4)), float(rng.normal())
        drives.measure(tick * 1_000_000, [count], [current])
        twin.observe([count], [current])
        if tick == 0 or rng.random() < 0.03:
            q, v, at = float(rng.normal(0.0, 0.01)), float(rng.normal(0.0, 0.1)), tick
            moving = rng.random() < 0.8
            v = v if moving else 0.0
            drives.aim(Target(np.array([q]), np.array([v]) if moving else None))
        ahead = min((tick - at) / 1000, motion_period)
        expected = twin.control([q + v * ahead], [v])
        assert drives.command(powered=True) == expected, f"voltage of tick {tick}"


def test_targets_that_go_on_stay_within_what_a_joint_may_be_asked_for() -> None:
    """At the bound of positions, outwards: no refusal within the loop, which nobody would catch."""
    largest = POSITION.most
    drives = Drives(ServoConfig(PERIOD, 0.05, 0.2, 2.0, 48.0, (JOINT,)))
    drives.measure(0, [0], [0.0])
    drives.aim(Target(np.array([-largest]), np.array([-VELOCITY.most])))
    for tick in range(60):
        drives.measure(tick * 1_000_000, [0], [0.0])
        assert np.isfinite(drives.command(powered=True)).all()


def test_a_smooth_motion_does_not_excite_a_gear_that_resonates_at_the_rate_of_the_targets() -> None:
    """Targets come 100 times a second, and the link resonates at 100 Hz, damped to 2 %.

    From 0.3 s on, when the step at the start has died away: 0.06 rad/s2 beside 5.4 rad/s2 of the
    motion, and 0.36 rad/s2 with accelerations and torques that step with every target.
    """
    joint, inertia, T = dataclasses.replace(JOINT, counts_per_turn=2**16), 0.4, 0.01
    stiffness = inertia * (2.0 * math.pi / T) ** 2
    damping = 0.04 * math.sqrt(stiffness * inertia)
    machine = Drivetrain(joint, inertia, stiffness, damping)
    drives = Drives(ServoConfig(PERIOD, T, 0.2, 2.0, 48.0, (joint,)))
    turn, rate, applied, v = 0.3, 6.0, np.zeros(1), [0.0]
    t = np.arange(-100, 1000) * PERIOD
    q = 0.5 * turn * (1.0 - np.cos(rate * np.maximum(t, 0.0)))
    a = 0.5 * turn * rate**2 * np.cos(rate * t) * (t > 0.0)
    for k in range(len(t) - 10):
        drives.measure(k * 1_000_000, [machine.counts], [machine.x[0]], applied)
        if k % 10 == 0:
            mean = (q[k + 10] - q[k]) / T
            tau = 0.5 * inertia * (a[k] + a[k + 10]) + 0.5 * mean
            drives.aim(Target(q[[k]], np.array([mean]), np.array([tau])))
        applied = drives.command(True)
        machine.advance(applied[0])
        v.append(float(machine.x[4]))
    beside = np.diff(v[::5])[80:] / (5 * PERIOD) - a[402:-8:5][: len(v[::5]) - 81]
    assert np.abs(beside).max() < 0.12


def test_speeds_in_steps_are_not_asked_of_the_rotor_twice() -> None:
    """Speeds of a controller that knows no accelerations: 1 rad/s from one target to the next.

    The acceleration of that step, 100 rad/s2, is asked for once: at most 1.8 times for a moment,
    and at most 0.4 times backwards a period later (2 times and once with all of the change).
    """
    T = 10 * PERIOD
    drives = Drives(ServoConfig(PERIOD, T, 0.2, 2.0, 48.0, (JOINT,)))
    asked = []
    for k in range(8):
        drives.measure(k * 10_000_000, [0], [0.0])
        drives.aim(Target(np.zeros(1), np.array([float(k > 3)]), np.zeros(1)))
        drives.command(powered=True)
        state = drives.servo.state[0]
        asked += [state["a_target"] * T, (state["a_target"] + state["jerk_target"] * T) * T]
    assert max(asked) <= 1.8 + 1e-9
    assert min(asked) >= -0.4 - 1e-9
    assert asked[-1] == 0.0


@pytest.mark.parametrize("speed", [0.2, -0.7])
def test_a_ramp_of_targets_with_speeds_is_followed_without_stairs(speed: float) -> None:
    """Targets every 50 ms with the ramp's speed: without going on, each is a step of 50 ms."""
    ripple = {}
    for name, motion_period in (("stairs", 0.0), ("line", 0.05)):
        drives = Drives(ServoConfig(PERIOD, motion_period, 0.2, 2.0, 48.0, (JOINT,)))
        machine, off = Drivetrain(JOINT), []
        for tick in range(1500):
            drives.measure(tick * 1_000_000, [machine.counts], [machine.x[0]])
            if tick % 50 == 0:
                drives.aim(Target(np.array([speed * PERIOD * tick]), np.array([speed])))
            off.append(machine.x[3] - speed * PERIOD * tick)
            machine.advance(drives.command(powered=True)[0])
        ripple[name] = np.ptp(off[1000:])
    # Encoder counts and the gear are left: a count is 6e-5 rad.
    assert ripple["line"] < 3.0 * JOINT.count_angle, f"{ripple}"
    assert ripple["stairs"] > 5.0 * ripple["line"], f"{ripple}"


def test_the_servo_is_reported_what_voltage_was_applied() -> None:
    """A fast motor's speed follows from its voltage: another than was asked for, as of a drive

    that answered late, is no surprise to a servo that is reported.
    """
    fast = dataclasses.replace(JOINT, rotor_inertia=1e-6, inductance=0.0, counts_per_turn=2**20)
    rng = np.random.default_rng(0)
    error = {}
    for reported in (True, False):
        servo, machine = servo_of(fast), Drivetrain(fast, stiffness=1.0, damping=0.0)
        applied, off = 0.0, []
        for tick in range(400):
            given = {"applied": [applied]} if reported else {}
            servo.observe([machine.counts], [machine.x[0]], **given)
            servo.control([0.0])
            applied = float(rng.uniform(-1.0, 1.0))
            if tick > 50:
                off.append(servo.v_measured[0] - machine.x[2] * machine.Ng)
            machine.advance(applied)
        error[reported] = float(np.sqrt(np.mean(np.square(off))))
    assert error[True] < 0.1 * error[False], f"rms error of the speed, reported or not: {error}"


# Limits


def test_voltage_current_and_speed_stay_within_their_limits() -> None:
    machine = Drivetrain(JOINT)
    rows = run(servo_of(supply_voltage=12.0), machine, 3.0, 2500)
    voltage, current = rows[:, 2], rows[:, 3]
    assert np.abs(voltage).max() == 12.0
    # R, with its share against current errors, lets the current overshoot its limit by a little.
    assert np.abs(current).max() < 1.1 * JOINT.current_limit

    slow = dataclasses.replace(JOINT, velocity_limit=0.5)
    rows = run(servo_of(slow), Drivetrain(slow), 3.0, 2500)
    # Cruising; the loop's integral overshoots its ramp by at most a fifth at the start.
    assert rows[:, 4].max() < 0.6
    assert rows[1000:2500, 4].mean() == pytest.approx(0.5, rel=0.01)


class WindingUp(Servo):
    """The same control with a plain integral, as a servo without anti-windup has it."""

    def control(self, q_target: Any, *others: Any) -> np.ndarray:
        (state,), (joint,) = self.state, self._joint
        before = state["integral"]
        error = q_target[0] / joint["ratio"] - state["theta"]
        limit = joint["omega_limit"]
        omega_ref = max(-limit, min(limit, joint["position_gain"] * error))
        voltage = super().control(q_target, *others)
        gain = joint["reset_rate"] * joint["velocity_gain"]
        state["integral"] = before + gain * (omega_ref - state["omega"])
        return voltage

    def update(self, counts: Any, current: Any, q_target: Any, **given: Any) -> np.ndarray:
        self.observe(counts, current, given["applied"])
        return self.control(q_target)


def test_anti_windup_recovers_from_saturation() -> None:
    """0.2 rad at once with a tenth of the current: saturated for most of the way.

    Position control of 10 1/s slows down by at most 2 rad/s per 0.2 s, which 2 A can do; so a servo
    whose integral does not wind up need not overshoot at all.
    """
    weak = dataclasses.replace(JOINT, current_limit=2.0, position_gain=10.0)
    step, overshoot = 0.2, {}
    for kind in (Servo, WindingUp):
        servo = kind(servo_of(weak).config)
        rows = run(servo, Drivetrain(weak), step, 3000)
        overshoot[kind] = rows[:, 0].max() / step - 1.0
        assert rows[:, 3].max() > 2.0  # it was saturated
    assert overshoot[Servo] < JOINT.count_angle / step  # a count
    assert overshoot[WindingUp] > 0.2


# Measuring


def test_q_measured_is_the_middle_of_the_count() -> None:
    servo = servo_of()
    servo.observe([-3], [0.0])
    assert servo.q_measured[0] == (-3 + 0.5) * (2 * math.pi / 1024) * 0.01


def test_speed_is_unbiased_at_constant_acceleration() -> None:
    """A tracker of third order has no lag there, whatever torque loads the motor."""
    fine = dataclasses.replace(JOINT, counts_per_turn=2**40)
    servo, acceleration = servo_of(fine), 2.0
    for tick in range(400):
        t = tick * PERIOD
        count = 0.5 * acceleration * t * t / fine.count_angle - 0.5
        servo.observe([round(count)], [1.7])
    # Poles at exp(-0.3) per period: the start has decayed by exp(-120) after 400 periods.
    assert servo.v_measured[0] == pytest.approx(acceleration * t, abs=1e-6)


def test_speed_is_far_smoother_than_counts_per_period() -> None:
    """A plain difference errs by up to a whole count per period, 0.06 rad/s at the link."""
    servo, speed, errors = servo_of(), 0.1234, []
    for tick in range(2000):
        servo.observe([math.floor(speed * tick * PERIOD / JOINT.count_angle)], [0.0])
        errors.append(servo.v_measured[0] - speed)
    plain = JOINT.count_angle / PERIOD
    assert np.sqrt(np.mean(np.square(errors[200:]))) < 0.1 * plain


def test_observer_starts_where_the_motor_stands_and_knows_nothing_before() -> None:
    servo = servo_of()
    assert np.isnan(servo.q_measured).all()
    with pytest.raises(Refusal, match="control must follow a measurement"):
        servo.control([0.0])
    servo.observe([123456], [0.0])
    assert servo.v_measured[0] == 0.0


def test_same_inputs_give_the_same_bits_and_reset_forgets() -> None:
    servo = servo_of()
    first = run(servo, Drivetrain(JOINT), 0.01, 300)
    servo.reset()
    assert np.array_equal(first, run(servo, Drivetrain(JOINT), 0.01, 300))


def test_after_a_cut_control_starts_without_the_old_integral() -> None:
    servo = servo_of()
    run(servo, Drivetrain(JOINT, load=-20.0), 0.0, 1000)
    assert servo.state["integral"][0] == pytest.approx(20.0 * 0.01 / 0.05, rel=0.05)
    servo.release()
    assert servo.state["integral"][0] == 0.0


# Refusals


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([1, 2], [0.0], [0.0]), "counts must have 1 values"),
        (([1], 0.0, [0.0]), "current must have 1 values"),
        (([1], [math.nan], [0.0]), "current must be numbers within"),
        (([1], [0.0], [math.inf]), "q_target must be numbers within"),
        (([1], [0.0], [0.0], [math.nan]), "v_target must be numbers within"),
        (([1], [0.0], [0.0], None, [0.0, 1.0]), "tau_feedforward must have 1 values"),
    ],
)
def test_bad_input_is_refused_and_changes_nothing(arguments: tuple[Any, ...], words: str) -> None:
    servo, twin = servo_of(), servo_of()
    for one in (servo, twin):
        one.update([5], [0.1], [0.01])
    with pytest.raises(Refusal, match=words):
        servo.update(*arguments)
    assert servo.update([6], [0.2], [0.01]) == twin.update([6], [0.2], [0.01])


def parameters() -> dict[str, Any]:
    """The parameters of a servo with one joint."""
    joint = dataclasses.asdict(JOINT)
    name = joint.pop("name")
    return {
        "period": 1e-3,
        "motion_period": 0.05,
        "hold_after": 0.2,
        "cut_after": 2.0,
        "supply_voltage": 48.0,
        "joint_names": [name],
        "joints": {name: joint},
    }


def test_parameters_may_be_nested_or_dotted_and_bring_ros_parameters() -> None:
    nested = parameters()
    dotted = {k: v for k, v in nested.items() if k != "joints"}
    dotted |= {f"joints.joint.{k}": v for k, v in nested["joints"]["joint"].items()}
    dotted |= {"use_sim_time": False, "qos_overrides./clock.subscription.depth": 1}
    expected = ServoConfig(1e-3, 0.05, 0.2, 2.0, 48.0, (JOINT,))
    assert ServoConfig.from_mapping(nested, "test") == expected
    assert ServoConfig.from_mapping(dotted, "test") == expected


def test_inductance_and_current_limit_may_be_left_out() -> None:
    mapping = parameters()
    del mapping["joints"]["joint"]["inductance"], mapping["joints"]["joint"]["current_limit"]
    (joint,) = ServoConfig.from_mapping(mapping, "test").joints
    assert joint.inductance == 0.0
    assert joint.current_limit == math.inf


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("period", 0.0, "period must be a number > 0 s, got 0.0"),
        ("period", "fast", "period must be a number > 0 s, got 'fast'"),
        ("period", True, "period must be a number > 0 s, got True"),
        ("period", math.nan, "period must be a number > 0 s, got nan"),
        ("period", None, "period must be given"),
        ("motion_period", -0.05, "motion_period must be a number >= 0 s"),
        ("motion_period", 0.0505, "motion_period must be a whole multiple of period"),
        ("hold_after", 0.0, "hold_after must be a number > 0 s"),
        ("cut_after", 0.2, "cut_after must be > hold_after"),
        ("supply_voltage", math.inf, "supply_voltage must be a number from 1e-15 to 1e+15 V"),
        ("gravity", 9.81, "gravity must be a known key, got an unknown one; valid: period"),
        ("joint_names", [], "joint_names must be a list of different joint names"),
        ("joint_names", ["joint", "joint"], "joint_names must be a list of different joint"),
        ("joint_names", ["other"], "joints.joint must be a known key"),
        ("joint_names", ["joint", "more"], "joints.more must be given"),
        ("joints", 3, "joints must be a mapping"),
        ("joints.joint", 3, "joints.joint must be a mapping"),
        (
            "joints.joint.gear_ratio",
            0,
            "joints.joint.gear_ratio must be a number other than 0, got 0",
        ),
        ("joints.joint.counts_per_turn", 10.5, "counts_per_turn must be a whole number >= 1"),
        ("joints.joint.counts_per_turn", 0, "counts_per_turn must be a whole number >= 1"),
        ("joints.joint.resistance", -1.0, "resistance must be a number >= 0 ohm"),
        ("joints.joint.inductance", -1e-3, "inductance must be a number >= 0 H"),
        ("joints.joint.torque_constant", None, "joints.joint.torque_constant must be given"),
        ("joints.joint.current_limit", 0.0, "current_limit must be a number > 0 A"),
        ("joints.joint.stiffness", 1e4, "joints.joint.stiffness must be a known key"),
        ("joints.joint.observer_bandwidth", 2000.0, "observer_bandwidth must be <= 1/period"),
        ("joints.joint.position_gain", 2000.0, "position_gain must be <= 1/period"),
        ("joints.joint.integral_time", 1e-4, "integral_time must be >= period"),
    ],
)
def test_bad_parameters_are_refused(path: str, value: object, words: str) -> None:
    mapping = parameters()
    *parents, leaf = path.split(".")
    table = mapping
    for parent in parents:
        table = table[parent]
    if value is None:
        del table[leaf]
    else:
        table[leaf] = value
    with pytest.raises(Refusal) as refusal:
        ServoConfig.from_mapping(mapping, "servo.yaml")
    assert words in str(refusal.value)
    assert str(refusal.value).startswith("servo.yaml: ")
    assert "\n" not in str(refusal.value)


def test_parameters_that_are_no_mapping_or_given_twice_are_refused() -> None:
    with pytest.raises(Refusal, match="the parameters must be a mapping"):
        ServoConfig.from_mapping([1], "test")  # type: ignore[arg-type]
    with pytest.raises(Refusal, match=r"period\.x must be given once"):
        ServoConfig.from_mapping({"period": 1e-3, "period.x": 2.0}, "test")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "servo.yaml must exist, got no such file"),
        ("a: [", "file must be well-formed YAML"),
        ("other: {ros__parameters: {}}", "hold the parameters of the node servo, got other"),
        ("- 1", "file must be a mapping of keys to values"),
        ("servo: 1", "hold the parameters of the node servo, got servo; valid: servo: ros__para"),
    ],
)
def test_bad_parameter_files_are_refused(tmp_path: Path, text: str | None, words: str) -> None:
    file = tmp_path / "servo.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(Refusal, match=words):
        load_servo_config(file)


def test_parameter_file_may_write_numbers_as_ros_takes_them(tmp_path: Path) -> None:
    """PyYAML alone reads 1e-3 as a text; ROS reads a number."""
    file = tmp_path / "servo.yaml"
    text = yaml.safe_dump({"/**": {"ros__parameters": parameters()}})
    file.write_text(text.replace("period: 0.001", "period: 1e-3"))
    assert load_servo_config(file).period == 1e-3


@pytest.mark.parametrize("node", ["servo", "/servo", "/**/servo", "/**"])
def test_parameter_files_may_name_the_node_or_all_nodes(tmp_path: Path, node: str) -> None:
    file = tmp_path / "servo.yaml"
    file.write_text(yaml.safe_dump({node: {"ros__parameters": parameters()}}))
    assert load_servo_config(file).joint_names == tuple(parameters()["joint_names"])
    motion = tmp_path / "motion.yaml"
    name = node.replace("servo", "motion_controller")
    motion.write_text(yaml.safe_dump({name: {"ros__parameters": {"weight": 0.25}}}))
    assert load_motion_config(motion).weight == 0.25


# The shipped files


@pytest.mark.parametrize("scene", ["three_axis", "ur5", "panda"])
def test_drives_know_the_motors_of_their_scene(scene: str) -> None:
    config = load_servo_config(CONFIG / "servo" / f"{scene}.yaml")
    machine = yaml.safe_load((CONFIG / f"{scene}.yaml").read_text())
    assert config.joint_names == tuple(machine["joints"])
    assert config.period == machine["servo_period"]
    assert config.supply_voltage == machine["supply_voltage"]
    for joint in config.joints:
        section = machine["joints"][joint.name]
        assert joint.gear_ratio == section["gear"]["ratio"]
        assert joint.counts_per_turn == section["encoder"]["counts_per_turn"]
        for name, value in section["motor"].items():
            if name == "current_loop":
                assert joint.current_bandwidth == value["bandwidth"]
            elif name not in ("current_limit", "friction"):
                assert getattr(joint, name) == float(value)


# Watchdog


def test_watchdog_holds_until_the_first_target_however_long() -> None:
    dog = Watchdog(0.2, 2.0)
    for now in (0.0, 1.0, 100.0):
        dog.state_came(now)
        assert dog.check(now) is WatchdogState.HOLD
    assert dog.reason == "no joint target has come yet"


@pytest.mark.parametrize("silent", ["joint target", "motor state"])
def test_watchdog_holds_then_cuts_when_either_falls_silent(silent: str) -> None:
    dog = Watchdog(0.25, 2.0)
    dog.state_came(10.0)
    dog.target_came(10.0)
    assert dog.check(10.25) is WatchdogState.OK
    for now in (11.0, 12.0, 12.25):
        (dog.state_came if silent == "joint target" else dog.target_came)(now)
        expected = WatchdogState.HOLD if now <= 12.0 else WatchdogState.CUT
        assert dog.check(now) is expected
        assert dog.reason.startswith(f"no {silent} for ")
        assert ("hold_after" in dog.reason) is (expected is WatchdogState.HOLD)


def test_watchdog_hold_ends_with_new_input_but_a_cut_only_with_a_reset() -> None:
    dog = Watchdog(0.2, 2.0)

    def both_came(now: float) -> WatchdogState:
        dog.target_came(now)
        dog.state_came(now)
        return dog.check(now)

    assert both_came(0.0) is WatchdogState.OK
    assert dog.check(1.0) is WatchdogState.HOLD
    assert both_came(1.0) is WatchdogState.OK
    assert dog.check(3.5) is WatchdogState.CUT
    assert both_came(3.5) is WatchdogState.CUT
    assert dog.reason.endswith("the power stays off until a reset")
    dog.reset()
    assert dog.check(3.6) is WatchdogState.HOLD
    assert both_came(3.6) is WatchdogState.OK


def test_watchdog_takes_a_clock_that_jumps_back() -> None:
    dog = Watchdog(0.2, 2.0)
    dog.target_came(50.0)
    dog.state_came(50.0)
    assert dog.check(0.0) is WatchdogState.OK
    assert dog.check(0.3) is WatchdogState.HOLD


@pytest.mark.parametrize(
    ("hold_after", "cut_after"), [(0.0, 1.0), (math.nan, 1.0), (0.2, 0.2), (0.2, math.nan)]
)
def test_watchdog_refuses_times_out_of_order(hold_after: float, cut_after: float) -> None:
    with pytest.raises(Refusal, match="watchdog: "):
        Watchdog(hold_after, cut_after)


def test_a_word_that_wraps_is_followed_as_counts_that_go_on() -> None:
    """Of any length, from any word on, by steps of less than half a word, also after a reset."""
    rng = np.random.default_rng(21)
    plain = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    N = len(plain.joints)
    for bits in (10, 13, 24, 48):
        joints = tuple(dataclasses.replace(joint, encoder_bits=bits) for joint in plain.joints)
        word = 2**bits
        going_on, wrapping = Servo(plain), Servo(dataclasses.replace(plain, joints=joints))
        largest = min(word // 2 - 1, 10**6)  # counts of a step
        counts = rng.integers(-largest, largest, N)  # nearer to 0 than half a word
        for k in range(300):
            if k == 200:  # where it stands is known up to whole words
                going_on.reset()
                wrapping.reset()
                counts = (counts + word // 2) % word - word // 2
            current, target = rng.normal(0.0, 1.0, N), rng.normal(0.0, 1.0, N)
            expected = going_on.update(counts, current, target)
            wrapped = wrapping.update(counts % word, current, target)
            np.testing.assert_array_equal(wrapped, expected, f"{bits} bits, period {k}")
            counts = counts + rng.integers(-largest, largest, N)


def test_an_impossible_word_is_refused_and_changes_nothing() -> None:
    plain = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    joints = tuple(dataclasses.replace(joint, encoder_bits=10) for joint in plain.joints)
    servo, other = (Servo(dataclasses.replace(plain, joints=joints)) for _ in range(2))
    zero = np.zeros(3)
    for one in (servo, other):
        one.update([1023, 0, 5], zero, zero)
    with pytest.raises(Refusal, match="counts must be numbers within"):
        servo.update([0, 1024, 0], zero, zero)
    voltages = [one.update([2, 1022, 7], zero, zero) for one in (servo, other)]
    np.testing.assert_array_equal(*voltages)

"""Loops of machine and servo: their linear form is what runs, and what is called stable is."""

import dataclasses
import math

import numpy as np
import pytest
import scipy.linalg
from draws import some

from arm_emulator import Refusal, Servo, Session, load_gains, load_scene
from arm_emulator.analysis.linear_servo import INPUTS, STATES, LinearServo
from arm_emulator.analysis.sampled_loop import Margins, SampledLoop
from arm_emulator.base.io.config_files import find_config
from arm_emulator.design.joint_gains import (
    GearData,
    MotorData,
    ServoGains,
    compute_gains,
    make_joint_model,
    make_joint_servo,
)
from arm_emulator.servo.servo import ServoConfig
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.servo.servo_config import JointServo
from arm_emulator.servo.zoh_motor import compute_zoh_motor, discretise_zoh

Rng = np.random.Generator

FINE = 2**40  # counts per turn: no steps that matter


def log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


@dataclasses.dataclass(frozen=True)
class Axis:
    """One joint, drawn."""

    motor: MotorData
    gear: GearData
    inertia: tuple[float, float]
    period: float


def draw_axis(
    rng: Rng,
    speed: tuple[float, float] = (0.01, 30.0),
    rigid: bool | None = None,
    counts: int | None = None,
) -> Axis:
    """Return a joint from the size of a small SCARA to that of a heavy arm.

    `speed` bounds the servo period in time constants of the motor, R Mm / (Kt Kb).
    """
    period = log_uniform(rng, 2.5e-4, 4e-3)
    mean, ratio_of_poses = log_uniform(rng, 1e-3, 300.0), log_uniform(rng, 1.0, 5.0)
    ratio = log_uniform(rng, 5e-3, 0.2)
    rotor = mean * log_uniform(rng, 0.1, 10.0) * ratio**2
    x = log_uniform(rng, *speed)
    y = 0.0 if rng.random() < 0.3 else min(log_uniform(rng, 0.03, 2.0), 0.2 / x)
    Kt = log_uniform(rng, 0.01, 1.0)
    R = Kt * Kt * period / (x * rotor)
    stiffness, damping = None, 0.0
    if rng.random() > 0.25 if rigid is None else not rigid:
        frequency = 2.0 * math.pi * log_uniform(rng, 4.0, 50.0)  # of the heaviest, rotor held
        stiffness = mean * ratio_of_poses * frequency**2
        damping = 2.0 * log_uniform(rng, 0.01, 0.1) * math.sqrt(stiffness * mean)
    return Axis(
        MotorData(R, y * R * period, Kt, Kt, rotor, counts),
        GearData(ratio, stiffness, damping),
        (mean / ratio_of_poses, mean * ratio_of_poses),
        period,
    )


# The motor over a period


@pytest.mark.parametrize("seed", range(16))
def test_a_motor_over_a_period_is_the_matrix_exponential(seed: int) -> None:
    """For any ratio of the period to both time constants."""
    rng = np.random.default_rng([seed, 1])
    x, y = log_uniform(rng, 1e-3, 100.0), log_uniform(rng, 0.01, 10.0)
    if seed % 4 == 0:
        y = 0.0
    period, R, Kt, Mm = (log_uniform(rng, 1e-4, 1.0) for _ in range(4))
    Kb, L = x * R * Mm / (Kt * period), y * R * period
    motor = compute_zoh_motor(R, L, Kt, Kb, Mm, period)
    i, omega, V, load = rng.normal(size=4)
    if L:
        A = np.array([[-R / L, -Kb / L, 0.0], [Kt / Mm, 0.0, 0.0], [0.0, 1.0, 0.0]])
        by_hand = [[1.0 / L, 0.0], [0.0, -1.0 / Mm], [0.0, 0.0]]
        start = np.array([i, omega, 0.0])
    else:
        A = np.array([[-Kt * Kb / R / Mm, 0.0], [1.0, 0.0]])
        by_hand = [[Kt / R / Mm, -1.0 / Mm], [0.0, 0.0]]
        start = np.array([omega, 0.0])
    block = np.zeros((len(A) + 2, len(A) + 2))
    block[: len(A)] = np.hstack([A, by_hand])
    after = scipy.linalg.expm(block * period) @ [*start, V, load]
    expected = after[:3] if L else [(V - Kb * after[0]) / R, after[0], after[1]]
    sums = (motor.current, motor.speed, motor.turn)
    for name, coefficients, value in zip(("current", "speed", "turn"), sums, expected, strict=True):
        # Large terms may cancel, and either exponential loses digits if L R and Mm are far apart.
        terms = np.abs(np.array(coefficients) * [i, omega, V, load]).sum()
        result = float(np.dot(coefficients, [i, omega, V, load]))
        assert result == pytest.approx(value, abs=1e-6 * terms), f"{name} at x = {x:g}, y = {y:g}"


@pytest.mark.parametrize("seed", range(5))
def test_zoh_is_the_matrix_exponential(seed: int) -> None:
    rng = np.random.default_rng([seed, 2])
    n, m = rng.integers(1, 8, size=2)
    A = rng.normal(size=(n, n)) * log_uniform(rng, 1e-3, 30.0)
    B = rng.normal(size=(n, m))
    F, G = discretise_zoh(A, B, 0.7)
    block = scipy.linalg.expm(0.7 * np.block([[A, B], [np.zeros((m, n + m))]]))
    scale = np.abs(block).max()
    assert np.abs(np.hstack([F, G]) - block[:n]).max() < 1e-11 * scale, "against scipy's expm"


# The servo as a linear system


@pytest.mark.parametrize("seed", range(5))
def test_the_linear_servo_is_the_servo_that_runs(seed: int) -> None:
    """Two runs of the servo differ by what its matrices state; counts too fine to matter."""
    rng = np.random.default_rng([seed, 3])
    axis = draw_axis(rng)
    gains = ServoGains(0.05 / axis.period, 1.0, 20 * axis.period, 0.3 / axis.period)
    motor = dataclasses.replace(axis.motor, counts_per_turn=FINE)
    joint = dataclasses.replace(make_joint_servo(motor, axis.gear, gains), velocity_limit=1e300)
    linear = LinearServo(joint, axis.period)
    pair = [Servo(ServoConfig(axis.period, 0.0, 1.0, 2.0, 1e300, (joint,))) for _ in range(2)]
    x, V = np.zeros(len(STATES)), 0.0
    size = {"theta": 1e-3, "current": 1.0, "applied": 1.0, "target": 1e-3 * axis.gear.ratio}
    for tick in range(50):
        first, second = rng.normal(size=(2, len(INPUTS))) * [
            size.get(name, axis.gear.ratio) for name in INPUTS
        ]
        if tick == 0:  # begins with the motor at rest, its load held
            first, second = np.zeros((2, len(INPUTS)))
        count = 2.0 * math.pi / FINE
        voltages = []
        for servo, row in zip(pair, (first, second), strict=True):
            theta, current, voltage, *targets = row
            counts = math.floor(theta / count)
            q, v, tau = ([value] for value in targets)
            voltages.append(servo.update([counts], [current], q, v, tau, [voltage])[0])
        u = first - second
        if tick > 0:
            V = float(linear.C @ x + linear.D @ u)
            x = linear.A @ x + linear.B @ u
            terms = (
                np.abs(linear.C * x).sum() + np.abs(linear.D * (np.abs(first) + abs(second))).sum()
            )
            difference = voltages[0] - voltages[1]
            # Both voltages are rounded, and a count of 6e-12 rad is left.
            assert difference == pytest.approx(V, abs=1e-6 * terms), f"voltages at tick {tick}"


# Motors of every speed, by the real servo and exact machines


def run_axis(
    axis: Axis, joint: JointServo, inertia: float, target: float, ticks: int, supply: float = 1e9
) -> np.ndarray:
    """Return link positions of the exact machine under the real servo, at rest at 0 at first."""
    plant = make_joint_model(axis.motor, axis.gear, inertia, 0.0, axis.period)
    servo = Servo(ServoConfig(axis.period, 0.0, 1.0, 2.0, supply, (joint,)))
    x, V, count, q = np.zeros(len(plant.F)), 0.0, 2.0 * math.pi / joint.counts_per_turn, []
    for _ in range(ticks):
        current = plant.current[0] @ x + plant.current_by_command[0] * V
        counts = math.floor(plant.theta[0] @ x / count)
        V = float(servo.update([counts], [current], [target])[0])
        x = plant.F @ x + plant.G[:, 0] * V
        q.append(plant.q[0] @ x)
    return np.array(q)


@pytest.mark.parametrize("seed", some(range(4), 2))
def test_motors_of_any_speed_follow_with_designed_gains(seed: int) -> None:
    """The period is a hundredth to thirty times the motor's time constant.

    With an emf compensation by the speed of the period before, a motor whose time constant is the
    period or less swings, or runs away.
    """
    rng = np.random.default_rng([seed, 4])
    axis = draw_axis(rng)
    gains = compute_gains(axis.motor, axis.gear, axis.inertia, axis.period)
    joint = make_joint_servo(
        dataclasses.replace(axis.motor, counts_per_turn=FINE), axis.gear, gains
    )
    swing = (
        0.0
        if axis.gear.stiffness is None
        else 2.0 * math.pi * math.sqrt(axis.inertia[1] / axis.gear.stiffness)
    )
    ticks = round(max(12.0 / gains.position_gain, 20.0 * swing) / axis.period)
    for inertia in axis.inertia:
        q = run_axis(axis, joint, inertia, 1e-3, ticks)
        over = q.max() / 1e-3 - 1.0
        assert over < 1.0, f"link overshoots by {over:.2f} with {inertia:g} kg m2"
        off = abs(q[-1] / 1e-3 - 1.0)
        assert off < 0.03, f"link is off by {off:.3f} of its step after {ticks} periods"


@pytest.mark.parametrize("seed", some(range(5), 3))
def test_designed_gains_have_the_margins_that_are_promised(seed: int) -> None:
    """Motors up to as fast as the period: sensitivity and overshoot, with a period of dead time."""
    rng = np.random.default_rng([seed, 5])
    axis = draw_axis(rng, speed=(0.01, 1.0))
    gains = compute_gains(axis.motor, axis.gear, axis.inertia, axis.period)
    servo = LinearServo(make_joint_servo(axis.motor, axis.gear, gains), axis.period)
    for inertia in (*axis.inertia, math.sqrt(math.prod(axis.inertia))):
        plant = make_joint_model(axis.motor, axis.gear, inertia, 0.0, axis.period)
        for delay in (0, 1):
            loop = SampledLoop(plant, [servo], delay)
            assert loop.is_stable, f"grows by {loop.radius} with {inertia:g} kg m2"
            margins = loop.compute_margins()[0]
            # docs/how_to/gains.md promises 2 and 10 %. The design looks at fewer frequencies.
            assert margins.sensitivity < 1.1 * 2.0, f"{margins}"
            rows = loop.compute_step_response(
                0, 1000, max(1, round(0.02 / gains.position_gain / axis.period))
            )
            assert rows.max() < 1.0 + 0.1 + 0.05, "overshoot of the link"


@pytest.mark.parametrize("seed", some(range(4), 2))
def test_large_steps_at_the_limits_come_to_rest(seed: int) -> None:
    """The size of ur5's large joints, speed and current at their limits on the way.

    While the rotor swings on its gear the observed speed lags. The few volts of error of the back
    EMF then cause many amperes in the winding. If the limit holds only for the requested current,
    the true current reaches ten times the limit, and the swing never ends.
    """
    rng = np.random.default_rng([seed, 9])
    motor = MotorData(0.3, 4e-4, 0.125, 0.125, 1e-4, FINE)
    gear = GearData(1.0 / 101.0, 31000.0, 15.0)
    gains = ServoGains(
        rng.uniform(20.0, 28.0), rng.uniform(320.0, 440.0), 0.15, rng.uniform(300.0, 500.0)
    )
    joint = dataclasses.replace(
        make_joint_servo(motor, gear, gains), current_limit=11.9, velocity_limit=3.15
    )
    axis = Axis(motor, gear, (1.0, 4.2), 1e-3)
    inertia = rng.uniform(3.0, 4.2)
    for step in (0.1, 0.5, 1.5):
        q = run_axis(axis, joint, inertia, step, 4000, supply=48.0)
        swing = float(np.ptp(q[-500:]))
        assert swing < 1e-3, f"a step of {step} rad: the link still swings by {swing:.2g} rad"
        assert abs(q[-1] - step) < 2e-3, f"a step of {step} rad ends at {q[-1]:.4f}"


def test_a_motor_that_no_gains_hold_is_refused_with_a_period() -> None:
    """A winding and a rotor that swing together, thirty times in a period."""
    motor = MotorData(0.01, 1e-3, 1.0, 1.0, 1e-7)
    with pytest.raises(Refusal, match=r"short enough for motor and gear, got 0\.01 s; valid: "):
        compute_gains(motor, GearData(0.01), (1.0, 1.0), 0.01)
    gains = ServoGains(1.0, 1.0, 1.0, 1.0)
    with pytest.raises(Refusal, match=r"do not swing together faster .*; valid: a period of "):
        joint = make_joint_servo(motor, GearData(0.01), gains)
        Servo(ServoConfig(0.01, 0.0, 1.0, 2.0, 48.0, (joint,)))


# Margins


@pytest.mark.parametrize("seed", some(range(4), 2))
def test_margins_are_where_the_loop_becomes_unstable(seed: int) -> None:
    """By closing the loop with the voltage scaled, and with dead time."""
    rng = np.random.default_rng([seed, 6])
    axis = draw_axis(rng, speed=(0.01, 3.0))
    gains = compute_gains(axis.motor, axis.gear, axis.inertia, axis.period)
    gains = dataclasses.replace(gains, velocity_gain=gains.velocity_gain * rng.uniform(0.7, 1.5))
    servo = LinearServo(make_joint_servo(axis.motor, axis.gear, gains), axis.period)
    plant = make_joint_model(axis.motor, axis.gear, axis.inertia[1], 0.0, axis.period)

    def stable(factor: float, delay: int = 0) -> bool:
        scaled = LinearServo(make_joint_servo(axis.motor, axis.gear, gains), axis.period)
        scaled.C, scaled.D = servo.C * factor, servo.D * factor
        return SampledLoop(plant, [scaled], delay).is_stable

    loop = SampledLoop(plant, [servo])
    margins: Margins = loop.compute_margins()[0]
    assert loop.is_stable
    if margins.gain_up < 1e3:
        # The observer receives the voltage that was applied, as by a drive whose gain is off.
        assert stable(0.97 * margins.gain_up), f"below the gain margin {margins.gain_up:g}"
        assert not stable(1.03 * margins.gain_up), f"beyond the gain margin {margins.gain_up:g}"
    periods = math.floor(min(margins.delay, 30.0) - 0.05)
    assert stable(1.0, periods), f"{periods} periods of dead time, margin {margins.delay:g}"
    if margins.delay < 29.0:
        assert not stable(1.0, math.ceil(margins.delay + 0.05)), f"margin {margins.delay:g}"


# Encoders


@pytest.mark.parametrize("counts", some([64, 16, 1024], 1))
@pytest.mark.parametrize("seed", range(1))
def test_a_link_rests_within_counts(seed: int, counts: int) -> None:
    """A whole arm in gravity; ur5's gears and limits."""
    rng = np.random.default_rng([seed, 10])
    scene = load_scene("ur5")  # as others compile it: the coarse encoders are read off its motors
    servo = load_gains(find_config("ur5", ".yaml")).servo
    joints = tuple(dataclasses.replace(joint, counts_per_turn=counts) for joint in servo.joints)
    servo = dataclasses.replace(servo, joints=joints)
    session, drives = Session(scene, "lockstep", "first_answer"), ServoArm(servo)
    target, rows, ticks = scene.start + rng.uniform(-0.01, 0.01, 6), [], 5000
    for tick in range(ticks):
        measured, theta_m = session.measured, session.state.theta_m
        read = np.floor(theta_m * counts / (2.0 * np.pi)).astype(np.int64)
        drives.take_measurement(session.logical_ns, read, measured.current, measured.applied)
        drives.set_target(Target(target))
        session.offer(tick, scene.joint_names, drives.compute_commands(powered=True).tolist())
        session.advance()
        if tick >= ticks - 2000:
            rows.append(session.state.q)
    counts_swung = np.ptp(np.array(rows), axis=0) / [joint.count_angle for joint in servo.joints]
    for j in range(3):  # the large joints; the wrists are moved by them
        assert counts_swung[j] < 1.5, f"{scene.joint_names[j]}: {counts_swung[j]:.2f} counts"

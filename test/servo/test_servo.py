"""The servo against motors integrated exactly, and everything that it refuses."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from one_motor import CONFIG, JOINT, PERIOD, Drivetrain

from arm_emulator.base.refusal import Refusal
from arm_emulator.servo.servo import JointServo, Servo, ServoConfig, load_servo_config


def servo_of(joint: JointServo = JOINT, supply_voltage: float = 48.0) -> Servo:
    return Servo(ServoConfig(PERIOD, 0.05, 0.2, 2.0, supply_voltage, (joint,)))


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


def test_feed_forward_of_the_rest_load_leaves_no_sag() -> None:
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


def test_the_servo_observes_by_the_voltage_that_was_applied() -> None:
    """A late drive applies another voltage than the servo commanded.

    A fast motor's speed follows from its voltage. A servo that receives the applied voltage
    observes the speed as well as before; a servo that does not is off.
    """
    fast = dataclasses.replace(JOINT, rotor_inertia=1e-6, inductance=0.0, counts_per_turn=2**20)
    rng = np.random.default_rng(0)
    error = {}
    for reported in (True, False):
        servo, machine = servo_of(fast), Drivetrain(fast, stiffness=1.0, damping=0.0)
        applied, off = 0.0, []
        for tick in range(400):
            voltages = {"applied": [applied]} if reported else {}
            servo.observe([machine.counts], [machine.x[0]], **voltages)
            servo.control([0.0])
            applied = float(rng.uniform(-1.0, 1.0))
            if tick > 50:
                off.append(servo.v_measured[0] - machine.x[2] * machine.Ng)
            machine.advance(applied)
        error[reported] = float(np.sqrt(np.mean(np.square(off))))
    assert error[True] < 0.1 * error[False], f"rms error of the speed, reported or not: {error}"


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


def test_anti_windup_recovers_from_saturation() -> None:
    """0.2 rad at once with a tenth of the current: saturated for most of the way.

    Position control of 10 1/s slows down by at most 2 rad/s per 0.2 s, which 2 A can do; so a servo
    whose integral does not wind up need not overshoot at all.
    """
    weak = dataclasses.replace(JOINT, current_limit=2.0, position_gain=10.0)
    rows = run(servo_of(weak), Drivetrain(weak), 0.2, 3000)
    assert rows[:, 3].max() > 2.0, "it was saturated"
    assert rows[:, 0].max() < 0.2 + JOINT.count_angle


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
    servo, twin = (Servo(dataclasses.replace(plain, joints=joints)) for _ in range(2))
    zero = np.zeros(3)
    for either in (servo, twin):
        either.update([1023, 0, 5], zero, zero)
    with pytest.raises(Refusal, match="counts must be numbers within"):
        servo.update([0, 1024, 0], zero, zero)
    voltages = [either.update([2, 1022, 7], zero, zero) for either in (servo, twin)]
    np.testing.assert_array_equal(*voltages)

"""Targets of the servo between two motion periods: their speed, their ramps."""

import dataclasses
import math

import numpy as np
import pytest
from one_motor import JOINT, PERIOD, Drivetrain

from arm_emulator.base.validation.bound import POSITION, VELOCITY
from arm_emulator.servo.servo import Servo, ServoConfig
from arm_emulator.servo.servo_arm import ServoArm, Target


@pytest.mark.parametrize("seed", range(5))
def test_targets_go_on_with_their_speed_for_no_longer_than_a_motion_period(seed: int) -> None:
    """Targets of the control law in every tick, against q + v (t - t_target)."""
    rng = np.random.default_rng(seed)
    motion_period = float(rng.choice([0.0, 0.01, 0.05]))
    config = ServoConfig(PERIOD, motion_period, 0.3, 2.0, 48.0, (JOINT,))
    drives, twin = ServoArm(config), Servo(config)
    q, v, at = 0.0, 0.0, 0
    for tick in range(200):
        count, current = int(rng.integers(-3, 4)), float(rng.normal())
        drives.take_measurement(tick * 1_000_000, [count], [current])
        twin.observe([count], [current])
        if tick == 0 or rng.random() < 0.03:
            q, v, at = float(rng.normal(0.0, 0.01)), float(rng.normal(0.0, 0.1)), tick
            moving = rng.random() < 0.8
            v = v if moving else 0.0
            drives.set_target(Target(np.array([q]), np.array([v]) if moving else None))
        ahead = min((tick - at) / 1000, motion_period)
        expected = twin.control([q + v * ahead], [v])
        assert drives.compute_commands(powered=True) == expected, f"voltage of tick {tick}"


def test_targets_that_go_on_stay_within_the_limits_of_a_joint() -> None:
    """At the bound of positions, outwards: no refusal within the loop, which no caller would
    catch."""
    largest = POSITION.most
    drives = ServoArm(ServoConfig(PERIOD, 0.05, 0.2, 2.0, 48.0, (JOINT,)))
    drives.take_measurement(0, [0], [0.0])
    drives.set_target(Target(np.array([-largest]), np.array([-VELOCITY.most])))
    for tick in range(60):
        drives.take_measurement(tick * 1_000_000, [0], [0.0])
        assert np.isfinite(drives.compute_commands(powered=True)).all()


def test_a_smooth_motion_does_not_excite_a_gear_that_resonates_at_the_rate_of_the_targets() -> None:
    """Targets come 100 times a second, and the link resonates at 100 Hz, damped to 2 %.

    From 0.3 s on, when the step at the start has died away: 0.06 rad/s2 beside 5.4 rad/s2 of the
    motion, and 0.36 rad/s2 with accelerations and torques that step with every target.
    """
    joint, inertia, T = dataclasses.replace(JOINT, counts_per_turn=2**16), 0.4, 0.01
    stiffness = inertia * (2.0 * math.pi / T) ** 2
    damping = 0.04 * math.sqrt(stiffness * inertia)
    machine = Drivetrain(joint, inertia, stiffness, damping)
    drives = ServoArm(ServoConfig(PERIOD, T, 0.2, 2.0, 48.0, (joint,)))
    turn, rate, applied, v = 0.3, 6.0, np.zeros(1), [0.0]
    t = np.arange(-100, 1000) * PERIOD
    q = 0.5 * turn * (1.0 - np.cos(rate * np.maximum(t, 0.0)))
    a = 0.5 * turn * rate**2 * np.cos(rate * t) * (t > 0.0)
    for k in range(len(t) - 10):
        drives.take_measurement(k * 1_000_000, [machine.counts], [machine.x[0]], applied)
        if k % 10 == 0:
            mean = (q[k + 10] - q[k]) / T
            tau = 0.5 * inertia * (a[k] + a[k + 10]) + 0.5 * mean
            drives.set_target(Target(q[[k]], np.array([mean]), np.array([tau])))
        applied = drives.compute_commands(True)
        machine.advance(applied[0])
        v.append(float(machine.x[4]))
    beside = np.diff(v[::5])[80:] / (5 * PERIOD) - a[402:-8:5][: len(v[::5]) - 81]
    assert np.abs(beside).max() < 0.12


def test_speeds_in_steps_are_not_applied_to_the_rotor_twice() -> None:
    """Speeds of a controller that knows no accelerations: 1 rad/s from one target to the next.

    The acceleration of that step, 100 rad/s2, is asked for once: at most 1.8 times for a moment,
    and at most 0.4 times backwards a period later (2 times and once with all of the change).
    """
    T = 10 * PERIOD
    drives = ServoArm(ServoConfig(PERIOD, T, 0.2, 2.0, 48.0, (JOINT,)))
    changes = []
    for k in range(8):
        drives.take_measurement(k * 10_000_000, [0], [0.0])
        drives.set_target(Target(np.zeros(1), np.array([float(k > 3)]), np.zeros(1)))
        drives.compute_commands(powered=True)
        state = drives.servo.state[0]
        changes += [state["a_target"] * T, (state["a_target"] + state["jerk_target"] * T) * T]
    assert max(changes) <= 1.8 + 1e-9
    assert min(changes) >= -0.4 - 1e-9
    assert changes[-1] == 0.0


@pytest.mark.parametrize("speed", [0.2, -0.7])
def test_a_ramp_of_targets_with_speeds_is_followed_without_stairs(speed: float) -> None:
    """Targets every 50 ms with the ramp's speed: without going on, each is a step of 50 ms."""
    ripple = {}
    for name, motion_period in (("stairs", 0.0), ("line", 0.05)):
        drives = ServoArm(ServoConfig(PERIOD, motion_period, 0.2, 2.0, 48.0, (JOINT,)))
        machine, off = Drivetrain(JOINT), []
        for tick in range(1500):
            drives.take_measurement(tick * 1_000_000, [machine.counts], [machine.x[0]])
            if tick % 50 == 0:
                drives.set_target(Target(np.array([speed * PERIOD * tick]), np.array([speed])))
            off.append(machine.x[3] - speed * PERIOD * tick)
            machine.advance(drives.compute_commands(powered=True)[0])
        ripple[name] = np.ptp(off[1000:])
    # Encoder counts and the gear are left: a count is 6e-5 rad.
    assert ripple["line"] < 3.0 * JOINT.count_angle, f"{ripple}"
    assert ripple["stairs"] > 5.0 * ripple["line"], f"{ripple}"

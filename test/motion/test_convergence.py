"""Convergence of eq. (6): derived, against closed forms and the whole machine."""

import dataclasses

import numpy as np
import pytest

from arm_emulator import OfflineRun, Pose, Session, load_gains, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.servo.servo_arm import ServoArm, Target
from oracles.convergence import compute_convergence_factor, predict_errors

SCENE = "three_axis"  # at its start the waist alone moves the tool along y
DISTANCE = 0.02  # m; a count of the encoder is 1e-3 of it
LONG = 1.0  # s until the servo is there
INSTRUCTIONS = 40


def step_response(period: float) -> Array:
    """Return which part of a step of the waist's target the servo has gone, by motion periods."""
    file = find_scene(SCENE)
    scene, config = load_scene(file), load_gains(file).servo
    session, drives = Session(scene, "lockstep", "first_answer"), ServoArm(config)
    target = scene.start.copy()
    target[0] += DISTANCE / 0.43
    travelled = []
    for tick in range(round(LONG / scene.servo_period) + 1):
        measured = session.measured
        drives.take_measurement(session.logical_ns, measured.encoder_counts, measured.current)
        drives.set_target(Target(target))
        if tick and tick % round(period / scene.servo_period) == 0:
            measured = drives.servo.q_measured[0]
            travelled.append((measured - scene.start[0]) / (target[0] - scene.start[0]))
        session.offer(tick, list(config.joint_names), drives.compute_commands(True).tolist())
        session.advance()
    return np.array(travelled)


def measured_factor(weight: float, period: float) -> float:
    """Return the factor by which the machine's error falls per instruction."""
    file = find_scene(SCENE)
    gains = load_gains(file)
    motion = dataclasses.replace(
        gains.motion, method="paper", weight=weight, period=period, step_limit=10.0
    )
    servo = dataclasses.replace(gains.servo, motion_period=period)
    run = OfflineRun(load_scene(file), servo, motion)
    kinematics, session = run.controller.kinematics, run.session
    R_WT, p_WT = kinematics.forward(session.scene.start)
    target = Pose(p_WT + np.array([0.0, DISTANCE, 0.0]), R_WT)
    run.instructor.add(0, target)
    errors = []
    for _ in range(INSTRUCTIONS):
        run.advance(run.motion_ticks)
        errors.append(kinematics.tool_error(run.drives.servo.q_measured, target)[1] / DISTANCE)
    return compute_convergence_factor(errors)


def test_closed_forms() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        w, g = rng.uniform(0.01, 1.0, 2)
        k = np.arange(1, 60)
        errors = predict_errors(w, 1.0 - (1.0 - g) ** k, len(k))
        assert np.allclose(errors, (1.0 - w * g) ** k, rtol=0, atol=1e-13), (w, g)  # rounding
        assert compute_convergence_factor(errors) == pytest.approx(1.0 - w * g, abs=1e-9)
        always_there = predict_errors(w, [1.0], len(k))
        assert np.allclose(always_there, (1.0 - w) ** k, rtol=0, atol=1e-13)


def test_the_errors_of_any_servo_are_those_of_the_loop_step_by_step() -> None:
    """Truth: the loop itself, a servo of second order that receives eq. (6) in every period."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        w = rng.uniform(0.05, 1.0)
        A = np.array([[0.0, 1.0], [-rng.uniform(0.05, 0.4), rng.uniform(0.2, 1.2)]])
        b = np.array([0.0, 1.0 - A[1, 1] - A[1, 0]])
        x, response = np.zeros(2), []
        for _ in range(60):
            x = A @ x + b
            response.append(x[0])
        x, errors = np.zeros(2), []
        for _ in range(30):
            x = A @ x + b * (x[0] + w * (1.0 - x[0]))
            errors.append(1.0 - x[0])
        assert np.allclose(predict_errors(w, response, 30), errors, rtol=0, atol=1e-12)


@pytest.mark.parametrize("period", [0.02, 0.05, 0.1])
def test_the_machine_converges_as_predicted(period: float) -> None:
    rng = np.random.default_rng(round(period * 1e3))
    response = step_response(period)
    for w in rng.uniform(0.2, 0.95, 2):
        expected = compute_convergence_factor(predict_errors(w, response, INSTRUCTIONS))
        # Counts of the encoder (1e-3 of the way), limits, and an arm whose Jacobian changes.
        assert measured_factor(w, period) == pytest.approx(expected, abs=0.03), w

"""Residual vibration: its measures by closed forms, its frequency by the modes of the machine."""

import dataclasses
import math

import numpy as np
import pytest

from arm_emulator import OfflineRun, Plant, Refusal, load_gains, load_scene
from arm_emulator.analysis.residual_vibration import find_reference_end, measure_vibration
from arm_emulator.analysis.vibration_modes import find_vibration_modes
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.model.input_shaper import ShapedMode
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint

PERIOD = 1e-3
AT = np.array([0.3, -0.2, 0.9])


@pytest.mark.parametrize("seed", range(10))
def test_a_decaying_swing_is_measured_as_its_closed_form_states(seed: int) -> None:
    """Turning points of exp(-z w t) sin(wd t + phi) are half a damped period apart."""
    rng = np.random.default_rng(seed)
    frequency, damping = float(rng.uniform(4.0, 40.0)), float(rng.uniform(0.01, 0.15))
    w = 2.0 * math.pi * frequency
    wd, size = w * math.sqrt(1.0 - damping**2), float(10 ** rng.uniform(-5.0, -3.0))
    t = PERIOD * np.arange(round(12.0 / (damping * w) / PERIOD))
    turn = rng.uniform(0.2, 0.8) * math.pi / wd  # tan(wd t + phi) = wd / (z w) where it turns
    phi = math.atan2(wd, damping * w) - wd * turn
    line = rng.normal(size=3)
    line /= np.linalg.norm(line)
    swing = size * np.exp(-damping * w * t) * np.sin(wd * t + phi)
    vibration = measure_vibration(np.outer(swing, line) + AT, PERIOD, 0.1 * size)
    value = size * math.exp(-damping * w * turn) * math.sqrt(1.0 - damping**2)
    K = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    rough = (w * PERIOD) ** 2 / 2.0  # what a turning point between two samples loses
    assert vibration.swing == pytest.approx(0.5 * value * (1.0 + K), rel=rough + 1e-4)
    assert vibration.largest == pytest.approx(np.abs(swing).max(), rel=1e-4)
    assert vibration.frequency == pytest.approx(
        frequency, rel=0.02
    )  # the spectrum is that of samples
    assert vibration.settled <= math.log(10.0) / (damping * w) + PERIOD, (
        "its envelope is in the band"
    )
    assert vibration.settled >= math.log(10.0) / (damping * w) - math.pi / wd - PERIOD


def test_a_tool_that_creeps_does_not_swing() -> None:
    t = PERIOD * np.arange(2000)
    creep = 1e-3 * np.exp(-t / 0.1)
    vibration = measure_vibration(np.outer(creep, [0.0, 1.0, 0.0]), PERIOD, 1e-4)
    assert vibration.swing == 0.0 and math.isnan(vibration.frequency)
    assert vibration.settled == pytest.approx(0.1 * math.log(10.0), abs=PERIOD)
    assert vibration.rms == pytest.approx(1e-3 * math.sqrt(0.05 / 2.0), rel=0.01)


def test_a_reference_ends_a_period_after_its_last_change() -> None:
    q = np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.2, 0.5], [0.2, 0.5], [0.2, 0.5]])
    assert find_reference_end(q) == 4
    creeping = np.vstack([q, q[-1] + 1e-5, q[-1] + 2e-5])
    assert find_reference_end(creeping) == 4, "a learned load is no motion"
    assert find_reference_end(np.repeat(q, 10, axis=0)) == 40
    assert find_reference_end(q[:1]) == find_reference_end(q[3:]) == 0


@pytest.mark.parametrize("places", [np.zeros((3, 3)), np.full((9, 3), math.nan)])
def test_too_little_to_judge_is_refused(places: np.ndarray) -> None:
    with pytest.raises(Refusal, match="the end of the reference must be followed by"):
        measure_vibration(places, PERIOD, 1e-4)


def ring(stiff: float, **motion: object) -> tuple[OfflineRun, np.ndarray]:
    """Places of the tool of three_axis after a fast move of the waist."""
    file = find_scene("three_axis")
    fine = {f"joints.{name}.encoder.counts_per_turn": 4_000_000 for name in NAMES}
    scene, gains = load_scene(file, fine), load_gains(file)
    joints = tuple(
        dataclasses.replace(
            joint, velocity_gain=stiff * joint.velocity_gain, counts_per_turn=4_000_000
        )
        for joint in gains.servo.joints
    )
    servo = dataclasses.replace(gains.servo, joints=joints, motion_period=0.01)
    config = dataclasses.replace(gains.motion, method="way", period=0.01, **motion)  # type: ignore[arg-type]
    run = OfflineRun(scene, servo, config)
    run.advance(200)
    q = run.aimed
    points = [TrajectoryPoint(150_000_000, q + 0.1 * np.eye(3)[0], np.zeros(3))]
    run.instructor.add_trajectory(run.controller, run.controller.kinematics.joint_names, points)
    places, targets = [], []
    for _ in range(1200):
        run.advance(1)
        places.append(run.controller.kinematics.forward(run.session.state.q)[1])
        targets.append(run.drives.servo.state["q_target"].copy())
    end = find_reference_end(np.array(targets))
    return run, np.array(places)[end:]


NAMES = ("waist", "shoulder", "elbow")


@pytest.mark.slow
def test_the_arm_swings_at_the_frequency_of_its_mode_and_less_when_shaped() -> None:
    """A waist that turns fast excites its own mode; ZVD takes it away."""
    run, places = ring(8.0)
    raw = measure_vibration(places, PERIOD, 1e-4)
    modes = find_vibration_modes(Plant(run.session.scene), run.drives.servo.config, run.aimed)
    near = min(modes, key=lambda mode: abs(mode.frequency - raw.frequency))
    # The spectrum of a swing that is damped by 20 % is wide, and the other modes lie beside it.
    assert near.frequency == pytest.approx(raw.frequency, rel=0.05), (raw, modes)
    mode = ShapedMode(near.frequency, near.damping)
    shaped = measure_vibration(ring(8.0, shaper="zvd", modes=(mode,))[1], PERIOD, 1e-4)
    assert shaped.swing < 0.1 * raw.swing, (raw, shaped)

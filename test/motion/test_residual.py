"""The residual that the motion controller predicts, and what arms leave."""

import dataclasses
from collections.abc import Iterator

import numpy as np
import pytest
from draws import with_slow
from kinematic_arms import CONFIG, START, THREE_AXIS

from arm_emulator import (
    JacobianController,
    Kinematics,
    OfflineRun,
    Plant,
    Pose,
    Servo,
    load_gains,
    load_scene,
    load_servo_config,
)
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.motion.planner.tool_controller import make_controller
from oracles.predicted_residual import predict_residual


def test_predicted_residual_of_a_single_joint_is_1_5_counts() -> None:
    """Waist alone, tool 0.43 m off its axis: by hand."""
    kinematics = Kinematics(
        THREE_AXIS.replace('name="shoulder" type="continuous"', 'name="shoulder" type="fixed"')
        .replace('name="elbow" type="continuous"', 'name="elbow" type="fixed"')
        .replace('<origin xyz="0 0 0.3"/>\n    <parent link="forearm"/>',
                 '<origin xyz="0.43 0 0.3"/>\n    <parent link="forearm"/>'),
        ["waist"],
        "tool",
    )  # fmt: skip
    count = 1e-4
    bound = predict_residual(JacobianController(kinematics), [0.0], [count], [2e-3])
    assert bound.encoder[1] == pytest.approx(0.43 * count * (0.5 / 0.5 + 0.5), rel=0.01)
    assert bound.wind_up[1] == pytest.approx(0.43 * 2e-3, rel=1e-5)
    assert np.array_equal(bound.total, bound.encoder + np.abs(bound.wind_up))


class Experiment:
    """Motion controller, servo and emulated machine, run together without a network."""

    def __init__(self, scene: str, **overrides: object) -> None:
        self.plant = Plant(load_scene(scene, overrides))
        scene_ = self.plant.scene
        motion = load_motion_config(CONFIG / "motion" / f"{scene}.yaml")
        config = load_servo_config(CONFIG / "servo" / f"{scene}.yaml")
        self.servo = Servo(config)
        self.controller = make_controller(scene_.urdf, scene_.joint_names, motion)
        self.cycle = round(motion.period / config.period)
        self.count_angle = np.array([joint.count_angle for joint in config.joints])
        self.stiffness = np.array([joint.gear.stiffness for joint in scene_.joints])

    def start(self, q: np.ndarray, settle: float) -> None:
        """Hold pose q for `settle` seconds."""
        self.plant.reset(q=q)
        self.servo.reset()
        for _ in range(round(settle / self.servo.config.period)):
            self.tick(q)

    def tick(self, q_target: np.ndarray) -> None:
        measured = self.plant.measured
        voltage = self.servo.update(measured.encoder_counts, measured.current, q_target)
        self.plant.advance(voltage, self.plant.scene.steps_per_period)

    def deviations(self, target: Pose, instructions: int) -> Iterator[np.ndarray]:
        """Yield the true deviation at every instruction, the first before any has worked."""
        for _ in range(instructions + 1):
            state = self.plant.state
            yield self.controller.kinematics.tool_error(state.q, target)
            q = (self.plant.measured.encoder_counts + 0.5) * self.count_angle
            q_target = self.controller.update(q, target).q
            for _ in range(self.cycle):
                self.tick(q_target)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_fig_4_ten_millimetres(axis: int, sign: int) -> None:
    """Below 1 % of the way within 20 instructions, and then within the bound for good."""
    experiment = Experiment("three_axis")
    experiment.start(START, settle=0.0)
    displacement = sign * 0.010 * np.eye(3)[axis]
    R_WT, p_WT = experiment.controller.kinematics.forward(START)
    deviations = np.array(list(experiment.deviations(Pose(p_WT + displacement, R_WT), 60)))
    bound = predict_residual(
        experiment.controller, experiment.plant.state.q, experiment.count_angle
    )
    assert np.allclose(deviations[0], displacement, rtol=0, atol=1e-12)
    assert np.linalg.norm(deviations[20:], axis=1).max() < 0.01 * 0.010
    assert (np.abs(deviations[25:]) < bound.encoder).all()
    assert bound.encoder.max() < 1e-4  # m; a bound that states something


def test_residual_stays_within_the_bound_and_the_bound_is_tight() -> None:
    """Other poses and ways, no gravity. 700 such runs came to 0.97 of the bound, never beyond."""
    rng = np.random.default_rng(7)
    experiment, ratios = Experiment("three_axis"), []
    while len(ratios) < 15:
        q = np.array([rng.uniform(-3, 3), rng.uniform(-1.2, 1.2), rng.uniform(0.4, 2.2)])
        if experiment.controller.kinematics.singular_values(q)[-1] < 0.1:
            continue
        experiment.start(q, settle=0.0)
        displacement = rng.normal(size=3)
        displacement *= 0.010 / np.linalg.norm(displacement)
        R_WT, p_WT = experiment.controller.kinematics.forward(q)
        rest = np.array(list(experiment.deviations(Pose(p_WT + displacement, R_WT), 40)))[25:]
        bound = predict_residual(
            experiment.controller, experiment.plant.state.q, experiment.count_angle
        )
        ratios.append(np.abs(rest).max(axis=0) / bound.encoder)
    assert np.max(ratios) < 1.0
    assert np.max(ratios) > 0.6


@pytest.mark.slow
def test_gravity_adds_the_wind_up_of_the_gears() -> None:
    """The arm with its weight: encoders do not see the gears wind up, the prediction does."""
    experiment = Experiment("three_axis", gravity=[0.0, 0.0, -9.81])
    experiment.start(START, settle=1.0)
    R_WT, p_WT = experiment.controller.kinematics.forward(START)
    target = Pose(p_WT + np.array([0.0, 0.010, 0.0]), R_WT)
    deviation = list(experiment.deviations(target, 60))[-1]
    state = experiment.plant.state
    bound = predict_residual(
        experiment.controller,
        state.q,
        experiment.count_angle,
        state.gear_torque / experiment.stiffness,
    )
    assert np.linalg.norm(bound.wind_up) > 5 * np.linalg.norm(bound.encoder)
    assert (np.abs(deviation - bound.wind_up) < bound.encoder).all()
    assert (np.abs(deviation) < bound.total).all()


@pytest.mark.skipif(
    find_example_robot_data() is None, reason="needs the package example-robot-data"
)
@pytest.mark.parametrize("scene", with_slow(["ur5", "panda"], 1))
@pytest.mark.parametrize("method", ["paper", "way"])
def test_robots_move_50_mm_with_constant_orientation(scene: str, method: str) -> None:
    """By either method, under gravity, through the whole machine."""
    file = find_scene(scene)
    gains = load_gains(file)
    motion = dataclasses.replace(gains.motion, method=method)
    if method == "paper":
        motion = dataclasses.replace(motion, period=0.05, step_limit=0.02)
    servo = dataclasses.replace(gains.servo, motion_period=motion.period)
    run = OfflineRun(load_scene(file), servo, motion)
    session, kinematics = run.session, run.controller.kinematics
    start = session.scene.start
    R_WT, p_WT = kinematics.forward(start)
    target = Pose(p_WT + np.array([0.0, 0.050, 0.0]), R_WT)
    second = round(1.0 / session.scene.servo_period)
    run.instructor.add(session.period_ns * second, target)
    run.advance(second)
    deviations = []
    for _ in range(round(9.0 / motion.period)):
        deviations.append(kinematics.tool_error(session.state.q, target))
        run.advance(run.motion_ticks)
    bound = predict_residual(
        run.controller,
        session.state.q,
        [joint.count_angle for joint in servo.joints],
        session.scene.wind_up(session.state.gear_torque) - run.wind_up,
    )
    errors = np.array(deviations)
    # Rotation: the wind-up of about 2 mrad, and what the joints' different swing adds on the way.
    assert np.linalg.norm(errors[:, 3:], axis=1).max() < 0.01, "the orientation was not held"  # rad
    # If links stick, the servo's integral winds the gears up over the seconds: the longer, the
    # closer to their targets they stick, as with feed-forward of friction.
    errors = (errors - bound.wind_up)[round(8.0 / motion.period) :]
    assert (np.abs(errors) < bound.encoder).all(), "the tool is not where it was predicted"

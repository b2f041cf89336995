"""Loops of whole arms: stable and unstable ones, margins, refusals with gains that hold."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow
from machines import list_moving_joints, write_scene
from test_servo_loop import Rng, draw_axis, log_uniform

from arm_emulator import Plant, Refusal, Scene, Session, load_gains, load_scene
from arm_emulator.analysis.servo_loop import ServoLoops, check_loops, compute_growth_rate
from arm_emulator.analysis.stability import SmallMotions
from arm_emulator.base.io.config_files import find_config
from arm_emulator.design.joint_gains import GearData, MotorData, ServoGains, make_joint_servo
from arm_emulator.servo.servo import ServoConfig
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.servo.zoh_motor import discretise_zoh
from oracles.random_chain import write_random_chain


def draw_scene(rng: Rng, folder: Path) -> tuple[Scene, ServoConfig]:
    """Return a random chain behind drawn motors, and servos with gains that may hold or not."""
    urdf = write_random_chain(rng, int(rng.integers(2, 5)))
    names = list_moving_joints(urdf)
    sections, joints = {}, []
    period = 1e-3
    for name in names:
        axis = draw_axis(rng, speed=(0.02, 2.0), rigid=False)
        mean = 0.5
        ratio, Kt = axis.gear.ratio, axis.motor.torque_constant
        rotor = mean * log_uniform(rng, 0.3, 5.0) * ratio**2
        R = Kt * Kt * period / (log_uniform(rng, 0.02, 2.0) * rotor)
        stiffness = log_uniform(rng, 1e3, 3e4)
        gear = GearData(ratio, stiffness, 0.05 * math.sqrt(stiffness * mean))
        motor = MotorData(R, 0.2 * R * period, Kt, Kt, rotor, 2**20)
        Z = math.sqrt(stiffness * rotor) / ratio
        velocity_gain = Z * log_uniform(rng, 0.5, 20.0)
        position_gain = min(900.0, 0.3 * velocity_gain / (mean + rotor / ratio**2))
        gains = ServoGains(position_gain, velocity_gain, 5.0 / position_gain, 300.0)
        joints.append(make_joint_servo(motor, gear, gains, name))
        sections[name] = {
            "motor": {
                "resistance": R,
                "inductance": motor.inductance,
                "torque_constant": Kt,
                "back_emf_constant": Kt,
                "rotor_inertia": rotor,
            },
            "gear": {"ratio": ratio, "stiffness": stiffness, "damping": gear.damping},
            "encoder": {"counts_per_turn": 2**20},
        }
    file = write_scene(
        folder,
        urdf,
        sections,
        gravity=[0.0, 0.0, -9.81],
        supply_voltage=1e4,
        integrator={"scheme": "rosenbrock", "dt": 2.5e-4},
    )
    return load_scene(file), ServoConfig(period, 0.0, 1.0, 2.0, 1e4, tuple(joints))


def swing_of(scene: Scene, servo: ServoConfig, ticks: int, kick: float) -> np.ndarray:
    """Return how far the motors are from rest in each tick of a run, (ticks,) [rad]."""
    session, drives = Session(scene, "lockstep", "first_answer"), ServoArm(servo)
    out = np.empty(ticks)
    order = [servo.joint_names.index(name) for name in scene.joint_names]
    for tick in range(ticks):
        measured = session.measured
        drives.take_measurement(
            session.logical_ns, measured.encoder_counts, measured.current, measured.applied
        )
        drives.set_target(Target(scene.start[order]))
        V = drives.compute_commands(powered=True)
        if tick == ticks // 8:
            V = V + kick
        session.offer(tick, scene.joint_names, V.tolist())
        session.advance()
        if session.fault is not None:
            out[tick:] = math.inf
            break
        out[tick] = np.abs(session.state.omega_m).max()
    return out


@pytest.mark.slow
@pytest.mark.parametrize("seed", with_slow(some(range(3), 2), 1))
def test_arms_called_stable_settle_and_those_called_unstable_swing(
    seed: int, tmp_path: Path
) -> None:
    """Against the machine itself, driven by the servo that runs."""
    rng = np.random.default_rng([seed, 7])
    scene, servo = draw_scene(rng, tmp_path)
    loops = ServoLoops(scene, servo, at=[scene.start])
    rate = compute_growth_rate(loops.loops[0], servo.period)
    speed = swing_of(scene, servo, 4000, kick=1.0)
    late, middle = speed[-500:].max(), speed[600:1100].max()
    if rate > 1.0:
        assert late > 3.0, f"grows by {rate:.3g} 1/s, but moves by {late:.3g} rad/s only"
    elif rate < -1.0:
        # The remainder is a count or two, converted to a speed by the servo.
        assert late < max(0.05 * middle, 0.3), f"dies by {rate:.3g} 1/s, but still {late:.3g} rad/s"


@pytest.mark.parametrize("name", with_slow(some(["three_axis", "ur5", "panda"], 2), 1))
def test_the_shipped_scenes_have_margins(name: str) -> None:
    file = find_config(name, ".yaml")
    scene, servo = load_scene(file), load_gains(file).servo
    assert check_loops(scene, servo) == []
    for margin in ServoLoops(scene, servo, delay=1).compute_margins():
        assert margin.gain_up > 1.6, f"with a period of dead time: {margin}"
        assert margin.phase > math.radians(30.0), f"with a period of dead time: {margin}"
        # Of drives that close a current loop: there is no back EMF that stands any dead time.
        assert margin.delay > 1.5, f"with a period of dead time: {margin}"


@pytest.mark.parametrize("seed", with_slow(range(3), 1))
def test_an_unstable_loop_is_refused_with_a_gain_and_a_period_that_hold(seed: int) -> None:
    rng = np.random.default_rng([seed, 8])
    name = str(rng.choice(["three_axis", "ur5", "panda"]))
    file = find_config(name, ".yaml")
    scene, servo = load_scene(file), load_gains(file).servo
    bad = int(rng.integers(len(servo.joints)))
    joints = list(servo.joints)
    for _ in range(12):  # until it is unstable
        joints[bad] = dataclasses.replace(
            joints[bad], velocity_gain=2.0 * joints[bad].velocity_gain
        )
        harder = dataclasses.replace(servo, joints=tuple(joints))
        loops = ServoLoops(scene, harder)
        result = loops.find_unstable()
        if result is not None and compute_growth_rate(loops.loops[0], servo.period) > 1.0:
            break
    assert result is not None
    with pytest.raises(Refusal) as refusal:
        check_loops(scene, harder)
    words = str(refusal.value)
    assert f"servo.joints.{joints[bad].name} must be stable" in words
    assert "small motions that grow" in words
    assert "; valid: velocity_gain " in words
    assert "or a servo period of " in words
    assert result.softer is not None
    assert result.period is not None
    joints[bad] = result.softer
    softer = dataclasses.replace(servo, joints=tuple(joints))
    assert ServoLoops(scene, softer).find_unstable() is None, "the gains that were named"
    again = ServoLoops(scene, harder)
    every = again.close_loops(again.joints, result.period, 0)
    assert all(loop.radius < 1.0 for loop in every), "the period that was named"


@pytest.mark.slow
def test_little_margin_is_warned_of() -> None:
    file = find_config("ur5", ".yaml")
    scene, servo = load_scene(file), load_gains(file).servo
    for factor in np.geomspace(1.0, 20.0, 10):
        joints = list(servo.joints)
        joints[3] = dataclasses.replace(
            joints[3], velocity_gain=float(factor) * joints[3].velocity_gain
        )
        lines = check_loops(scene, dataclasses.replace(servo, joints=tuple(joints)))
        if lines:
            break
    assert len(lines) == 1
    assert lines[0].startswith("ur5.yaml: servo.joints.wrist_1_joint: ")
    assert lines[0].endswith("; `tune` computes gains")


@pytest.mark.parametrize("overrides", with_slow([{}, {"joints.*.motor.inductance": None}], 1))
def test_the_currents_and_motor_angles_of_small_motions_are_those_of_the_machine(
    overrides: dict[str, Any],
) -> None:
    """One servo period under a small voltage, by the core and by the matrices; L or none."""
    scene = load_scene(
        "three_axis",
        {"joints.waist.gear.stiffness": None, "joints.waist.gear.damping": None}
        | {"integrator.dt": 1e-5, "gravity": None, "varied": ["joints.*"]}
        | overrides,
    )
    plant = Plant(scene)
    motions = SmallMotions(plant, scene.start)
    V = np.array([1e-3, -2e-3, 3e-3])
    F, G = discretise_zoh(motions.J, motions.B, scene.servo_period)
    x = np.zeros(len(F))
    plant.reset(q=scene.start)
    before = plant.state.theta_m
    for _ in range(5):
        plant.advance(V, scene.steps_per_period)
        x = F @ x + G @ V
    for quantity, actual, expected in (
        ("current", plant.state.current, motions.current @ x + motions.current_by_command * V),
        ("motor angle", plant.state.theta_m - before, motions.theta_m @ x),
    ):
        error = np.abs(actual - expected).max() / np.abs(expected).max()
        assert error < 1e-4, f"{quantity}: {actual} by the core, {expected} by the matrices"


@pytest.mark.slow
def test_a_gear_with_play_is_looked_at_loaded_and_within_its_play() -> None:
    """Loaded it is the gear without play; within, its rotor turns by itself."""
    servo = load_gains(find_config("three_axis", ".yaml")).servo
    common = {"gravity": [0.0, 0.0, -9.81], "varied": ["joints.*.gear.backlash"]}
    plain, played = (
        load_scene("three_axis", common | {"joints.*.gear.backlash": play}) for play in (0.0, 1e-3)
    )
    first, second = ServoLoops(plain, servo), ServoLoops(played, servo)
    for without, loaded in zip(first.loops, second.loops, strict=True):
        np.testing.assert_allclose(loaded.A, without.A, atol=1e-9)
    worst = zip(first.compute_margins(), second.compute_margins(), strict=True)
    assert all(b.delay <= a.delay + 1e-9 and b.phase <= a.phase + 1e-9 for a, b in worst)
    assert second.find_unstable() is None, (
        "links that hang in the play fall; that is no loop's fault"
    )
    apart = SmallMotions(Plant(played), plain.start)
    assert not np.array_equal(apart.J, SmallMotions(Plant(played), plain.start, loaded=True).J)

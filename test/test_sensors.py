"""Sensors: what they has a known motion, their noise, their faults, and the same bits always."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from machines import CONFIG, GRAVITY, LINK, MOTOR, Oracle, write_scene
from scipy import stats

from arm_emulator.analysis.servo_loop import ServoLoops
from arm_emulator.base.refusal import Refusal
from arm_emulator.design.tuned import run
from arm_emulator.machine.core_calls import ARM
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.fleet import Fleet
from arm_emulator.machine.measured import Measured
from arm_emulator.machine.outputs import ALWAYS, KNOWN
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.plant_state import PlantState
from arm_emulator.machine.real_time import RealTimeLoop
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.machine.scene_unit import scene_unit
from arm_emulator.runs.gains import check_joints
from arm_emulator.servo.servo_config import load_servo_config

TURN = 2.0 * math.pi
FIELDS = tuple(KNOWN)
OF_SENSORS = [name for name, one in KNOWN.items() if one not in ALWAYS]
DRAWS = 4000  # ticks of a statistic
SIGMAS = 5.0  # that a statistic of so many draws may be off; by chance 1 in 2 million is

ERRORS = {  # of an encoder, all of which can be set while the machine runs
    "offset": 0.0,
    "eccentricity": 0.0,
    "eccentricity_phase": 0.0,
    "ripple": 0.0,
    "ripple_order": 5,
    "ripple_phase": 0.0,
    "noise": 0.0,
    "missed": 0.0,
    "held": 0.0,
}
ANALOG = {
    "held": 0.0,
    "gain_error": 0.0,
    "offset": 0.0,
    "noise": 0.0,
    "range": 1e9,
    "resolution": 1e-12,
}
AXES = {"held": 0.0, "gain_error": 0.0, "noise": 0.0, "range": 1e9, "resolution": 1e-12}
AXES |= {f"bias_{axis}": 0.0 for axis in "xyz"}
POSE = {"xyz": [0.1, -0.2, 0.05], "rpy": [0.4, -1.1, 2.2]}
FRICTION = {"viscous": 0.3, "coulomb": 0.5, "breakaway": 60.0}


def urdf() -> str:
    """A turn, a slide and a turn about slanted axes; the last link has another fixed to it."""
    joints = [
        ("turn", "continuous"),
        ("slide", "prismatic"),
        ("hand", "revolute"),
        ("tip", "fixed"),
    ]
    text, parent = '<robot name="sensed"><link name="base"/>', "base"
    rng = np.random.default_rng(12)
    for name, kind in joints:
        text += LINK.format(
            name=name, kind=kind, parent=parent, xyz="0.1 0.2 0.3", rpy="0.3 -0.5 1.2",
            axis=" ".join(map(repr, rng.normal(size=3).tolist())), com="0.05 0.1 0.02",
            com_rpy="0 0 0", mass=1.5, ixx=0.03, iyy=0.04, izz=0.05, ixy=0.0, ixz=0.0, iyz=0.01,
        )  # fmt: skip
        parent = f"{name}_link"
    return text + "</robot>"


def write(folder: Path) -> Path:
    gear = {"ratio": 0.02, "stiffness": 3e3, "damping": 5.0}
    joints = {
        "turn": {
            "gear": gear,
            "encoder": {"counts_per_turn": 1000, "index": "latch", **ERRORS},
            "link_encoder": {"kind": "absolute", "counts_per_turn": 4096, "bits": 14, **ERRORS},
            "current_sensor": ANALOG,
        },
        "slide": {
            "gear": {"ratio": 0.03},
            "encoder": {"counts_per_turn": 1024, "index": "correct", **ERRORS},
            "link_encoder": {"counts_per_turn": 100_000, "index": "latch", "delay": 2},
            "torque_sensor": {**ANALOG, "delay": 3},
        },
        "hand": {
            "gear": gear,
            "encoder": {"kind": "absolute", "counts_per_turn": 1000, "bits": 10, "delay": 1, **ERRORS},
            "current_sensor": {"delay": 2},
            "torque_sensor": {},
        },
    }  # fmt: skip
    for joint in joints.values():
        joint |= {"motor": MOTOR, "friction": FRICTION}
    imus = {
        "at_hand": {"link": "tip_link", **POSE, "accelerometer": AXES, "gyroscope": AXES},
        "late": {"link": "turn_link", "delay": 1},
    }
    names = "joints.*.*encoder.*", "joints.*_sensor.*", "imus.*", "seed"
    return write_scene(
        folder, urdf(), joints, imus=imus, seed=1, varied=list(names), gravity=GRAVITY,
        integrator={"scheme": "rosenbrock", "dt": 2e-4},
    )  # fmt: skip


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write(tmp_path_factory.mktemp("sensed")))


def set_all(plant: Plant, numbers: dict[str, float]) -> None:
    for name, value in numbers.items():
        plant.set_parameter(name, value)


def motion(plant: Plant, rng: np.random.Generator, ticks: int) -> list[tuple[Measured, PlantState]]:
    """Return measured and true values at each tick, from the present one on."""
    reported = [(plant.measured, plant.state)]
    for tick in range(ticks):
        if tick % 50 == 0:
            voltage = rng.choice([-1.0, 1.0], 3) * rng.uniform(35.0, 48.0, 3)
        plant.exchange(voltage)
        reported.append((plant.measured, plant.state))
    return reported


def rows(reported: list[tuple[Measured, PlantState]], name: str) -> np.ndarray:
    """A quantity measured, a row per tick."""
    return np.array([getattr(measured, name) for measured, _ in reported])


def truth(reported: list[tuple[Measured, PlantState]], name: str) -> np.ndarray:
    return np.array([getattr(state, name) for _, state in reported])


def late(values: np.ndarray, ticks: int) -> np.ndarray:
    """Return the readings of a delayed sensor: at first the initial value."""
    return np.concatenate([np.repeat(values[:1], ticks, axis=0), values[: len(values) - ticks]])


def same(one: Measured, other: Measured) -> bool:
    return all(getattr(one, f).tobytes() == getattr(other, f).tobytes() for f in FIELDS)


def test_without_errors_sensors_report_what_is_there(scene: Scene) -> None:
    plant = Plant(scene)
    reported = motion(plant, np.random.default_rng(1), 400)
    theta, q, current = truth(reported, "theta_m"), truth(reported, "q"), truth(reported, "current")
    counts = rows(reported, "encoder_counts")
    disc = np.floor(theta * np.array([1000, 1024, 1000]) / TURN)
    assert np.ptp(disc, axis=0).min() > 1000, "the motors shall turn by several turns"
    np.testing.assert_array_equal(counts[:, :2], disc[:, :2], "incremental at the motor")
    np.testing.assert_array_equal(counts[:, 2], late(disc[:, 2] % 1024, 1), "a word, 1 tick late")
    link = rows(reported, "link_encoder_counts")
    at_link = np.floor(q[:, 0] * 4096 / TURN) % 2**14
    np.testing.assert_array_equal(link[:, 0], at_link, "absolute at the link")
    scale = np.floor(q[:, 1] * 100_000)  # counts per m
    np.testing.assert_array_equal(link[:, 1], late(scale, 2), "along the slide, 2 ticks late")
    np.testing.assert_array_equal(link[:, 2], 0, "a joint without encoder at the link")
    reported_current = rows(reported, "current")
    np.testing.assert_allclose(reported_current[:, 0], current[:, 0], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(reported_current[:, 1], current[:, 1], "without a current sensor")
    np.testing.assert_array_equal(reported_current[:, 2], late(current[:, 2], 2), "current, late")
    torque, true = rows(reported, "torque"), truth(reported, "gear_torque")
    np.testing.assert_array_equal(torque[:, 0], 0.0, "without a torque sensor")
    # Behind a rigid gear the torque follows from the accelerations, worked out twice.
    np.testing.assert_allclose(torque[:, 1], late(true[:, 1], 3), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(torque[:, 2], true[:, 2], "torque")
    rate = rows(reported, "angular_rate")
    np.testing.assert_allclose(
        np.linalg.norm(rate[:, 1], axis=1), late(np.abs(truth(reported, "v")[:, 0]), 1), atol=1e-12,
        err_msg="rate of the first link, 1 tick late",
    )  # fmt: skip


def test_index_pulses_come_where_a_turn_is_full(scene: Scene) -> None:
    """As often as the disc passes a multiple of a turn between ticks; the newest is latched."""
    plant = Plant(scene)
    plant.reset(v=np.array([6.0, 6.0, 6.0]))
    reported = motion(plant, np.random.default_rng(2), 400)
    for joint, per_turn, delay, names in (
        (0, 1000, 0, ("encoder_counts", "index_counts", "index_pulses")),
        (1, 1024, 0, ("encoder_counts", "index_counts", "index_pulses")),
        (1, 100_000, 2, ("link_encoder_counts", "link_index_counts", "link_index_pulses")),
    ):
        counts, index, pulses = (rows(reported, name)[:, joint] for name in names)
        turns = counts // per_turn
        passed = np.abs(np.diff(turns)).cumsum()
        np.testing.assert_array_equal(pulses[1:], passed, f"pulses of {names[0]} {joint}")
        up = np.diff(turns) > 0
        newest = np.where(up, turns[1:], turns[:-1] + 0) * per_turn
        newest = np.where(~up, (turns[1:] + 1) * per_turn, newest)
        came = np.diff(turns) != 0
        np.testing.assert_array_equal(index[1:][came], newest[came], f"{names[1]} at a pulse")
        held = ~came
        np.testing.assert_array_equal(index[1:][held], index[:-1][held], f"{names[1]} between")
        assert delay or came.sum() > 4, f"{came.sum()} pulses"


def drawn_state(rng: np.random.Generator, plant: Plant) -> None:
    q, v = rng.normal(0.0, 1.0, 3), rng.normal(0.0, 2.0, 3)
    ratio = plant.scene.gear_ratios
    theta_m, omega_m = (q + 1e-3 * rng.normal(size=3)) / ratio, (v + rng.normal(size=3)) / ratio
    theta_m[1], omega_m[1] = q[1] / ratio[1], v[1] / ratio[1]  # behind a rigid gear
    given = {"q": q, "v": v, "theta_m": theta_m, "omega_m": omega_m, "current": rng.normal(size=3)}
    plant.put("drawn", given)


def test_an_imu_feels_what_the_equations_of_motion_state(scene: Scene) -> None:
    """Against Pinocchio: classical acceleration of the unit's frame, less that of free fall."""
    rng = np.random.default_rng(3)
    oracle, plant = Oracle(scene), Plant(scene)
    model, data = oracle.model, oracle.data
    R = pin.rpy.rpyToMatrix(*POSE["rpy"])
    frames = []
    for link, pose in (
        ("tip_link", pin.SE3(R, np.array(POSE["xyz"]))),
        ("turn_link", pin.SE3.Identity()),
    ):
        frame = model.frames[model.getFrameId(link)]
        frames.append(
            model.addFrame(
                pin.Frame(f"imu {link}", frame.parentJoint, frame.placement * pose, pin.OP_FRAME)
            )
        )
    data = model.createData()
    viscous, coulomb = FRICTION["viscous"], FRICTION["coulomb"]
    for _ in range(30):
        drawn_state(rng, plant)
        x, measured = plant.state, plant.measured
        tau = x.gear_torque - viscous * x.v - coulomb * np.sign(x.v)
        at = oracle.configuration(x.q)
        a = pin.aba(model, data, at, x.v, tau)
        pin.forwardKinematics(model, data, at, x.v, a)
        for unit, frame in enumerate(frames):
            local = pin.ReferenceFrame.LOCAL
            acceleration = pin.getFrameClassicalAcceleration(model, data, frame, local).linear
            placement = pin.updateFramePlacement(model, data, frame)
            force = acceleration - placement.rotation.T @ np.array(GRAVITY)
            rate = pin.getFrameVelocity(model, data, frame, local).angular
            scale = 1.0 + np.abs(force).max()
            np.testing.assert_allclose(
                measured.specific_force[unit], force, rtol=0, atol=1e-9 * scale, err_msg="force"
            )
            np.testing.assert_allclose(
                measured.angular_rate[unit], rate, rtol=0, atol=1e-11 * scale, err_msg="rate"
            )


def test_an_imu_that_sticks_feels_gravity_alone(scene: Scene) -> None:
    """At rest, held by friction, whatever the pose."""
    rng, oracle, plant = np.random.default_rng(4), Oracle(scene), Plant(scene)
    for _ in range(10):
        q = rng.normal(0.0, 1.0, 3)
        plant.reset(q)
        plant.exchange(np.zeros(3))
        np.testing.assert_array_equal(plant.state.q, q, "the joints shall stick")
        pin.framesForwardKinematics(oracle.model, oracle.data, oracle.configuration(q))
        link = oracle.data.oMf[oracle.model.getFrameId("tip_link")].rotation
        R = link @ pin.rpy.rpyToMatrix(*POSE["rpy"])
        force = plant.measured.specific_force[0]
        np.testing.assert_allclose(force, -R.T @ np.array(GRAVITY), rtol=0, atol=1e-12)
        np.testing.assert_array_equal(plant.measured.angular_rate, 0.0)


ENCODERS = (
    # joint, section, what is measured, true angle, counts per turn, what a turn is, word, delay
    ("turn", "encoder", "encoder_counts", "theta_m", 1000, TURN, 0, 0),
    ("turn", "link_encoder", "link_encoder_counts", "q", 4096, TURN, 2**14, 0),
    ("slide", "encoder", "encoder_counts", "theta_m", 1024, TURN, 0, 0),
    ("hand", "encoder", "encoder_counts", "theta_m", 1000, TURN, 2**10, 1),
)
of_every_encoder = pytest.mark.parametrize("which", ENCODERS, ids=lambda e: f"{e[0]} {e[1]}")


@of_every_encoder
def test_a_disc_that_sits_badly_shows_the_angle_that_its_errors_state(
    scene: Scene, which: tuple[Any, ...]
) -> None:
    joint, section, named_by, angle, per_turn, turn, word, delay = which
    rng = np.random.default_rng(len(joint + section))
    plant, j = Plant(scene), scene.joint_names.index(joint)
    errors = {"offset": rng.normal(), "eccentricity": 0.02, "eccentricity_phase": rng.normal(),
              "ripple": 0.01, "ripple_phase": rng.normal()}  # fmt: skip
    set_all(plant, {f"joints.{joint}.{section}.{key}": float(x) for key, x in errors.items()})
    plant.reset()
    reported = motion(plant, rng, 300)
    theta = truth(reported, angle)[:, j]
    t = theta * TURN / turn
    alpha = theta + errors["offset"] + 0.02 * np.sin(t + errors["eccentricity_phase"])
    alpha += 0.01 * np.sin(5 * t + errors["ripple_phase"])
    exact = late(alpha * per_turn / turn, delay)
    disc = np.floor(exact)
    counts = rows(reported, named_by)[:, j]
    off = counts - (disc % word if word else disc)
    near_edge = np.abs(exact - np.rint(exact)) < 1e-9 * np.abs(exact).max()
    assert np.ptp(disc) > 50, "it shall turn"
    assert (off[~near_edge] == 0).all(), f"counts off: {off[off != 0]}"
    assert near_edge.sum() <= 2, "angles at the very edge of a count"


@of_every_encoder
def test_noise_of_an_encoder_has_its_deviation(scene: Scene, which: tuple[Any, ...]) -> None:
    """At rest: normal noise of the angle, rounded down to counts."""
    joint, section, named_by, _, per_turn, turn, word, _ = which
    plant, j = Plant(scene), scene.joint_names.index(joint)
    sigma = 3.0 * turn / per_turn  # of three counts
    set_all(plant, {f"joints.{joint}.{section}.noise": sigma, "seed": 5.0})
    start = plant.scene.start
    plant.reset(start + 0.4 * turn * (1.0 if section == "link_encoder" else 0.02))
    counts = np.empty(DRAWS)
    for k in range(DRAWS):
        plant.exchange(np.zeros(3))
        counts[k] = getattr(plant.measured, named_by)[j]
    if word:
        counts = (counts - counts[0] + word // 2) % word
    # Rounding adds a twelfth of a count to the variance.
    expected = math.sqrt(9.0 + 1.0 / 12.0)
    assert np.std(counts) == pytest.approx(expected, rel=SIGMAS / math.sqrt(2 * DRAWS)), "deviation"
    white = np.corrcoef(counts[1:], counts[:-1])[0, 1]
    assert abs(white) < SIGMAS / math.sqrt(DRAWS), "correlation from tick to tick"


CHANNELS = {  # name of the numbers: what is measured, place, true value at rest
    "joints.turn.current_sensor": ("current", (0,)),
    "joints.slide.torque_sensor": ("torque", (1,)),
    "imus.at_hand.accelerometer": ("specific_force", (0, slice(3))),
    "imus.at_hand.gyroscope": ("angular_rate", (0, slice(3))),
}


def at_rest(plant: Plant, name: str, ticks: int) -> np.ndarray:
    """Readings of a channel at rest, where the truth stands still; (ticks, axes)."""
    field, place = CHANNELS[name]
    readings = []
    for _ in range(ticks):
        plant.exchange(np.zeros(3))
        readings.append(np.atleast_1d(getattr(plant.measured, field)[place]))
    return np.array(readings)


@pytest.mark.parametrize("name", CHANNELS)
def test_noise_of_a_sensor_is_normal_white_and_its_own(scene: Scene, name: str) -> None:
    sigma, plant = 0.25, Plant(scene)
    plain = at_rest(plant, name, 5)[-1]
    set_all(plant, {f"{name}.noise": sigma, "seed": 7.0})
    plant.reset()
    noise = (at_rest(plant, name, DRAWS)[4:] - plain) / sigma  # what was late is there, too
    for axis in noise.T:
        assert stats.kstest(axis, "norm").pvalue > 1e-4, "a normal distribution"
        assert abs(axis.mean()) < SIGMAS / math.sqrt(DRAWS), "mean"
        assert axis.std() == pytest.approx(1.0, rel=SIGMAS / math.sqrt(2 * DRAWS)), "deviation"
        assert abs(np.corrcoef(axis[1:], axis[:-1])[0, 1]) < SIGMAS / math.sqrt(DRAWS), "white"
    if noise.shape[1] > 1:
        between = np.corrcoef(noise.T) - np.eye(3)
        assert np.abs(between).max() < SIGMAS / math.sqrt(DRAWS), "axes are independent"


@pytest.mark.parametrize("name", CHANNELS)
def test_gain_offset_range_and_resolution_are_as_the_equation_states(
    scene: Scene, name: str
) -> None:
    rng = np.random.default_rng(len(name))
    field, place = CHANNELS[name]
    one, other = Plant(scene), Plant(scene)  # with errors and without
    x = rows(motion(other, np.random.default_rng(8), 300), field)[(slice(None), *place)]
    x = x.reshape(len(x), -1)
    gain, biases = float(rng.uniform(-0.2, 0.2)), rng.normal(size=3)
    wanted = (1.0 + gain) * x + biases[: x.shape[1]]
    limit = float(np.median(np.abs(wanted)))  # so that half of them are beyond
    res = limit * float(rng.uniform(0.01, 0.1))
    numbers = {"gain_error": gain, "resolution": res, "range": limit}
    keys = ("offset",) if name.endswith("_sensor") else ("bias_x", "bias_y", "bias_z")
    numbers |= dict(zip(keys, map(float, biases), strict=False))
    set_all(one, {f"{name}.{key}": value for key, value in numbers.items()})
    one.reset()
    y = rows(motion(one, np.random.default_rng(8), 300), field)[(slice(None), *place)]
    y, wanted = y.reshape(len(y), -1), np.clip(wanted, -limit, limit)
    steps = y / res
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-9, err_msg="multiples")
    assert np.abs(y - wanted).max() <= 0.5 * res * (1.0 + 1e-9), "rounded to the next multiple"
    assert np.abs(y).max() <= limit + 0.5 * res, "limited"


def test_edges_are_missed_as_often_as_is_stated(scene: Scene) -> None:
    """The counter lags by a binomial number; an index pulse reports, or sets it right."""
    for missed in (1e-3, 0.05):
        plant = Plant(scene)
        set_all(plant, {f"joints.{name}.encoder.missed": missed for name in ("turn", "slide")})
        set_all(plant, {"seed": 11.0})
        plant.reset(v=np.array([3.0, 3.0, 0.0]))
        reported = [(plant.measured, plant.state)]
        for _ in range(300):
            plant.exchange(np.array([24.0, 30.0, 0.0]))
            reported.append((plant.measured, plant.state))
        per_turn = np.array([1000, 1024])
        disc = np.floor(truth(reported, "theta_m")[:, :2] * per_turn / TURN)
        assert (np.diff(disc, axis=0) >= 0).all(), "one way only"
        lag = disc - rows(reported, "encoder_counts")[:, :2]
        edges = disc[-1] - disc[0]
        assert (edges > 8_000).all(), f"{edges} edges"
        expected, spread = missed * edges, np.sqrt(edges * missed * (1 - missed))
        assert abs(lag[-1, 0] - expected[0]) < SIGMAS * spread[0], "missed and not made up for"
        assert (np.diff(lag[:, 0]) >= 0).all(), "a counter that nobody sets right"
        index, pulses = rows(reported, "index_counts")[:, :2], rows(reported, "index_pulses")[:, :2]
        came = np.diff(pulses, axis=0) > 0
        # The index reports by how much the counter lags.
        latched = -index[1:, 0][came[:, 0]] % 1000
        assert (latched >= lag[:-1, 0][came[:, 0]]).all() and (
            latched <= lag[1:, 0][came[:, 0]]
        ).all()
        # Since the newest pulse about as many were missed as edges have passed.
        since = disc[1:, 1] % 1024
        bound = missed * 1024 + SIGMAS * math.sqrt(1024 * missed) + 5.0
        assert (lag[1:, 1] <= np.minimum(since, bound)).all() and (lag[:, 1] >= 0).all(), (
            "set right"
        )


def test_a_word_that_does_not_come_is_the_one_before(scene: Scene) -> None:
    plant = Plant(scene)
    set_all(plant, {"joints.turn.link_encoder.missed": 0.3, "seed": 3.0})
    plant.reset(v=np.array([4.0, 0.0, 0.0]))
    reported = [(plant.measured, plant.state)]
    for _ in range(2000):
        plant.exchange(np.array([30.0, 0.0, 0.0]))
        reported.append((plant.measured, plant.state))
    word = np.floor(truth(reported, "q")[:, 0] * 4096 / TURN) % 2**14
    given = rows(reported, "link_encoder_counts")[:, 0]
    moved = np.diff(word) != 0
    repeated = given[1:] == given[:-1]
    assert (repeated | (given[1:] == word[1:])).all(), "either the word or the one before"
    share, spread = repeated[moved].mean(), math.sqrt(0.3 * 0.7 / moved.sum())
    assert moved.sum() > 500, "it shall turn"
    assert share == pytest.approx(0.3, abs=SIGMAS * spread), "share of words that did not come"


def test_an_encoder_slips_while_the_machine_runs(scene: Scene) -> None:
    plant, other = Plant(scene), Plant(scene)
    for one in (plant, other):
        motion(one, np.random.default_rng(1), 60)
    before = plant.measured
    plant.set_parameter("joints.turn.encoder.offset", TURN / 8.0)
    assert same(plant.measured, before), "what was measured at this tick stays"
    for one in (plant, other):
        one.exchange(np.ones(3))
    np.testing.assert_array_equal(plant.state.q, other.state.q, "the motion is the same")
    slipped = plant.measured.encoder_counts - other.measured.encoder_counts
    assert slipped.tolist() == [125, 0, 0], "an eighth of 1000 counts"


def noisy(scene: Scene, seed: float) -> Plant:
    plant = Plant(scene)
    numbers = {one.name: 0.02 for one in scene.varied if one.name.endswith(("noise", "missed"))}
    set_all(plant, numbers | {"seed": seed})
    plant.reset()
    return plant


def test_the_same_seed_gives_the_same_bits_and_another_one_others(scene: Scene) -> None:
    one, again, other = (
        motion(noisy(scene, seed), np.random.default_rng(6), 100) for seed in (1.0, 1.0, 2.0)
    )
    assert all(same(a, b) for (a, _), (b, _) in zip(one, again, strict=True)), "the same seed"
    for name in ("encoder_counts", "current", "torque", "specific_force", "angular_rate"):
        assert not np.array_equal(rows(one, name), rows(other, name)), f"{name} of another seed"
    np.testing.assert_array_equal(truth(one, "q"), truth(other, "q"), "the same motion")


def test_steps_in_any_pieces_give_the_same_bits(scene: Scene) -> None:
    rng = np.random.default_rng(9)
    one, other = noisy(scene, 4.0), noisy(scene, 4.0)
    for _ in range(60):
        voltage = rng.normal(0.0, 20.0, 3)
        one.exchange(voltage)
        left = scene.steps_per_period
        while left:
            some = min(left, int(rng.integers(1, 4)))
            if rng.random() < 0.5:
                other.advance(voltage, some)
            else:
                other.run([voltage], some)
            left -= some
        mine, its = one.measured, other.measured
        for field in set(FIELDS) - {"applied"}:  # which only an exchange reports
            assert getattr(mine, field).tobytes() == getattr(its, field).tobytes(), field


def test_measurements_hold_until_the_next_tick(scene: Scene) -> None:
    plant = noisy(scene, 4.0)
    motion(plant, np.random.default_rng(2), 20)
    before = plant.measured
    plant.advance([20.0, 20.0, 20.0], scene.steps_per_period - 1)
    assert same(plant.measured, before), "between ticks"
    plant.advance([20.0, 20.0, 20.0], 1)
    assert not same(plant.measured, before), "at the tick"


def test_a_restored_machine_measures_on_to_the_last_bit(scene: Scene) -> None:
    one, other = noisy(scene, 4.0), noisy(scene, 9.0)
    motion(one, np.random.default_rng(2), 77)
    motion(other, np.random.default_rng(3), 33)
    other.restore(one.save())
    assert same(one.measured, other.measured), "at once"
    after = [motion(plant, np.random.default_rng(4), 100) for plant in (one, other)]
    assert all(same(a, b) for (a, _), (b, _) in zip(*after, strict=True)), "from there on"
    assert one.save() == other.save(), "all that the machine is"


def test_lanes_of_a_fleet_measure_as_single_arms(scene: Scene) -> None:
    """Each with a seed of its own; what is drawn is equal, the motions to some 1e-12."""
    rng, count = np.random.default_rng(10), 9  # more than a group
    numbers = {one.name: 0.02 for one in scene.varied if one.name.endswith(("noise", "missed"))}
    numbers |= {one.name: 1e-6 for one in scene.varied if one.name.endswith("resolution")}
    seeds = np.arange(count, dtype=float)
    fleets = [Fleet(scene, count, varied={**numbers, "seed": seeds}) for _ in range(2)]
    voltages = rng.normal(0.0, 20.0, (12, count, 3))
    steps = 7  # some rows end between two ticks
    for fleet in fleets:
        fleet.run(voltages, steps)
    for arm in range(count):
        mine = fleets[0][arm].measured
        assert same(mine, fleets[1][arm].measured), "two fleets"
        plant = noisy(scene, float(arm))
        set_all(plant, numbers)
        plant.reset()
        for row in voltages[:, arm]:
            plant.advance(row, steps)
        alone = plant.measured
        for field in FIELDS:
            # A motion that is off by 1e-12 may be at the edge of a count.
            atol = 1.0 if getattr(mine, field).dtype == np.int64 else 2e-6
            np.testing.assert_allclose(
                getattr(mine, field), getattr(alone, field), rtol=0, atol=atol, err_msg=field
            )
    for field in ("encoder_counts", "torque", "specific_force"):
        reported = [getattr(fleets[0][arm].measured, field).tobytes() for arm in range(count)]
        assert len(set(reported)) == count, f"each arm has noise of its own: {field}"
    alike = Fleet(scene, 2, varied={**numbers, "seed": 3.0})
    alike.run(voltages[:, 0], steps)
    assert same(alike[0].measured, alike[1].measured), "equal arms with equal seeds"
    np.testing.assert_array_equal(
        fleets[0].measured.encoder_counts,
        [fleets[0][k].measured.encoder_counts for k in range(count)],
    )


def test_real_time_measures_the_bits_of_exchanges(scene: Scene) -> None:
    timed, plant = noisy(scene, 4.0), noisy(scene, 4.0)
    loop = RealTimeLoop(timed, 10**6, scene.steps_per_period, -1)
    loop.command(0, np.array([10.0, 10.0, 10.0]))
    loop.start(0)
    reached = []
    while len(reached) < 40 and loop.wait(10.0):
        while (one := loop.take()) is not None:
            reached.append(one)
    loop.stop()
    assert len(reached) >= 40, "ticks of the loop"
    for one in reached:
        plant.exchange(np.array([10.0, 10.0, 10.0]))
        assert same(one.measured, plant.measured), f"tick {one.tick}"


def test_a_machine_put_elsewhere_is_measured_there_with_what_it_has_missed(scene: Scene) -> None:
    plant = Plant(scene)
    set_all(plant, {"joints.turn.encoder.missed": 0.05})
    plant.reset()
    motion(plant, np.random.default_rng(5), 200)
    lag = math.floor(plant.state.theta_m[0] * 1000 / TURN) - plant.measured.encoder_counts[0]
    pulses = plant.measured.index_pulses.tolist()
    assert lag != 0, "some shall be missed"
    drawn_state(np.random.default_rng(6), plant)
    x, measured = plant.state, plant.measured
    counts = np.floor(x.theta_m * np.array([1000, 1024, 1000]) / TURN)
    expected = [counts[0] - lag, counts[1], counts[2] % 1024]
    assert measured.encoder_counts.tolist() == expected, "no count was passed on the way"
    assert measured.index_pulses.tolist() == pulses, "nor an index"
    np.testing.assert_allclose(
        measured.current, x.current, atol=1e-12, err_msg="as if it had been so for long"
    )
    assert measured.link_encoder_counts[1] == math.floor(x.q[1] * 100_000)
    plant.reset()
    assert not plant.measured.index_pulses.any(), "a reset forgets"
    assert plant.measured.encoder_counts[0] == 0, "what was missed, too"


def test_a_machine_that_diverged_is_measured_where_it_stays(tmp_path: Path) -> None:
    joint = {"motor": MOTOR, "encoder": {"counts_per_turn": 1000, "index": "latch"}}
    joint["gear"] = {"ratio": 0.02, "stiffness": 1e9}  # which this scheme does not follow
    urdf_text = urdf()
    joints = {name: joint for name in ("turn", "slide", "hand")}
    scene = load_scene(
        write_scene(
            tmp_path, urdf_text, joints, integrator={"scheme": "paper", "dt": 1e-3}, gravity=GRAVITY
        )
    )
    plant = Plant(scene)
    with pytest.raises(Diverged):
        for _ in range(10_000):
            plant.exchange(np.array([40.0, -40.0, 40.0]))
    x, measured = plant.state, plant.measured
    shown = np.floor(x.theta_m * 1000 / TURN)
    np.testing.assert_array_equal(measured.encoder_counts, shown, "at the last sound state")
    np.testing.assert_array_equal(measured.current, x.current, "at the last sound state")


def test_without_sensors_the_core_has_none(scene: Scene, tmp_path: Path) -> None:
    """A plain encoder is not compiled; and sensors change nothing of the motion."""
    file = write(tmp_path)
    bare = {f"joints.*.{key}": None for key in ("link_encoder", "current_sensor", "torque_sensor")}
    bare |= {"imus": None, "seed": None, "varied": None}
    plain = bare | {"joints.*.encoder": {"counts_per_turn": 1000}}
    scenes = [load_scene(file, overrides) for overrides in (plain, bare)]
    units = [scene_unit(scene) for scene in scenes]
    assert [scene.sensed for scene in scenes] == [False, True]
    assert ["ensor" in unit for unit in units] == [False, True], units[0]
    kinds = {"kind": "incremental", "index": "none", "delay": 0, "counts_per_turn": 1000}
    reported = scene_unit(load_scene(file, bare | {"joints.*.encoder": kinds}))
    assert reported == units[0], "what is as it is anyway"
    plant = Plant(scenes[0])
    reported, untold = (
        motion(one, np.random.default_rng(3), 100) for one in (noisy(scene, 1.0), plant)
    )
    # Numbers that can be varied make another library, whose sums may be rounded otherwise.
    np.testing.assert_allclose(truth(reported, "q"), truth(untold, "q"), rtol=0, atol=1e-11)
    measured = plant.measured
    np.testing.assert_array_equal(measured.current, plant.state.current)
    for field in OF_SENSORS:
        assert not getattr(measured, field).any(), f"{field} of no sensor"


def test_a_client_of_version_1_is_served(scene: Scene) -> None:
    """Its structs are shorter: nothing is written behind their ends."""
    plant = Plant(scene)
    plant.exchange(np.ones(3))
    measurement = plant.measurement
    short, size = ARM.ffi.offsetof("arm_measurement", "sensors"), ARM.sizeof("arm_measurement")
    one = ARM.ffi.new("arm_measurement *")
    room = ARM.ffi.buffer(one)
    room[:] = bytes(ARM.ffi.buffer(measurement, short)) + b"\xab" * (size - short)
    one.size = short
    assert plant.core.arm_measure(plant.machine, one) == 0, "the struct of version 1"
    assert room[short:] == b"\xab" * (size - short), "behind its end"
    one.size = short - 1
    assert plant.core.arm_measure(plant.machine, one) == 1, "one that is too short"


def test_a_servo_holds_and_moves_an_arm_by_words_and_noisy_sensors() -> None:
    """As with counts that go on; noise moves the links by no more than it states of them."""
    encoder = {"kind": "absolute", "counts_per_turn": 1024, "bits": 16, "noise": 0.0}
    numbers = {"joints.*.encoder": encoder, "joints.*.current_sensor": {"noise": 0.0}}
    scene = load_scene("three_axis", {**numbers, "varied": ["joints.*.*.noise"]})
    plain = load_scene("three_axis")
    servo = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    with pytest.raises(Refusal, match=r"servo.joints.waist.encoder_bits must be .* 16, got 0"):
        check_joints(scene, servo)
    joints = tuple(dataclasses.replace(joint, encoder_bits=16) for joint in servo.joints)
    words = dataclasses.replace(servo, joints=joints)
    check_joints(scene, words)
    with pytest.raises(Refusal, match=r"servo.joints.waist.encoder_bits must be .* 0, got 16"):
        check_joints(plain, words)
    one, other = run(plain, servo), run(scene, words)
    # The counts are the same, but for angles at the very edge of one.
    np.testing.assert_allclose(other.off, one.off, rtol=0, atol=1e-9, err_msg="the motion")
    count = TURN / 1024
    sigma = 3.0 * count  # of the motor's angle; and 0.05 A
    varied = tuple(
        dataclasses.replace(number, value=sigma if "encoder" in number.name else 0.05)
        for number in scene.varied
    )
    noisy = run(dataclasses.replace(scene, varied=varied), words)
    at_link = scene.gear_ratios * (sigma + count)
    assert (noisy.swing < 6.0 * at_link).all(), f"at rest: {noisy.swing} of {at_link}"
    worse = np.abs(noisy.off).max(axis=0) - np.abs(one.off).max(axis=0)
    assert (worse < 6.0 * at_link).all(), f"on the way: {worse} of {at_link}"


def test_a_delay_is_dead_time_of_the_loop() -> None:
    """Small motions are as predicted: 7 periods are too many."""
    scene = load_scene(
        "three_axis", {"joints.*.encoder.delay": 7, "joints.*.current_sensor.delay": 7}
    )
    servo = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    plain = load_scene("three_axis")
    spare = min(one.delay for one in ServoLoops(plain, servo).margins())
    assert 5.0 < spare < 7.0, "servo periods that the loop may come late"
    assert ServoLoops(plain, servo).unstable() is None, "without delay"
    assert ServoLoops(scene, servo).unstable() is not None, "with more than that"
    swing = [run(one, servo).swing for one in (plain, scene)]
    assert swing[1].max() > 20.0 * swing[0].max(), f"it swings by itself: {swing}"


BAD: list[tuple[dict[str, Any], str]] = [
    ({"joints.turn.encoder.kind": "optical"}, "turn.encoder.kind must be one of the known, got 'optical'; valid: incremental, absolute"),
    ({"joints.turn.encoder.counts_per_turn": 0}, "turn.encoder.counts_per_turn must be a whole number from 1 to"),
    ({"joints.turn.encoder.index": "once"}, "turn.encoder.index must be one of the known, got 'once'; valid: none, latch, correct"),
    ({"joints.turn.encoder.bits": 12}, "turn.encoder.bits must belong to an encoder of kind absolute, got incremental"),
    ({"joints.hand.encoder.bits": None}, "hand.encoder.bits must be a whole number from 10 to 48, got nothing"),
    ({"joints.hand.encoder.bits": 9}, "hand.encoder.bits must be a whole number from 10 to 48, got 9"),
    ({"joints.hand.encoder.bits": 49}, "hand.encoder.bits must be a whole number from 10 to 48, got 49"),
    ({"joints.hand.encoder.index": "latch"}, "hand.encoder.index must be left out of an encoder of kind absolute, got 'latch'"),
    ({"joints.turn.encoder.delay": 0.5}, "turn.encoder.delay must be a whole number from 0 to 100 servo periods, got 0.5"),
    ({"joints.turn.encoder.delay": 101}, "turn.encoder.delay must be a whole number from 0 to 100 servo periods, got 101"),
    ({"joints.turn.encoder.delay": -1}, "turn.encoder.delay must be a whole number from 0 to 100 servo periods, got -1"),
    ({"joints.turn.encoder.offset": 2e4}, "turn.encoder.offset must be a number from -10000 to 10000 rad, got 20000"),
    ({"joints.turn.encoder.eccentricity": -0.1}, "turn.encoder.eccentricity must be a number from 0 to 1 rad, got -0.1"),
    ({"joints.turn.encoder.eccentricity": None}, "turn.encoder.eccentricity_phase must come with a key eccentricity, got alone"),
    ({"joints.turn.encoder.eccentricity_phase": -2e4}, "turn.encoder.eccentricity_phase must be a number from -10000 to 10000 rad, got -20000"),
    ({"joints.turn.encoder.ripple": 1.5}, "turn.encoder.ripple must be a number from 0 to 1 rad, got 1.5"),
    ({"joints.turn.encoder.ripple": None}, "turn.encoder.ripple_order must come with a key ripple, got alone"),
    ({"joints.turn.encoder.ripple_order": 0}, "turn.encoder.ripple_order must be a whole number from 1 to 1000000, got 0"),
    ({"joints.turn.encoder.ripple_phase": "up"}, "turn.encoder.ripple_phase must be a number from -10000 to 10000 rad, got 'up'"),
    ({"joints.turn.encoder.noise": -1e-3}, "turn.encoder.noise must be a number from 0 to 1 rad, got -0.001"),
    ({"joints.turn.encoder.missed": 0.6}, "turn.encoder.missed must be a number from 0 to 0.5, got 0.6"),
    ({"joints.turn.encoder.colour": 1}, "key joints.turn.encoder.colour must be known, got 'colour'; valid: bits, counts_per_turn, delay"),
    ({"joints.turn.link_encoder.bits": 3}, "turn.link_encoder.bits must be a whole number from 12 to 48, got 3"),
    ({"joints.turn.link_encoder": 3}, "turn.link_encoder must be a section of keys and values, got 3"),
    ({"joints.turn.current_sensor.gain_error": 2}, "turn.current_sensor.gain_error must be a number from -1 to 1, got 2"),
    ({"joints.turn.current_sensor.offset": 1e7}, "turn.current_sensor.offset must be a number from -1e+06 to 1e+06 A, got 10000000"),
    ({"joints.turn.current_sensor.noise": -1}, "turn.current_sensor.noise must be a number from 0 to 1e+06 A, got -1"),
    ({"joints.turn.current_sensor.range": 0}, "turn.current_sensor.range must be a number > 0 A, got 0"),
    ({"joints.turn.current_sensor.resolution": 0}, "turn.current_sensor.resolution must be a number > 0 A, got 0"),
    ({"joints.turn.current_sensor.delay": 1e3}, "turn.current_sensor.delay must be a whole number from 0 to 100 servo periods, got 1000"),
    ({"joints.slide.torque_sensor.noise": "loud"}, "slide.torque_sensor.noise must be a number from 0 to 1e+06 N m, got 'loud'"),
    ({"joints.slide.torque_sensor.range": -1}, "slide.torque_sensor.range must be a number > 0 N m, got -1"),
    ({"joints.slide.motor": None, "joints.slide.gear": None}, "slide.encoder must belong to a joint with a motor, got no motor section"),
    ({"joints.slide.motor": None, "joints.slide.gear": None, "joints.slide.encoder": None}, "slide.torque_sensor must belong to a joint with a motor"),
    ({"joints.turn.motor": None, "joints.turn.gear": None, "joints.turn.encoder": None}, "turn.current_sensor must belong to a joint with a motor"),
    ({"imus": 3}, "imus must be a section of keys and values, got 3"),
    ({"imus.at_hand": None, "imus.late.link": None}, "imus.late.link must be a text, got nothing"),
    ({"imus.at_hand.link": "base"}, "imus.at_hand.link must be a link that a joint moves, got base; valid: turn_link, slide_link, hand_link, tip_link"),
    ({"imus.at_hand.xyz": [0, 0]}, "imus.at_hand.xyz must be 3 numbers within +-100 m, got [0, 0]"),
    ({"imus.at_hand.rpy": [0, 0, 1e3]}, "imus.at_hand.rpy must be 3 numbers within +-100 rad"),
    ({"imus.at_hand.delay": -1}, "imus.at_hand.delay must be a whole number from 0 to 100 servo periods, got -1"),
    ({"imus.at_hand.accelerometer.noise": -1}, "imus.at_hand.accelerometer.noise must be a number from 0 to 1e+06 m/s2, got -1"),
    ({"imus.at_hand.accelerometer.offset": 1}, "key imus.at_hand.accelerometer.offset must be known, got 'offset'; valid: bias_x"),
    ({"imus.at_hand.gyroscope.bias_x": "up"}, "imus.at_hand.gyroscope.bias_x must be a number from -1e+06 to 1e+06 rad/s, got 'up'"),
    ({"imus.at_hand.gyroscope.range": 0}, "imus.at_hand.gyroscope.range must be a number > 0 rad/s, got 0"),
    ({"imus.at_hand.colour": 1}, "key imus.at_hand.colour must be known, got 'colour'"),
    ({"seed": -1}, "seed must be a whole number from 0 to 9007199254740992, got -1"),
    ({"seed": 0.5}, "seed must be a whole number from 0 to"),
    ({"varied": ["joints.hand.current_sensor.noise"]}, "varied must name numbers of this scene that can be varied, got joints.hand.current_sensor.noise"),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "words"), BAD, ids=lambda value: str(value)[:50])
def test_bad_values_are_refused_in_one_line(
    overrides: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(Refusal, match=re.escape(words)) as refusal:
        load_scene(write(tmp_path), {"varied": [], **overrides})
    assert "\n" not in str(refusal.value)


def test_every_number_that_is_given_can_be_varied_within_its_bounds(scene: Scene) -> None:
    names = {one.name for one in scene.varied}
    assert {f"joints.turn.encoder.{key}" for key in ERRORS} - names == {
        "joints.turn.encoder.ripple_order"  # which is structure
    }
    assert {f"imus.at_hand.gyroscope.{key}" for key in AXES} <= names and "seed" in names
    plant = Plant(scene)
    for one in scene.varied:
        for value in (one.number.least, one.number.most):
            plant.set_parameter(one.name, value)
            assert plant.parameters[one.name] == value, one.name
        with pytest.raises(Refusal, match=re.escape(one.name)):
            plant.set_parameter(one.name, one.number.most * 1.1)
        plant.set_parameter(one.name, one.value)
    before = dataclasses.astuple(plant.state)
    plant.reset()
    for was, now in zip(before, dataclasses.astuple(plant.state), strict=True):
        np.testing.assert_array_equal(was, now, "after numbers that were set and set back")

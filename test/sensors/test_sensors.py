"""Sensors: readings of a known motion, noise, faults, and the same bits always."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import CONFIG
from sensed_machine import (
    AXES,
    DRAWS,
    ERRORS,
    SIGMAS,
    TURN,
    late,
    motion,
    noisy,
    rows,
    set_all,
    truth,
    write,
)

from arm_emulator import Plant, Refusal, Scene, load_scene, load_servo_config
from arm_emulator.analysis.servo_loop import ServoLoops
from arm_emulator.design.tuned import run_move
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.outputs import ALWAYS, KNOWN
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.runs.gains import check_joints

OF_SENSORS = [name for name, output in KNOWN.items() if output not in ALWAYS]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write(tmp_path_factory.mktemp("sensed")))


def test_without_errors_sensors_report_the_truth(scene: Scene) -> None:
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
    np.testing.assert_array_equal(link[:, 1], late(scale, 4), "later than all other sensors")
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
    from scipy import stats

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
    faulty, ideal = Plant(scene), Plant(scene)  # with errors and without
    x = rows(motion(ideal, np.random.default_rng(8), 300), field)[(slice(None), *place)]
    x = x.reshape(len(x), -1)
    gain, biases = float(rng.uniform(-0.2, 0.2)), rng.normal(size=3)
    expected = (1.0 + gain) * x + biases[: x.shape[1]]
    limit = float(np.median(np.abs(expected)))  # so that half of them are beyond
    res = limit * float(rng.uniform(0.01, 0.1))
    numbers = {"gain_error": gain, "resolution": res, "range": limit}
    keys = ("offset",) if name.endswith("_sensor") else ("bias_x", "bias_y", "bias_z")
    numbers |= dict(zip(keys, map(float, biases), strict=False))
    set_all(faulty, {f"{name}.{key}": value for key, value in numbers.items()})
    faulty.reset()
    y = rows(motion(faulty, np.random.default_rng(8), 300), field)[(slice(None), *place)]
    y, expected = y.reshape(len(y), -1), np.clip(expected, -limit, limit)
    steps = y / res
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-9, err_msg="multiples")
    assert np.abs(y - expected).max() <= 0.5 * res * (1.0 + 1e-9), "rounded to the next multiple"
    assert np.abs(y).max() <= limit + 0.5 * res, "limited"


def test_a_drift_grows_with_time_and_ends_with_a_reset(scene: Scene) -> None:
    plant = Plant(scene)
    set_all(plant, {"joints.turn.current_sensor.drift": 0.5})
    for _ in range(2):
        plant.reset()
        assert plant.measured.current[0] == plant.state.current[0], "none at the start"
        for _ in range(20):
            plant.exchange([3.0, 0.0, 0.0])
            off = plant.measured.current[0] - plant.state.current[0]
            # A in so many seconds; the sensor rounds to 1e-12 A.
            assert off == pytest.approx(0.5 * plant.t, rel=1e-9, abs=1e-12)


def test_readings_of_a_unit_are_lost_independently(scene: Scene) -> None:
    """Each of the six channels keeps its reading in half of the ticks."""
    plant = Plant(scene)
    names = ("accelerometer", "gyroscope")
    set_all(plant, {f"imus.at_hand.{name}.held": 0.5 for name in names})
    reported = motion(plant, np.random.default_rng(6), 600)
    channels = (rows(reported, name)[:, 0] for name in ("specific_force", "angular_rate"))
    is_repeated = np.diff(np.hstack([*channels]), axis=0) == 0.0
    shares = is_repeated.mean(axis=0)
    assert np.abs(shares - 0.5).max() < 5.0 * 0.5 / math.sqrt(len(is_repeated)), "five deviations"
    together = np.corrcoef(is_repeated.T) - np.eye(6)
    assert np.abs(together).max() < 5.0 / math.sqrt(len(is_repeated)), (
        "five deviations, of independent ones"
    )


@pytest.mark.slow
def test_without_sensors_the_core_has_none(scene: Scene, tmp_path: Path) -> None:
    """A plain encoder is not compiled; and sensors change nothing of the motion."""
    file = write(tmp_path)
    bare = {f"joints.*.{key}": None for key in ("link_encoder", "current_sensor", "torque_sensor")}
    bare |= {"imus": None, "seed": None, "varied": None}
    plain = bare | {"joints.*.encoder": {"counts_per_turn": 1000}}
    scenes = [load_scene(file, overrides) for overrides in (plain, bare)]
    units = [write_scene_unit(scene) for scene in scenes]
    assert [scene.has_sensor_errors for scene in scenes] == [False, True]
    assert ["ensor" in unit for unit in units] == [False, True], units[0]
    kinds = {"kind": "incremental", "index": "none", "delay": 0, "counts_per_turn": 1000}
    reported = write_scene_unit(load_scene(file, bare | {"joints.*.encoder": kinds}))
    assert reported == units[0], "what is as it is anyway"
    plant = Plant(scenes[0])
    reported, untold = (
        motion(machine, np.random.default_rng(3), 100) for machine in (noisy(scene, 1.0), plant)
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
    short, size = ARM.ffi.offsetof("arm_measurement", "sensors"), ARM.get_size("arm_measurement")
    struct = ARM.ffi.new("arm_measurement *")
    room = ARM.ffi.buffer(struct)
    room[:] = bytes(ARM.ffi.buffer(measurement, short)) + b"\xab" * (size - short)
    struct.size = short
    assert plant.core.arm_measure(plant.machine, struct) == 0, "the struct of version 1"
    assert room[short:] == b"\xab" * (size - short), "behind its end"
    struct.size = short - 1
    assert plant.core.arm_measure(plant.machine, struct) == 1, "one that is too short"


@pytest.mark.slow
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
    counted, worded = run_move(plain, servo), run_move(scene, words)
    # The counts are the same, but for angles at the very edge of one.
    np.testing.assert_allclose(worded.off, counted.off, rtol=0, atol=1e-9, err_msg="the motion")
    count = TURN / 1024
    sigma = 3.0 * count  # of the motor's angle; and 0.05 A
    varied = tuple(
        dataclasses.replace(number, value=sigma if "encoder" in number.name else 0.05)
        for number in scene.varied
    )
    noisy = run_move(dataclasses.replace(scene, varied=varied), words)
    at_link = scene.gear_ratios * (sigma + count)
    assert (noisy.swing < 6.0 * at_link).all(), f"at rest: {noisy.swing} of {at_link}"
    worse = np.abs(noisy.off).max(axis=0) - np.abs(counted.off).max(axis=0)
    assert (worse < 6.0 * at_link).all(), f"on the way: {worse} of {at_link}"


@pytest.mark.slow
def test_a_delay_is_dead_time_of_the_loop() -> None:
    """Small motions are as predicted: 7 periods are too many."""
    scene = load_scene(
        "three_axis", {"joints.*.encoder.delay": 7, "joints.*.current_sensor.delay": 7}
    )
    servo = load_servo_config(CONFIG / "servo" / "three_axis.yaml")
    plain = load_scene("three_axis")
    spare = min(margin.delay for margin in ServoLoops(plain, servo).compute_margins())
    assert 5.0 < spare < 7.0, "servo periods that the loop may come late"
    assert ServoLoops(plain, servo).find_unstable() is None, "without delay"
    assert ServoLoops(scene, servo).find_unstable() is not None, "with more than that"
    swing = [run_move(machine, servo).swing for machine in (plain, scene)]
    assert swing[1].max() > 20.0 * swing[0].max(), f"it swings by itself: {swing}"


BAD: list[tuple[dict[str, Any], str]] = [
    ({"joints.turn.encoder.kind": "optical"}, "turn.encoder.kind must be one of the known, got 'optical'; valid: incremental, absolute"),
    ({"joints.turn.encoder.index": "once"}, "turn.encoder.index must be one of the known, got 'once'; valid: none, latch, correct"),
    ({"joints.turn.encoder.bits": 12}, "turn.encoder.bits must belong to an encoder of kind absolute, got incremental"),
    ({"joints.hand.encoder.bits": None}, "hand.encoder.bits must be a whole number from 10 to 48, got nothing"),
    ({"joints.hand.encoder.bits": 9}, "hand.encoder.bits must be a whole number from 10 to 48, got 9"),
    ({"joints.hand.encoder.index": "latch"}, "hand.encoder.index must be left out of an encoder of kind absolute, got 'latch'"),
    ({"joints.turn.encoder.delay": 0.5}, "turn.encoder.delay must be a whole number from 0 to 100 servo periods, got 0.5"),
    ({"joints.turn.encoder.eccentricity": None}, "turn.encoder.eccentricity_phase must come with a key eccentricity, got alone"),
    ({"joints.turn.encoder.ripple": None}, "turn.encoder.ripple_order must come with a key ripple, got alone"),
    ({"joints.turn.encoder.colour": 1}, "key joints.turn.encoder.colour must be known, got 'colour'; valid: bits, counts_per_turn, delay"),
    ({"joints.turn.link_encoder.bits": 3}, "turn.link_encoder.bits must be a whole number from 12 to 48, got 3"),
    ({"joints.turn.link_encoder": 3}, "turn.link_encoder must be a section of keys and values, got 3"),
    ({"joints.slide.motor": None, "joints.slide.gear": None}, "slide.encoder must belong to a joint with a motor, got no motor section"),
    ({"joints.slide.motor": None, "joints.slide.gear": None, "joints.slide.encoder": None}, "slide.torque_sensor must belong to a joint with a motor"),
    ({"joints.turn.motor": None, "joints.turn.gear": None, "joints.turn.encoder": None}, "turn.current_sensor must belong to a joint with a motor"),
    ({"imus": 3}, "imus must be a section of keys and values, got 3"),
    ({"imus.at_hand": None, "imus.late.link": None}, "imus.late.link must be a text, got nothing"),
    ({"imus.at_hand.link": "base"}, "imus.at_hand.link must be a link that a joint moves, got base; valid: turn_link, slide_link, hand_link, tip_link"),
    ({"imus.at_hand.xyz": [0, 0]}, "imus.at_hand.xyz must be 3 numbers within +-100 m, got [0, 0]"),
    ({"imus.at_hand.rpy": [0, 0, 1e3]}, "imus.at_hand.rpy must be 3 numbers within +-100 rad"),
    ({"imus.at_hand.accelerometer.offset": 1}, "key imus.at_hand.accelerometer.offset must be known, got 'offset'; valid: bias_x"),
    ({"imus.at_hand.gyroscope.range": 0}, "imus.at_hand.gyroscope.range must be a number > 0 rad/s, got 0"),
    ({"imus.at_hand.colour": 1}, "key imus.at_hand.colour must be known, got 'colour'"),
    ({"seed": -1}, "seed must be a whole number from 0 to 9007199254740992, got -1"),
    ({"varied": ["joints.hand.current_sensor.noise"]}, "varied must name numbers of this scene that can be varied, got joints.hand.current_sensor.noise"),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "words"), BAD, ids=lambda value: str(value)[:50])
def test_bad_values_are_refused_in_a_line(
    overrides: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(Refusal, match=re.escape(words)) as refusal:
        load_scene(write(tmp_path), {"varied": [], **overrides})
    assert "\n" not in str(refusal.value)


def test_every_number_of_a_sensor_can_be_varied_within_its_bounds(scene: Scene) -> None:
    names = {number.name for number in scene.varied}
    assert {f"joints.turn.encoder.{key}" for key in ERRORS} - names == {
        "joints.turn.encoder.ripple_order"  # which is structure
    }
    assert {f"imus.at_hand.gyroscope.{key}" for key in AXES} <= names and "seed" in names
    plant = Plant(scene)
    for number in scene.varied:
        for value in (number.number.least, number.number.most):
            plant.set_parameter(number.name, value)
            assert plant.parameters[number.name] == value, number.name
        with pytest.raises(Refusal, match=re.escape(number.name)):
            plant.set_parameter(number.name, number.number.most * 1.1)
        plant.set_parameter(number.name, number.value)
    before = dataclasses.astuple(plant.state)
    plant.reset()
    for was, now in zip(before, dataclasses.astuple(plant.state), strict=True):
        np.testing.assert_array_equal(was, now, "after numbers that were set and set back")

"""Closed loops of a fleet in C: each arm does what machine and servo do alone."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from hard_cases import EARTH, Rod, chain
from machines import SENSED
from test_fleet_step import COUNT, LOCATED

from arm_emulator.base.refusal import Refusal
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.runs.gains import load_gains
from arm_emulator.servo.servo_arm import ServoArm, Target
from arm_emulator.toolchain.cxx import run_compiler
from arm_emulator_fleet.fleet import Fleet
from arm_emulator_fleet.fleet_control import FleetControl
from arm_emulator_fleet.fleet_schedule import FleetWay
from arm_emulator_fleet.servo_fleet import ServoFleet
from arm_emulator_fleet.unit import FOLDER

STICKING: dict[str, Any] = {**LOCATED, "joints.*.friction.coulomb": 2.0}
BEARINGS: dict[str, Any] = {
    "joints.waist.bearing.tilt_x": {"stiffness": 2e4, "damping": 20.0},
    "joints.shoulder.bearing.tilt_z": {"stiffness": 3e4, "damping": 20.0},
    "joints.shoulder.bearing.shift_x": {"stiffness": 1e6, "damping": 1e3},
}
SCENES: dict[str, tuple[str, dict[str, Any]]] = {
    "three_axis": ("three_axis", STICKING),
    "bearings": ("three_axis", {**STICKING, **BEARINGS}),
    "ur5": ("ur5", {}),
    "panda": ("panda", {}),
}


@pytest.fixture(scope="module", params=some(SCENES, 1))
def scene(request: pytest.FixtureRequest) -> Scene:
    name, overrides = SCENES[request.param]
    return load_scene(name, overrides)


@pytest.fixture
def three_axis() -> Scene:
    name, overrides = SCENES["three_axis"]
    return load_scene(name, overrides)


def targets(scene: Scene, rng: np.random.Generator, periods: int) -> tuple[np.ndarray, np.ndarray]:
    """Swings of every joint that reverse, rest for a while, and are too quick for some motors."""
    shape = 1, COUNT, len(scene.joints)
    size, rate = rng.uniform(-0.4, 0.4, shape), rng.uniform(5.0, 40.0, shape)
    t = scene.servo_period * np.arange(periods)[:, None, None]
    t = np.where(np.arange(COUNT)[None, :, None] % 3 == 0, np.minimum(t, 0.05), t)
    moves = np.gradient(t, scene.servo_period, axis=0)
    return scene.start + size * (1 - np.cos(rate * t)), size * rate * np.sin(rate * t) * moves


def coulomb(scene: Scene, rng: np.random.Generator) -> dict[str, np.ndarray]:
    names = (number.name for number in scene.varied if number.name.endswith("coulomb"))
    return {name: rng.uniform(0.5, 4.0, COUNT) for name in names}


@pytest.mark.parametrize("device", [None, "processor"])
def test_every_arm_moves_as_machine_and_servo_alone(scene: Scene, device: str | None) -> None:
    rng = np.random.default_rng(7)
    periods = 240
    q, v = targets(scene, rng, periods)
    varied, servo = coulomb(scene, rng), load_gains(scene.where.removesuffix(".yaml")).servo
    workers = 2 if device is None else None
    fleet = Fleet(scene, COUNT, varied=varied, workers=workers, device=device)
    assert fleet.lanes > 1, "lanes"
    servos = ServoFleet(fleet, servo)
    servos.aim(q[::2], v[::2], every=2)
    links = np.zeros((periods, COUNT, len(scene.joints)))
    off = np.arange(COUNT) % 4 == 1
    fleet.follow(servos, 100, links=links[:100])
    fleet.powered = ~off
    fleet.follow(servos, 60, links=links[100:160])
    fleet.powered = True
    frame = fleet.follow(servos, 80, links=links[160:])
    results = frame.q, frame.faults, frame.measured.encoder_counts
    q_end, faults, counts = (to_numpy(rows) for rows in results)
    assert np.array_equal(q_end, links[-1]) and (faults == -1).all()
    assert np.array_equal(counts, fleet.measured.encoder_counts)
    rested = 0
    for arm in range(COUNT):
        plant, drives = Plant(scene), ServoArm(servo)
        for name, values in varied.items():
            plant.set_parameter(name, float(values[arm]))
        plant.reset()
        drives.servo.arm.motion_period = 2 * round(scene.servo_period * 1e9)
        for tick in range(periods):
            if tick in (100, 160):
                plant.powered = not (off[arm] and tick == 100)
            observed = plant.measured
            counts, now = observed.encoder_counts, round(tick * scene.servo_period * 1e9)
            drives.take_measurement(
                now, counts, observed.current, observed.applied, observed.brake_closed
            )
            if tick % 2 == 0:
                drives.set_target(Target(q[tick, arm], v[tick, arm]))
            plant.exchange(drives.compute_commands(plant.powered))
            rested += int((plant.state.v == 0.0).sum())
            np.testing.assert_array_equal(links[tick, arm], plant.state.q, f"{arm} {tick}")
    assert rested > 100, f"joints rest in {rested} periods: the test relies on that"


def to_numpy(rows: Any) -> np.ndarray:
    return rows if isinstance(rows, np.ndarray) else np.asarray(rows.numpy())


def test_rows_that_state_their_periods_hold_from_these_on(three_axis: Scene) -> None:
    """Each arm does what machine and servo alone do with the row of each period."""
    rng, rows, periods = np.random.default_rng(12), 4, 40
    servo = load_gains("three_axis").servo
    since = np.arange(rows) * 7 + rng.integers(0, 6, (COUNT, rows))
    since[:, 0] = 0
    q = three_axis.start + rng.uniform(-0.2, 0.2, (COUNT, rows, 3))
    fleet = Fleet(three_axis, COUNT, workers=1)
    servos = ServoFleet(fleet, servo)
    servos.aim_at(since.ravel(), q.reshape(-1, 3), np.arange(COUNT + 1) * rows)
    links = np.zeros((periods, COUNT, 3))
    fleet.follow(servos, periods, links=links)
    for arm in (0, COUNT - 1):
        plant, drives = Plant(three_axis), ServoArm(servo)
        for tick in range(periods):
            observed, now = plant.measured, round(tick * three_axis.servo_period * 1e9)
            drives.take_measurement(
                now,
                observed.encoder_counts,
                observed.current,
                observed.applied,
                observed.brake_closed,
            )
            row = np.flatnonzero(since[arm] <= tick)[-1]
            drives.set_target(Target(q[arm, row]))
            plant.exchange(drives.compute_commands(plant.powered))
            np.testing.assert_array_equal(links[tick, arm], plant.state.q, f"{arm} {tick}")


def test_an_arm_moves_as_with_changed_neighbours_and_pieces(scene: Scene) -> None:
    """To the last bit: resets of some, periods in pieces, other arms beside it."""
    q, v = targets(scene, np.random.default_rng(8), 120)
    servo = load_gains(scene.where.removesuffix(".yaml")).servo
    fleet = Fleet(scene, COUNT, workers=1)
    servos = ServoFleet(fleet, servo)
    servos.aim(q, v)
    full = fleet.follow(servos, 120).q.copy()
    some_arms = np.arange(COUNT) % 2 == 0
    fleet.reset()
    servos.reset()
    fleet.follow(servos, 57)
    fleet.reset(some_arms)
    servos.reset(some_arms)
    for _ in range(63):
        frame = fleet.follow(servos, 1)
    assert np.array_equal(frame.q[~some_arms], full[~some_arms])
    fleet.follow(servos, 57, out=frame)
    assert np.array_equal(frame.q[some_arms], full[some_arms])


@pytest.mark.slow
def test_neighbours_whose_joints_stick_change_no_bit(tmp_path: Path) -> None:
    """Four joints: with three, code for lanes with a locked joint and for others rounded alike."""
    motor = {"torque_constant": 0.15, "back_emf_constant": 0.15, "resistance": 0.8}
    motor |= {"inductance": 8e-4, "rotor_inertia": 6e-5}
    gear = {"ratio": 0.01, "stiffness": 2e4, "damping": 10.0}
    joint = {"motor": motor, "gear": gear, "friction": {"viscous": 0.1, "coulomb": 1.0}}
    rods = [Rod(0.3, 1.0, 0.02, axis) for axis in 2 * ("0 0 1", "0 1 0")]
    file = chain("rods", rods, tmp_path, joint, gravity=EARTH)
    keys = {"integrator.events": "located", "integrator.scheme": "extrapolated"}
    scene, rng = load_scene(file, keys), np.random.default_rng(3)
    q, V = rng.uniform(-1.0, 1.0, (COUNT, 4)), rng.uniform(-12.0, 12.0, (60, COUNT, 4))
    order, rested = np.roll(np.arange(COUNT), 1), 0
    fleet, second = Fleet(scene, COUNT, q=q, workers=1), Fleet(scene, COUNT, q=q[order], workers=1)
    for row in V:
        fleet.exchange(row)
        second.exchange(row[order])
        v = fleet.state.v
        assert np.array_equal(second.state.v, v[order])
        rested += int((v == 0.0).any(axis=1).sum())
    assert 0 < rested < len(V) * COUNT / 2, "some arms have a joint that sticks, others do not"


# A law that reads all that rows of lanes have, and the same arm by arm.
ROWS = """
#include "arm_fleet.h"
typedef struct law { int32_t joints, spoiled, periods[16]; } law;
static double command_of(int64_t encoder, double current, double applied, int64_t brake, int on) {
  return on && !brake ? 0.3 - 0.01 * encoder - 0.05 * current + 0.1 * applied : 0.0;
}
void by_arm(void* with, int32_t first, int32_t arms, const arm_joint_measurement* joint,
            const uint8_t* powered, arm_joint_command* command) {
  law* one = (law*)with;
  for (int32_t k = first; k < first + arms; ++k)
    for (int32_t j = k * one->joints; j < (k + 1) * one->joints; ++j)
      command[j].value = command_of(joint[j].encoder, joint[j].current, joint[j].applied,
                                    joint[j].brake, powered[k]);
}
void by_rows(void* with, const arm_fleet_rows* rows) {
  law* one = (law*)with;
  for (int32_t l = 0; l < rows->arms; ++l) {
    ++one->periods[rows->first + l];
    for (int32_t j = 0; j < one->joints; ++j) {
      const int32_t at = j * rows->lanes + l;
      rows->value[at] = command_of(rows->encoder[at], rows->current[at], rows->applied[at],
                                   rows->brake[at], rows->powered[l]);
      if (rows->first + l == one->spoiled) rows->value[at] = 0.0 / 0.0;
    }
  }
}
#ifdef ARM_ADDRESS /* of kernels */
ARM_ADDRESS(law_by_arm, by_arm)
ARM_ADDRESS(law_by_rows, by_rows)
#endif
"""


def compiled(folder: Path, text: str) -> ctypes.CDLL:
    source, built = folder / "mine.c", folder / "mine.so"
    source.write_text(text)
    warnings = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    command = ["cc", *warnings, "-shared", "-fPIC", "-ffp-contract=off"]
    command += [f"-I{BOUNDARY}", f"-I{FOLDER}", str(source), "-o", str(built)]
    run_compiler(command, folder, "mine", "mine.c")
    return ctypes.CDLL(str(built))


def address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0


def test_code_of_users_over_rows_of_lanes(tmp_path: Path, three_axis: Scene) -> None:
    """It moves the arms as the same law does arm by arm, and in Python: gliding, cut, braked."""
    law = compiled(tmp_path, ROWS)
    fleets = [Fleet(three_axis, COUNT, workers=2) for _ in range(2)]
    second = Fleet(three_axis, COUNT)
    keeps = np.array([len(three_axis.joints), -1, *[0] * 16], np.int32)
    in_rows = FleetControl(address(law.by_rows), keeps.ctypes.data, in_lanes=True)
    controls = in_rows, FleetControl(address(law.by_arm), keeps.ctypes.data)
    off = np.arange(COUNT) % 4 == 1
    links = np.zeros((2, 90, COUNT, len(three_axis.joints)))
    for fleet, control, rows in zip(fleets, controls, links, strict=True):
        fleet.follow(control, 30, links=rows[:30])
        fleet.powered = ~off
        fleet.follow(control, 30, links=rows[30:60])
        fleet.powered = True
        fleet.follow(control, 30, links=rows[60:])
    assert np.array_equal(links[0], links[1])
    for period in range(90):
        on = ~off if 30 <= period < 60 else np.ones(COUNT, bool)
        second.powered, observed = on, second.measured
        requested = (
            0.3 - 0.01 * observed.encoder_counts - 0.05 * observed.current + 0.1 * observed.applied
        )
        second.exchange(np.where(on[:, None] & (observed.brake_closed == 0), requested, 0.0))
        assert np.array_equal(second.state.q, links[0, period]), period
    assert fleets[0].measured.applied.any(axis=1).all() and np.ptp(links[0], axis=0).max() > 1e-3
    assert not np.array_equal(links[0, -1, 0], links[0, -1, 1]), "an arm that was cut"
    assert (keeps[2 : 2 + COUNT] == 90).all() and (keeps[2 + COUNT :] == 0).all()
    keeps[1] = 9
    with pytest.raises(Refusal, match=r"Fleet\.follow: arm 9: .* must be finite, got nan"):
        fleets[0].follow(in_rows, 5)
    assert fleets[0].state.t[9] == pytest.approx(0.090)
    assert fleets[0].state.t[0] == pytest.approx(0.095)


@pytest.mark.slow
def test_code_of_users_moves_arms_on_a_device_as_in_lanes(tmp_path: Path) -> None:
    """The kernels contain the same file; its arms stay in lanes, are cut, and have brakes."""
    scene = load_scene("three_axis", SENSED)
    law, file = compiled(tmp_path, ROWS), tmp_path / "mine.c"
    keeps = np.array([len(scene.joints), -1, *[0] * 16], np.int32)
    fleet = Fleet(scene, COUNT)
    expected = np.zeros((60, COUNT, len(scene.joints)))
    off = np.arange(COUNT) % 4 == 1

    def follow(arms: Fleet, control: FleetControl, links: np.ndarray) -> None:
        arms.reset()
        arms.follow(control, 30, links=links[:30])
        arms.powered = ~off
        arms.follow(control, 30, links=links[30:])
        arms.powered = True

    follow(fleet, FleetControl(address(law.by_arm), keeps.ctypes.data), expected)
    arms = Fleet(scene, COUNT, device="processor", kernels=[file])
    data = arms.to_device(keeps)
    for control in (
        FleetControl("law_by_rows", data, in_lanes=True),
        FleetControl("law_by_arm", data),
    ):
        links = np.zeros_like(expected)
        follow(arms, control, links)
        np.testing.assert_array_equal(links, expected)
    assert (np.asarray(data)[2 : 2 + COUNT] == 60).all(), "periods by rows"
    with pytest.raises(Refusal, match="name must be in the module, got nobody"):
        arms.follow(FleetControl("nobody"), 1)
    with pytest.raises(Refusal, match="run where the fleet is"):
        fleet.follow(FleetControl("law_by_arm"), 1)


def test_senseless_arguments_are_refused(three_axis: Scene) -> None:
    scene = three_axis
    fleet, servo = Fleet(scene, 2), load_gains("three_axis").servo
    servos = ServoFleet(fleet, servo)
    nan = np.full((4, 3), np.nan)
    attempts: list[tuple[Any, str]] = [
        (lambda: fleet.follow(7, 1), "control must be a FleetControl"),  # type: ignore[arg-type]
        (lambda: fleet.follow(servos, -1), "periods must be"),
        (lambda: fleet.follow(servos, 2, links=np.zeros((2, 2, 2))), "links must be a contiguous"),
        (lambda: fleet.follow(servos, 2, out=Fleet(scene, 3).frame()), "out must be a frame"),
        (lambda: Fleet(scene, 3).follow(servos, 2), "fleet must be 2 arms of the same scene"),
        (lambda: ServoFleet(fleet, [servo] * 3), "config must be one, or one for each of 2"),
        (lambda: ServoFleet(fleet, load_gains("ur5").servo), "name every moving joint"),
        (lambda: servos.aim(np.zeros((4, 2))), r"q must have shape \(K, 3\)"),
        (lambda: servos.aim(nan), "q must be numbers within"),
        (lambda: servos.aim(np.zeros((4, 3)), np.zeros((4, 2, 3))), "v must have the shape of q"),
        (lambda: servos.aim(np.zeros((4, 3)), every=1000), "every must be at most 200"),
        (lambda: servos.reset([2]), "arms must be a mask of 2"),
        (lambda: FleetControl(0), "step must be"),
        (lambda: FleetControl(1, in_lanes="no"), "in_lanes must be"),  # type: ignore[arg-type]
    ]
    for attempt, words in attempts:
        with pytest.raises(Refusal, match=words):
            attempt()
    assert np.array_equal(fleet.follow(servos, 0).t, [0.0, 0.0])


def test_a_look_is_a_pointer_in_lanes_and_a_name_on_a_device() -> None:
    fleet = Fleet("three_axis", 2)
    servos = ServoFleet(fleet, load_gains("three_axis").servo)
    schedule = FleetWay(fleet.scene, 2, "sampler_look")
    calls = lambda: fleet.follow(servos, 1, way=schedule), lambda: fleet.look(schedule)
    for call in calls:
        with pytest.raises(
            Refusal, match="look must be a pointer in lanes, and on a device a name"
        ):
            call()
    with pytest.raises(
        Refusal, match=r"Fleet\.look: way must be a FleetWay for this fleet, with a"
    ):
        fleet.look(FleetWay(fleet.scene, 2))
    with pytest.raises(Refusal, match="Fleet: kernels must be none in lanes of the processor"):
        Fleet("three_axis", 2, kernels=[Path("kernels.hpp")])
    assert fleet.state.t.tolist() == [0.0, 0.0]

"""Loops of every mode that a drive can be put into: eigenvalues, what is offered, torques."""

import dataclasses
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL, some, with_slow
from machines import make_link_urdf, write_scene
from test_command_line import run
from torque_modes import CYCLIC_TORQUE, PROFILE_TORQUE, enabled, faults, swings

from arm_emulator import Plant, Refusal, Scene, load_gains, load_scene
from arm_emulator.analysis.linear_servo import Loop
from arm_emulator.analysis.mode_loops import (
    LoopFigure,
    ModeLoops,
    describe_withheld_modes,
    list_withheld_modes,
)
from arm_emulator.analysis.stability import SmallMotions
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.design.joint_gains import GearData, MotorData, compute_gains, make_joint_servo
from arm_emulator.design.new_scene import write_new
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator_fieldbus.object_dictionary import Aborted, list_entries, modes
from bench.motion.modes import PAGE, make_modes_table
from oracles.any_arm import list_arms

ROOT = Path(__file__).resolve().parents[3]
SHIPPED = ("ur5", "three_axis", "panda")
TORQUE_BITS = sum(1 << mode - 1 for mode in (PROFILE_TORQUE, CYCLIC_TORQUE))


def shipped(name: str) -> tuple[Scene, ServoConfig]:
    file = find_scene(name)
    return load_scene(file), load_gains(file).servo


def by_voltage(more: dict[str, Any] | None = None) -> tuple[Scene, ServoConfig]:
    """ur5 as if its drives closed no current loop: K^2/R is large against the period."""
    servo = load_gains(find_scene("ur5")).servo
    joints = tuple(dataclasses.replace(joint, current_bandwidth=0.0) for joint in servo.joints)
    loop = {"joints.*.motor.current_loop": None, "joints.*.motor.current_limit": None}
    varied = {"varied": ["joints.*.friction.coulomb"]}  # share a library
    scene = load_scene("ur5", {**loop, **varied, **(more or {})})
    return scene, dataclasses.replace(servo, joints=joints)


@pytest.mark.parametrize("name", with_slow(some(SHIPPED, 2), 1))
def test_every_mode_of_the_shipped_arms_is_offered_and_holds(name: str) -> None:
    scene, servo = shipped(name)
    assert list_withheld_modes(scene, servo, modes()) == []
    loops = {
        (figure.joint, figure.loop, figure.braked) for figure in ModeLoops(scene, servo).figures
    }
    for j, joint in enumerate(scene.joints):
        for loop in set(Loop) - {Loop.POSITION}:
            assert (j, loop, False) in loops
            assert ((j, loop, True) in loops) == (joint.brake is not None)


@pytest.mark.parametrize("name", some(SHIPPED, 2))
def test_torques_are_as_requested_on_every_joint(name: str) -> None:
    assert list(faults(*shipped(name))) == []


@pytest.mark.skipif(not FULL, reason="some 60 arms are made and compiled: make test-in-full")
def test_torques_are_as_requested_on_new_arms() -> None:
    bad, count = [], 0
    for robot in list_arms().values():
        if not isinstance(robot, Path):
            continue
        with tempfile.TemporaryDirectory() as folder:
            try:
                file = write_new(robot, Path(folder) / "new").file
            except Refusal:
                continue  # is no arm
            scene, servo = load_scene(file), load_gains(file).servo
            withheld = list_withheld_modes(scene, servo, modes())
            bad += describe_withheld_modes(scene, withheld)
            if not any(loop.mode.number in (PROFILE_TORQUE, CYCLIC_TORQUE) for loop in withheld):
                bad += list(faults(scene, servo))
        count += 1
    assert count >= 40, f"{count} arms"
    assert bad == []


@pytest.mark.slow
def test_modes_that_do_not_hold_are_not_offered_and_refused() -> None:
    scene, servo = by_voltage()
    withheld = list_withheld_modes(scene, servo, modes())
    withheld_of = {(loop.joint, loop.mode.number) for loop in withheld}
    assert withheld_of == {(j, mode) for j in range(6) for mode in (PROFILE_TORQUE, CYCLIC_TORQUE)}
    drives = enabled(scene, servo)
    assert drives.withheld == withheld
    for j in range(6):
        assert drives.read(j, 0x6502) == 0x3AD & ~TORQUE_BITS
        for mode in (PROFILE_TORQUE, CYCLIC_TORQUE):
            with pytest.raises(Aborted, match="06090030"):
                drives.write(j, 0x6060, mode)
        drives.period()
        assert drives.read(j, 0x6061) == 8, "it stays in its mode"
    lines = describe_withheld_modes(scene, withheld)
    assert len(lines) == 6
    for line in lines:
        assert re.match(
            r"ur5.yaml: \w+_joint: a drive offers no profile torque \(4\) or cyclic torque \(10\): "
            r"small motions of its torque loop.* grow by [\d.]+ 1/s.* at q = \[.*\]$",
            line,
        ), line


def test_it_swings_as_its_eigenvalues_state() -> None:
    """A mode that is withheld does swing, at the frequency and by the factor of the table."""
    # Dry friction would hold small swings, which eigenvalues do not know.
    scene, servo = by_voltage({"joints.*.friction.coulomb": 0.0})
    loops = ModeLoops(scene, servo)
    torque = [
        figure for figure in loops.figures if figure.loop is Loop.TORQUE and figure.joint == 0
    ]
    (loop,) = [loop for loop in torque if not loop.braked and not loop.alike]
    assert not loop.is_stable and loop.swing > 1.01
    # Its own drives, asked for the mode behind the dictionary's back.
    drives = enabled(scene, servo, withheld=True)
    drives.write(0, 0x6071, 0)
    drives.write(0, 0x6060, CYCLIC_TORQUE)
    drives.period()
    drives.write(0, 0x6071, 3)
    currents = []
    for _ in range(1500):
        drives.period()
        currents.append(drives.plant.state.current[0])
    growing = np.array(currents[300:600])
    spectrum = np.abs(np.fft.rfft((growing - growing.mean()) * np.hanning(len(growing)), 4096))
    heard = float(np.argmax(spectrum)) / 4096.0 / servo.period
    assert np.std(currents[-300:]) > 1.0, "A: it swings to the limits of its current"
    # Limits and the pose bend the frequency of small motions a little.
    assert heard == pytest.approx(loop.frequency, rel=0.35)


def draw_drive(rng: np.random.Generator, folder: Path) -> tuple[Scene, ServoConfig] | None:
    """A link behind a motor of any speed, by a voltage or a current; None: no gains hold it."""
    looped = bool(rng.random() < 0.25)
    numbers = {
        "resistance": float(10 ** rng.uniform(-0.6, 0.0)),
        "torque_constant": float(10 ** rng.uniform(-1.3, -0.4)),
        "rotor_inertia": float(10 ** rng.uniform(-4.6, -3.8)),
    }
    numbers["inductance"] = numbers["resistance"] * float(10 ** rng.uniform(-3.7, -2.8))
    if looped:  # whose data sheet is compiled
        numbers = {"resistance": 0.3, "torque_constant": 0.2, "rotor_inertia": 3e-5,
                   "inductance": 3e-4}  # fmt: skip
    numbers["back_emf_constant"] = numbers["torque_constant"]
    bandwidth = float(rng.uniform(300.0, 1500.0)) if looped else 0.0
    gear = {"ratio": 0.01, "stiffness": float(10 ** rng.uniform(3.5, 4.5)), "damping": 10.0}
    motor = MotorData(counts_per_turn=2**20, current_bandwidth=bandwidth, **numbers)
    inertia = 0.23
    try:
        gains = compute_gains(motor, GearData(**gear), (inertia, inertia), 1e-3, 1.0, 48.0, 20.0)
    except Refusal:
        return None
    servo = dataclasses.replace(
        make_joint_servo(motor, GearData(**gear), gains, "joint"),
        current_limit=20.0,
        velocity_limit=20.0,
    )
    if not looped:  # a data sheet that is not this motor's: commands act more strongly, or less
        off = float(rng.choice([1.0, 0.8, 1.3, 1.7, 2.2]))
        reported = {key: off * numbers[key] for key in ("resistance", "inductance")}
        servo = dataclasses.replace(servo, **reported)
    loop = {"current_limit": 20.0, "current_loop": {"bandwidth": bandwidth}} if looped else {}
    joint = {"motor": numbers | loop, "gear": gear, "friction": {"viscous": 1.0}}
    keys = ["resistance", "inductance", "torque_constant", "back_emf_constant", "rotor_inertia"]
    file = write_scene(
        folder, make_link_urdf(), {"joint": joint}, servo_period=1e-3,
        varied=[*(f"joints.joint.motor.{key}" for key in keys), "joints.joint.gear.stiffness",
                *(["joints.joint.motor.current_loop.bandwidth"] if looped else [])],
        integrator={"scheme": "extrapolated", "dt": 2.5e-4},
    )  # fmt: skip
    return load_scene(file), ServoConfig(1e-3, 0.0, 1.0, 2.0, 48.0, (servo,))


@pytest.mark.slow
def test_drives_behave_as_the_eigenvalues_state(tmp_path: Path) -> None:
    """In each loop, of motors slow and fast against the period, only unstable modes grow."""
    rng = np.random.default_rng(4)
    stable, grew = 0, 0
    draws = 200 if FULL else 8
    for draw in range(draws):
        (folder := tmp_path / str(draw)).mkdir()
        scene_and_servo = draw_drive(rng, folder)
        if scene_and_servo is None:
            continue
        scene, servo = scene_and_servo
        figures = ModeLoops(scene, servo).figures
        for loop, mode in ((Loop.TORQUE, CYCLIC_TORQUE), (Loop.SPEED, 9), (Loop.POSITION, 8)):
            own = [
                figure.beyond for figure in figures if figure.loop is loop and figure.gain == 1.0
            ]
            growth = max(own, default=0.0)
            if 0.1 < growth < 20.0:
                continue  # it grows, but not to be seen in a fraction of a second
            drives = enabled(scene, servo, withheld=True)
            drives.write(0, 0x6060, mode)
            drives.period()
            drives.write(0, 0x60B2, 20)  # a kick of 2 % of the torque
            drives.period(20)
            drives.write(0, 0x60B2, 0)
            drives.period(300)
            torque = []
            for _ in range(200):
                drives.period()
                torque.append(drives.read(0, 0x6077) / 10.0)
            swing = swings(np.array(torque))
            about = f"draw {draw}, {loop.value}: growth {growth:.3g} 1/s, swings by {swing:.3g} %"
            assert (swing > 1.0) == (growth > 1.0), about
            stable, grew = stable + (growth < 1.0), grew + (growth > 1.0)
    assert stable > 0.9 * draws and grew > 0.1 * draws, f"{stable} that hold, {grew} that do not"


def test_a_locked_rotor_is_a_rotor_of_infinite_inertia() -> None:
    """The machine with a brake closed, against one whose rotor nothing turns."""
    name = "joints.elbow.motor.rotor_inertia"
    rigid = {"joints.elbow.gear.stiffness": None, "joints.elbow.gear.damping": None}
    for gear in some(({}, rigid), 1):
        own = {"joints.elbow.brake": {"torque": 1.0}, "varied": [name], **gear}
        scene, heavy = (load_scene("three_axis", {**own, **more}) for more in ({}, {name: 1e9}))
        q = np.array([0.3, -0.4, 0.8])
        J, _ = SmallMotions(Plant(scene), q).apply_brake(2)
        inertia_J = SmallMotions(Plant(heavy), q).J
        # The slowest are the rotor's own, 0 and nearly so.
        eigenvalues, two = (np.sort_complex(np.linalg.eigvals(matrix)) for matrix in (J, inertia_J))
        size = np.abs(eigenvalues).max()
        assert np.abs(eigenvalues - two).max() < 1e-4 * size, f"{eigenvalues} {two}"


def test_without_motor_torques_an_arm_falls_as_its_links_do() -> None:
    scene = load_scene("ur5")
    plant = Plant(scene)
    motions = SmallMotions(plant, scene.start)
    assert 0.0 < motions.falls < 10.0
    upright = np.array([0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    hanging = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0])
    upright_rate = SmallMotions(plant, upright).falls
    assert upright_rate > 2.0 * SmallMotions(plant, hanging).falls, "a pendulum that stands"


def test_check_scene_prints_all_loops_and_warns_of_withheld_modes(tmp_path: Path) -> None:
    for place in ("", "servo/", "motion/"):
        text = (ROOT / "config" / f"{place}ur5.yaml").read_text()
        # Drives that close no current loop: the machine of `by_voltage`.
        left_out = "current_loop|bandwidth|current_bandwidth" + ("" if place else "|current_limit")
        text = re.sub(rf"^ +({left_out}):.*\n", "", text, flags=re.M)
        text += "" if place else "varied: [joints.*.friction.coulomb]\n"
        (tmp_path / place).mkdir(exist_ok=True)
        (tmp_path / f"{place}ur5.yaml").write_text(text)
    code, out, errors = run("check-scene", str(tmp_path / "ur5.yaml"), "--modes")
    assert not code, errors
    rows = [line for line in out.splitlines() if line.endswith("| withheld |")]
    assert len(rows) == 7, "the torque loop of each joint, and of all: " + out
    assert all("| torque |" in row for row in rows)
    warned = [line for line in errors.splitlines() if "a drive offers no" in line]
    assert len(warned) == 6 and warned[0].startswith("warning: ur5.yaml: shoulder_pan_joint: ")


@pytest.mark.parametrize("name", some(["three_axis", "ur5", "panda"], 2))
def test_the_page_has_the_table_of_every_mode(name: str) -> None:
    """Its eigenvalues are those of today, but for a unit of their last place."""
    page = PAGE.read_text()
    number = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
    there, now = (text[text.index(f"#### {name}\n") :] for text in (page, make_modes_table(name)))
    there, now = (text.split("\n\n", 2)[1].strip() for text in (there, now))
    advice = "make it anew: python -m bench.motion.modes"
    for line, expected in zip(there.splitlines(), now.splitlines(), strict=True):
        assert number.sub("#", line) == number.sub("#", expected), advice
        numbers = [float(text) for text in number.findall(line)]
        today = [float(text) for text in number.findall(expected)]
        assert numbers == pytest.approx(today, rel=2e-2, abs=2e-3), f"{line}: {advice}"


def test_modes_are_those_of_cia_402_and_of_the_dictionary() -> None:
    position, speed, torque, limit = Loop.POSITION, Loop.SPEED, Loop.TORQUE, Loop.SPEED_LIMIT
    assert {mode.number: (mode.name, mode.loops) for mode in modes()} == {
        1: ("profile position", (position,)),
        3: ("profile velocity", (speed,)),
        4: ("profile torque", (torque, limit)),
        6: ("homing", (position, speed)),
        8: ("cyclic position", (position,)),
        9: ("cyclic velocity", (speed,)),
        10: ("cyclic torque", (torque, limit)),
    }
    (supported,) = (entry for entry in list_entries() if entry.index == 0x6502)
    assert supported.standard == sum(1 << mode.number - 1 for mode in modes())
    assert isinstance(LoopFigure.is_stable, property)

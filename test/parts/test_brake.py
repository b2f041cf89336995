"""Brakes: when they close and open, what they take, and that they hold."""

import random
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from by_hand import CLOCKS, go_on, session_of
from draws import some, with_slow
from in_process import in_process
from machines import CONFIG, MOVED, gantry_urdf, make_link_urdf, write_scene

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.servo_step import ServoStep
from arm_emulator.runs.table_run import TableRun
from arm_emulator.runs.target_table import TargetTable
from arm_emulator.servo.servo_arm import ServoArm, Target

CLOSE, RELEASE = 0.0205, 0.0335  # s, no whole servo periods
BRAKE = {"torque": 0.6, "close_delay": CLOSE, "release_delay": RELEASE}


def braked_scene(folder: Path) -> Path:
    """The three-axis arm under gravity, with a brake on each motor; two steps per servo period."""
    shutil.copytree(CONFIG / "urdf", folder / "urdf", dirs_exist_ok=True)
    data = yaml.safe_load((CONFIG / "three_axis.yaml").read_text())
    data["gravity"], data["energy_flow"] = [0.0, 0.0, -9.81], True
    data["integrator"]["dt"] = 0.5 * data["servo_period"]
    for joint in data["joints"].values():
        joint["brake"] = BRAKE
    (folder / "three_axis.yaml").write_text(yaml.safe_dump(data))
    return folder / "three_axis.yaml"


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return braked_scene(tmp_path_factory.mktemp("braked"))


@pytest.fixture(scope="module")
def scene(file: Path) -> Scene:
    return load_scene(file)


Ng, Mm, DT = 0.02, 1e-4, 1e-4


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Joints behind a rigid gear, a stiff elastic one, and a rigid one with a quick brake."""
    motor = {"resistance": 1e6, "torque_constant": 0.05, "back_emf_constant": 0.0}
    stiff, quick = {"stiffness": 1e9, "damping": 1e5}, {"close_delay": 3e-4, "release_delay": 6e-4}
    joints = {
        name: {"motor": motor | {"rotor_inertia": Mm}, "gear": {"ratio": Ng} | spring,
               "brake": BRAKE | delays}
        for name, spring, delays in (("x", {}, {}), ("y", stiff, {}), ("z", {}, quick))
    }  # fmt: skip
    integrator = {"scheme": "rosenbrock", "dt": DT, "events": "located"}
    return load_scene(
        write_scene(tmp_path_factory.mktemp("gantry"), gantry_urdf(), joints,
                    varied=["joints.*.brake.torque"], integrator=integrator)
    )  # fmt: skip


def test_turning_joints_stop_within_the_distance_of_the_closed_form(gantry: Scene) -> None:
    """They turn on until the brakes close, then slow down steadily: v^2 / (2 a) more."""
    rng, plant, dt = np.random.default_rng(1), Plant(gantry), DT
    # A stiff gear is no rigid one: its wind-up, 1e-8 m, is what differs.
    for _ in range(5):
        v, torque = rng.uniform((0.5, 0.05), (3.0, 0.3), (2, 2)).T
        plant.powered = True
        for name, of_joint in zip("xy", torque, strict=True):
            plant.set_parameter(f"joints.{name}.brake.torque", float(of_joint))
        plant.reset(v=[*v, 0.0])
        plant.powered = False
        a = torque / Ng / (MOVED[:2] + Mm / Ng**2)
        slowing, steps = round(0.5 * (v / a).min() / dt), round(1.1 * (v / a).max() / dt)
        plant.advance(np.zeros(3), round(CLOSE / dt))
        closing = plant.state.q[:2] - v * CLOSE
        plant.advance(np.zeros(3), slowing)
        speeds = plant.state.v[:2] - (v - a * slowing * dt)
        plant.advance(np.zeros(3), steps)
        distances = plant.state.q[:2] - (v * CLOSE + v**2 / (2.0 * a))
        for off, phase in ((closing, "until they close"), (0.1 * speeds, "while they slow"),
                             (distances, "all the way")):  # fmt: skip
            assert (np.abs(off) < [1e-9, 1e-7]).all(), f"{phase}: {off} beside {v}, {torque}"
        assert plant.state.v[0] == 0.0, "behind the rigid gear it is at rest exactly"
        assert (plant.state.omega_m[:2] == 0.0).all(), "the rotors are at rest exactly"


@pytest.mark.slow
def test_brakes_follow_after_their_delays_to_the_step(scene: Scene) -> None:
    """Divisions into calls change no bit; a withdrawn command has no effect."""
    draw = random.Random(2)
    dt = scene.integrator.dt
    steps = {False: round(CLOSE / dt), True: round(RELEASE / dt)}
    for _ in range(10):
        plant, stepped, now, expected, due, closed = Plant(scene), Plant(scene), 0, False, 0, False
        for _ in range(30):
            if draw.random() < 0.5:
                on = draw.random() < 0.5
                if expected != (not on):
                    expected, due = not on, now + steps[on]
                plant.powered = stepped.powered = on
            count = draw.choice([1, 2, 7, 20, 41])
            plant.advance(np.array([1.0, -2.0, 0.5]), count)
            for _ in range(count):
                stepped.advance(np.array([1.0, -2.0, 0.5]), 1)
            now += count
            if now >= due:
                closed = expected
            assert (plant.measured.brake_closed == closed).all(), f"after {now} steps"
        assert plant.save() == stepped.save(), "in pieces of time"
        plant.reset()
        assert (plant.measured.brake_closed == (not plant.powered)).all(), "as power is"


def test_a_delay_of_integer_steps_is_so_many_steps_though_its_quotient_is_rounded(
    gantry: Scene,
) -> None:
    """3e-4 / 1e-4 is a little less than 3 in binary numbers, 6e-4 / 1e-4 a little less than 6."""
    assert 3e-4 / DT < 3.0 and 6e-4 / DT < 6.0
    plant = Plant(gantry)
    for on, steps in ((False, 3), (True, 6)):
        plant.powered = on
        plant.advance(np.zeros(3), steps - 1)
        assert plant.measured.brake_closed[2] == on, f"{steps - 1} steps after a request"
        plant.advance(np.zeros(3), 1)
        assert plant.measured.brake_closed[2] == (not on), f"{steps} steps after it"


@pytest.mark.slow
def test_power_off_holds_the_arm_by_its_brakes(scene: Scene) -> None:
    """It falls until they close, then hangs in its gears: rotors stand still to the last bit."""
    rng = np.random.default_rng(4)
    for _ in range(3):
        plant = Plant(scene)
        plant.reset(scene.start + rng.uniform(-0.3, 0.3, 3))
        plant.powered = False
        plant.advance(np.zeros(3), round(0.5 / scene.integrator.dt))
        theta, q = plant.state.theta_m, plant.state.q
        assert (plant.state.omega_m == 0.0).all(), "rotors stand"
        highest = np.zeros(3)
        wind_up = scene.wind_up(plant.state.gear_torque)
        for _ in range(100):
            plant.advance(np.zeros(3), round(0.01 / scene.integrator.dt))
            highest = np.maximum(highest, np.abs(plant.state.q - q))
        np.testing.assert_array_equal(plant.state.theta_m, theta, err_msg="rotors, 1 s later")
        # Oscillations are about the wind-up under the weight.
        assert (highest <= 2.5 * np.abs(wind_up) + 1e-3).all(), f"{highest}, wind-up {wind_up}"


def quick_brake(torque: float, dt: float, scheme: str = "rosenbrock") -> dict[str, Any]:
    """Return what gives each joint of three_axis a brake; all torques share a library."""
    brake = {"torque": torque, "close_delay": 0.02}
    keys = {"joints.*.brake": brake, "varied": ["joints.*.brake.torque"]}
    return keys | {"integrator.dt": dt, "integrator.scheme": scheme}


@pytest.mark.parametrize("scheme", some(["rosenbrock", "implicit", "extrapolated", "paper"], 1))
@pytest.mark.parametrize("dt", [1e-3, 1e-4])
@pytest.mark.parametrize("torque", with_slow(some([0.05, 0.5, 2.0, 50.0], 2), 1))
def test_a_brake_that_closes_at_rest_moves_nothing(torque: float, dt: float, scheme: str) -> None:
    """Rotors without friction stand but for rounding: some 1e-12 rad/s of either sign."""
    plant = Plant(load_scene("three_axis", quick_brake(torque, dt, scheme)))
    plant.powered = False
    start = plant.state
    plant.advance(np.zeros(3), round(0.3 / dt))
    assert plant.measured.brake_closed.all()
    np.testing.assert_allclose(plant.state.q, start.q, atol=1e-12)
    np.testing.assert_allclose(plant.state.v, 0.0, atol=1e-11)


def test_commands_close_brakes_by_their_bits(scene: Scene) -> None:
    """Not enabled, or asked to close: bits of arm_joint_command.enable."""
    rng = np.random.default_rng(7)
    plant = Plant(scene)
    for enable, closed in ((1, 0), (0, 1), (1, 0), (3, 1), (2, 1), (1, 0)):
        joint = int(rng.integers(3))
        plant._commands["enable"] = 1
        plant._commands["enable"][joint] = enable
        for _ in range(40):
            plant.exchange(np.zeros(3))
        expected = np.zeros(3)
        expected[joint] = closed
        np.testing.assert_array_equal(plant.measured.brake_closed, expected, f"enable {enable}")


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
def test_a_run_with_brakes_is_repeated_to_the_last_bit(
    clock: str, file: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    draw = random.Random(8)
    with in_process(clock, file=file) as nodes:
        nodes.begin_record()
        assert nodes.call("emulator/reset").success
        observed = set()

        def between() -> None:
            observed.update(nodes.newest("motor_states").brake_closed)
            if draw.random() < 0.02:
                nodes.nodes[
                    "emulator"
                ]._status.publish_status()  # by which `check-bag` knows the clock
                assert nodes.call("emulator/power", draw.random() < 0.5).success

        go_on(nodes, 200, between)
        for on in (False, True):  # for longer than the delays
            assert nodes.call("emulator/power", on).success
            go_on(nodes, 50, lambda: observed.update(nodes.newest("motor_states").brake_closed))
        assert observed == {0, 1}, "brakes close and open"
        assert session_of(nodes).scene.joints[0].brake is not None
        nodes.write(tmp_path / "bag")
    code, words = check_bag(tmp_path / "bag", scene=str(file)), capfd.readouterr().out
    assert code == 0 and "equal to the last bit" in words, words
    assert re.search(r"\d+ changes by hand", words), words


def test_servos_in_c_and_python_handle_brakes_alike(scene: Scene) -> None:
    """The bits are those of calls one by one, with power while the brakes are still closed, too."""
    servo = load_gains("three_axis").servo
    q = scene.start + np.array([[0.0, 0.0, 0.0], [0.1, -0.2, 0.15]])
    table = TargetTable(np.array([0.0, 0.02]), q)
    run = TableRun(scene, table, ServoStep(ServoArm(servo), [0, 1, 2]))
    plant, drives, closed = Plant(scene), ServoArm(servo), 0
    for tick in range(150):
        run.session.powered = plant.powered = not 40 <= tick < 80
        run.advance(1)
        observed, now = plant.measured, round(tick * scene.servo_period * 1e9)
        closed += int(observed.brake_closed.any() and plant.powered)
        drives.take_measurement(
            now, observed.encoder_counts, observed.current, observed.applied, observed.brake_closed
        )
        drives.set_target(Target(q[int(tick >= 20)]))
        plant.exchange(drives.compute_commands(plant.powered))
        np.testing.assert_array_equal(run.session.state.q, plant.state.q, f"after tick {tick}")
    assert closed > 20, "ticks with power and a closed brake"


def test_an_open_brake_does_nothing() -> None:
    rows = np.random.default_rng(9).uniform(-10.0, 10.0, (60, 3))
    scenes = (load_scene("three_axis", quick_brake(torque, 1e-3)) for torque in (1e-3, 1e3))
    assert np.array_equal(*(Plant(scene).run(rows, 10) for scene in scenes))


def test_a_brake_belongs_to_a_motor(tmp_path: Path) -> None:
    file = write_scene(tmp_path, make_link_urdf(), {"joint": {"brake": BRAKE}})
    with pytest.raises(Refusal, match=r"joint\.brake must belong to a joint with a motor"):
        load_scene(file)

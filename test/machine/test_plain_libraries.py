"""Arguments of the plain libraries from any caller: counts, arrays, rotations, poses.

Anything else is refused in one line, and changes nothing. Calls of plants and
fleets: test_manners.py.
"""

import math
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from arm_emulator import (
    JacobianController,
    Kinematics,
    OfflineRun,
    Plant,
    Pose,
    Refusal,
    Servo,
    Session,
    load_scene,
    load_servo_config,
)
from arm_emulator.base.validation.count import check_count
from arm_emulator.machine.plant.call_arguments import PIECE
from arm_emulator.machine.session.real_time import RealTimeLoop
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.servo.servo_arm import ServoArm

N = 3
CONFIG = Path(__file__).resolve().parents[2] / "config"


@pytest.fixture(scope="module")
def plant() -> Plant:
    return Plant(load_scene("three_axis"))


@pytest.fixture(scope="module")
def controller(plant: Plant) -> JacobianController:
    scene = plant.scene
    return JacobianController(Kinematics(scene.urdf, scene.joint_names, scene.tool))


def no_count(rng: np.random.Generator) -> Any:
    """Something that is no count of steps, not even one that would take years."""
    digits = int(rng.integers(16, 30))
    return [
        -int(rng.integers(1, 10**9)),
        -(2 ** int(rng.integers(1, 200))),
        int(rng.integers(1, 10)) * 10**digits,
        2**64 + int(rng.integers(0, 1000)),  # ctypes takes it for the number it is modulo 2^64
        2**63 - int(rng.integers(0, 1000)),
        10 ** int(rng.integers(300, 6000)),
        float(rng.uniform(-1e3, 1e3)),
        math.nan,
        math.inf,
        "10",
        None,
        True,
        np.float64(3.0),
        [3],
        Fraction(6, 2),
        3 + 0j,
        np.array([3]),
    ][int(rng.integers(17))]


def no_vector(rng: np.random.Generator) -> Any:
    """Something that is no N finite numbers."""
    vector = rng.normal(size=N)
    place = int(rng.integers(N))
    spoiled: list[Any] = vector.tolist()
    spoiled[place] = [math.nan, math.inf, -math.inf, None, "1", 1j, [1.0], {}, 10**400, b"1", ""][
        int(rng.integers(11))
    ]
    wrong = int(rng.choice([0, 1, 2, 4, 30]))
    return [
        spoiled,
        tuple(spoiled),
        rng.normal(size=wrong),
        rng.normal(size=(N, 1)),
        rng.normal(size=(1, 1, N)),
        vector.astype(complex) + 1j,
        vector.astype(str),
        np.array(spoiled, dtype=object),
        "abc",
        None,
        float(vector[0]),
        {"a": 1.0},
        {1.0, 2.0, 3.0},
        np.zeros((2, N, 2)),
        np.array(["2020-01-01"] * N, dtype="datetime64[D]"),
    ][int(rng.integers(15))]


def constant(x: Any) -> Any:
    """Replace None, which is allowed here, by something wrong."""
    return "none" if x is None else x


def as_bytes(plant: Plant) -> bytes:
    x = plant.state
    arrays = (x.current, x.theta_m, x.omega_m, x.q, x.v, x.gear_torque, np.array(x.t))
    return b"".join(array.tobytes() for array in arrays)


def refused(call: Callable[..., object], *arguments: Any) -> None:
    with pytest.raises(Refusal) as printed:
        call(*arguments)
    assert len(str(printed.value).splitlines()) == 1, (call, arguments)


def test_wrong_counts_change_nothing(plant: Plant) -> None:
    rng = np.random.default_rng(1)
    offline = OfflineRun(
        plant.scene,
        load_servo_config(CONFIG / "servo/three_axis.yaml"),
        load_motion_config(CONFIG / "motion/three_axis.yaml"),
    )
    session = Session(plant.scene, "lockstep", "first_answer")
    loop = RealTimeLoop(plant, 1_000_000, -1)
    names, zero = plant.scene.joint_names, np.zeros(N)
    plant.advance(zero, 5)
    before = as_bytes(plant)
    for _ in range(300):
        count = no_count(rng)
        refused(loop.start_time, count)
        refused(RealTimeLoop, plant, count, -1)
        refused(RealTimeLoop, plant, 1_000_000, count)
        refused(check_count, "here", "count", count, 0, 10**15)
        if not isinstance(count, int) or count < 0:  # else it advances that far
            refused(offline.advance, count)
        if count not in (0, -1):
            refused(session.offer, count, names, zero)
            refused(loop.hold_command, -2 if isinstance(count, int) else count, zero)
    assert as_bytes(plant) == before
    assert (session.tick, session.is_answered, offline.session.tick) == (0, False, 0)


def test_rows_times_steps_beyond_the_counter_are_refused(plant: Plant) -> None:
    """Once, 2**61 steps under each of eight rows did nothing: their product is 0 modulo 2^64."""
    rng = np.random.default_rng(2)
    before = as_bytes(plant)
    for _ in range(200):
        rows = np.zeros((int(2 ** rng.integers(1, 12)), N))
        lowest = 10**15 // len(rows) + 1
        steps = int(rng.choice([lowest, 2**62, 2**64 // len(rows), 2**63 // len(rows)]))
        refused(plant.run, rows, max(steps, lowest))
        assert as_bytes(plant) == before, (len(rows), steps)
    assert plant.run(np.zeros((0, N)), 10**15).shape == (0, N)


def test_wrong_arrays_change_nothing(plant: Plant, controller: JacobianController) -> None:
    rng = np.random.default_rng(3)
    servo = Servo(load_servo_config(CONFIG / "servo/three_axis.yaml"))
    drives = ServoArm(servo.config)
    session = Session(plant.scene, "lockstep", "first_answer")
    loop = RealTimeLoop(plant, 1_000_000, -1)
    good, counts = np.zeros(N), np.zeros(N, dtype=np.int64)
    p_WT, R_WT = np.zeros(3), np.eye(3)
    target = Pose(p_WT, R_WT)
    servo.observe(counts, good)
    drives.take_measurement(0, counts, good)
    kinematics = controller.kinematics
    before = as_bytes(plant)
    calls: list[Callable[[Any], object]] = [
        lambda x: plant.put("here", {"q": x}),
        lambda x: plant.put("here", {"v": good, "current": x}),
        lambda x: loop.hold_command(0, x),
        lambda x: servo.observe(x, good),
        lambda x: servo.observe(counts, x),
        servo.control,
        lambda x: servo.control(good, constant(x)),
        lambda x: servo.control(good, good, constant(x)),
        lambda x: drives.take_measurement(1, x, good),
        lambda x: drives.take_measurement(1, counts, x),
        kinematics.forward,
        kinematics.jacobian,
        kinematics.singular_values,
        controller.begin,
        lambda x: kinematics.tool_error(x, target),
        lambda x: controller.update(x, target),
        lambda x: Pose(x, R_WT),
        lambda x: Pose(p_WT, [x, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        lambda x: Pose.from_quaternion(x, [0.0, 0.0, 0.0, 1.0]),
        lambda x: session.offer(0, plant.scene.joint_names, x),
    ]
    for _ in range(150):
        wrong = no_vector(rng)
        for call in calls:
            refused(call, wrong)
    assert as_bytes(plant) == before
    assert not session.is_answered


@pytest.mark.parametrize("exponent", [7, 20, 100, 200, 308])
def test_numbers_too_large_are_refused_or_lead_to_finite_ones(exponent: int, plant: Plant) -> None:
    rng = np.random.default_rng(exponent)
    for _ in range(50):
        q, v, tau = rng.uniform(-1.7, 1.7, (3, N)) * 10.0 ** (exponent * rng.integers(0, 2, (3, 1)))
        try:
            assert np.isfinite(plant.links.accelerations(q, v, tau)).all()
        except Refusal:
            pass
        try:
            plant.reset(q, v)
        except Refusal:
            plant.reset()
        state = plant.state
        for array in (state.theta_m, state.omega_m, state.gear_torque, plant.energy):
            assert np.isfinite(array).all(), (q, v)
    plant.reset()


def rotation(rng: np.random.Generator) -> np.ndarray:
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q * np.linalg.det(Q)


def test_a_matrix_that_does_not_rotate_is_refused(controller: JacobianController) -> None:
    rng = np.random.default_rng(5)
    for _ in range(500):
        R = rotation(rng)
        scale = 10.0 ** rng.uniform(-2.0, 300.0)
        direction = np.outer(*rng.normal(size=(2, 3)))
        direction /= np.abs(direction).max()
        wrong = [
            np.zeros((3, 3)),
            R * (1.0 + 0.01 * rng.uniform(0.3, 1.0)),
            R * scale * 2.0,
            -R,
            R @ np.diag([1.0, 1.0, -1.0]),
            R + 0.01 * rng.uniform(0.5, 1.0) * direction @ R,
            R + math.nan * direction,
            R[:2],
            R.ravel(),
            R[None],
            np.diag([1.0, 1.0, 0.0]),
            rng.normal(size=(3, 3)) * 3.0,
            R.astype(complex) + 1e-9j,
            None,
        ]
        for case in wrong:
            refused(Pose, np.zeros(3), case)
        near = R + 1e-5 * direction  # as one that was written with five digits
        pose = Pose([0.1, 0.2, 0.3], near)
        assert np.abs(pose.R_WT - near).max() == 0.0, "it is taken as it is"
        q = controller.update(np.zeros(N), pose).q
        assert np.isfinite(q).all()


def test_a_pose_is_not_changed_from_outside() -> None:
    p, R = np.zeros(3), np.eye(3)
    pose = Pose(p, R)
    p[0] = R[0, 0] = math.nan
    assert np.isfinite(pose.p_WT).all() and np.isfinite(pose.R_WT).all()


def test_long_calls_give_the_same_bits_in_pieces(
    plant: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(6)
    rows = rng.uniform(-20.0, 20.0, (7, N))
    for steps in (1, 100, 137):
        plant.reset()
        q = plant.run(rows, steps)
        plant.advance(rows[0], 1000)
        in_full = as_bytes(plant)
        for piece in (16, 128, 512):
            monkeypatch.setattr("arm_emulator.machine.plant.plant.PIECE", piece)
            plant.reset()
            assert plant.run(rows, steps).tobytes() == q.tobytes(), (steps, piece)
            plant.advance(rows[0], 1000)
            assert as_bytes(plant) == in_full, (steps, piece)
            monkeypatch.undo()
    assert PIECE % 16 == 0


@pytest.mark.slow
def test_ctrl_c_ends_a_call_that_would_take_years() -> None:
    code = """
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.scene.scene import load_scene
plant = Plant(load_scene("three_axis"))
try:
    print("ready", flush=True)
    plant.CALL
except KeyboardInterrupt:
    print("ended", plant.t > 0.0, flush=True)
"""

    for call in ("advance([0.0] * 3, 10**15)", "run([[0.0] * 3] * 10, 10**14)"):
        process = subprocess.Popen(
            [sys.executable, "-c", code.replace("CALL", call)], stdout=subprocess.PIPE, text=True
        )
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            times = psutil.Process(process.pid).cpu_times
            before = times().user
            while times().user < before + 0.1:  # s: nothing but the call takes so much
                assert process.poll() is None
                time.sleep(0.01)
            process.send_signal(signal.SIGINT)  # once: another one would interrupt the answer
            assert process.stdout.readline() in ("ended True\n", "ended False\n"), call
            assert process.wait(60.0) == 0
        finally:
            process.kill()
            process.wait()
            process.stdout.close()

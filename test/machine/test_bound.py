"""The plain libraries and extreme finite numbers: refused, and every state as before."""

import dataclasses
import itertools
import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from random_messages import huge, number, random_urdf

from arm_emulator import OfflineRun, Pose, Refusal, Servo, Session, load_scene, load_servo_config
from arm_emulator.base.io.config_files import find_config
from arm_emulator.base.validation.bound import (
    COMMAND,
    CURRENT,
    EFFORT,
    POSITION,
    VELOCITY,
    bound_encoder_counts,
)
from arm_emulator.base.validation.number import Number
from arm_emulator.machine.plant.plant_state import bound_state
from arm_emulator.motion.executor.goal_queue import MAX_TARGETS
from arm_emulator.motion.executor.motion_executor import MotionExecutor
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.kinematics import list_moving_joints
from arm_emulator.motion.planner.tool_controller import Controller, make_controller
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.servo.servo import ServoConfig
from arm_emulator.servo.servo_arm import ServoArm, Target

# A warning of NumPy's would be printed among what the nodes state.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

SCENES = ("three_axis", "ur5")
NO_NUMBERS: tuple[Any, ...] = (
    "x",
    None,
    [None],
    [[1.0], [2.0, 3.0]],
    ["1", "2", "3"],
    [1j] * 3,
    {},
)


def servo_config(scene: str) -> ServoConfig:
    return load_servo_config(find_config(scene, ".yaml", "servo"))


# The bound itself


@pytest.mark.parametrize("seed", range(3))
def test_a_bound_takes_exactly_the_numbers_within(seed: int) -> None:
    rng = random.Random(seed)
    for _ in range(2000):
        N = rng.randint(1, 9)
        limits = [10.0 ** rng.uniform(-3, 300) for _ in range(N)]
        largest = np.array(limits) if rng.random() < 0.5 else limits[0]
        values = [limit * rng.choice((0.0, 0.5, -0.9, 1.0, -1.0, 1.0001)) for limit in limits]
        if rng.random() < 0.3:
            values[rng.randrange(N)] = number(rng)
        within = all(abs(x) <= y for x, y in zip(values, np.broadcast_to(largest, N), strict=True))
        bound = Number.bound_size("q", "rad", largest)
        if within:
            assert bound.check_row("here", values, N).tolist() == values
        else:
            with pytest.raises(Refusal, match=r"^here: q must be numbers within \+-\S+ rad, got"):
                bound.check_row("here", values, N)


def test_motors_are_set_within_the_bounds_of_their_links() -> None:
    """1e6 rad and 1e6 rad/s at the links of both ends of a gear, whatever way it turns."""
    scene = load_scene("three_axis", {"joints.elbow.gear.ratio": -0.004})
    ratios, bounds = np.abs(scene.gear_ratios), bound_state(scene)
    assert (ratios < 0.1).all() and 0.004 in ratios
    np.testing.assert_allclose(ratios * bounds["theta_m"].at_most, 1e6, rtol=1e-15)
    np.testing.assert_allclose(ratios * bounds["omega_m"].at_most, 1e6, rtol=1e-15)
    np.testing.assert_array_equal(bounds["q"].at_most, 1e6)
    assert (bounds["v"].at_most, bounds["current"].at_most) == (1e6, 1e9)


def test_encoder_counts_keep_the_joint_and_the_hold_of_it_within_its_position() -> None:
    for seed in range(100):
        angle = 10.0 ** random.Random(seed).uniform(-15, 2)
        largest = float(np.min(bound_encoder_counts([angle]).at_most))
        assert (largest + 0.5) * angle <= POSITION.most
        assert largest + 0.5 != largest + 1.0, "half a count must not be lost"


# Servo


def state_of(servo: Servo) -> bytes:
    return servo.state.tobytes()


@pytest.mark.parametrize("scene", SCENES)
def test_the_servo_refuses_extreme_numbers_and_stays_as_it_was(scene: str) -> None:
    rng, config = random.Random(scene), servo_config(scene)
    N = len(config.joints)
    servo = Servo(config)
    counts, zero = [10.0] * N, [0.0] * N

    def wrong(bound: Number) -> list[float]:
        values = [rng.uniform(-1.0, 1.0) for _ in range(N)]
        values[rng.randrange(N)] = rng.choice((huge(rng), math.nan, math.inf, 1.01 * bound.most))
        return values

    for _ in range(50):
        servo.update(counts, zero, [0.1] * N)
    largest_count = Number.bound_size("counts", "", 2.0**53)
    paths: list[Callable[[], Any]] = [
        lambda: servo.observe(wrong(largest_count), zero),
        lambda: servo.observe(counts, wrong(CURRENT)),
        lambda: servo.control(wrong(POSITION)),
        lambda: servo.control(zero, wrong(VELOCITY)),
        lambda: servo.control(zero, zero, wrong(EFFORT)),
        lambda: servo.update(counts, zero, zero, wrong(VELOCITY)),
        lambda: servo.observe(rng.choice(NO_NUMBERS), zero),
    ]
    before = state_of(servo)
    for turn in range(700):
        with pytest.raises(Refusal, match=r"^servo: "):
            paths[turn % len(paths)]()
        assert state_of(servo) == before, "a refused number has changed the state"
    assert servo.restarts == 0


@pytest.mark.parametrize("scene", SCENES)
def test_the_servo_stays_finite_within_the_bounds(scene: str) -> None:
    """Any sequence of numbers that are taken gives finite voltages; a reset forgets all of them."""
    rng, config = random.Random(scene), servo_config(scene)
    N = len(config.joints)
    servo = Servo(config)
    counts_bound = bound_encoder_counts([joint.count_angle for joint in config.joints]).at_most

    def within(largest: Any) -> Any:
        return np.array([rng.choice((-1.0, 0.0, 1e-300, 0.3, 1.0)) for _ in range(N)]) * largest

    for _ in range(2000):
        voltage = servo.update(
            np.floor(within(counts_bound)),
            within(CURRENT.most),
            within(POSITION.most),
            within(VELOCITY.most),
            within(EFFORT.most),
        )
        assert (np.abs(voltage) <= config.supply_voltage).all()
    assert servo.restarts == 0
    fresh = Servo(config)
    servo.reset()
    for tick in range(20):
        now = [tick] * N, [0.1] * N, [0.2] * N
        assert servo.update(*now).tobytes() == fresh.update(*now).tobytes(), f"tick {tick}"


def test_a_servo_that_is_not_finite_restarts() -> None:
    """Each number of a joint's state is spoiled: commands stay finite, and the state is again.

    What was learned, or follows from measurements or targets, comes again by itself.
    """
    config = servo_config("three_axis")

    def numbers(drives: ServoArm) -> dict[str, Any]:
        """Return views of all real numbers of the joints' states, by name."""
        state, of_load = drives.servo.state, drives.servo.state["learned"]
        learned = {f"learned.{name}": of_load[name] for name in of_load.dtype.names}
        alone = {name: state[name] for name in state.dtype.names if name != "learned"}
        return {name: of for name, of in (alone | learned).items() if of.dtype.kind == "f"}

    restarted = set()
    names = list(numbers(ServoArm(config)))
    assert len(names) > 15
    for name, value in itertools.product(names, [math.nan, math.inf, -math.inf]):
        drives = ServoArm(config)
        for tick in range(26):
            now = tick * 1_000_000
            if tick % 5 == 0:
                drives.set_target(Target(np.zeros(3), np.full(3, 0.01), np.full(3, 0.1 * tick)))
            if tick == 21:
                numbers(drives)[name][1] = value
            drives.take_measurement(now, [5, 5, 5], [0.1, 0.1, 0.1])
            assert np.isfinite(drives.compute_commands(True)).all(), (
                f"{name} = {value}, tick {tick}"
            )
        for second, of in numbers(drives).items():
            # The angle to hold is set when targets cease, and not used until then. A joint whose
            # observer is too slow to learn its load does not use what it would have learned.
            unused = second == name and (name == "q_hold" or name.startswith("learned."))
            assert np.isfinite(of).all() or unused, f"{name} = {value}: {second} = {of}"
        # The joint has no command until a target with an angle comes, at tick 25.
        assert drives.servo.restarts <= (4 if name == "q_target" else 1), f"{name} = {value}"
        if drives.servo.restarts:
            restarted.add(name)
    assert restarted >= {"theta", "omega", "load", "current", "integral"}


def test_any_finite_data_sheet_is_refused_or_computed_with() -> None:
    """Numbers that no machine has, in every place of a servo's parameters."""
    rng = random.Random(1)
    good = servo_config("three_axis")
    joint = dataclasses.asdict(good.joints[0])
    joint.pop("name")
    refused = 0
    for _ in range(3000):
        sheet = dict(joint)
        scalars = {
            name: getattr(good, name)
            for name in ("period", "motion_period", "hold_after", "cut_after", "supply_voltage")
        }
        for _ in range(rng.randint(1, 3)):
            table = rng.choice((sheet, sheet, scalars))
            table[rng.choice(list(table))] = abs(number(rng))
        try:
            config = ServoConfig.from_mapping(
                {**scalars, "joint_names": ["one"], "joints": {"one": sheet}}, "sheet"
            )
            servo = Servo(config)
        except Refusal as refusal:
            refused += 1
            assert "\n" not in str(refusal), "a refusal is one line"
            continue
        for count in (0, 1, 5, -300):
            try:
                voltage = servo.update([count], [rng.uniform(-50, 50)], [rng.uniform(-3, 3)], [1.0])
            except Refusal:  # a count is more than a joint may turn
                continue
            assert np.isfinite(voltage).all(), f"{config}"
    assert 0 < refused < 3000, f"{refused} refused: the draws are one-sided"


# Motion controller


def begin(controller: Controller, start: np.ndarray, target: Pose) -> None:
    controller.begin(start)
    controller.update(start, target)  # a control law may remember the one before


@pytest.mark.parametrize("scene", with_slow(SCENES, 1))
def test_the_motion_controller_refuses_extreme_numbers_and_stays_as_it_was(scene: str) -> None:
    rng, run = random.Random(scene), load_offline_run(scene)
    controller, start = run.controller, run.session.scene.start
    R_WT, p_WT = controller.kinematics.forward(start)
    target = Pose(p_WT + 0.01, R_WT)
    begin(controller, start, target)
    expected = controller.update(start, target).q
    for turn in range(300):
        begin(controller, start, target)
        values = [number(rng) for _ in range(4)]
        values[rng.randrange(3)] = huge(rng)
        with pytest.raises(Refusal):
            if turn % 4 == 0:
                Pose.from_quaternion(values[:3], [0.0, 0.0, 0.0, 1.0])
            elif turn % 4 == 1:
                Pose.from_quaternion([0.0, 0.0, 0.0], values)
            elif turn % 4 == 2:
                controller.update(np.array([*values[:3], *start[3:]]), target)
            else:
                controller.update(start, dataclasses.replace(target, p_WT=np.array(values[:3])))
        assert np.array_equal(controller.update(start, target).q, expected)


@pytest.mark.parametrize("size", [0.0, 5e-324, 1e-300, 1e-160, 1e155, 1e300, 1.7e308])
def test_quaternions_that_are_not_of_unit_length_are_refused(size: float) -> None:
    for seed in range(50):
        direction = np.random.default_rng(seed).normal(size=4)
        quaternion = (direction / np.abs(direction).max() * size).tolist()
        with pytest.raises(Refusal, match="orientation must be a quaternion of length 1"):
            Pose.from_quaternion([0.0, 0.0, 0.0], quaternion)


@pytest.mark.parametrize("scene", with_slow(SCENES, 1))
def test_every_target_that_is_taken_gives_targets_that_a_servo_takes(scene: str) -> None:
    rng, run = random.Random(scene), load_offline_run(scene)
    controller, N = run.controller, len(run.session.scene.start)
    for _ in range(500):
        q = [rng.choice((0.0, 1.0, -1e6, 1e6, rng.uniform(-3, 3))) for _ in range(N)]
        p = [rng.choice((0.0, 5e-324, -1e6, 1e6, rng.uniform(-1, 1))) for _ in range(3)]
        direction = np.random.default_rng(rng.getrandbits(32)).normal(size=4)
        pose = Pose.from_quaternion(p, direction / np.linalg.norm(direction))
        executor = MotionExecutor()
        executor.add(0, pose)
        POSITION.check_values("test", executor.compute_setpoint(controller, 0, np.array(q)).q)


def test_an_executor_that_is_not_finite_restarts() -> None:
    run = load_offline_run("three_axis")
    q, nowhere = run.session.scene.start, Pose(np.zeros(3), np.eye(3))
    object.__setattr__(nowhere, "p_WT", np.full(3, math.nan))
    for poison in (
        lambda executor: setattr(executor, "_hold", np.full(3, math.nan)),
        lambda executor: executor.add(0, nowhere),
    ):
        executor = MotionExecutor()
        poison(executor)
        assert np.array_equal(executor.compute_setpoint(run.controller, 0, q).q, q), (
            "the arm is not held"
        )
        assert executor.restarts == 1 and executor.trouble
        assert np.array_equal(executor.compute_setpoint(run.controller, 50_000_000, q + 1e-3).q, q)
        assert executor.restarts == 1, "it has begun anew once"


def test_tool_targets_that_wait_for_their_time_are_bounded_in_number() -> None:
    run = load_offline_run("three_axis")
    target = Pose(np.zeros(3), np.eye(3))
    executor = MotionExecutor()
    for time_ns in range(MAX_TARGETS):
        executor.add(10**18 + time_ns, target)
    with pytest.raises(Refusal, match=f"one of at most {MAX_TARGETS} that wait"):
        executor.add(0, target)
    executor.add(10**18, target)  # in place of the one for the same time
    executor.compute_setpoint(run.controller, 10**18, run.session.scene.start)
    executor.add(0, target)


@pytest.mark.parametrize("method", ["paper", "way"])
@pytest.mark.parametrize("seed", with_slow(range(3), 1))
def test_any_robot_of_numbers_is_refused_or_computed_with(seed: int, method: str) -> None:
    rng = random.Random(seed)
    names, taken = ["a", "b", "c"], 0
    config = MotionConfig(method=method, task=rng.choice(("position", "pose")))
    for _ in range(200):
        urdf = random_urdf(rng, names, lambda: number(rng) if rng.random() < 0.2 else 0.3)
        try:
            controller = make_controller(urdf, list_moving_joints(urdf), config)
        except Refusal as refusal:
            assert "\n" not in str(refusal), "a refusal is one line"
            continue
        taken += 1
        executor, q = MotionExecutor(), np.array([0.1, 0.2, 0.3])
        executor.add(0, Pose(np.array([1.0, 2.0, 3.0]), np.eye(3)))
        for period in range(5):
            instruction = executor.compute_setpoint(controller, period * 50_000_000, q)
            POSITION.check_values("test", instruction.q)
            if instruction.v is not None:
                VELOCITY.check_values("test", instruction.v)
            q = instruction.q
    assert taken > 0


@pytest.mark.parametrize("joints", [129, 900])
def test_robots_that_take_long_to_compute_with_are_refused(joints: int) -> None:
    urdf = random_urdf(random.Random(joints), [f"joint_{j}" for j in range(joints)])
    with pytest.raises(Refusal, match=f"must have at most 128 moving joints, got {joints}"):
        list_moving_joints(urdf)


# Session and offline run


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_a_session_refuses_extreme_numbers_and_stays_as_it_was(clock: str) -> None:
    scene, rng = load_scene("three_axis"), random.Random(clock)
    first, second = (Session(scene, clock, "first_answer") for _ in range(2))
    names = list(scene.joint_names)
    for tick in range(100):
        for _ in range(5):
            voltage = [rng.gauss(0.0, 1.0) for _ in names]
            voltage[rng.randrange(3)] = rng.choice((huge(rng), math.nan, 1.01 * COMMAND.most))
            with pytest.raises(Refusal):
                first.offer(tick, names, voltage)
            with pytest.raises(Refusal):
                first.offer(rng.choice((tick + 1, 2**63 - 1, 2**64)), names, [0.0] * 3)
            with pytest.raises(Refusal):
                first.offer(tick, names, rng.choice(([None] * 3, ["x"] * 3, [10**400] * 3)))
        for session in (first, second):
            # As much as there may be: the drives apply the supply voltage.
            session.offer(tick, names, [1.0, -2.0, COMMAND.most if tick % 7 else 0.0])
            session.advance()
        assert first.state.q.tobytes() == second.state.q.tobytes(), f"tick {tick}"


def test_a_target_that_an_offline_run_refuses_leaves_it_as_it_was() -> None:
    def run(disturb: Callable[[OfflineRun], None]) -> bytes:
        offline = load_offline_run("three_axis")
        for _ in range(10):
            disturb(offline)
            offline.advance(10)
        return offline.session.state.q.tobytes()

    rng = random.Random(3)

    def disturb(offline: OfflineRun) -> None:
        with pytest.raises(Refusal):
            offline.instructor.add(0, Pose.from_quaternion([huge(rng), 0.0, 0.0], [0, 0, 0, 1]))
        with pytest.raises(Refusal):
            offline.drives.take_measurement(0, [2**62] * 3, [0.0] * 3)

    assert run(disturb) == run(lambda _: None)

"""Machines as objects of Python: copies, forks, threads, and whatever a caller may hand over."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import random
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some

from arm_emulator.base.config_files import find_beside, find_scene
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.external_wrench import ExternalWrench
from arm_emulator.machine.fleet import Fleet
from arm_emulator.machine.loop_clock import real_time_session
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.machine.session import Session
from arm_emulator.motion.jacobian import JacobianController
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.servo.servo import Servo

PATIENCE = 60.0  # s, after which a child hangs
ROW = [5.0, -20.0, 3.0]
VARIED = {"varied": ["joints.*.friction.viscous"], "external_wrench": True}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis", overrides=VARIED)


@pytest.fixture
def plant(scene: Scene) -> Plant:
    """In motion, with a number and a wrench of its own."""
    plant = Plant(scene)
    plant.set_parameter("joints.elbow.friction.viscous", 6.5)
    plant.set_external_wrench(scene.chain.joints[1].link, ExternalWrench(force=(1.0, 2.0, 3.0)))
    plant.exchange(np.array(ROW), 7)
    plant.advance(ROW, 13)
    return plant


def bits(plant: Plant) -> bytes:
    return plant.save()


WAYS: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda one: pickle.loads(pickle.dumps(one)),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_goes_on_alike_and_alone(way: str, plant: Plant) -> None:
    other = WAYS[way](plant)
    assert bits(other) == bits(plant) and other.parameters == plant.parameters
    assert other.external_wrenches == plant.external_wrenches
    plant.advance(ROW, 20)
    assert bits(other) != bits(plant), "they share the machine"
    other.advance(ROW, 20)
    assert bits(other) == bits(plant)
    del plant
    other.advance(ROW, 20)


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_a_fleet_goes_on_alike_and_alone(way: str, scene: Scene) -> None:
    fleet = Fleet(scene, 5, varied={NAME: np.linspace(1.0, 5.0, 5)}, workers=2)
    fleet.exchange(ROW)
    other = WAYS[way](fleet)
    assert other.save() == fleet.save() and len(other) == 5
    assert np.array_equal(other.parameters[NAME], np.linspace(1.0, 5.0, 5))
    before = fleet.save()
    other.advance(ROW, 20)
    assert fleet.save() == before, "they share the machines"


@pytest.mark.parametrize("way", WAYS)
def test_an_arm_of_a_fleet_is_copied_out_of_it(way: str, scene: Scene) -> None:
    fleet = Fleet(scene, 3)
    fleet.advance(ROW, 30)
    other, before = WAYS[way](fleet[1]), fleet[1].save()
    assert other.save() == before
    other.advance(ROW, 5)
    assert fleet[1].save() == before, "the fleet moves with the copy"


@pytest.mark.parametrize("way", WAYS)
def test_frames_and_kinematics_are_copied(way: str, scene: Scene) -> None:
    fleet = Fleet(scene, 3)
    frame = fleet.step(ROW, 30)
    other, q = WAYS[way](frame), frame.q.copy()
    fleet.step(ROW, 30, out=frame)
    assert np.array_equal(other.q, q) and not np.array_equal(frame.q, q)
    assert other.measured != frame.measured, "they share their arrays"
    fleet.step(ROW, 30, out=other)
    assert other.t[0] > frame.t[0]
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    p = WAYS[way](JacobianController(kinematics)).kinematics.forward(scene.start)[1]
    assert np.array_equal(p, kinematics.forward(scene.start)[1])


@pytest.mark.parametrize("way", WAYS)
def test_reasons_are_handed_over_whole(way: str) -> None:
    overrides = {"integrator.scheme": "paper", "integrator.dt": 1e-2, "servo_period": 1e-2}
    plant = Plant(load_scene("three_axis", overrides=overrides))
    with pytest.raises(Diverged) as diverged:
        plant.advance([20.0, -20.0, 10.0], 100_000)
    diverged.value.hint = "a hint"
    got = WAYS[way](diverged.value)
    assert str(got) == str(diverged.value) and got.t == diverged.value.t
    with pytest.raises(Refusal) as refused:
        plant.advance([1.0], 1)
    got = WAYS[way](refused.value)
    assert str(got) == str(refused.value) and got.rule == refused.value.rule


def in_child(work: Callable[[], object]) -> str:
    """Do work in a forked child, and return what it gives, as text."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            text = repr(work())
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
        os.write(writer, text.encode())
        os._exit(0)
    os.close(writer)
    timer = threading.Timer(PATIENCE, os.kill, (child, 9))
    timer.start()
    with os.fdopen(reader) as answer:
        text = answer.read()
    timer.cancel()
    os.waitpid(child, 0)
    return text


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
@pytest.mark.parametrize("threads", some([2, 1], 1))
def test_a_forked_child_goes_on_for_itself(threads: int, tmp_path: Path) -> None:
    keys = {"threads": threads, "integrator.scheme": "extrapolated"}
    scene = load_scene("three_axis", overrides=keys)
    plant, fleet = Plant(scene), Fleet(scene, 40, workers=2)
    rows = np.tile(ROW, (40, 1))

    def work() -> list[float]:
        plant.advance(ROW, 1000)
        return [*plant.state.q.tolist(), *fleet.run(rows, 200)[-1].ravel().tolist()]

    plant.advance(ROW, 10)
    fleet.run(rows, 200)  # its threads are there
    before = plant.save()
    child = in_child(work)
    assert plant.save() == before, "the child moves the parent's"
    assert child == repr(work())


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_a_fork_waits_for_calls_of_other_threads(scene: Scene) -> None:
    """The child never finds a machine in the middle of a call, nor a turn that nobody ends."""
    plant = Plant(scene)
    with ThreadPoolExecutor(1) as pool:
        long = pool.submit(plant.advance, ROW, 300_000)
        while plant.turn.acquire(blocking=False):  # until the call has its turn
            plant.turn.release()
        text = in_child(lambda: plant.t)
        long.result()
    assert float(text) == pytest.approx(300_000 * scene.integrator.dt)


def a_servo() -> Servo:
    """In the middle of a motion, with an integral of its own."""
    servo = Servo(find_beside(find_scene("three_axis"), "servo"))
    for tick in range(30):
        servo.update([tick, -2 * tick, 80], [0.1, 0.0, -0.2], [0.1, 0.2, 0.3])
    return servo


def go_on(servo: Servo) -> bytes:
    commands = [servo.update([40, 9 * k, 80], [0.1] * 3, [0.2] * 3) for k in range(20)]
    return np.array(commands).tobytes()


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_a_servo_goes_on_alike_and_alone(way: str) -> None:
    servo = a_servo()
    other, still = WAYS[way](servo), WAYS[way](servo)
    went = go_on(servo)
    assert go_on(other) == went, "it has forgotten something"
    assert go_on(still) == went, "they share what they remember"
    assert go_on(Servo(servo.config)) != went, "any servo would have passed"


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_a_session_goes_on_alike_and_alone(way: str, scene: Scene) -> None:
    names = scene.joint_names

    def run(session: Session, ticks: int) -> bytes:
        for _ in range(ticks):
            session.offer(session.tick, names, [3.0, -2.0, 1.0])
            session.advance()
        return session.plant.save()

    session = Session(scene, "lockstep", "first_answer")
    run(session, 20)
    session.paused = True
    other, still = WAYS[way](session), WAYS[way](session)
    assert other.tick == 20 and other.paused and other.scene is other.plant.scene
    went = run(session, 10)
    assert run(other, 10) == went and still.tick == 20, "they share the machine"
    assert run(still, 10) == went and still.state.t == pytest.approx(0.03)


@pytest.mark.parametrize("way", WAYS)
def test_a_session_whose_time_passes_by_itself_is_not_copied(way: str, scene: Scene) -> None:
    session = real_time_session(scene, "paused")
    with pytest.raises(Refusal, match="its clock must be advanced by its owner"):
        WAYS[way](session)
    session.close()


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_sessions_and_servos_of_a_forked_child(scene: Scene) -> None:
    session, servo = Session(scene, "lockstep", "free_run"), a_servo()
    loop = real_time_session(scene, "free_run")  # its thread runs

    def work() -> list[float]:
        for _ in range(20):
            session.advance()
        return [*session.state.q.tolist(), float(go_on(servo)[0])]

    def started() -> None:
        loop.paused = True
        loop.paused = False

    child = in_child(work)
    assert session.tick == 0 and child == repr(work())
    assert "must be the one that made it, got a forked child" in in_child(started)
    assert loop.wait(PATIENCE), "the parent's goes on"
    loop.close()


def test_calls_of_threads_on_one_servo_and_one_session_go_one_after_the_other(scene: Scene) -> None:
    """No measurement and no tick is lost."""
    servo, session = a_servo(), Session(scene, "lockstep", "free_run")

    def push(_: int) -> None:
        for _ in range(200):
            session.advance()
            servo.observe([1, 2, 3], [0.0] * 3)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(push, range(4)))
    assert session.tick == 800 and session.plant.t == pytest.approx(0.8)
    expected = a_servo()
    for _ in range(800):
        expected.observe([1, 2, 3], [0.0] * 3)
    assert go_on(servo) == go_on(expected)


def test_workers_of_other_processes_take_and_give_plants(plant: Plant) -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        moved = pool.map(advanced, [plant])[0]
    plant.advance(ROW, 50)
    assert moved.save() == plant.save()


def advanced(plant: Plant) -> Plant:
    plant.advance(ROW, 50)
    return plant


def test_calls_of_threads_on_one_plant_go_one_after_the_other(scene: Scene) -> None:
    """In any order of calls no step is lost, and every observed state is that of a step."""
    plant, expected = Plant(scene), Plant(scene)
    known = {expected.save()}
    for _ in range(400):
        expected.advance(ROW, 50)
        known.add(expected.save())
    seen: set[bytes] = set()

    def push() -> None:
        for _ in range(100):
            plant.advance(ROW, 50)
            seen.add(plant.save())

    with ThreadPoolExecutor(4) as pool:
        for one in [pool.submit(push) for _ in range(4)]:
            one.result()
    assert plant.save() == expected.save() and seen <= known


def test_a_fleet_is_a_sequence_of_plants(scene: Scene) -> None:
    fleet = Fleet(scene, 3, q=np.arange(9.0).reshape(3, 3) / 10.0)
    assert [arm.state.q[0] for arm in fleet] == fleet.state.q[:, 0].tolist()
    assert [arm.state.q[0] for arm in reversed(fleet)] == fleet.state.q[::-1, 0].tolist()
    assert fleet[np.int64(-1)].state.q[0] == fleet.state.q[2, 0]


def test_a_scene_may_be_given_by_name() -> None:
    assert Plant("three_axis").save() == Plant(load_scene("three_axis")).save()
    assert len(Fleet("three_axis", np.int32(2))) == 2
    with pytest.raises(Refusal, match="must be a Scene, a name or a file, got 5"):
        Plant(5)  # type: ignore[arg-type]
    with pytest.raises(Refusal, match="must exist"):
        Plant("no_such_arm")


def test_commands_may_be_given_by_names_of_joints(scene: Scene) -> None:
    one, other = Plant(scene), Plant(scene)
    for voltages in ({"elbow": 3, "waist": np.float32(5.0), "shoulder": -20.0}, np.array(ROW)):
        plant = one if isinstance(voltages, dict) else other
        plant.exchange(voltages)
        plant.advance(voltages, 3)
    assert one.save() == other.save()
    for wrong in ({"elbow": 1.0}, {"elbow": 1.0, "waist": 1.0, "wrist": 1.0}, {}):
        with pytest.raises(Refusal, match="must name every joint once"):
            one.exchange(wrong)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ({"payload": 0}, lambda scene: scene.load is None),
        ({"payload.mass": 0}, lambda scene: scene.load is None),
        ({"payload": np.float32(0.5)}, lambda scene: Plant(scene).energy is not None),
        ({"varied": ["seed"]}, lambda scene: scene.varied[0].name == "seed"),
        ({"varied": ("seed",), "seed": np.int64(4)}, lambda scene: scene.seed == 4),
        ({"gravity": np.array([0, 0, -9.81])}, lambda scene: scene.gravity == (0, 0, -9.81)),
        ({"integrator.dt": np.float32(1e-4)}, lambda scene: scene.integrator.dt == 1e-4),
    ],
    ids=range(7),
)
def test_overrides_may_be_what_a_caller_has(
    overrides: dict[str, Any], expected: Callable[[Scene], bool]
) -> None:
    assert expected(load_scene("three_axis", overrides=overrides))


def test_a_payload_of_no_mass_is_no_payload() -> None:
    ends = []
    for payload in (None, 0, 3.0):
        plant = Plant(load_scene("three_axis", overrides={"payload": payload}))
        plant.advance(ROW, 200)
        ends.append(plant.state.q)
    assert np.array_equal(ends[0], ends[1]) and not np.allclose(ends[0], ends[2])


@pytest.mark.parametrize("wrong", [[1], 5, {5: 3}, {None: 1}, "x"])
def test_overrides_of_another_kind_are_refused(wrong: Any) -> None:
    with pytest.raises(Refusal):
        load_scene("three_axis", overrides=wrong)


# Any argument: a call accepts it with its meaning, or refuses it and changes nothing.

NO_ROWS: list[Any] = [
    None, "abc", b"abc", ["a", "b", "c"], [None] * 3, [1j, 0, 0], {1.0, 2.0, 3.0}, object(), Plant,
    [True, False, True], np.array([True] * 3), [1.0, True, 2.0], (0.0, np.True_, 0.0), [5.0], 5.0,
    [[1.0, 2.0, 3.0]], [1.0, 2.0], [1.0, 2.0, 3.0, 4.0], [np.nan, 0.0, 0.0], [0.0, np.inf, 0.0],
    [10**400, 0, 0], [[1.0], [2.0, 3.0], 4], np.zeros((3, 1)), np.zeros(0), {"elbow": 1.0},
    np.array(["1", "2", "3"]), np.array([None] * 3), np.zeros(3, "m8[s]"), lambda: ROW,
]  # fmt: skip
NO_SETS = [x for x in NO_ROWS if not (isinstance(x, list) and x == [[1.0, 2.0, 3.0]])]  # of rows
NO_COUNTS: list[Any] = [
    None, "5", 5.0, True, np.True_, -3, np.float64(5.0), [5], np.array([5, 6]), 10**30, object(),
    np.nan, 1j, b"5", np.array(True), Fraction(5), {}, np.int8(-2),
]  # fmt: skip
NO_NUMBERS: list[Any] = [
    None, "5", True, np.True_, [5.0], np.array([1.0]), np.nan, np.inf, 1j, -1e30, 10**400, {},
    object(), np.array(True),
]  # fmt: skip
NO_FLAGS: list[Any] = [None, 0, 1, "off", "True", [], 1.0, np.int8(1), object()]
NO_BYTES: list[Any] = [None, 5, "abc", b"", b"x" * 100, [1, 2], np.zeros(4), object()]
NO_NAMES: list[Any] = [None, 5, "x", b"joints.elbow.friction.viscous", [], {}, True, object()]
NO_OBJECTS: list[Any] = [None, 5, "x", [], {}, object(), np.zeros(3)]
NAME = "joints.elbow.friction.viscous"


def calls() -> Iterator[tuple[str, Callable[[Any, Any], Any], list[Any]]]:
    """Yield calls of a plant or a fleet with each of the wrong arguments."""
    yield "advance", lambda p, x: p.advance(x, 1), NO_ROWS
    yield "advance steps", lambda p, x: p.advance(ROW, x), NO_COUNTS
    yield "run", lambda p, x: p.run(x, 1), NO_SETS
    yield "run steps", lambda p, x: p.run([ROW], x), NO_COUNTS
    yield "reset q", lambda p, x: p.reset(q=x), NO_ROWS[1:]
    yield "reset v", lambda p, x: p.reset(v=x), NO_ROWS[1:]
    yield "parameter", lambda p, x: p.set_parameter(NAME, x), NO_NUMBERS
    yield "name", lambda p, x: p.set_parameter(x, 1.0), NO_NAMES


def calls_of_plant() -> Iterator[tuple[str, Callable[[Any, Any], Any], list[Any]]]:
    ones = {"force": (1.0, 0.0, 0.0)}
    yield "exchange", lambda p, x: p.exchange(x), NO_ROWS
    yield "tick", lambda p, x: p.exchange(ROW, x), NO_COUNTS
    yield "command_d", lambda p, x: p.exchange(ROW, command_d=x), NO_ROWS
    yield "powered", lambda p, x: setattr(p, "powered", x), NO_FLAGS
    yield "restore", lambda p, x: p.restore(x), NO_BYTES
    yield "state", lambda p, x: setattr(p, "state", x), NO_OBJECTS
    yield "wrench", lambda p, x: p.set_external_wrench("forearm", x), NO_OBJECTS
    yield "link", lambda p, x: p.set_external_wrench(x, ExternalWrench(**ones)), NO_NAMES
    yield "loaded", lambda p, x: p.linear_drives(x), NO_FLAGS
    yield "accelerations", lambda p, x: p.links.accelerations(ROW, x, ROW), NO_ROWS
    yield "inverse", lambda p, x: p.links.inverse_dynamics(ROW, ROW, x), NO_ROWS
    yield "M", lambda p, x: p.links.mass_matrix(x), NO_SETS
    yield "metered", lambda p, x: p.advance_metered(x, 1), NO_ROWS


def calls_of_fleet() -> Iterator[tuple[str, Callable[[Any, Any], Any], list[Any]]]:
    no_arms: list[Any] = [
        True,
        "0",
        5,
        -5,
        [0, 4],
        [0.0, 1.0],
        [True] * 3,
        [[0]],
        object(),
        [[1], 2],
    ]
    no_flags: list[Any] = [*NO_FLAGS, [True] * 3, [1, 0, 1, 0], np.zeros(4), "xxxx"]
    no_columns: list[Any] = [*NO_NUMBERS, [1.0] * 3, [1.0, True, 1.0, 1.0], np.zeros((4, 1))]
    yield "exchange", lambda f, x: f.exchange(x), NO_ROWS
    yield "tick", lambda f, x: f.exchange(ROW, x), NO_COUNTS
    yield "command_d", lambda f, x: f.exchange(ROW, command_d=x), NO_ROWS
    yield "powered", lambda f, x: setattr(f, "powered", x), no_flags
    yield "restore", lambda f, x: f.restore(x), NO_BYTES
    yield "restore arms", lambda f, x: f.restore(f.save(), arms=x), no_arms
    yield "reset arms", lambda f, x: f.reset(x), no_arms
    yield "reset varied", lambda f, x: f.reset(varied={NAME: x}), no_columns
    yield "reset names", lambda f, x: f.reset(varied={x: 1.0}), ["x", 5, None, ""]
    yield "varied", lambda f, x: f.reset(varied=x), NO_OBJECTS[1:3]
    yield "arms of a number", lambda f, x: f.set_parameter(NAME, 5.0, arms=x), no_arms
    yield "by names", lambda f, x: f.advance({"waist": x, "shoulder": 0, "elbow": 0}, 1), [
        *NO_NUMBERS[:4], [1.0] * 3, np.inf, object(),
    ]  # fmt: skip


OF_FLEET = [*calls(), *calls_of_fleet()]
OF_PLANT = [*calls(), *calls_of_plant()]


@pytest.mark.parametrize(
    ("call", "wrong"), [one[1:] for one in OF_PLANT], ids=[one[0] for one in OF_PLANT]
)
def test_a_plant_refuses_what_it_cannot_take(
    call: Callable[[Any, Any], Any], wrong: list[Any], plant: Plant
) -> None:
    before = plant.save()
    for one in wrong:
        with pytest.raises(Refusal) as refused:
            call(plant, one)
            pytest.fail(f"took {one!r}")
        assert "\n" not in str(refused.value)
        assert plant.save() == before, f"{one!r} has changed the machine"


@pytest.mark.parametrize(
    ("call", "wrong"), [one[1:] for one in OF_FLEET], ids=[one[0] for one in OF_FLEET]
)
def test_a_fleet_refuses_what_it_cannot_take(
    call: Callable[[Any, Any], Any], wrong: list[Any], scene: Scene
) -> None:
    fleet = Fleet(scene, 4)  # of another count than its joints
    fleet.advance(ROW, 10)
    before = [arm.save() for arm in fleet]
    for one in wrong:
        with pytest.raises(Refusal):
            call(fleet, one)
            pytest.fail(f"took {one!r}")
        assert [arm.save() for arm in fleet] == before, f"{one!r} has changed the machines"


KINDS = ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u4", "u8", "g")


@pytest.mark.parametrize("seed", some(range(6), 2))
def test_numbers_of_every_kind_are_taken_for_what_they_are(seed: int, scene: Scene) -> None:
    """Lists, tuples, arrays, views; counts and numbers as scalars of NumPy."""
    rng = random.Random(seed)
    expected = Plant(scene)
    plant = Plant(scene)
    for _ in range(60):
        kind = np.dtype(rng.choice(KINDS))
        row = [rng.randint(0, 20) for _ in range(3)]
        array = np.array(row, kind)
        wide = np.zeros((3, 2), kind)
        wide[:, 1] = row
        given = rng.choice([row, tuple(row), array, list(array), wide[:, 1], array[::-1][::-1]])
        steps = rng.randint(0, 9)
        count = rng.choice([steps, np.int8(steps), np.uint64(steps), np.array(steps)])
        number = rng.choice([5, 5.0, np.float32(5.0), np.int16(5), np.array(5.0), Fraction(5)])
        plant.set_parameter(NAME, number)
        plant.advance(given, count)
        plant.exchange(given, tick=count)
        expected.set_parameter(NAME, 5.0)
        expected.advance(np.array(row, float), steps)
        expected.exchange(np.array(row, float), tick=steps)
        plant.powered = expected.powered = rng.choice([True, np.True_])
    assert plant.save() == expected.save()


def test_dynamics_of_links_agree_among_themselves(scene: Scene) -> None:
    """M is that of the kinetic energy's Hessian: columns by accelerations, and its inverse."""
    rng = np.random.default_rng(3)
    plant = Plant(scene)
    q, v, a = rng.normal(size=(3, 5, 3))
    M, nle = plant.links.mass_matrix(q), plant.links.nle(q, v)
    np.testing.assert_allclose(M, np.swapaxes(M, 1, 2), rtol=0, atol=0)
    assert (np.linalg.eigvalsh(M) > 0).all()
    tau = plant.links.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(plant.links.accelerations(q, v, tau), a, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(plant.links.accelerations(q, v, nle), np.zeros_like(q), atol=1e-9)
    np.testing.assert_allclose(plant.links.mass_matrix(q[2]), M[2], rtol=0, atol=0)

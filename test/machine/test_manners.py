"""Machines as objects of Python: copies, forks, threads, and all kinds of arguments."""

import copy
import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some

from arm_emulator import (
    Breakpoint,
    Condition,
    ExternalWrench,
    JacobianController,
    Kinematics,
    OfflineRun,
    Plant,
    Pose,
    Recording,
    Refusal,
    Scene,
    Servo,
    Session,
    Timeline,
    load_gains,
    load_scene,
    sensitivities,
    testing,
)
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.motion.planner.target_planner import TargetPlanner
from arm_emulator_fleet import Fleet, FleetWay, ServoFleet

PATIENCE = 60.0  # s, after which a child hangs
ROW = [5.0, -20.0, 3.0]
# As in `test_campaign`, so that they share their libraries.
VARIED = {"payload": 1.0, "varied": ["payload.mass"], "external_wrench": True}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis", overrides=VARIED)


def write_loaded(mass: float) -> str:
    return write_scene_unit(load_scene("three_axis", overrides={"payload": mass}))


@pytest.fixture
def plant(scene: Scene) -> Plant:
    """In motion, with a number and a wrench of its own."""
    plant = Plant(scene)
    plant.set_parameter(NAME, 6.5)
    plant.set_external_wrench(scene.chain.joints[1].link, ExternalWrench(force=(1.0, 2.0, 3.0)))
    plant.exchange(np.array(ROW), 7)
    plant.advance(ROW, 13)
    return plant


def test_a_scene_may_be_named() -> None:
    assert Plant("three_axis").save() == Plant(load_scene("three_axis")).save()
    assert len(Fleet("three_axis", np.int32(2))) == 2
    with pytest.raises(Refusal, match="must be a Scene, a name or a file, got 5"):
        Plant(5)  # type: ignore[arg-type]
    with pytest.raises(Refusal, match="must exist"):
        Plant("no_such_arm")


def test_commands_may_be_named_by_joint(scene: Scene) -> None:
    named, indexed = Plant(scene), Plant(scene)
    for voltages in ({"elbow": 3, "waist": np.float32(5.0), "shoulder": -20.0}, np.array(ROW)):
        plant = named if isinstance(voltages, dict) else indexed
        plant.exchange(voltages)
        plant.advance(voltages, 3)
    assert named.save() == indexed.save()
    for wrong in ({"elbow": 1.0}, {}):
        with pytest.raises(Refusal, match="must name every joint once"):
            named.exchange(wrong)
    with pytest.raises(Refusal, match="joint must be one of the arm, got wrist; valid: waist"):
        named.exchange({"elbow": 1.0, "waist": 1.0, "wrist": 1.0})


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ({"payload": 0}, lambda scene: scene.load is None),
        ({"payload.mass": 0}, lambda scene: scene.load is None),
        ({"payload": np.float32(2.0)}, lambda scene: write_scene_unit(scene) == write_loaded(2.0)),
        ({"varied": ["seed"]}, lambda scene: scene.varied[0].name == "seed"),
        ({"varied": ("seed",), "seed": np.int64(4)}, lambda scene: scene.seed == 4),
        ({"gravity": np.array([0, 0, -9.81])}, lambda scene: scene.gravity == (0, 0, -9.81)),
        ({"integrator.dt": np.float32(1e-4)}, lambda scene: scene.integrator.dt == 1e-4),
    ],
    ids=range(7),
)
def test_overrides_may_be_any_mapping(
    overrides: dict[str, Any], expected: Callable[[Scene], bool]
) -> None:
    assert expected(load_scene("three_axis", overrides=overrides))


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
NO_NAMES: list[Any] = [None, 5, "x", b"payload.mass", [], {}, True, object()]
NO_OBJECTS: list[Any] = [None, 5, "x", [], {}, object(), np.zeros(3)]
NAME = "payload.mass"


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
        True, "0", 5, -5, [0, 4], [0.0, 1.0], [True] * 3, [[0]], object(), [[1], 2],
    ]  # fmt: skip
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


OF_PLANT = [(Plant, *call) for call in (*calls(), *calls_of_plant())]
OF_FLEET = [(Fleet, *call) for call in (*calls(), *calls_of_fleet())]


@pytest.mark.parametrize(
    ("kind", "call", "wrong"),
    [(kind, call, wrong) for kind, _, call, wrong in OF_PLANT + OF_FLEET],
    ids=[f"{kind.__name__} {name}" for kind, name, *_ in OF_PLANT + OF_FLEET],
)
def test_machines_refuse_invalid_arguments(
    kind: type, call: Callable[[Any, Any], Any], wrong: list[Any], scene: Scene, plant: Plant
) -> None:
    machine = plant if kind is Plant else Fleet(scene, 4)  # of another count than its joints
    if kind is Fleet:
        machine.advance(ROW, 10)
    arms = [machine] if kind is Plant else [*machine]
    before = [(arm.save(), arm.commanded.tolist()) for arm in arms]
    for argument in wrong:
        with pytest.raises(Refusal) as refused:
            call(machine, argument)
            pytest.fail(f"took {argument!r}")
        assert "\n" not in str(refused.value)
        now = [(arm.save(), arm.commanded.tolist()) for arm in arms]
        assert now == before, f"{argument!r} has changed the machine"


KINDS = ("f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u4", "u8", "g")


def test_users_of_machines_refuse_invalid_arguments(scene: Scene, tmp_path: Path) -> None:
    """Servos, sessions, recordings, kinematics: every argument of another kind."""
    gains, ur5 = load_gains("three_axis"), load_gains("ur5")
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    turned = replace(gains.servo, joints=gains.servo.joints[::-1])
    ours = [turned, replace(gains.servo, joints=gains.servo.joints[:1]), ur5.servo]
    no_arms, pose = (
        [[0.5], [True], ["0"], 0, None, [[0]], [2**60]],
        Pose([0.3, 0.1, 0.2], np.eye(3)),
    )
    fleet, session = Fleet(scene, 2), Session(scene, "lockstep", "first_answer")
    servos, jacobian = ServoFleet(fleet, gains.servo), JacobianController(kinematics)
    record, timeline = (
        Recording(Plant(scene)),
        Timeline(OfflineRun(scene, gains.servo, gains.motion)),
    )
    planner, plant, objects = TargetPlanner(kinematics, gains.motion), Plant(scene), NO_OBJECTS
    planner.begin([0.0, 0.5, 0.8])
    values = {"q": [0.1]}
    calls: list[tuple[Callable[[Any], Any], list[Any]]] = [
        (Servo(gains.servo).retune, [*objects, *ours]),
        (lambda x: servos.retune(1, x), [*objects, *ours]),
        (lambda x: servos.aim_at(x, np.zeros((2, 3)), [0, 1, 2]), no_arms),
        (lambda x: servos.aim_at([0, 0], np.zeros((2, 3)), x), no_arms),
        (lambda x: FleetWay(x, 2), objects), (lambda x: FleetWay(scene, x), NO_COUNTS),
        (lambda x: session.offer(0, x, ROW), NO_NAMES), (session.return_to, objects),
        (lambda x: session.set_state(x, values), [*objects, "elbow", ["elbow"] * 2]),
        (lambda x: session.set_state(["elbow"], x), [*objects, {"elbow": [1.0]}, {"q": 1.0}]),
        (session.advance_under, [np.zeros((3, 3)), np.zeros((2, 3))]),
        (lambda x: plant.exchange(ROW, came=x), NO_FLAGS),
        (lambda x: plant.equations(ROW, slides=x), NO_FLAGS),
        (lambda x: plant.equations(ROW, follows=x), NO_FLAGS),
        (lambda x: plant.put("here", x), [*objects[:-3], {"elbow": ROW}]),
        (lambda x: plant.set_parameter(x, 1.0), [np.zeros(3), np.array(["a", "b"])]),
        (lambda x: plant.set_external_wrench("tool", ExternalWrench(axes=x)), objects),
        (lambda x: kinematics.tool_error(ROW, x), objects),
        (lambda x: kinematics.axes(x, ROW), NO_NAMES),
        (lambda x: jacobian.update([0.0, 0.5, 0.8], x), objects), (jacobian.retune, objects),
        (lambda x: planner.update([0.0, 0.5, 0.8], x), objects), (planner.retune, objects),
        (lambda x: planner.begin([0.0, 0.5, 0.8], x), NO_ROWS[1:]),
        (lambda x: Condition("v.elbow > 1", x), objects),
        (lambda x: Breakpoint(x, "v.elbow > 1"), objects),
        (record.write, [*objects[:2], *objects[3:], "", tmp_path / "run.xyz"]),
        (lambda x: Recording(plant, names=x), [None, 5, "q", [5], [None], [np.zeros(3)]]),
        (record.__getitem__, [None, 5, "energy", np.zeros(3)]),
        (lambda x: timeline.find(x, 3), objects), (lambda x: timeline.change("x", x), objects),
        (lambda x: testing.drive(plant, x, 3), objects),
        (lambda x: testing.drive(plant, lambda *_: ROW, x), NO_COUNTS),
        (lambda x: testing.assert_settles([ROW], ROW, x, 1), NO_NUMBERS),
        (lambda x: testing.assert_settles([ROW], x, 1.0, 1), NO_ROWS[:4]),
        (lambda x: sensitivities(scene, [ROW], x), [None, 5, [None]]),
    ]  # fmt: skip
    before = plant.save(), plant.commanded.tolist(), session.save(), fleet.save()
    for place, (call, wrong) in enumerate(calls):
        for argument in wrong:
            with pytest.raises(Refusal) as refused:
                call(argument)
                pytest.fail(f"call {place} took {argument!r}")
            assert "\n" not in str(refused.value)
    assert before == (plant.save(), plant.commanded.tolist(), session.save(), fleet.save())
    assert kinematics.tool_error(ROW, pose).shape == (3,), "what is right is taken"
    record.write(str(tmp_path / "run.csv"))
    assert (tmp_path / "run.csv").is_file()


@pytest.mark.parametrize("seed", some(range(6), 2))
def test_numbers_of_every_kind_are_accepted_by_value(seed: int, scene: Scene) -> None:
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
        command = rng.choice([row, tuple(row), array, list(array), wide[:, 1], array[::-1][::-1]])
        steps = rng.randint(0, 9)
        count = rng.choice([steps, np.int8(steps), np.uint64(steps), np.array(steps)])
        number = rng.choice([5, 5.0, np.float32(5.0), np.int16(5), np.array(5.0), Fraction(5)])
        plant.set_parameter(NAME, number)
        plant.advance(command, count)
        plant.exchange(command, tick=count)
        expected.set_parameter(NAME, 5.0)
        expected.advance(np.array(row, float), steps)
        expected.exchange(np.array(row, float), tick=steps)
        plant.powered = expected.powered = rng.choice([True, np.True_])
    assert plant.save() == expected.save()
    assert np.array_equal(copy.copy(plant).commanded, plant.commanded)


@pytest.mark.slow
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

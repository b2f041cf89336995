"""Copies, pickles, forks and threads of machines, sessions and servos."""

import copy
import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from test_manners import NAME, PATIENCE, ROW, plant, scene

from arm_emulator import (
    Diverged,
    JacobianController,
    Kinematics,
    Plant,
    Refusal,
    Scene,
    Servo,
    Session,
    load_scene,
)
from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.machine.session.real_time import open_real_time_session
from arm_emulator_fleet import Fleet

__all__ = ["plant", "scene"]  # fixtures


def bits(plant: Plant) -> bytes:
    return plant.save()


METHODS: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    "pickle": lambda original: pickle.loads(pickle.dumps(original)),
}


@pytest.mark.parametrize("method", METHODS)
def test_a_copy_goes_on_alike_and_alone(method: str, plant: Plant) -> None:
    second = METHODS[method](plant)
    assert bits(second) == bits(plant) and second.parameters == plant.parameters
    assert second.external_wrenches == plant.external_wrenches
    plant.advance(ROW, 20)
    assert bits(second) != bits(plant), "they share the machine"
    second.advance(ROW, 20)
    assert bits(second) == bits(plant)
    del plant
    second.advance(ROW, 20)


@pytest.mark.parametrize("method", METHODS)
def test_a_copy_of_a_fleet_goes_on_alike_and_alone(method: str, scene: Scene) -> None:
    fleet = Fleet(scene, 5, varied={NAME: np.linspace(1.0, 5.0, 5)}, workers=2)
    fleet.exchange(ROW)
    second = METHODS[method](fleet)
    assert second.save() == fleet.save() and len(second) == 5
    assert np.array_equal(second.parameters[NAME], np.linspace(1.0, 5.0, 5))
    before = fleet.save()
    second.advance(ROW, 20)
    assert fleet.save() == before, "they share the machines"


@pytest.mark.parametrize("method", METHODS)
def test_an_arm_of_a_fleet_is_copied_out_of_it(method: str, scene: Scene) -> None:
    fleet = Fleet(scene, 3)
    fleet.advance(ROW, 30)
    second, before = METHODS[method](fleet[1]), fleet[1].save()
    assert second.save() == before
    second.advance(ROW, 5)
    assert fleet[1].save() == before, "the fleet moves with the copy"


@pytest.mark.parametrize("method", METHODS)
def test_frames_and_kinematics_are_copied(method: str, scene: Scene) -> None:
    fleet = Fleet(scene, 3)
    frame = fleet.step(ROW, 30)
    second, q = METHODS[method](frame), frame.q.copy()
    fleet.step(ROW, 30, out=frame)
    assert np.array_equal(second.q, q) and not np.array_equal(frame.q, q)
    assert second.measured != frame.measured, "they share their arrays"
    fleet.step(ROW, 30, out=second)
    assert second.t[0] > frame.t[0]
    kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
    p = METHODS[method](JacobianController(kinematics)).kinematics.forward(scene.start)[1]
    assert np.array_equal(p, kinematics.forward(scene.start)[1])


@pytest.mark.parametrize("method", METHODS)
def test_reasons_are_copied_in_full(method: str) -> None:
    overrides = {"integrator.scheme": "paper", "integrator.dt": 1e-2, "servo_period": 1e-2}
    plant = Plant(load_scene("three_axis", overrides=overrides))
    with pytest.raises(Diverged) as diverged:
        plant.advance([20.0, -20.0, 10.0], 100_000)
    diverged.value.hint = "a hint"
    actual = METHODS[method](diverged.value)
    assert str(actual) == str(diverged.value) and actual.t == diverged.value.t
    with pytest.raises(Refusal) as refused:
        plant.advance([1.0], 1)
    actual = METHODS[method](refused.value)
    assert str(actual) == str(refused.value) and actual.rule == refused.value.rule


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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
@pytest.mark.parametrize("threads", some([2, 1], 1))
def test_a_forked_child_continues_independently(threads: int, tmp_path: Path) -> None:
    keys = {"threads": threads, "integrator.scheme": "paper"}  # those of `test_threads`
    scene = load_scene("three_axis", overrides=keys)
    plant, fleet = Plant(scene), Fleet(scene, 10, workers=2)
    rows = np.tile(ROW, (20, 1))

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
def test_a_fork_waits_for_calls_of_further_threads(scene: Scene) -> None:
    """The child never finds a machine in the middle of a call, nor a turn that no thread ends."""
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


@pytest.mark.parametrize("method", METHODS)
def test_a_copy_of_a_servo_goes_on_alike_and_alone(method: str) -> None:
    servo = a_servo()
    second, still = METHODS[method](servo), METHODS[method](servo)
    went = go_on(servo)
    assert go_on(second) == went, "it has forgotten something"
    assert go_on(still) == went, "they share what they remember"
    assert go_on(Servo(servo.config)) != went, "any servo would have passed"


@pytest.mark.parametrize("method", METHODS)
def test_a_copy_of_a_session_goes_on_alike_and_alone(method: str, scene: Scene) -> None:
    names = scene.joint_names

    def run(session: Session, ticks: int) -> bytes:
        for _ in range(ticks):
            session.offer(session.tick, names, [3.0, -2.0, 1.0])
            session.advance()
        return session.plant.save()

    session = Session(scene, "lockstep", "first_answer")
    run(session, 20)
    session.paused = True
    second, still = METHODS[method](session), METHODS[method](session)
    assert second.tick == 20 and second.paused and second.scene is second.plant.scene
    went = run(session, 10)
    assert run(second, 10) == went and still.tick == 20, "they share the machine"
    assert run(still, 10) == went and still.state.t == pytest.approx(0.03)


@pytest.mark.parametrize("method", METHODS)
def test_a_session_in_real_time_is_not_copied(method: str, scene: Scene) -> None:
    session = open_real_time_session(scene, "paused")
    with pytest.raises(Refusal, match="its clock must be advanced by its owner"):
        METHODS[method](session)
    session.close()


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*:DeprecationWarning")
def test_sessions_and_servos_of_a_forked_child(scene: Scene) -> None:
    session, servo = Session(scene, "lockstep", "free_run"), a_servo()
    loop = open_real_time_session(scene, "free_run")  # its thread runs

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


def test_calls_of_threads_on_servo_and_session_are_serialised(scene: Scene) -> None:
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


@pytest.mark.slow
def test_worker_processes_take_and_return_plants(plant: Plant) -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        moved = pool.map(advanced, [plant])[0]
    plant.advance(ROW, 50)
    assert moved.save() == plant.save()


def advanced(plant: Plant) -> Plant:
    plant.advance(ROW, 50)
    return plant


def test_calls_of_threads_on_a_plant_are_serialised(scene: Scene) -> None:
    """In any order of calls no step is lost, and every observed state is that of a step."""
    plant, expected = Plant(scene), Plant(scene)
    valid_states = {expected.save()}
    for _ in range(400):
        expected.advance(ROW, 50)
        valid_states.add(expected.save())
    observed: set[bytes] = set()

    def push() -> None:
        for _ in range(100):
            plant.advance(ROW, 50)
            observed.add(plant.save())

    with ThreadPoolExecutor(4) as pool:
        for future in [pool.submit(push) for _ in range(4)]:
            future.result()
    assert plant.save() == expected.save() and observed <= valid_states

"""A machine that is changed by hand: what services do, and what is refused."""

import math
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from by_hand import CLOCKS, QUANTITIES, go_on, session_of, sound_set_state, varied
from draws import some, with_slow
from in_process import in_process
from network import JOINTS, PATIENCE

from arm_emulator import Plant, load_scene
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.machine.session.real_time import RealTimeLoop
from arm_emulator_msgs.srv import RestoreState, SaveState, SetState, SetVaried

__all__ = ["varied"]  # a fixture


@pytest.mark.parametrize("seed", with_slow(some(range(10), 3), 1))
def test_set_quantities_change_and_all_others_stay(seed: int) -> None:
    draw = random.Random(seed)
    rows = dict(zip(QUANTITIES, ("q", "v", "theta_m", "omega_m", "current"), strict=True))
    with in_process() as nodes:
        go_on(nodes, 20)
        for _ in range(20):
            before, request = session_of(nodes).state, sound_set_state(draw)
            tick, changes = session_of(nodes).tick, nodes.nodes["emulator"]._reports.changes
            answer = nodes.call("emulator/set_state", request)
            assert answer.success and answer.message == f"at tick {tick}", answer
            after = session_of(nodes).state
            for name, row in rows.items():
                values = dict(zip(request.joint_names, getattr(request, name), strict=False))
                for j, joint in enumerate(JOINTS):
                    expected = values.get(joint, getattr(before, row)[j])
                    # Gears are elastic here: each quantity is one of its own, to the bit.
                    assert getattr(after, row)[j] == expected, f"{name} of {joint} after {request}"
            assert nodes.nodes["emulator"]._reports.changes == changes + 1, "events"
            # And it is reported at once, at the same tick.
            reported = nodes.newest("motor_states")
            assert reported.tick == tick and list(reported.current) == list(after.current)
            assert list(nodes.newest("emulator/joint_states").position) == list(after.q)
            go_on(nodes, draw.randrange(1, 4))


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
def test_a_varied_number_is_set_and_bad_ones_are_refused(clock: str, varied: Path) -> None:
    draw = random.Random(8)
    with in_process(clock, file=varied) as nodes:
        go_on(nodes, 10)
        numbers = session_of(nodes).scene.varied
        assert len(numbers) > 3, numbers
        for _ in range(20):
            number = draw.choice(numbers)
            value = max(number.value, 0.1) * draw.uniform(0.8, 1.25)
            request = SetVaried.Request(name=number.name, value=value)
            answer = nodes.call("emulator/set_varied", request)
            assert answer.success, answer.message
            assert session_of(nodes).plant.parameters[number.name] == value
            parameters = session_of(nodes).plant.parameters
            for bad in (math.nan, math.inf, -math.inf, -1e308, 1e308):
                request.value = bad
                answer = nodes.call("emulator/set_varied", request)
                assert not answer.success and f"{number.name} must" in answer.message, answer
            assert session_of(nodes).plant.parameters == parameters
            go_on(nodes, 2)


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
def test_a_restored_machine_is_as_it_was_saved_and_ticks_continue(clock: str) -> None:
    with in_process(clock) as nodes:
        go_on(nodes, 30)
        assert nodes.call("emulator/power", False).success
        saved = nodes.call("emulator/save_state", SaveState.Request(name="here"))
        assert nodes.call("emulator/power", True).success
        go_on(nodes, 30)
        assert nodes.call("emulator/pause", True).success
        tick, stamps = session_of(nodes).tick, nodes.newest("motor_states").header.stamp.nanosec
        for request in (RestoreState.Request(state=saved.state), RestoreState.Request(name="here")):
            assert nodes.call("emulator/set_state", SetState.Request(
                joint_names=["elbow"], current=[0.1])).success  # fmt: skip
            assert nodes.call("emulator/restore_state", request).success
            assert session_of(nodes).plant.save() == bytes(saved.state), "all that the machine is"
            assert not session_of(nodes).powered and not nodes.newest("motor_states").powered
            assert session_of(nodes).tick == tick, "ticks neither stand nor run back"
            assert nodes.newest("motor_states").header.stamp.nanosec == stamps
        assert nodes.call("emulator/pause", False).success
        go_on(nodes, 10)
        assert session_of(nodes).tick > tick


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
def test_a_machine_that_has_diverged_goes_on_when_it_is_put_elsewhere(
    clock: str, tmp_path: Path
) -> None:
    draw = random.Random(5)
    with in_process(clock) as nodes:
        nodes.begin_record()
        assert nodes.call("emulator/reset").success
        go_on(nodes, 20)
        saved = nodes.call("emulator/save_state", SaveState.Request()).state
        faults = 0
        for case in range(12):
            # Too fast for the step at once, or after some steps within a period.
            apart = SetState.Request(
                joint_names=[draw.choice(JOINTS)], velocity=[10.0 ** draw.uniform(3.0, 6.0)]
            )
            assert nodes.call("emulator/set_state", apart).success
            tick, deadline = session_of(nodes).tick, time.monotonic() + PATIENCE
            while session_of(nodes).fault is None and session_of(nodes).tick < tick + 30:
                assert time.monotonic() < deadline, "neither a fault nor a tick"
                nodes.deliver()
            faults += session_of(nodes).fault is not None
            assert nodes.call("emulator/power", False).success  # while it stands still
            assert nodes.call("emulator/power", True).success
            tick = session_of(nodes).tick
            if case % 2:
                request: Any = RestoreState.Request(state=saved)
                assert nodes.call("emulator/restore_state", request).success
            else:
                request = SetState.Request(
                    joint_names=JOINTS,
                    position=[0.0, 0.3, 0.3],
                    velocity=[0.0] * 3,
                    motor_position=[0.0, 30.0, 30.0],
                    motor_velocity=[0.0] * 3,
                    current=[0.0] * 3,
                )
                assert nodes.call("emulator/set_state", request).success
            go_on(nodes, 20)
            assert session_of(nodes).fault is None and session_of(nodes).tick >= tick + 20
        assert faults > 3, "the test is of something"
        nodes.nodes["emulator"]._status.publish_status()
        nodes.write(tmp_path / "bag")
    assert check_bag(tmp_path / "bag", scene="three_axis") == 0


def bad_requests(draw: random.Random, saved: bytes) -> Iterator[tuple[str, Any]]:
    for _ in range(40):
        request = sound_set_state(draw)
        inputs = [name for name in QUANTITIES if getattr(request, name)]
        row = getattr(request, draw.choice(inputs))
        match draw.randrange(5):
            case 0:
                number = draw.choice([math.nan, math.inf, -math.inf, 1e308, -1e300, 1e17])
                row[draw.randrange(len(row))] = number
            case 1:
                row.append(0.0) if draw.random() < 0.5 else row.extend([0.0] * 10_000)
            case 2:
                names = request.joint_names
                second = draw.choice(["hand", "", "\0", "x" * 10_000, JOINTS[0], "WAIST"])
                names = [*names, second] if second != JOINTS[0] else [*names, names[0]]
                request.joint_names = names
            case 3:
                request.joint_names = []
            case 4:
                for name in inputs:
                    setattr(request, name, [])
        yield "emulator/set_state", request
    for _ in range(40):
        spoiled = bytearray(saved)
        match draw.randrange(4):
            case 0:
                spoiled[draw.randrange(len(saved))] ^= 1 << draw.randrange(8)
            case 1:
                spoiled = spoiled[: draw.randrange(1, len(saved))]
            case 2:
                spoiled = bytearray(draw.randbytes(len(saved)))
            case 3:
                spoiled[64:] = draw.randbytes(len(saved) - 64)
        yield "emulator/restore_state", RestoreState.Request(state=bytes(spoiled))
    for name in ("payload.mass", "", "joints", "x" * 1000):
        yield "emulator/set_varied", SetVaried.Request(name=name, value=1.0)  # not varied here
    yield "emulator/restore_state", RestoreState.Request()
    yield "emulator/restore_state", RestoreState.Request(name="nobody")
    yield "emulator/restore_state", RestoreState.Request(name="kept", state=saved)


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
def test_bad_requests_are_refused_and_change_nothing(clock: str) -> None:
    draw = random.Random(7)
    with in_process(clock) as nodes:
        go_on(nodes, 20)
        saved = bytes(nodes.call("emulator/save_state", SaveState.Request(name="kept")).state)
        assert nodes.call("emulator/pause", True).success
        before, tick = session_of(nodes).plant.save(), session_of(nodes).tick
        changes = nodes.nodes["emulator"]._reports.changes
        for name, request in bad_requests(draw, saved):
            answer = nodes.call(name, request)
            words = f"{name} {str(request)[:300]}: {answer.message}"
            assert not answer.success and " must " in answer.message, words
            assert "\n" not in answer.message, words
            assert session_of(nodes).plant.save() == before, words
        assert (session_of(nodes).tick, nodes.nodes["emulator"]._reports.changes) == (tick, changes)
        assert nodes.call("emulator/pause", False).success
        # And while it runs.
        for name, request in bad_requests(draw, saved):
            assert not nodes.call(name, request).success, name
            nodes.deliver()
        go_on(nodes, 20)
        assert nodes.nodes["emulator"]._reports.changes == changes, "events"


def test_a_machine_of_another_scene_is_refused() -> None:
    with in_process() as nodes:
        state = Plant(load_scene("three_axis", overrides={"integrator.dt": 2.5e-4})).save()
        answer = nodes.call("emulator/restore_state", RestoreState.Request(state=state))
        assert not answer.success and "saved machine must" in answer.message, answer


def test_names_are_stored_up_to_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator_node.services.SAVED_LIMIT", 3)
    with in_process() as nodes:
        for name in ("a", "b", "c", "a"):
            assert nodes.call("emulator/save_state", SaveState.Request(name=name)).success
        assert not nodes.call("emulator/save_state", SaveState.Request(name="d")).success
        assert nodes.call("emulator/save_state", SaveState.Request()).success


def test_periods_in_which_the_loop_stands_still_are_lost_and_counted() -> None:
    plant, period = Plant(load_scene("three_axis")), 1_000_000  # ns
    loop = RealTimeLoop(plant, period, -1)
    began = time.monotonic_ns()
    loop.start_time(0)
    draw = np.random.default_rng(3)
    for _ in range(5):
        while loop.figures.tick < draw.integers(5, 20):
            pass
        loop.stop_time()
        stands = time.monotonic_ns() + int(draw.uniform(3, 40)) * period
        before = loop.figures
        while time.monotonic_ns() < stands:
            pass
        assert loop.figures == before, "the loop stands still"
        loop.go_on()
        while loop.figures.tick == before.tick:
            pass
        # It began the newest period before it stopped.
        assert loop.figures.tick >= before.tick + 1, "ticks go on where they were"
    smallest = time.monotonic_ns() - began
    loop.stop_time()
    figures, largest = loop.figures, time.monotonic_ns() - began
    passed = (figures.tick + figures.lost_periods) * period
    # All time is either a tick or a lost period, except for the present period and the loop's delay
    # for it.
    open_ns = 2 * period + figures.worst_lateness
    assert smallest - passed < open_ns, f"{passed} of {smallest} ns are reported"
    assert passed <= largest, f"{passed} of {largest} ns are reported"

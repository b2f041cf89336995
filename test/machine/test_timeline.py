"""A run's past visited again, and runs that fork from it, equal straight runs to the last bit."""

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from draws import some, with_slow

from arm_emulator import OfflineRun, Pose, Refusal, Timeline
from arm_emulator.motion.executor.jog import JogCommand
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.runs.offline import load_offline_run

Act = Callable[[OfflineRun], object]


def save_all(run: OfflineRun) -> tuple[Any, ...]:
    """All that a run shows at a tick."""
    servo = run.drives.servo
    return (
        run.tick,
        run.session.plant.save(),
        servo.state.tobytes(),
        bytes(servo.arm.does.to_bytes(4, "little")),
        run.aimed.tobytes(),
        run.session.phase,
        run.session.powered,
        run.drives.reason,
    )


def move(x: float, y: float, z: float) -> Act:
    """A tool target beside where the tool is."""

    def act(run: OfflineRun) -> None:
        R_WT, p_WT = run.controller.kinematics.forward(run.session.state.q)
        run.instructor.add(run.session.logical_ns, Pose(p_WT + np.array([x, y, z]), R_WT))

    return act


def power(on: bool) -> Act:
    def act(run: OfflineRun) -> None:
        run.session.powered = on

    return act


def push(run: OfflineRun) -> None:
    """Set the machine elsewhere."""
    first = run.session.scene.joint_names[0]
    run.session.set_state([first], {"v": [0.05]})


def jog(run: OfflineRun) -> None:
    run.instructor.take_jog(
        JogCommand(run.session.logical_ns, np.array([0.02, -0.03, 0.01, 0.0, 0.0, 0.0]))
    )


def path(run: OfflineRun) -> None:
    """Two lines with a corner."""
    R_WT, p_WT = run.controller.kinematics.forward(run.session.state.q)
    places = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, -0.01], [0.02, 0.02, 0.0]])
    run.instructor.add_path(run.controller, [Pose(p_WT + place, R_WT) for place in places])


def trajectory(run: OfflineRun) -> None:
    names = run.controller.kinematics.joint_names
    end = run.aimed + 0.05
    run.instructor.add_trajectory(run.controller, names, [TrajectoryPoint(400_000_000, end)])


def retune(run: OfflineRun) -> None:
    config = run.drives.servo.config
    joints = tuple(
        dataclasses.replace(joint, position_gain=0.5 * joint.position_gain)
        for joint in config.joints
    )
    run.drives.set_config(dataclasses.replace(config, joints=joints))


STORY: list[tuple[int, str, Act]] = [
    (90, "target", move(0.02, 0.03, -0.03)),
    (333, "a target before the end of the last", move(-0.03, 0.01, 0.02)),
    (117, "gains", retune),
    (60, "power off", power(False)),
    (150, "power on", power(True)),
    (260, "target", move(0.01, -0.02, 0.01)),
    (41, "machine set", push),
    (320, "target", move(-0.01, 0.02, -0.01)),
    (180, "path", path),
    (330, "trajectory", trajectory),
    (260, "jog", jog),
    (15, "jog", jog),
]


def straight(scene: str, story: list[tuple[int, str, Act]], ends: int) -> dict[int, Any]:
    """Every 7th tick of a run without a timeline, and those after changes."""
    run = load_offline_run(scene)
    states: dict[int, Any] = {}
    for ticks, _, act in [*story, (ends, "", lambda _: None)]:
        end = run.tick + ticks
        while run.tick < end:
            run.advance(min(7 - run.tick % 7, end - run.tick))
            states[run.tick] = save_all(run)
        act(run)
        states[run.tick] = save_all(run)
    return states


@pytest.mark.parametrize("scene", with_slow(some(("three_axis", "ur5", "panda"), 2), 1))
def test_any_tick_of_the_past_equals_the_straight_run(scene: str) -> None:
    states = straight(scene, STORY, 200)
    line = Timeline(load_offline_run(scene), every=100)
    for ticks, name, act in STORY:
        line.advance(ticks)
        line.change(name, act)
    line.advance(200)
    assert [change.name for change in line.changes] == [name for _, name, _ in STORY]
    ticks = [change.tick for change in line.changes]
    for (begin, name, _), end in zip(line.changes, [*ticks[1:], line.newest], strict=True):
        if name in ("target", "path", "trajectory", "jog"):
            assert states[begin][4] != states[end][4], f"joint targets during: {name}"
    rng = np.random.default_rng(3)
    for tick in rng.permutation(list(states)).tolist():
        line.go_to(tick)
        assert save_all(line.run) == states[tick], f"tick {tick} visited"
    # Driving on from the past leads through the changes, too.
    line.go_to(5)
    line.advance(line.newest - 5)
    assert save_all(line.run) == states[line.newest], "end, driven from the past"


def test_forks_of_forks_are_straight_runs_of_their_own_story() -> None:
    first, second, third = move(0.02, 0.0, -0.02), move(0.0, 0.03, 0.0), retune
    line = Timeline(load_offline_run("three_axis"), every=64)
    line.advance(50)
    line.change("one", first)
    line.advance(450)
    line.go_to(170)
    fork = line.fork()
    fork.change("two", second)
    fork.advance(230)
    fork.go_to(290)
    of_fork = fork.fork()
    of_fork.change("three", third)
    of_fork.advance(140)
    stories = {
        line: ([(50, "one", first)], 500),
        fork: ([(50, "one", first), (120, "two", second)], 400),
        of_fork: ([(50, "one", first), (120, "two", second), (120, "three", third)], 430),
    }
    assert of_fork.parent is fork and fork.parent is line and line.parent is None
    assert (fork.begins, of_fork.begins) == (170, 290), "where they fork"
    for timeline, (story, newest) in stories.items():
        assert timeline.newest == newest, "a fork changes no other"
        states = straight("three_axis", story, newest - sum(ticks for ticks, *_ in story))
        for tick in sorted(states, key=lambda tick: tick * 7919 % 101):
            for member in (line, of_fork, timeline):  # they share one run
                member.go_to(min(tick, member.newest))
            assert save_all(timeline.run) == states[tick], f"{timeline}, tick {tick}"


def test_a_change_that_is_refused_leaves_no_trace() -> None:
    line = Timeline(load_offline_run("three_axis"))
    line.advance(20)
    before = save_all(line.run)

    def half(run: OfflineRun) -> None:
        run.session.powered = False
        run.session.set_state(["no such joint"], {"q": [0.0]})

    with pytest.raises(Refusal, match="joint names must name joints"):
        line.change("half", half)
    assert save_all(line.run) == before and not line.changes
    line.advance(5)
    line.go_to(20)
    with pytest.raises(Refusal, match="tick must be 25, the newest, got 20"):
        line.change("late", power(False))
    for tick in (-1, 26, 1.5, True):
        with pytest.raises(Refusal, match=r"Timeline.go_to: tick must be"):
            line.go_to(tick)  # type: ignore[arg-type]
    second_run = load_offline_run("three_axis")
    with pytest.raises(Refusal, match=r"what `save` of the same run returned"):
        second_run.restore(line.run.save())


@pytest.mark.parametrize("answered", [False, True])
def test_a_run_that_ctrl_c_broke_off_goes_on_as_the_straight_run(
    monkeypatch: pytest.MonkeyPatch, answered: bool
) -> None:
    """Before and after the motion controller's answer, driven to a new tick and to a past one."""
    act = move(0.02, 0.03, -0.03)
    states = straight("three_axis", [(90, "target", act)], 300)
    line = Timeline(load_offline_run("three_axis"), every=64)
    line.advance(90)
    line.change("target", act)

    @contextmanager
    def break_off_at(tick: int) -> Iterator[None]:
        instruct = line.run._instruct_servo

        def interrupted() -> None:
            if answered or line.run.tick != tick:
                instruct()
            if line.run.tick == tick:
                raise KeyboardInterrupt

        with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
            patched.setattr(line.run, "_instruct_servo", interrupted)
            yield

    with break_off_at(250):
        line.advance(300)
    assert line.tick == line.newest == 250
    line.advance(140)
    line.go_to(20)
    with break_off_at(200):
        line.go_to(210)
    assert line.newest == 390
    line.go_to(line.tick)
    line.advance(1)
    for tick in (390, 210, 385, 371, 90):
        line.go_to(tick)
        assert save_all(line.run) == states[tick], f"tick {tick}"


def test_checkpoints_cost_no_more_than_their_number() -> None:
    few, many = (Timeline(load_offline_run("three_axis"), every) for every in (500, 50))
    for line in (few, many):
        line.advance(500)
    assert 4 * few.bytes < many.bytes < 7 * few.bytes  # 2 and 11 checkpoints

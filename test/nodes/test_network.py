"""The nodes among strangers: bad messages, services, both clocks, simulated time."""

import math
import random
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
import rclpy
from bad_messages import BAD, ZERO, at_tick, joint_state, motor_command, motor_state, pose
from diagnostic_msgs.msg import DiagnosticStatus
from draws import some
from in_process import in_process
from network import (
    ASK_AGAIN,
    JOINTS,
    RECEIVER,
    SOLE_PUBLISHER,
    SharedNetwork,
    User,
    assert_same_bits,
    node,
    offline_states,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from arm_emulator.motion.model.pose import Pose
from arm_emulator.ros.messages.time_stamp import NANOSECONDS, convert_to_nanoseconds
from arm_emulator.runs.offline import OfflineRun, load_offline_run
from arm_emulator_msgs.msg import EmulatorStatus
from emulator_node.page_controls import RosControls

TICKS = 400


@pytest.fixture(scope="module")
def lockstep(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedNetwork]:
    with closing(SharedNetwork(tmp_path_factory.mktemp("lockstep"))) as shared:
        yield shared


@pytest.fixture(scope="module")
def real_time(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedNetwork]:
    with closing(SharedNetwork(tmp_path_factory.mktemp("real_time"), clock="realtime")) as shared:
        yield shared


def go(user: User) -> None:
    user.await_start()
    assert user.call("emulator/pause", False).success


def pause_at(user: User, tick: int) -> int:
    """Pause a lock-step run at `tick` or soon after, when that tick is answered."""
    user.wait(f"tick {tick}", lambda: user.tick >= tick)
    assert user.call("emulator/pause", True).success
    paused = EmulatorStatus.PHASE_PAUSED
    user.wait("the pause", lambda: user.status.phase == paused and user.status.answered)
    user.wait("the last state", lambda: user.tick == user.status.tick)
    return int(user.status.tick)


# ------------------------------------------------------------------------------------ bad messages


# Nodes read these with best effort: a message may get lost.
MAY_GET_LOST = ("motor_states", "joint_states")
# Topics of different receivers.
TOGETHER = [("motor_commands", "joint_targets", "tool_target"), ("motor_states", "joint_states")]
# Of which a node reports every second what it has refused; in one process all are tried.
SENT = {topic: some(bad, 2) for topic, bad in BAD.items()}


def publishers(user: User) -> dict[str, Any]:
    return {
        "motor_commands": user.commands,
        "joint_targets": user.targets,
        "motor_states": user.states,
        "tool_target": user.tool_targets,
        "joint_states": user.measured,
    }


def assert_all_refused(user: User, bad: dict[str, tuple[Any, str]], tick: int) -> None:
    """Publish a bad message on each topic and wait until they are refused in these words."""
    before = {topic: user.refused(RECEIVER[topic], topic) for topic in bad}
    for topic, (message, _) in bad.items():
        user.publish(publishers(user)[topic], message)
    for topic, (message, words) in bad.items():
        await_refusal(user, topic, message, before[topic], refusal(topic, at_tick(words, tick)))


def refusal(topic: str, words: str) -> str:
    """Return how the refusal of a bad message of this user begins, where others publish, too."""
    if topic in SOLE_PUBLISHER:
        words = f"publisher must be node /{SOLE_PUBLISHER[topic]}, whose messages are taken"
    return f"{topic}: {words}"


def await_refusal(user: User, topic: str, message: Any, before: int, words: str) -> None:
    """Wait until a message is refused; send it again if it may have been lost."""
    name, again_at = RECEIVER[topic], time.monotonic() + ASK_AGAIN

    def refused() -> bool:
        nonlocal again_at
        if topic in MAY_GET_LOST and time.monotonic() > again_at:
            again_at = time.monotonic() + ASK_AGAIN
            user.publish(publishers(user)[topic], message)
        printed = user.value(name, "newest refusal")
        return user.refused(name, topic) > before and printed.startswith(words)

    user.wait(f"the refusal {words}", refused)
    assert "\n" not in user.value(name, "newest refusal")
    assert user.diagnostics[name].level == DiagnosticStatus.WARN


def tool_targets(user: User) -> int:
    """Return how many tool targets the motion controller has taken."""
    return int(user.value("motion_controller", "tool targets") or 0)


def refusals(user: User) -> dict[str, int]:
    """Return how many messages of each topic were refused so far."""
    return {topic: user.refused(receiver, topic) for topic, receiver in RECEIVER.items()}


def reference(change: Callable[[OfflineRun], None] | None = None) -> dict[int, bytes]:
    run = load_offline_run("three_axis")
    if change:
        change(run)
    return offline_states(run, TICKS)


@pytest.mark.slow
def test_bad_messages_are_refused_counted_and_change_nothing(lockstep: SharedNetwork) -> None:
    with lockstep() as (user, _):
        go(user)
        tick = pause_at(user, 120)
        before, taken = refusals(user), tool_targets(user)
        commands_refused = user.status.commands_refused + len(SENT["motor_commands"])
        # One bad message per node and turn, so that each one's words are seen.
        for topics in TOGETHER:
            for turn in range(max(len(SENT[topic]) for topic in topics)):
                bad = {topic: SENT[topic][turn] for topic in topics if turn < len(SENT[topic])}
                messages = {topic: (make(tick), words) for topic, (make, words) in bad.items()}
                assert_all_refused(user, messages, tick)
        user.wait("the count", lambda: user.status.commands_refused == commands_refused)
        for topic in set(BAD) - set(MAY_GET_LOST):
            refused = user.refused(RECEIVER[topic], topic) - before[topic]
            assert refused == len(SENT[topic]), f"{topic} refused {refused} times"
        assert tool_targets(user) == taken, "a bad tool target was taken"
        assert user.call("emulator/pause", False).success
        user.wait("the run", lambda: user.tick >= TICKS)
        assert_same_bits(user.motor_states(), reference(), TICKS)


def test_every_bad_message_is_refused_in_its_words() -> None:
    """As above, in one process."""
    with in_process() as nodes:
        nodes.run_to(120)
        for topic, bad in BAD.items():
            node = nodes.nodes[RECEIVER[topic]]
            for make, words in bad:
                before = nodes.refused(RECEIVER[topic])
                nodes.send(topic, make(nodes.tick))
                assert nodes.refused(RECEIVER[topic]) == before + 1, f"{topic}: {words}"
                reported = node._diagnostics._newest_refusal
                assert reported.startswith(f"{topic}: {at_tick(words, nodes.tick)}"), reported
                assert "\n" not in reported, reported
        nodes.run_to(TICKS)
        assert_same_bits(nodes.states, reference(), TICKS)


@pytest.mark.slow
def test_garbage_and_huge_messages_change_nothing(lockstep: SharedNetwork) -> None:
    rng = random.Random(5)
    little_endian = b"\0\1\0\0"
    garbage = [
        b"",
        little_endian,
        little_endian + b"\xff" * 64,
        *[little_endian + rng.randbytes(rng.randint(1, 300)) for _ in range(20)],
        *[rng.randbytes(rng.randint(1, 300)) for _ in range(20)],
    ]
    names = [f"joint_{index}" for index in range(5_000)]
    values = [0.0] * len(names)
    with lockstep() as (user, _):
        go(user)
        tick = pause_at(user, 120)
        publish = publishers(user)
        for publisher in publish.values():
            for data in garbage:
                user.publish(publisher, data)
                user.spin(0.001)
        huge = {
            "motor_commands": motor_command(tick, values, names),
            "joint_targets": joint_state(tick * 10**6, values, names),
            "motor_states": motor_state(
                tick + 1, joint_names=names, encoder_counts=[0] * len(names), current=values
            ),
            "joint_states": joint_state(10**18, values, names),
            "tool_target": pose(ZERO, [0.0, 0.0, 0.0, 1.0], "x" * 100_000),
        }
        before, waiting = refusals(user), set(huge)

        def refused() -> bool:
            for topic in list(waiting):
                if user.refused(RECEIVER[topic], topic) > before[topic]:
                    waiting.remove(topic)
                    assert len(user.value(RECEIVER[topic], "newest refusal")) < 300
                else:
                    user.publish(publish[topic], huge[topic])  # again: states may get lost
            return not waiting

        user.wait("the refusals of huge messages", refused)
        assert user.call("emulator/pause", False).success
        user.wait("the run", lambda: user.tick >= TICKS)
        assert_same_bits(user.motor_states(), reference(), TICKS)


@pytest.mark.slow
def test_tool_targets_for_different_times_may_come_at_once(lockstep: SharedNetwork) -> None:
    _, p_WT = load_offline_run("three_axis").controller.kinematics.forward([0.0, 0.5, 0.8])
    there, back = p_WT + np.array([0.0, 0.02, 0.0]), p_WT - np.array([0.0, 0.01, 0.0])

    def aim(run: OfflineRun) -> None:
        run.instructor.add(100_000_000, Pose(there, np.eye(3)))
        run.instructor.add(250_000_000, Pose(back, np.eye(3)))

    with lockstep() as (user, _):
        user.await_start()
        before = tool_targets(user)
        user.send_tool_target(tuple(map(float, back)), at=0.25)
        user.send_tool_target(tuple(map(float, there)), at=0.1)
        user.wait("both", lambda: tool_targets(user) == before + 2)
        assert user.call("emulator/pause", False).success
        user.wait("the run", lambda: user.tick >= TICKS)
        assert_same_bits(user.motor_states(), reference(aim), TICKS)


# ---------------------------------------------------------------------------------------- services


def test_services_in_lock_step(lockstep: SharedNetwork) -> None:
    with lockstep() as (user, _):
        go(user)
        refused = user.call("emulator/step")
        assert not refused.success and refused.message == "not paused, pause first"
        tick = pause_at(user, 100)
        for more in range(1, 4):
            stepped = user.call("emulator/step")
            assert stepped.success and stepped.message == f"at tick {tick + more}"
            user.wait("the state", lambda more=more: user.tick == tick + more)
            user.wait("the status", lambda more=more: user.status.tick == tick + more)
            user.wait("its answer", lambda: user.status.answered)
        off_at = tick + 3
        assert user.call("emulator/power", False).success
        assert user.call("emulator/pause", False).success
        user.wait("the servo to notice", lambda: user.printed("servo", "the drives' power is off"))
        on_at = pause_at(user, off_at + 60)
        user.wait("the status", lambda: not user.status.powered)
        assert user.call("emulator/power", True).success
        assert user.call("emulator/pause", False).success
        end = on_at + 100
        user.wait("the run", lambda: user.tick >= end)
        user.wait("the status", lambda: user.status.powered)
        powerless = load_offline_run("three_axis")
        offline = offline_states(powerless, off_at)
        # Power is off from this tick on; the servo has answered it already and receives it in the
        # next state. Likewise when it comes back.
        powerless.session.powered = False
        offline |= offline_states(powerless, on_at + 1)
        powerless.session.powered = True
        offline |= offline_states(powerless, end)
        assert_same_bits(user.motor_states(), offline, end)

        user.forget()
        assert user.call("emulator/reset").message == "at tick 0"
        user.wait("the pause of the start", lambda: user.status and user.status.tick == 0)
        assert user.status.phase == EmulatorStatus.PHASE_PAUSED
        go(user)
        user.wait("the run", lambda: user.tick >= TICKS)
        assert_same_bits(user.motor_states(), reference(), TICKS)


def test_the_first_actions_of_a_page_are_answered(lockstep: SharedNetwork) -> None:
    with lockstep() as (user, _):
        user.await_start()
        controls = RosControls("/", 1e-3, lockstep=True)
        try:
            assert controls.pause(False) == "going on at tick 0"
            user.wait("the run", lambda: user.tick > 20)
            assert controls.pause(True).startswith("paused at tick ")
            tick = int(controls.step(1).removeprefix("at tick "))
            user.wait("the step", lambda: user.tick == tick)
            gains = controls.gains()
            assert {f"joints.{name}.position_gain" for name in JOINTS} <= set(gains)
        finally:
            controls.close()


@pytest.mark.slow
def test_nodes_follow_the_emulators_clock(lockstep: SharedNetwork) -> None:
    """One of ours beside the others, which commands another arm, and one of the test's."""
    renamed = ("-r", "__node:=other", "-r", "joint_targets:=other_targets")
    with (
        lockstep() as (user, _),
        node("motion_controller_node.node", "-p", "use_sim_time:=true", *renamed),
    ):
        user.wait("words of it", lambda: "other" in user.diagnostics)
        listener = rclpy.create_node(
            "follower",
            context=user.node.context,
            parameter_overrides=[Parameter("use_sim_time", value=True)],
        )
        user.add(listener)
        go(user)
        tick = pause_at(user, 1100)
        # The clock is reported every 10 ticks, and nodes read it with best effort: 100 ms are left
        # for what gets lost.
        expected = tick // 10 * 10 * 1_000_000

        def now(node: Node = listener) -> int:
            return int(node.get_clock().now().nanoseconds)

        user.wait("the time", lambda: expected - 100_000_000 <= now() <= expected)
        assert now() % 10_000_000 == 0
        late = rclpy.create_node(
            "late",
            context=user.node.context,
            parameter_overrides=[Parameter("use_sim_time", value=True)],
        )
        user.add(late)
        user.wait("the time for one who comes while it stands", lambda: now(late) == expected)
        assert now() == expected
        # Diagnostics carry the node's own time: since 0 here, since 1970 in a node without.
        user.wait("words at 1 s", lambda: user.stamps.get("other", 0) >= NANOSECONDS)
        assert user.stamps["other"] <= expected
        assert user.stamps["servo"] > 10**9 * NANOSECONDS
        # They go on while logical time stands still.
        del user.diagnostics["other"]
        user.wait("words at a standstill", lambda: "other" in user.diagnostics)
        listener.destroy_node()
        late.destroy_node()


@pytest.mark.slow
def test_services_in_real_time(real_time: SharedNetwork) -> None:
    with real_time() as (user, _):
        go(user)
        running = EmulatorStatus.PHASE_RUNNING
        user.wait("the run", lambda: user.status and user.status.phase == running)
        assert not user.call("emulator/step").success
        assert user.call("emulator/pause", True).success
        first = int(user.call("emulator/step").message.removeprefix("at tick "))
        for more in range(1, 4):
            assert user.call("emulator/step").message == f"at tick {first + more}"
        user.wait("the status", lambda: user.status.tick == first + 3)
        assert user.status.phase == EmulatorStatus.PHASE_PAUSED
        for _ in range(10):  # in a row, with ticks on their way
            assert user.call("emulator/pause", False).success
            paused, stepped = user.calls(("emulator/pause", True), ("emulator/step", None))
            tick = int(paused.message.removeprefix("paused at tick "))
            if stepped.message == "not paused, pause first":  # it overtook: of two services
                stepped = user.call("emulator/step")
            assert stepped.message == f"at tick {tick + 1}"
        user.motor_states()  # no tick was reported twice
        assert user.call("emulator/power", False).success
        assert user.call("emulator/pause", False).success
        user.wait("the servo to notice", lambda: user.printed("servo", "the drives' power is off"))
        user.wait("the status", lambda: not user.status.powered and user.status.phase == running)
        assert user.call("emulator/power", True).success
        user.wait("the servo to go on", lambda: user.diagnostics["servo"].message == "following")
        # All have been read, of those reported so far.
        user.wait("the states", lambda: user.tick > tick + 1)
        before = user.tick
        assert user.call("emulator/reset").success
        go(user)
        user.wait("the new run", lambda: 0 < user.tick < before)
        user.motor_states()  # nor after the reset
        user.wait(
            "the servo to begin anew", lambda: user.printed("servo", "the emulator began anew")
        )


# --------------------------------------------------------------------------------------- real time


def test_real_time_is_real_time(real_time: SharedNetwork) -> None:
    """Properties of every machine, however busy; the bench measures punctuality."""
    period = 1e-3  # s
    with real_time() as (user, _):
        user.wait("the nodes to meet", lambda: user.status and user.status.answered)
        before_start = time.monotonic()
        assert user.call("emulator/pause", False).success
        after_start = time.monotonic()
        heard: list[tuple[float, EmulatorStatus]] = []

        def enough() -> bool:
            if user.status.tick > 0 and not (heard and heard[-1][1] is user.status):
                heard.append((time.monotonic(), user.status))
            return len(heard) > 5

        user.wait("six times the status", enough)
        user.wait("targets", lambda: user.joint_targets and user.joint_states and user.truth)
        before_end = time.monotonic()
        paused = user.call("emulator/pause", True)
        user.wait("the pause", lambda: user.status.phase == EmulatorStatus.PHASE_PAUSED)
        last = user.status
        assert paused.message == f"paused at tick {last.tick}"
        user.wait("the last state", lambda: user.tick == last.tick)
        assert max(user.motor_states()) == last.tick  # and no tick was reported twice

        # Logical time never runs ahead: each period takes its time, and so does each lost one.
        for at, status in (*heard, (time.monotonic(), last)):
            assert (status.tick + status.overruns) * period < at - before_start
        # And all time is there or counted as lost, but for half a second that a busy machine may
        # take to end the loop.
        assert (last.tick + last.overruns) * period > before_end - after_start - 0.5
        assert (last.overruns > 0) == (last.worst_lateness >= period)
        assert last.median_lateness <= last.p99_lateness <= last.worst_lateness + 1e-6  # s, a bin

        assert [status.phase for _, status in heard] == [EmulatorStatus.PHASE_RUNNING] * len(heard)
        for (_, before), (_, after) in zip(heard, [*heard[1:], (0.0, last)], strict=True):
            for counter in ("tick", "overruns", "old_commands", "worst_lateness"):
                assert getattr(before, counter) <= getattr(after, counter)
        for _, status in heard:
            assert status.logical_time == pytest.approx(status.tick * period)
            assert convert_to_nanoseconds(status.header.stamp) == status.tick * 1_000_000
            assert status.powered and math.isfinite(status.energy)
            assert status.waiting_time == 0.0
        assert any(status.step_time > 0.0 for _, status in heard)
        angles = dict(zip(user.truth.name, user.truth.position, strict=True))
        # Holding where it started, however late commands are: at rest they are 0 V. Two encoder
        # counts of 2 pi / 1024 * 0.01 rad.
        start = {"waist": 0.0, "shoulder": 0.5, "elbow": 0.8}
        assert angles == pytest.approx(start, abs=2 * 6.2e-5)

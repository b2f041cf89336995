"""Bags: what was reported is kept to the byte, stated again, and checked to the bit."""

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
import yaml
from draws import with_slow
from made_bags import TYPES, synthetic
from network import PATIENCE, RECORD_QOS, User, network, user
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message, serialize_message
from rewritten_bags import changed, flip, rewrite, without
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from arm_emulator.cli.command_line import main
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.ros.recording.bag import Bag, BagMessage
from arm_emulator.toolchain.flags import ARITHMETIC
from arm_emulator_msgs.msg import MotorCommand, MotorState

TICKS = 300


@contextmanager
def command_line(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "arm_emulator", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def run(*arguments: object) -> tuple[int, str]:
    """Run a command in this process; return its exit code and all that it states."""
    printed = io.StringIO()
    before, sys.argv = sys.argv, ["arm_emulator", *map(str, arguments)]
    try:
        with redirect_stdout(printed), redirect_stderr(printed), pytest.raises(SystemExit) as ended:
            main()
    finally:
        sys.argv = before
    return ended.value.code, printed.getvalue()


def await_line(process: subprocess.Popen[str], line: str) -> None:
    assert process.stdout is not None
    printed = []
    for output in process.stdout:
        printed.append(output)
        if output.strip() == line:
            return
    raise AssertionError(f"ended without stating {line}: {printed}")


def restart(user: User, bag: Path) -> None:
    """Reset a paused network until a recorder has tick 0 and its answer, and let it go.

    The emulator may find a new listener later than the listener finds the emulator.
    """
    user.wait("the nodes to meet", lambda: user.status and user.status.answered)
    user.forget()
    reset_at = 0.0

    def begun() -> bool:
        nonlocal reset_at
        if time.monotonic() > reset_at:
            assert user.call("emulator/reset").success
            reset_at = time.monotonic() + 2.0  # s; the recorder flushes every half second
        reported = {
            (m.topic, deserialize_message(m.data, TYPES[m.topic]).tick)
            for m in Bag(bag).read_messages(TYPES)
        }
        return reported >= {(topic, 0) for topic in TYPES}

    user.wait("tick 0 to be recorded", begun)
    user.send_tool_target((0.1, 0.02, 0.8), at=0.05)
    user.wait("the target", lambda: int(user.value("motion_controller", "tool targets") or 0) > 0)
    assert user.call("emulator/pause", False).success


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A run of three processes with a stop of the power, in a bag; and the recorder's words."""
    return record_run(tmp_path_factory.mktemp("recording"))


def record_run(folder: Path) -> tuple[Path, str]:
    bag = folder / "bag"
    with network(folder / "log") as (user, _), command_line("record", bag) as recorder:
        await_until_all_are_recorded(recorder)
        restart(user, bag)
        user.wait("the run", lambda: user.tick >= TICKS // 2)
        assert user.call("emulator/power", False).success
        at = user.tick
        user.wait("ticks without power", lambda: user.tick >= at + 20)
        assert user.calls(("emulator/pause", True), ("emulator/power", True))[0].success
        assert user.call("emulator/pause", False).success
        at = user.tick
        user.wait("the rest", lambda: user.tick >= max(TICKS, at + 50))
        assert user.call("emulator/pause", True).success
        recorder.send_signal(signal.SIGINT)
        printed, _ = recorder.communicate(timeout=PATIENCE)
        assert recorder.returncode == 0, printed
    return bag, printed


def await_until_all_are_recorded(recorder: subprocess.Popen[str]) -> None:
    assert recorder.stdout is not None
    missing = {f"recording /{name}" for name in (*(t[1:] for t in TYPES), "emulator/joint_states")}
    for line in recorder.stdout:
        missing.discard(line.strip())
        if not missing:
            return
    raise AssertionError(f"the recorder ended without {missing}")


def test_a_recorded_run_is_equal_to_the_last_bit(
    recording: tuple[Path, str], capfd: pytest.CaptureFixture[str]
) -> None:
    bag, printed = recording
    assert re.search(r"bag: \d+ messages on \d+ topics in [\d.]+ s$", printed.strip())
    assert check_bag(bag) == 0
    words = capfd.readouterr().out
    assert "equal to the last bit" in words
    states = [m for m in messages(bag) if isinstance(m, MotorState)]
    assert len({m.tick for m in states}) > TICKS
    # The test is of something: the arm moved, and the power was off for a while.
    assert len({m.encoder_counts.tobytes() for m in states}) > 20
    assert {m.powered for m in states} == {True, False}


def test_a_bag_of_another_arithmetic_is_named(
    recording: tuple[Path, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    bag, second = recording[0], tmp_path / "other"
    assert Bag(bag).about["arithmetic"] == ARITHMETIC
    assert check_bag(bag) == 0 and "arithmetic" not in capfd.readouterr().out
    shutil.copytree(bag, second)
    metadata = second / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(ARITHMETIC, "portable 0"))
    check_bag(second)
    line = f"recorded in another arithmetic, portable 0; this is {ARITHMETIC}\n"
    assert capfd.readouterr().out.count(line) == 1


def messages(bag: Path) -> list[Any]:
    kinds = {**TYPES, "/emulator/joint_states": JointState}
    return [deserialize_message(m.data, kinds[m.topic]) for m in Bag(bag).read_messages(kinds)]


STATES, COMMANDS, TRUTH = "/motor_states", "/motor_commands", "/emulator/joint_states"
ELBOW = r"the first difference: run \d+, tick {}, joint elbow, {}: "
LOST = np.random.default_rng(3)
# Change, exit code of `check-bag`, and what it prints.
CHANGES: dict[str, tuple[Callable[[BagMessage], bytes | None], int, str]] = {
    "a count": (flip(STATES, MotorState, 57, "encoder_counts"), 1,
                ELBOW.format(57, "encoder_counts") + "recorded "),
    "a current": (flip(STATES, MotorState, 211, "current"), 1,
                  ELBOW.format(211, "current") + "recorded "),
    "a true speed": (flip(TRUTH, JointState, 120, "velocity"), 1,
                     ELBOW.format(120, "velocity") + "recorded "),
    # Not its lowest bit, which the rounding of the motor's current may swallow.
    "a command": (flip(COMMANDS, MotorCommand, 80, "command", bit=30), 1,
                  ELBOW.format(80, "applied") + r"commanded \S+, applied "),
    # Without commands, too, what was applied must lead to what was measured. The links pass it on
    # within the period: the first joint that differs may be another one.
    "a voltage": (lambda message: None if message.topic == COMMANDS
                  else flip(STATES, MotorState, 80, "applied", bit=40)(message), 1,
                  r"the first difference: run \d+, tick 80, joint \w+, current: recorded "),
    # A servo that publishes with a depth of 1 may lose some on the way to a recorder.
    "lost commands": (without([COMMANDS], lambda _: LOST.random() < 0.3), 0,
                      "equal to the last bit"),
    "a lost state": (without([STATES], lambda tick: tick == 80), 0, "1 states are missing"),
    "a gap in both": (without(TYPES, lambda tick: tick == 80), 2,
                      "motor_states must report tick 80, got nothing"),
    "a late begin": (without(TYPES, lambda tick: tick < 10), 2,
                     "must hold a run from tick 0 on"),
}  # fmt: skip


# These changes are slow tests: the others make the same claims.
LONG = {"a current", "a true speed", "lost commands"}


@pytest.mark.parametrize(
    "name", with_slow(sorted(CHANGES, key=LONG.__contains__), len(CHANGES) - len(LONG))
)
def test_a_change_of_a_bag_is_detected(
    recording: tuple[Path, str], tmp_path: Path, name: str
) -> None:
    change, exit_code, words = CHANGES[name]
    code, printed = run("check-bag", rewrite(recording[0], tmp_path / "copy", change))
    assert code == exit_code and re.search(words, printed), printed
    if name in ("a count", "a current", "a true speed"):
        recorded, computed = re.findall(r"(?:recorded|computed) (\S+?),? *(?=,|$)", printed, re.M)
        assert recorded != computed


def test_rosbags_reads_it_back(recording: tuple[Path, str]) -> None:
    """An independent reader: metadata, QoS, definitions, and every byte."""
    bag, printed = recording
    mine = list(Bag(bag).read_messages())
    with Reader(bag) as reader:
        assert reader.message_count == len(mine)
        assert f": {len(mine)} messages" in printed
        theirs = sorted((time, c.topic, bytes(data)) for c, time, data in reader.messages())
        store = get_typestore(Stores.ROS2_JAZZY)
        for connection in reader.connections:
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            # rosbags computes the hash of what the definition states, ROS hands out its own.
            assert store.hash_rihs01(connection.msgtype) == connection.digest
        offered = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        connection = next(c for c in reader.connections if c.topic == "/motor_states")
        first = next(reader.messages([connection]))[2]
        state = store.deserialize_cdr(first, connection.msgtype)
        assert list(vars(state)["joint_names"]) == ["waist", "shoulder", "elbow"]
    assert theirs == sorted((m.received, m.topic, m.data) for m in mine)
    assert offered["/robot_description"][0].durability.name == "TRANSIENT_LOCAL"
    assert offered["/motor_states"][0].reliability.name == "RELIABLE"
    metadata = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (metadata["version"], metadata["ros_distro"]) == (9, "jazzy")
    assert metadata["storage_identifier"] == "mcap"
    assert metadata["relative_file_paths"] == ["bag_0.mcap"]


def test_a_replay_publishes_the_same_bytes_in_the_same_order(recording: tuple[Path, str]) -> None:
    bag, _ = recording
    expected = [m.data for m in Bag(bag).read_messages(["/motor_states"])]
    actual: list[bytes] = []
    # The only listener: the replay waits for no second one.
    with own_domain() as domain, listener(domain, actual) as spin:
        arguments = (bag, "--topics", "motor_states", "--rate", "20", "--wait")
        with command_line("replay", *arguments) as process:
            deadline = time.monotonic() + PATIENCE
            while len(actual) < len(expected):
                assert time.monotonic() < deadline, f"{len(actual)} of {len(expected)} messages"
                spin()
            printed, _ = process.communicate(timeout=PATIENCE)
            assert process.returncode == 0, printed
    assert actual == expected
    assert f"{len(expected)} messages on 1 topics" in printed


@contextmanager
def listener(domain: int, actual: list[bytes]) -> Iterator[Callable[[], None]]:
    """Be one listener on motor_states and nothing else; yield what takes a message."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node("listener", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    node.create_subscription(MotorState, "motor_states", actual.append, RECORD_QOS, raw=True)
    try:
        yield lambda: executor.spin_once(timeout_sec=0.1)
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)


@pytest.mark.slow
def test_a_late_listener_gets_a_replayed_description(
    recording: tuple[Path, str], tmp_path: Path
) -> None:
    """Between the description and the only other message the replay waits longer than any test."""
    bag = recording[0]
    last = list(Bag(bag).read_messages([STATES]))[-1].data

    def description_and_end(message: BagMessage) -> bytes | None:
        is_end = message.topic == STATES and message.data == last
        return message.data if message.topic == "/robot_description" or is_end else None

    copy = rewrite(bag, tmp_path / "copy", description_and_end)
    with (
        user() as client,
        command_line("replay", copy, "--rate", "1e-4"),
    ):
        client.wait("the description", lambda: client.description)
        late = User(client.node.context.get_domain_id())
        try:
            late.wait("the description", lambda: late.description)
            assert late.description == client.description == load_scene("three_axis").urdf
        finally:
            late.close()


@pytest.mark.slow
def test_a_killed_recorder_leaves_its_flushed_messages(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with user() as client, command_line("record", bag) as recorder:
        talk = client.node.create_publisher(String, "talk", 1000)
        await_line(recorder, "recording /talk")
        client.wait("the recorder", talk.get_subscription_count)
        sent = 0

        def size() -> int:
            nonlocal sent
            talk.publish(String(data=f"word {sent}"))
            sent += 1
            return (bag / "bag_0.mcap").stat().st_size

        empty = size()
        client.wait("a flush", lambda: size() > empty)
        flushed = size()
        client.wait("another flush", lambda: size() > flushed)
        recorder.send_signal(signal.SIGKILL)
        recorder.wait()
    file = bag / "bag_0.mcap"
    saved = [deserialize_message(m.data, String).data for m in Bag(bag).read_messages(["/talk"])]
    assert not Bag(bag).complete
    assert len(saved) > 1
    assert saved == [f"word {k}" for k in range(len(saved))]
    # And cut off in the middle of a chunk: the chunks before it.
    os.truncate(file, file.stat().st_size - 20)
    cut = [deserialize_message(m.data, String).data for m in Bag(bag).read_messages(["/talk"])]
    assert 0 < len(cut) <= len(saved)
    assert cut == saved[: len(cut)]


def test_resets_power_and_a_free_run_are_followed(tmp_path: Path) -> None:
    powers = [True] * 7 + [False] * 5 + [True] * 6
    code, printed = run("check-bag", synthetic(tmp_path / "bag", powers))
    assert code == 0, printed
    assert "2 runs, 74 motor states" in printed
    assert "26 commands" in printed  # 13 ticks with power in each of the 2 runs
    assert "36 commands answer no state" in printed
    code, printed = run("check-bag", synthetic(tmp_path / "free", powers, first=4))
    assert code == 0, printed
    assert "8 ticks at 0 V before the first command" in printed


def _set(name: str, value: Any) -> Callable[[Any], None]:
    return lambda message: setattr(message, name, value)


def _set_stamp(message: Any) -> None:
    message.header.stamp.nanosec += 1


# Change in the states of tick 7, whether the bag reports changes by hand, and the outcome.
EDITS: list[tuple[Callable[[Any], None], bool, int, str]] = [
    (_set("tick", 3), False, 1, "not compared: 18 motor states that belong to no run, from one of"),
    (_set("tick", 0), False, 1, "the first difference: run 2, tick 0"),
    (_set("tick", 3), True, 1, "tick 3 comes after tick 6, and no reset is recorded"),
    (_set("tick", 0), True, 1, "tick 0 comes after tick 6, and no reset is recorded"),
    (_set_stamp, False, 1, "tick 7, stamp: recorded 7000001 ns, computed 7000000 ns"),
    (_set("torque", [1.0] * 3), False, 1, "tick 7, torque: recorded, and the scene has no such"),
    (_set("imu_names", ["a"]), False, 1, "tick 7, imu_names: recorded, and the scene has no"),
    (_set("applied", [1e9] * 3), False, 1, "tick 6, joint waist, applied: commanded"),
]


@pytest.mark.parametrize(("edit", "reports_changes", "exit_code", "words"), EDITS)
def test_nothing_of_a_state_is_passed_over_in_silence(
    edit: Callable[[Any], None], reports_changes: bool, exit_code: int, words: str, tmp_path: Path
) -> None:
    bag = synthetic(tmp_path / "bag", [True] * 15, runs=1)
    copy = rewrite(
        bag,
        tmp_path / "copy",
        changed(STATES, MotorState, lambda state: state.tick == 7, edit),
        reports_changes,
    )
    code, printed = run("check-bag", copy, "--scene", "three_axis")
    assert code == exit_code and words in printed, printed


def test_messages_not_compared_are_listed_and_fail_with_strict(
    tmp_path: Path,
) -> None:
    bag = synthetic(tmp_path / "bag", [True] * 15)
    code, printed = run("check-bag", bag)
    assert code == 0 and "equal to the last bit, as far as it was compared" in printed, printed
    for part in ("the true state of the machine", "whether this was lock-step, as assumed"):
        assert f"not compared: {part}" in printed, printed
    code, strict = run("check-bag", bag, "--strict")
    assert code == 1 and strict == printed, "the same words, another exit code"

    def later(message: BagMessage) -> bytes | None:
        """Without the beginning of the first run, which a recorder that came late lacks."""
        kind = TYPES[message.topic]
        early = message.received < 10**18 + 30_000
        return None if early and deserialize_message(message.data, kind).tick < 5 else message.data

    code, printed = run("check-bag", rewrite(bag, tmp_path / "later", later))
    assert code == 0 and "motor states of a run that began before the recording" in printed, printed


def test_a_check_that_compares_nothing_is_refused(tmp_path: Path) -> None:
    bag = synthetic(tmp_path / "bag", [True] * 5)

    def at_rest(message: BagMessage) -> bytes | None:
        return (
            message.data
            if deserialize_message(message.data, TYPES[message.topic]).tick == 0
            else None
        )

    code, printed = run("check-bag", rewrite(bag, tmp_path / "rest", at_rest))
    assert code == 2 and "must hold a servo period of a run, got 2 states of tick 0" in printed, (
        printed
    )


def test_a_true_state_of_no_tick_is_counted(recording: tuple[Path, str], tmp_path: Path) -> None:
    code, printed = run("check-bag", recording[0], "--strict")
    assert "true joint states of no tick" not in printed, printed

    def replace_time(record: BagMessage) -> bytes:
        if record.topic != "/emulator/joint_states":
            return record.data
        message = deserialize_message(record.data, JointState)
        message.header.stamp.nanosec += 1
        return serialize_message(message)

    code, printed = run(
        "check-bag", rewrite(recording[0], tmp_path / "copy", replace_time), "--strict"
    )
    assert code == 1, printed
    assert "true joint states of no tick that the bag has" in printed, printed

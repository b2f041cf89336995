"""Recordings lose nothing in lock-step, even with a killed recorder, and count in real time."""

import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from draws import some
from network import PATIENCE, User, network, user
from rclpy.serialization import deserialize_message

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.ros.recording import run_record
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import Topic
from arm_emulator.ros.recording.bag_writer import BagWriter, repair_bag
from arm_emulator.ros.recording.recorder import Numbered
from arm_emulator.ros.recording.recorder_presence import RecorderPresence, list_recorders
from arm_emulator.ros.recording.run_record import RunRecord
from arm_emulator_msgs.msg import MotorState, RecorderReport
from emulator_node.recorder_gate import RecorderGate

COMMAND = ("-m", "arm_emulator")
# A recorder that keeps little, and writes nothing between SIGUSR1 and SIGUSR2. Only its writing
# stands: a process that is stopped stops its middleware's threads too, and what the middleware does
# about that is another matter.
BUSY = (
    "-c",
    """
import signal
signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGUSR2})
signal.signal(signal.SIGUSR1, lambda *_: signal.sigwait({signal.SIGUSR2}))
from arm_emulator.__main__ import main
from arm_emulator.ros.recording import recorder
recorder.DEPTH = 200
main()
""",
)


@contextmanager
def recorder(
    out: Path, *arguments: str, program: tuple[str, ...] = COMMAND
) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        [sys.executable, *program, "record", str(out), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        # A process that is stopped while it holds a lock in shared memory receives nothing any
        # more.
        env={**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def end(process: subprocess.Popen[str], how: signal.Signals = signal.SIGINT) -> tuple[int, str]:
    process.send_signal(how)
    printed, _ = process.communicate(timeout=PATIENCE)
    return process.returncode, printed


def await_words(process: subprocess.Popen[str], words: str) -> str:
    """Return the line with these words; a process that does not print them is killed."""
    assert process.stdout is not None
    printed, guard = [], threading.Timer(PATIENCE, process.kill)
    guard.start()
    try:
        for line in process.stdout:
            printed.append(line)
            if words in line:
                return line
    finally:
        guard.cancel()
    raise AssertionError(f"it did not print {words!r}, but {printed}")


def ticks_in(bag: Path) -> list[int]:
    return [
        int(deserialize_message(m.data, MotorState).tick)
        for m in Bag(bag).read_messages(["/motor_states"])
    ]


def assert_every_tick(bag: Path, count: int) -> None:
    """Each tick from 0 on is there, and `check-bag` finds the run equal."""
    ticks = ticks_in(bag)
    missing = set(range(max(ticks))) - set(ticks)
    assert not missing, f"{len(missing)} of {max(ticks)} ticks are missing, first {min(missing)}"
    assert max(ticks) >= count, "ticks that the test waited for"
    assert check_bag(bag, scene="three_axis") == 0, "check"


def away(process: subprocess.Popen[str], seconds: float) -> None:
    """Keep a process from running for a while."""
    process.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    process.send_signal(signal.SIGCONT)


def await_ticks(listener: User, count: int) -> None:
    at = listener.tick
    listener.wait(f"{count} ticks more", lambda: listener.tick > at + count)


@pytest.fixture(scope="module")
def lockstep_bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path, str]:
    """One run with three records: of a recorder that is often away, of one that is killed, its own.

    Returns the three bags, and what the first recorder stated.
    """
    folder = tmp_path_factory.mktemp("lockstep")
    slow_bag, killed_bag, own_bag = (folder / name for name in ("slow", "killed", "own"))
    with (
        user() as listener,
        recorder(slow_bag) as slow,
        recorder(killed_bag) as killed,
        begun(slow, killed),
        network_of(listener, folder / "log", record=own_bag, start="first_answer"),
    ):
        # As late as a busy machine may make them; the machine must not leave tick 0 before.
        for process in (slow, killed):
            process.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        for process in (slow, killed):
            process.send_signal(signal.SIGCONT)
        listener.wait("the run", lambda: listener.tick > 100)
        for seconds in (0.5, 1.5):
            away(slow, seconds)
            await_ticks(listener, 50)
        killed.kill()
        await_ticks(listener, 300)
        printed = listener.wait(
            "word of it", lambda: listener.value("emulator", "newest of recorders")
        )
        assert "has ended; its bag may need `repair`" in printed
        assert listener.call("emulator/pause", True).success
        code, words = end(slow)
        assert code == 0, f"the recorder states that something is missing: {words}"
    return slow_bag, killed_bag, own_bag, words


@contextmanager
def begun(*recorders: subprocess.Popen[str]) -> Iterator[None]:
    """Go on when recorders are there, without a wait for one that is still being loaded."""
    for started in recorders:
        await_words(started, "recording ")
    yield


@contextmanager
def network_of(listener: User, log: Path, **options: Any) -> Iterator[None]:
    """Run a network in the domain of a user who is there already."""
    clock, start = options.pop("clock", "lockstep"), options.pop("start")
    with Bringup("three_axis", clock=clock, start=start, emulator=options, log=log) as nodes:
        yield
        codes = nodes.stop_nodes()
        assert set(codes.values()) == {0}, f"exit codes {codes}"


@pytest.mark.slow
def test_a_recorder_that_is_often_away_misses_nothing(
    lockstep_bags: tuple[Path, Path, Path, str],
) -> None:
    bag, _, _, printed = lockstep_bags
    assert_every_tick(bag, count=500)
    assert "lost" not in printed


def test_a_killed_recorder_has_every_tick_before_it(
    lockstep_bags: tuple[Path, Path, Path, str],
) -> None:
    _, bag, _, _ = lockstep_bags
    assert repair_bag(bag)
    assert_every_tick(bag, count=1)


def test_the_emulators_own_record_is_complete(
    lockstep_bags: tuple[Path, Path, Path, str], capfd: pytest.CaptureFixture[str]
) -> None:
    slow, _, bag, _ = lockstep_bags
    assert Bag(bag).complete
    assert_every_tick(bag, count=max(ticks_in(slow)))
    # Every voltage is compared with a command: those that were taken are all there.
    reported = re.search(
        r"(\d+) motor states, \d+ true joint states, (\d+) commands", capfd.readouterr().out
    )
    assert reported is not None and int(reported[2]) > 400, reported
    for topic in ("/robot_description", "/diagnostics", "/emulator/status", "/clock"):
        assert Bag(bag).topics[topic].count > 0, topic


@pytest.mark.slow
def test_a_late_recorder_states_so_or_resets_on_request(tmp_path: Path) -> None:
    with network(tmp_path / "log", start="first_answer") as (listener, _):
        listener.wait("the run", lambda: listener.tick > 200)
        # The machine stands while a recorder is loaded: both would want the processor.
        assert listener.call("emulator/pause", True).success
        with recorder(tmp_path / "late") as late, begun(late):
            assert listener.call("emulator/pause", False).success
            await_words(late, "/motor_states: the first state has arrived, tick ")
            printed = await_words(late, "the machine is at tick")
            assert re.search(
                r"at tick \d+ already, and `check-bag` needs a run from tick 0 on", printed
            ), printed
            assert "--from-start" in printed
            assert listener.call("emulator/pause", True).success
            with recorder(tmp_path / "reset", "--from-start") as again, begun(again):
                assert listener.call("emulator/pause", False).success
                listener.wait("the reset", lambda: 0 <= listener.tick < 100)
                await_ticks(listener, 300)
                assert listener.call("emulator/pause", True).success
                code, words = end(again, signal.SIGTERM)
    assert code == 0 and "it is reset now" in words, words
    ticks = ticks_in(tmp_path / "reset")
    run = ticks[ticks.index(0) :]
    assert set(run) == set(range(max(run) + 1)), "ticks from the reset on"
    assert check_bag(tmp_path / "reset") == 0


@pytest.mark.slow
def test_a_recorder_in_real_time_counts_its_losses_and_the_emulators_own_record_is_complete(
    tmp_path: Path,
) -> None:
    """A recorder that writes nothing while far more arrives than it keeps."""
    reports: list[RecorderReport] = []
    with (
        user(clock="realtime") as listener,
        recorder(tmp_path / "away", program=BUSY) as process,
        network_of(
            listener,
            tmp_path / "log",
            clock="realtime",
            start="first_answer",
            record=tmp_path / "own",
        ),
    ):
        listener.node.create_subscription(RecorderReport, "emulator/recorders", reports.append, 10)
        listener.wait("some states to be recorded", lambda: reports and reports[-1].written > 100)
        process.send_signal(signal.SIGUSR1)
        await_ticks(listener, 3000)  # more than it keeps
        process.send_signal(signal.SIGUSR2)
        await_words(process, "ticks of /motor_states")  # while recording
        code, printed = end(process)
    assert code == 1, printed
    reported = re.search(r"; lost: .*?(\d+) ticks of /motor_states", printed)
    assert reported is not None, printed
    ticks = ticks_in(tmp_path / "away")
    span = range(min(ticks), max(ticks))
    assert int(reported[1]) == len(set(span) - set(ticks)) > 1000, printed
    assert_every_tick(tmp_path / "own", count=3000)


@pytest.mark.slow
def test_ctrl_c_at_any_moment_leaves_a_complete_bag(tmp_path: Path) -> None:
    """The recorder starts in one or two seconds: some moments about there."""
    draw = random.Random(6)
    with own_domain():
        for case in some(range(6), 2):
            bag = tmp_path / f"bag{case}"
            with recorder(bag) as process:
                moment = draw.uniform(0.0, 2.5)
                time.sleep(moment)
                how = draw.choice([signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
                code, printed = end(process, how)
            words = f"{how.name} after {moment:.2f} s: exit code {code}, {printed}"
            if bag.exists():  # before, nothing is recorded
                assert code == 0 and "Traceback" not in printed, words
                assert (bag / "metadata.yaml").exists() and Bag(bag).complete, words


# Without a network


@pytest.mark.parametrize("seed", range(20))
def test_losses_are_counted_by_number_of_each_publisher(seed: int) -> None:
    """To the message, however several of them interleave."""
    draw = random.Random(seed)
    single = Numbered()
    first = draw.randrange(1, 1000)
    numbers = sorted(draw.sample(range(first, first + 500), 300))
    for number in numbers:
        single.count_message(b"a", number)
    assert single.lost == numbers[-1] - numbers[0] + 1 - len(numbers)
    assert single.newest == numbers[-1]

    lost = single.lost
    single.restart_count()
    for number in (single.newest + 1, single.newest + 8):
        single.count_message(b"a", number)
    assert single.lost == 6, f"beside {lost} that are forgotten"
    for more in (0, 2):  # the middleware reports what was forgotten late, and more at once
        single.take_lost_event(SimpleNamespace(total_count=lost + 6 + more))
        assert single.lost == 6 + more

    several, lost = Numbered(), 0
    next_numbers = [draw.randrange(1, 1000) for _ in range(draw.randrange(2, 5))]
    for count in range(2000):
        which = draw.randrange(len(next_numbers))
        if count > 100 and draw.random() < 0.02:
            gap = draw.randrange(1, 5)
            lost += gap
            next_numbers[which] += gap
        several.count_message(bytes([which]), next_numbers[which])
        next_numbers[which] += 1
        several.count_message(b"another middleware", -1)
    for which, number in enumerate(next_numbers):  # a gap at the very end is nobody's to see
        several.count_message(bytes([which]), number)
    assert several.lost == lost


@pytest.mark.parametrize("seed", range(20))
def test_no_recorder_is_ever_further_behind_than_it_may_be(seed: int) -> None:
    """Recorders write at random speeds, and are killed or stay away at random moments."""
    draw = random.Random(seed)
    names = [f"{k}.{draw.randrange(16**8):08x}" for k in range(3)]
    here, written, now = set(names), dict.fromkeys(names, 0), 0.0
    news: list[str] = []
    recorders = RecorderGate(lambda: set(here), True, news.append, lambda: now)
    recorders.begin_run()
    recorders.published, tick = 1, 0
    ended, silent_name = names[0], names[1]
    ended_at, asleep_at = draw.randrange(50, 2000), draw.randrange(50, 2000)
    for step in range(18_000):
        now += 0.01
        if step == ended_at:
            here.discard(ended)
        for name in names:
            silent = (name == ended and step >= ended_at) or (
                name == silent_name and step >= asleep_at
            )
            if not silent and draw.random() < 0.3:
                written[name] = min(recorders.published, written[name] + draw.randrange(40))
                recorders.take_report(name, written[name], False)
        if not recorders.is_closed(tick == 0):
            if tick == 0:
                assert min(written.values()) >= 1, "tick 0 was left before all had written it"
            tick += 1
            recorders.published += 1
        positions = [w for name, w in written.items() if name in recorders.names]
        assert recorders.published - min(positions, default=recorders.published) <= 100 + 1
    assert recorders.names == [names[2]], "who is gone, or writes nothing, is let go"
    printed = " ".join(news)
    assert f"recorder {ended} has ended" in printed
    assert f"recorder {silent_name} has written nothing for 120 s" in printed
    assert tick > 1000, "the machine went on"


def test_reports_that_no_recorder_wrote_stop_nothing() -> None:
    recorders = RecorderGate(set, True, print)
    recorders.published = 10
    for name in ("", "x" * 300, "1.xyz", "1.00000000\n"):
        with pytest.raises(Refusal, match="be a recorder's name"):
            recorders.take_report(name, 5, False)
    recorders.take_report("1.00000000", 2**63, False)
    assert recorders.names == []


def test_recorders_are_registered_before_the_network_reports_of_them() -> None:
    topics = ["cell1/motor_states", "clock"]
    with own_domain():
        with RecorderPresence(None) as every, RecorderPresence(topics) as limited:
            with RecorderPresence(["clock"]):
                assert list_recorders("/cell1/motor_states") == {every.recorder, limited.recorder}
            assert list_recorders("/motor_states") == {every.recorder}
            with own_domain():  # another one
                assert list_recorders("/motor_states") == set()
        assert list_recorders("/cell1/motor_states") == set()


@pytest.mark.parametrize("waits", [True, False])
def test_a_slow_disk_makes_lockstep_wait_and_real_time_count(
    waits: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_record, "CAPACITY", 50)
    monkeypatch.setattr(BagWriter, "write_message", _slow_write(BagWriter.write_message))
    record = RunRecord(tmp_path / "bag", [Topic("/talk", "std_msgs/msg/String")], waits)
    for k in range(1000):
        record.add_message("/talk", k.to_bytes(4, "little"))
    if waits:
        record.close()
    else:
        with pytest.raises(Refusal, match=r"\d+ messages were dropped, the disk is too slow"):
            record.close()
    numbers = [int.from_bytes(m.data, "little") for m in Bag(tmp_path / "bag").read_messages()]
    assert Bag(tmp_path / "bag").complete
    assert len(numbers) + record.dropped == 1000, "what is neither kept nor counted"
    assert (record.dropped == 0) == waits
    assert numbers == sorted(numbers)


def _slow_write(write: Callable[..., None]) -> Callable[..., None]:
    def slow(self: BagWriter, *arguments: Any) -> None:
        time.sleep(1e-4)
        write(self, *arguments)

    return slow


def test_a_full_disk_stops_no_machine_and_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_record, "CAPACITY", 50)
    write, left = BagWriter.write_message, 300

    def full(self: BagWriter, *arguments: Any) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(28, "No space left on device")
        write(self, *arguments)

    monkeypatch.setattr(BagWriter, "write_message", full)
    record = RunRecord(tmp_path / "bag", [Topic("/talk", "std_msgs/msg/String")], waits=True)
    for k in range(1000):
        record.add_message("/talk", k.to_bytes(4, "little"))
    with pytest.raises(Refusal, match="the disk takes no more: No space left on device"):
        record.close()
    assert Bag(tmp_path / "bag").complete
    assert Bag(tmp_path / "bag").topics["/talk"].count == 300

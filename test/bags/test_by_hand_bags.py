"""Changes of a machine by hand in bags: repeated, spoiled and missing ones."""

import random
import re
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from by_hand import CLOCKS, ByHand, events_of, go_on, session_of, varied
from draws import some, with_slow
from in_process import in_process
from network import User, user
from rclpy.serialization import deserialize_message
from rewritten_bags import changed, rewrite
from test_recording import begun, end, network_of, recorder

from arm_emulator import Refusal
from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator.ros.recording.bag import Bag, BagMessage
from arm_emulator_msgs.msg import MachineEvent, MotorState

__all__ = ["varied"]  # a fixture


def recorded(clock: str, seed: int, bag: Path, varied: Path) -> set[str]:
    """Write a bag of a run with many changes at random ticks; return what was done."""
    draw = random.Random(seed)
    with in_process(clock, file=varied) as nodes:
        nodes.begin_record()
        hand = ByHand(draw, nodes.call, session_of(nodes).scene.varied)
        hand.changes()  # of which the run that is checked begins with some
        hand.bursts = [0]
        assert nodes.call("emulator/reset").success

        def between() -> None:
            if draw.random() < 0.02:
                nodes.nodes[
                    "emulator"
                ]._status.publish_status()  # by which `check-bag` knows the clock
                hand.changes()

        go_on(nodes, 400, between)
        while not hand.has_done_much():  # a busy machine looks less often between its ticks
            go_on(nodes, 20, between)
        if clock == "realtime":
            assert nodes.call("emulator/pause", True).success
            hand.changes(reset=False)
            assert nodes.call("emulator/pause", False).success
            go_on(nodes, 50)
        nodes.write(bag)
    return hand.kinds


@pytest.fixture(scope="module", params=with_slow(CLOCKS, 1))
def bag(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, varied: Path
) -> Path:
    folder = tmp_path_factory.mktemp(request.param) / "bag"
    recorded(request.param, 1, folder, varied)
    return folder


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
@pytest.mark.parametrize("seed", some(range(4), 1))
def test_a_run_with_changes_by_hand_is_equal_to_the_last_bit(
    clock: str, seed: int, tmp_path: Path, varied: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    kinds = recorded(clock, seed, tmp_path / "bag", varied)
    code, printed = check_bag(tmp_path / "bag", scene=str(varied)), capfd.readouterr().out
    assert code == 0 and "equal to the last bit" in printed, printed
    assert ("in real time" in printed) == (clock == "realtime"), printed
    # The test is of something: many changes, several of them at one tick.
    reported = re.search(r"(\d+) changes by hand", printed)
    assert reported is not None and int(reported[1]) > 5 and len(kinds) >= 3, (printed, kinds)
    ticks = [event.tick for event in events_of(tmp_path / "bag")]
    assert len(set(ticks)) < len(ticks), f"each change at a tick of its own: {ticks}"


def spoil(which: int, change: Callable[[MachineEvent], None]) -> Callable[[BagMessage], bytes]:
    """Change one event of a bag, by its number."""
    return changed("/emulator/events", MachineEvent, lambda event: event.number == which, change)


@pytest.mark.slow
def test_a_spoiled_event_is_named(
    bag: Path, tmp_path: Path, varied: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    draw = random.Random(2)
    events = events_of(bag)

    def flip(event: MachineEvent) -> None:
        event.state[draw.randrange(len(event.state))] ^= 1 << draw.randrange(8)

    def elsewhere(event: MachineEvent) -> None:
        event.tick = max(0, event.tick + draw.choice([-2, -1, 1, 2])) if event.tick else 3

    def switch_power(event: MachineEvent) -> None:
        event.powered = not event.powered

    for case in some(range(12), 3):
        change = (flip, elsewhere, switch_power)[case % 3]
        event = draw.choice(
            [e for e in events if change is not elsewhere or e.kind != e.KIND_RESET]
        )
        copy = rewrite(bag, tmp_path / f"copy{case}", spoil(event.number, change))
        code, printed = check_bag(copy, scene=str(varied)), capfd.readouterr().out
        words = f"{change.__name__} of change {event.number} of kind {event.kind}: {printed}"
        assert code == 1, words
        assert f"change {event.number} by hand" in printed, words


def test_a_missing_event_is_named(
    bag: Path, tmp_path: Path, varied: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """By its number, or by what it would have changed."""
    puts = (MachineEvent.KIND_SET_STATE, MachineEvent.KIND_RESTORE)
    missing = next(event.number for event in events_of(bag) if event.kind in puts)

    def without(message: BagMessage) -> bytes | None:
        lost = message.topic == "/emulator/events" and (
            deserialize_message(message.data, MachineEvent).number == missing
        )
        return None if lost else message.data

    try:
        assert check_bag(rewrite(bag, tmp_path / "copy", without), scene=str(varied)) == 1
    except Refusal as reason:
        assert f"must report change {missing} by hand" in str(reason)
    else:
        assert "the first difference" in capfd.readouterr().out


def test_without_events_a_difference_is_explained(
    bag: Path, tmp_path: Path, varied: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    copy = rewrite(
        bag, tmp_path / "copy", lambda m: None if m.topic == "/emulator/events" else m.data
    )
    assert check_bag(copy, scene=str(varied)) == 1
    assert "without emulator/events changes by hand are unknown" in capfd.readouterr().out


@contextmanager
def changed_network(client: User, folder: Path, clock: str) -> Iterator[None]:
    with (
        recorder(folder / "recorder") as process,
        begun(process),
        network_of(
            client, folder / "log", clock=clock, record=folder / "own", start="first_answer"
        ),
    ):
        client.wait("the run", lambda: client.tick > 50)
        yield
        assert client.call("emulator/pause", True).success
        code, printed = end(process, signal.SIGINT)
        assert clock == "realtime" or code == 0, printed


def listen(client: User, bag: Path) -> None:
    """Change something until a recorder has heard of it."""

    def heard() -> bool:
        assert client.call("emulator/power", True).success
        try:
            return bool(events_of(bag))
        except Refusal:  # not even its head is written yet
            return False

    client.wait("the recorder to hear of an event", heard)


@pytest.mark.slow
@pytest.mark.parametrize("clock", CLOCKS)
def test_a_network_changed_by_hand_is_recorded_and_checked(clock: str, tmp_path: Path) -> None:
    draw = random.Random(11)
    with user(clock=clock) as client, changed_network(client, tmp_path, clock):
        if clock == "realtime":  # the machine does not wait for a recorder to be discovered
            listen(client, tmp_path / "recorder")
        hand = ByHand(draw, client.call)
        for _ in range(12):
            at = client.tick + draw.randrange(40)
            client.wait("some ticks", lambda at=at: client.tick >= at or client.tick < 10)
            hand.changes(reset=clock == "lockstep")
        assert client.call("emulator/power", True).success
        at = client.tick
        client.wait("the rest", lambda: client.tick > at + 50)
    assert {"set_state", "restore_state"} <= hand.kinds, hand.kinds
    assert check_bag(tmp_path / "own", scene="three_axis") == 0, "the emulator's own record"
    events = [bytes(event.state) for event in events_of(tmp_path / "own")]
    assert len(events) > 8, "changes"
    # A recorder in real time may miss states, and reports it; events come without a gap from where
    # it listens to where it ends, which may be behind the machine.
    heard = [bytes(event.state) for event in events_of(tmp_path / "recorder")]
    unheard = len(events) - len(heard)
    assert clock == "realtime" or not unheard, "lock-step waits for its recorder"
    runs = [events[first : first + len(heard)] for first in range(unheard + 1)]
    assert len(heard) > 8 and heard in runs, "changes that the recorder heard"
    states = [
        deserialize_message(m.data, MotorState).tick
        for m in Bag(tmp_path / "recorder").read_messages(["/motor_states"])
    ]
    if clock == "lockstep":
        assert check_bag(tmp_path / "recorder", scene="three_axis") == 0, f"{len(states)} states"

"""Random messages to a running network of three processes: no node is lost, refused is unchanged.

python -m fuzz.messages SEED CLOCK COUNT: COUNT messages in lockstep or realtime.

Half of them must be refused: in lock-step the run that goes on meanwhile is equal, bit by bit, to
one without them. The others may be anything: afterwards the network begins anew and makes the same
run.
"""

import itertools
import random
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from network import ALL_THREE, User, assert_same_bits, kill, logs, network, offline_states
from random_messages import RECEIVER, TOPICS, bad_message, random_message
from rclpy.serialization import serialize_message

from arm_emulator.ros.node.node_shell import DESCRIPTION_QOS
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_msgs.msg import EmulatorStatus
from fuzz.line import FAILED, REFUSED, TAKEN, report

AT_ONCE = 2  # messages per topic: what is read with best effort is kept five deep
AHEAD = 1000  # ticks: what is for a later tick stays of the future while it is on its way
# Health is reported every second, and no node may hang for two: of its own processor time, so that
# a busy machine does not count; and by the wall clock a node that waits indefinitely.
SILENCE, FOR_EVER = 3.0, 60.0  # s
AFTERWARDS = 200  # ticks of the run that shows that all is as before


class Silence:
    """The most processor time that a node has used while it reported nothing of its health."""

    def __init__(self, user: User, nodes: Bringup) -> None:
        self._user = user
        self._processes = {n: psutil.Process(nodes.get_process(n).pid) for n in ALL_THREE}
        self._heard = {node: (time.monotonic(), self._used(node)) for node in ALL_THREE}
        self._last: dict[str, Any] = {}
        self.longest = 0.0

    def look(self) -> None:
        """Read the diagnostics that came since the last call."""
        now = time.monotonic()
        for node in ALL_THREE:
            reported, used = self._user.diagnostics.get(node), self._used(node)
            if reported is not self._last.get(node):
                self._last[node] = reported
                self._heard[node] = now, used
            at, before = self._heard[node]
            self.longest = max(self.longest, used - before)
            assert now - at < FOR_EVER, f"{node} has been silent for {now - at:.0f} s"

    def _used(self, node: str) -> float:
        times = self._processes[node].cpu_times()
        return float(times.user + times.system)


def send(
    user: User,
    nodes: Bringup,
    make: Callable[[str, int], Any],
    count: int,
    paced: Callable[[], None],
) -> Silence:
    """Send `count` messages over all topics, each when the nodes have had time for those before."""
    publishers = {
        topic: user.node.create_publisher(
            type(make(topic, 0)), topic, DESCRIPTION_QOS if topic == "robot_description" else 100
        )
        for topic in TOPICS
    }
    heard = [value.get_subscription_count for value in publishers.values()]
    user.wait("receivers of every topic", lambda: all(count() for count in heard))
    silence = Silence(user, nodes)
    topics = itertools.cycle(TOPICS)
    sent = 0
    while sent < count:
        for topic in itertools.islice(topics, AT_ONCE * len(TOPICS)):
            message = serialize_message(make(topic, user.tick + AHEAD))
            if topic == "motor_states":
                user.own_states.add(message)
            publishers[topic].publish(message)
            sent += 1
        paced()
        silence.look()
        ended = nodes.find_ended()
        assert ended is None, f"node and exit code: {ended}"
        report(sent=AT_ONCE * len(TOPICS))
    for publisher in publishers.values():
        user.node.destroy_publisher(publisher)
    return silence


def refused(user: User) -> dict[str, int]:
    """Return how many messages of each topic were refused, as the nodes state."""
    return {topic: user.refused(RECEIVER[topic], topic) for topic in TOPICS}


def await_counts(user: User) -> None:
    """Wait until every node has reported its health anew, twice: all that was sent is counted."""
    for _ in range(2):
        before = dict(user.diagnostics)
        user.wait(
            "news of every node",
            lambda before=before: all(
                user.diagnostics.get(n) is not before.get(n) for n in ALL_THREE
            ),
        )


def go(user: User) -> None:
    """Let a paused network run from tick 0."""
    user.await_start()
    assert user.call("emulator/pause", False).success, "the emulator did not go on"


def paces(user: User) -> Iterator[None]:
    """Wait until the run has gone on."""
    while True:
        tick = user.tick
        user.wait("the run to go on", lambda tick=tick: user.tick > tick)
        yield


def fuzz(seed: int, clock: str, count: int, folder: Path) -> dict[str, int]:
    """Send `count` messages; return how many were refused, and taken or lost.

    Nodes may refuse each other's messages, too, after absurd ones.
    """
    rng = random.Random(f"{seed} {clock}")
    run = load_offline_run("three_axis")
    names = run.session.scene.joint_names
    start = np.array(run.session.scene.start)
    with network(folder, clock=clock) as (user, nodes):
        go(user)
        pace = paces(user)
        silences = [
            send(
                user,
                nodes,
                lambda topic, tick: bad_message(rng, topic, names, tick),
                count // 2,
                lambda: next(pace),
            )
        ]
        await_counts(user)
        total = sum(refused(user).values())
        assert total > 0, "nothing was refused"
        if clock == "lockstep":
            assert user.call("emulator/pause", True).success, "the emulator did not pause"
            user.wait("the last state", lambda: user.status and user.tick == user.status.tick)
            assert_same_bits(user.motor_states(), offline_states(run, user.tick), user.tick)
            assert user.call("emulator/pause", False).success, "the emulator did not go on"
        else:  # where it began, but for two encoder counts, as without these messages
            off = np.abs(np.array(user.truth.position) - start).max()
            assert off < 2 * 6.2e-5, f"the arm at rest has moved by {off:g} rad"
        silences.append(
            send(
                user,
                nodes,
                lambda topic, tick: random_message(rng, topic, names, user.tick),
                count - count // 2,
                lambda: user.spin(0.002),
            )
        )
        await_counts(user)
        total = sum(refused(user).values())
        for silence in silences:
            assert silence.longest < SILENCE, (
                f"a node was silent for {silence.longest:.1f} s of work"
            )
        _restart_all(user, nodes, clock)
    assert "Traceback" not in logs(folder), logs(folder)
    total = min(total, count)
    return {REFUSED: total, TAKEN: count - total}


def _restart_all(user: User, nodes: Bringup, clock: str) -> None:
    """Reset the network, with a motion controller that has heard of no target and no other arm."""
    kill(user, nodes, "motion_controller")
    nodes.start_node("motion_controller")
    user.forget()  # what is still to be read ends with tick 0
    assert user.call("emulator/reset").success, "the emulator did not begin anew"
    go(user)
    user.wait("the run afterwards", lambda: user.tick >= AFTERWARDS)
    if clock == "lockstep":
        reference = offline_states(load_offline_run("three_axis"), AFTERWARDS)
        assert_same_bits(user.motor_states(), reference, AFTERWARDS)
    user.wait("the status", lambda: user.status and user.status.tick > 0)
    assert user.status.phase != EmulatorStatus.PHASE_STOPPED, "the machine stopped"


def main() -> None:
    """Report what came of it."""
    seed, clock, count = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    report(begin=0)
    with tempfile.TemporaryDirectory(prefix="fuzz-messages-") as scratch:
        try:
            outcomes = fuzz(seed, clock, count, Path(scratch))
        except Exception:  # whatever it is, it is what is looked for
            words = traceback.format_exc(limit=-4) + logs(Path(scratch))
            report(outcome=FAILED, count=1, what=words)
        else:
            for outcome, much in outcomes.items():
                report(outcome=outcome, count=much)


if __name__ == "__main__":
    main()

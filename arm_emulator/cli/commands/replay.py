"""Publish the messages of a bag at the recorded times."""

import contextlib
import math
import time
from collections.abc import Collection
from pathlib import Path
from typing import Literal

import rclpy
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Topics
from arm_emulator.cli.output import output
from arm_emulator.ros.messages.message_types import get_message_class
from arm_emulator.ros.node.network_client import join_network
from arm_emulator.ros.process.ctrl_c import CtrlC, suppress_shutdown_errors
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import NANOSECONDS
from arm_emulator.ros.recording.causal_replay import CausalReplay

DEPTH = (
    1000  # messages kept for a listener that is slow; discovery does not report the recorded depth
)
ACKNOWLEDGE = Duration(seconds=5)  # patience with listeners at the end
NAP = 0.05  # s, wall: Ctrl-C and new listeners are noticed this often


@command(
    until_stopped=True,
    keys=(
        "`bag`, `messages`, `topics`, `seconds`, `whole`; with into `answers`, `alike` (to the "
        "recorded ones), `first_other`, `digest` and `missed` in the place of `topics`"
    ),
)
def replay_bag(
    bag: Path,
    /,
    *,
    into: Literal["servo", "motion_controller"] | None = None,
    topics: Topics = None,
    rate: float = 1.0,
    wait: bool = False,
) -> int:
    """Publish the messages of a bag at the recorded times, or answer by answer into a node.

    With --into the exit code is 1 where an answer is missing.

    Args:
        bag: folder of the bag.
        into: node under test: each message follows its answer to the last one.
        rate: recorded seconds per second.
        wait: begin when every topic has a subscriber.
    """
    if into is not None:
        for option, value in (("--topics", topics), ("--rate", None if rate == 1.0 else rate)):
            if value is not None:
                raise Refusal("replay", option, "stand without --into", "both")
        return _replay_into(Bag(bag), into, wait)
    if not (math.isfinite(rate) and rate > 0.0):
        raise Refusal("replay", "rate", "be > 0 and finite", rate)
    recorded = Bag(bag)
    names = _choose_topics(recorded, topics)
    rclpy.init()
    CtrlC.leave_to_rclpy()
    node = rclpy.create_node("replayer", enable_rosout=False, start_parameter_services=False)
    count, started = 0, time.monotonic()
    try:
        with suppress_shutdown_errors():
            publishers = {
                name: node.create_publisher(
                    get_message_class(recorded.topics[name].type),
                    name,
                    choose_publishing_qos(recorded.topics[name].offered),
                )
                for name in names
            }
            if wait:
                _wait_for_listeners(publishers)
            count = _publish_messages(recorded, publishers, rate)
            for publisher in publishers.values():
                publisher.wait_for_all_acked(ACKNOWLEDGE)
    finally:
        _end_node(node)
    cut = "" if recorded.complete else "; its recorder did not end it"
    wall = time.monotonic() - started
    output.print_line(f"{bag}: {count} messages on {len(names)} topics in {wall:.1f} s{cut}")
    output.add_facts({
        "bag": bag, "messages": count, "topics": names, "seconds": wall, "whole": recorded.complete,
    })  # fmt: skip
    return 0


def _replay_into(bag: Bag, name: str, wait: bool) -> int:
    """Play a bag into a node, and print what it has answered."""
    started = time.monotonic()
    with join_network("replayer", "") as node:
        result = CausalReplay(bag, name, node).play_bag(wait, output.print_line)
    wall = time.monotonic() - started
    lost = result.requested - result.answered
    output.print_line(
        f"{bag.path} into {name}: {result.answered} answers to {result.requested} messages in "
        f"{wall:.1f} s"
    )
    difference = (
        f", the first other one at {result.first_difference}" if result.first_difference else ""
    )
    output.print_line(f"as recorded to the last bit: {result.alike}{difference}")
    output.print_line(f"digest of the answers: {result.digest}")
    output.add_facts({
        "bag": bag.path, "messages": result.requested, "answers": result.answered,
        "alike": result.alike, "first_other": result.first_difference or None,
        "digest": result.digest, "seconds": wall, "whole": bag.complete,
    })  # fmt: skip
    at = ", ".join(result.missing)
    return output.report_miss("replay", f"{lost} answers are missing, from {at} on" if lost else "")


def choose_publishing_qos(recorded: Collection[QoSProfile]) -> QoSProfile:
    """Return the QoS to publish with: as recorded, and where publishers differed, the most.

    A reliable publisher serves best-effort listeners too, and a latching one volatile listeners.
    """
    profile = QoSProfile(depth=DEPTH, history=HistoryPolicy.KEEP_LAST)
    if any(
        offered.reliability == ReliabilityPolicy.BEST_EFFORT for offered in recorded
    ) and not any(offered.reliability == ReliabilityPolicy.RELIABLE for offered in recorded):
        profile.reliability = ReliabilityPolicy.BEST_EFFORT
    if any(offered.durability == DurabilityPolicy.TRANSIENT_LOCAL for offered in recorded):
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    first = next(iter(recorded), None)
    if first is not None and len({str(offered) for offered in recorded}) == 1:
        profile.deadline, profile.lifespan = first.deadline, first.lifespan
        profile.liveliness = first.liveliness
        profile.liveliness_lease_duration = first.liveliness_lease_duration
    return profile


def _choose_topics(bag: Bag, topics: Collection[str] | None) -> list[str]:
    if topics is None:
        names = [name for name, topic in bag.topics.items() if topic.count]
        if not names:
            raise Refusal(str(bag.path), "the bag", "hold messages", "none")
        return names
    names = [name if name.startswith("/") else f"/{name}" for name in topics]
    for name in names:
        if name not in bag.topics:
            listed = ", ".join(sorted(bag.topics)) or "none"
            raise Refusal(str(bag.path), "--topics", "be in the bag", name, listed)
    return names


def _wait_for_listeners(publishers: dict[str, Publisher]) -> None:
    for name, publisher in publishers.items():
        reported = False
        while publisher.get_subscription_count() == 0:
            _check_running()
            if not reported:
                print(f"waiting for a listener on {name}", flush=True)
                reported = True
            time.sleep(NAP)


def _publish_messages(bag: Bag, publishers: dict[str, Publisher], rate: float) -> int:
    """Publish everything and return the number of messages."""
    count, origin = 0, None
    begin = time.monotonic_ns()
    for message in bag.read_messages(publishers):
        if origin is None:
            origin = message.received
        due = begin + (message.received - origin) / rate
        while (left := (due - time.monotonic_ns()) / NANOSECONDS) > 0.0:
            _check_running()
            time.sleep(min(left, NAP))
        _check_running()
        publishers[message.topic].publish(message.data)
        count += 1
    return count


def _check_running() -> None:
    if not rclpy.ok():
        raise ExternalShutdownException


def _end_node(node: Node) -> None:
    with contextlib.suppress(RuntimeError):  # a signal's own shutdown may come in between
        node.destroy_node()
        rclpy.try_shutdown()

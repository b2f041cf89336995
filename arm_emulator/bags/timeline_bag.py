"""A timeline written as a bag, which names the bag that it forked from, and made again from it."""

import json
from pathlib import Path
from typing import Any

from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.run_bag import KINDS, RunBag
from arm_emulator.bags.targeted_run import LeaveChanges, TargetedRun, load_targeted_run
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.ros.recording.bag_metadata import FORKED_AT, PARENT
from arm_emulator.runs.offline import OfflineRun, load_offline_run
from arm_emulator.runs.order import Order, convert_to_data, read_order
from arm_emulator.runs.timeline import Timeline, TimelineChange
from arm_emulator_msgs.msg import MachineEvent

CHANGES, ORDERS = "changes", "orders"  # in words, and as data
TARGETS = "joint_targets_of"  # the network's bag that has the joint targets


def write_timeline(line: Timeline[OfflineRun], folder: Path, parent: Path | None = None) -> None:
    """Write a run from tick 0 to the newest one as a bag that `check-bag` repeats.

    An `Order` that changes the machine is an event of its kind, and the bag has all of them as
    data; any other change is the event of a machine that was restored. Afterwards the timeline is
    where it was.

    Args:
        line: the timeline.
        folder: the new bag.
        parent: the bag of the timeline that it forked from.

    Raises:
        Refusal: it begins later, has no parent, the parent's bag cannot be read, or the folder
            exists or cannot be made.
    """
    if line.first != 0:
        raise Refusal("write_timeline", "the timeline", "begin at tick 0", f"tick {line.first}")
    about = {CHANGES: ", ".join(f"{change.name} at tick {change.tick}" for change in line.changes)}
    orders = [
        (change.tick, change.action) for change in line.changes if isinstance(change.action, Order)
    ]
    if len(orders) == len(line.changes):
        about[ORDERS] = json.dumps(
            [{"tick": tick, **convert_to_data(order)} for tick, order in orders]
        )
    if isinstance(line.run, TargetedRun):
        about[TARGETS] = line.run.source
    if parent is not None:
        if line.parent is None:
            raise Refusal("write_timeline", "the timeline", "be a fork of a parent", "none")
        Bag(parent)
        about |= {PARENT: str(parent), FORKED_AT: str(line.begins)}
    here = line.tick
    bag = RunBag(folder, line.run.session, about)
    line.go_to(0)
    with bag:
        _write_ticks(line, bag)
    line.go_to(here)


def _write_ticks(line: Timeline[OfflineRun], bag: RunBag) -> None:
    """Write all ticks of a timeline, and what was changed by hand."""
    session = line.run.session
    changed: dict[int, list[TimelineChange]] = {}
    for by_hand in line.changes:
        changed.setdefault(by_hand.tick, []).append(by_hand)
    for tick in range(1, line.newest + 1):
        line.run.advance(1)  # not by the timeline: the state before changes is reported
        bag.write_state()
        if isinstance(line.run, TargetedRun) and tick < line.newest:
            for kind, saved in line.run.changes_here:
                bag.write_change(kind, saved)
        changes_here = changed.get(tick, [])
        orders = [change.action for change in changes_here if isinstance(change.action, Order)]
        if len(orders) == len(changes_here):
            for order in orders:
                order(line.run)
                if (change := order.change) is not None:
                    bag.write_change(KINDS[type(change)])
        before = session.plant.save() if changes_here else b""
        line.go_to(tick)
        if changes_here and session.plant.save() != before:
            bag.write_change(MachineEvent.KIND_RESTORE)


def load_ordered_run(topics: RecordedTopics, scene: str) -> Timeline[OfflineRun]:
    """Return the timeline of a bag that has its orders or joint targets, at its last tick.

    Args:
        topics: the bag, of `write_timeline` or of a network.
        scene: name or file of its scene, whose gains it had.

    Raises:
        Refusal: it has neither, or they lead elsewhere with this code, scene or gains.
    """
    about = topics.bag.about
    source = RecordedTopics(Bag(Path(about[TARGETS]))) if TARGETS in about else topics
    of_network = TARGETS in about or ORDERS not in about
    line = Timeline(load_targeted_run(source, scene) if of_network else load_offline_run(scene))
    record = RecordedMachine(topics, line.run.session.scene)
    for tick, order in _read_orders(topics) if ORDERS in about else ():
        line.advance(tick - line.tick)
        order.give(line)
    line.advance(record.last - line.tick)
    # In a closed loop all of the past decides on the last command.
    actual, recorded = line.run.session.measured.applied, record.ticks[-1].applied[0]
    if record.last and actual.tobytes() != recorded.tobytes():
        rule = "lead to the recorded commands, with the same code, scene and gains"
        missing = "its joint targets" if of_network else "its orders"
        raise Refusal(str(topics.bag.path), missing, rule, "others", "see check-bag")
    return line


def _read_orders(topics: RecordedTopics) -> list[tuple[int, Order]]:
    """Return the orders of a bag by their ticks."""
    where = str(topics.bag.path)
    try:
        data: Any = json.loads(topics.bag.about[ORDERS])
    except ValueError as error:
        raise Refusal(where, "its orders", "be JSON", error) from None
    orders: list[tuple[int, Order]] = []
    for entry in data if isinstance(data, list) else [data]:
        tick = entry.pop("tick", None) if isinstance(entry, dict) else None
        earliest = orders[-1][0] if orders else 0
        if not isinstance(tick, int) or isinstance(tick, bool) or tick < earliest:
            raise Refusal(where, "tick of an order", f"be a number from {earliest} on", tick)
        orders.append((tick, read_order(where, entry, (LeaveChanges,))))
    return orders

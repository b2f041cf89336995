"""A run in a bag made again: from its orders, or from the joint targets of a network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.targeted_run import LeaveChanges, targeted_run
from arm_emulator.bags.timeline_bag import ORDERS, TARGETS
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.bag import Bag
from arm_emulator.runs.offline import OfflineRun, load_offline_run
from arm_emulator.runs.order import Order, of_data
from arm_emulator.runs.timeline import Timeline


def ordered_run(topics: RecordedTopics, scene: str) -> Timeline[OfflineRun]:
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
    line = Timeline(targeted_run(source, scene) if of_network else load_offline_run(scene))
    record = RecordedMachine(topics, line.run.session.scene)
    for tick, order in _orders(topics) if ORDERS in about else ():
        line.advance(tick - line.tick)
        order.give(line)
    line.advance(record.last - line.tick)
    # In a closed loop all of the past decides on the last command.
    got, wanted = line.run.session.measured.applied, record.ticks[-1].applied[0]
    if record.last and got.tobytes() != wanted.tobytes():
        rule = "lead to the recorded commands, with the same code, scene and gains"
        what = "its joint targets" if of_network else "its orders"
        raise Refusal(str(topics.bag.path), what, rule, "others", "see bisect")
    return line


def _orders(topics: RecordedTopics) -> list[tuple[int, Order]]:
    """Return the orders of a bag by their ticks."""
    where = str(topics.bag.path)
    try:
        data: Any = json.loads(topics.bag.about[ORDERS])
    except ValueError as error:
        raise Refusal(where, "its orders", "be JSON", error) from None
    found: list[tuple[int, Order]] = []
    for one in data if isinstance(data, list) else [data]:
        tick = one.pop("tick", None) if isinstance(one, dict) else None
        least = found[-1][0] if found else 0
        if not isinstance(tick, int) or isinstance(tick, bool) or tick < least:
            raise Refusal(where, "tick of an order", f"be a number from {least} on", tick)
        found.append((tick, of_data(where, one, (LeaveChanges,))))
    return found

"""A run in a bag made again from its orders: machine, servo and motion controller."""

from __future__ import annotations

import json
from typing import Any

from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.timeline_bag import ORDERS
from arm_emulator.base.refusal import Refusal
from arm_emulator.runs.offline import OfflineRun, load_offline_run
from arm_emulator.runs.order import Order, of_data
from arm_emulator.runs.timeline import Timeline


def ordered_run(topics: RecordedTopics, scene: str) -> Timeline[OfflineRun]:
    """Return the timeline of a bag that has its orders, at its last tick.

    Args:
        topics: the bag, as `write_timeline` writes it.
        scene: name or file of its scene, whose gains it had.

    Raises:
        Refusal: it has no orders, or they lead elsewhere with this code, scene or gains.
    """
    orders = _orders(topics)
    line = Timeline(load_offline_run(scene))
    record = RecordedMachine(topics, line.run.session.scene)
    for tick, order in orders:
        line.advance(tick - line.tick)
        order.give(line)
    line.advance(record.last - line.tick)
    # In a closed loop all of the past decides on the last command.
    got, wanted = line.run.session.measured.applied, record.ticks[-1].applied[0]
    if record.last and got.tobytes() != wanted.tobytes():
        rule = "lead to the recorded commands, with the same code, scene and gains"
        raise Refusal(str(topics.bag.path), "its orders", rule, "others", "see bisect")
    return line


def _orders(topics: RecordedTopics) -> list[tuple[int, Order]]:
    """Return the orders of a bag by their ticks."""
    where = str(topics.bag.path)
    text = topics.bag.about.get(ORDERS)
    if text is None:
        rule = "have its orders, as a bag of `run --bag` and `fork`"
        raise Refusal(where, "the bag", rule, "none")
    try:
        data: Any = json.loads(text)
    except ValueError as error:
        raise Refusal(where, "its orders", "be JSON", error) from None
    found: list[tuple[int, Order]] = []
    for one in data if isinstance(data, list) else [data]:
        tick = one.pop("tick", None) if isinstance(one, dict) else None
        least = found[-1][0] if found else 0
        if not isinstance(tick, int) or isinstance(tick, bool) or tick < least:
            raise Refusal(where, "tick of an order", f"be a number from {least} on", tick)
        found.append((tick, of_data(where, one)))
    return found

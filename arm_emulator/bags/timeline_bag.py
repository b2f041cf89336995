"""A timeline written as a bag, which names the bag of the run that it forked from."""

from __future__ import annotations

import json
from pathlib import Path

from arm_emulator.bags.run_bag import KINDS, RunBag
from arm_emulator.bags.targeted_run import TargetedRun
from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.bag import Bag
from arm_emulator.ros.bag_metadata import FORKED_AT, PARENT
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.order import Order, as_data
from arm_emulator.runs.timeline import Change, Timeline
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
    about = {CHANGES: ", ".join(f"{one.name} at tick {one.tick}" for one in line.changes)}
    orders = [(one.tick, one.made) for one in line.changes if isinstance(one.made, Order)]
    if len(orders) == len(line.changes):
        about[ORDERS] = json.dumps([{"tick": tick, **as_data(one)} for tick, one in orders])
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
        _write(line, bag)
    line.go_to(here)


def _write(line: Timeline[OfflineRun], bag: RunBag) -> None:
    """Write all ticks of a timeline, and what was changed by hand."""
    session = line.run.session
    changed: dict[int, list[Change]] = {}
    for one in line.changes:
        changed.setdefault(one.tick, []).append(one)
    for tick in range(1, line.newest + 1):
        line.run.advance(1)  # not by the timeline: the state before changes is reported
        bag.report()
        if isinstance(line.run, TargetedRun) and tick < line.newest:
            for kind, saved in line.run.changes_here:
                bag.changed(kind, saved)
        made = changed.get(tick, [])
        orders = [one.made for one in made if isinstance(one.made, Order)]
        if len(orders) == len(made):
            for order in orders:
                order(line.run)
                if (change := order.change) is not None:
                    bag.changed(KINDS[type(change)])
        before = session.plant.save() if made else b""
        line.go_to(tick)
        if made and session.plant.save() != before:
            bag.changed(MachineEvent.KIND_RESTORE)

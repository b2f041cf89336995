"""Lead a recorded run on in another way from one of its moments, into a new bag."""

import math
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.targeted_run import LeaveChanges, TargetedRun
from arm_emulator.bags.timeline_bag import load_ordered_run, write_timeline
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.ros.recording.bag import Bag
from arm_emulator.runs.goal import find_missed_order
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.order import MoveTool, Order, Push, ScaleGains, SetVaried, SwitchPower


@command(keys="`bag`, `parent`, `tick`, `ticks`, `orders`, `diverged`, `missed`")
def fork_run(
    bag: Path,
    new: Path,
    /,
    *,
    at: Annotated[float, Parameter(metavar="S")],
    seconds: Annotated[float | None, Parameter(metavar="S")] = None,
    displacement: Annotated[tuple[float, float, float] | None, Parameter(metavar="X Y Z")] = None,
    power: Literal["on", "off"] | None = None,
    gains: Annotated[float | None, Parameter(metavar="FACTOR")] = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", metavar="NAME=VALUE ...")] = None,
    push: Annotated[tuple[str, float, float, float] | None, Parameter(metavar="LINK X Y Z")] = None,
    scene: SceneName | None = None,
) -> int:
    """Lead a recorded run on in another way, into a new bag that names its parent.

    Machine, servo and motion controller are as they were at that moment, to the last bit.

    Args:
        bag: folder of a bag of `run --bag`, of a fork, or of a network in lock-step (`record`).
        new: folder of the new bag.
        at: logical time of the moment (s).
        seconds: logical time from there on (default: up to the end of the bag).
        displacement: displacement of the tool from where it is (m, in the world).
        power: of the drives.
        gains: factor of the servo's position gains.
        set_: varied numbers and faults of the scene.
        push: force on a link from then on (N, in the world).
        scene: scene file or name (default: the one that the bag names).
    """
    orders: list[Order] = []
    if displacement is not None:
        orders.append(MoveTool(displacement))
    if power is not None:
        orders.append(SwitchPower(power == "on"))
    if gains is not None:
        orders.append(ScaleGains(gains))
    orders += [_read_number(text) for text in set_ or ()]
    if push is not None:
        orders.append(Push(push[0], push[1:]))
    if new.exists():
        raise Refusal("fork", f"folder {new}", "be new", "one that exists")
    topics = RecordedTopics(Bag(bag))
    line = load_ordered_run(topics, scene or topics.scene)
    period = line.run.session.scene.servo_period
    left = line.newest * period - at if seconds is None else seconds
    for option, value, limit in (("--at", at, line.newest * period), ("--seconds", left, math.inf)):
        if not (math.isfinite(value) and 0.0 <= value <= limit + 0.5 * period):
            rule = f"be within 0 and {limit:g} s"
            raise Refusal("fork", option, rule, f"{value:g}")
    line.go_to(min(round(at / period), line.newest))
    future = line.fork()
    if isinstance(line.run, TargetedRun) and line.tick < line.newest:
        LeaveChanges().give(future)
    for order in orders:
        order.give(future)
    diverged = ""
    try:
        future.advance(round(left / period))
    except Diverged as fault:
        diverged = str(fault)
        output.print_line(diverged)
    write_timeline(future, new, bag)
    done = ", ".join(order.name for order in orders) or "as it was"
    ticks = future.newest - future.begins
    output.print_line(f"{new}: from tick {future.begins} of {bag}, {done}, {ticks} ticks")
    output.add_facts(
        {
            "bag": new,
            "parent": bag,
            "tick": future.begins,
            "ticks": ticks,
            "orders": [order.name for order in orders],
            "diverged": diverged or None,
        }
    )
    if diverged or displacement is None or not isinstance(line.run, OfflineRun):
        return 1 if diverged else 0
    return output.report_miss("fork", find_missed_order(line.run))


def _read_number(text: str) -> SetVaried:
    """Return the order of a text NAME=VALUE."""
    name, _, value = text.partition("=")
    try:
        return SetVaried(name, float(value))
    except ValueError:
        raise Refusal("fork", "--set", "be NAME=VALUE", text) from None

"""Explain one moment of a recorded run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from arm_emulator.bags.explanation import Explanation, explain_moment
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import RunNumber, SceneName, When
from arm_emulator.cli.output import output
from arm_emulator.machine.chain import Array
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.ros.bag import Bag
from arm_emulator.runs.condition import Condition
from arm_emulator.runs.timeline import Timeline


@command(
    keys=(
        "`scene`, `tick`, `t`, `powered`, `orders`, `q_target`, `q`, `v`, `current`, "
        "`commanded`, `applied`, `supplied`, `dissipated`, `torques_on_links`, "
        "`torques_on_rotors`, `active`"
    ),
)
def explain(
    bag: Path,
    /,
    *,
    at: Annotated[float | None, Parameter(metavar="S")] = None,
    when: When = None,
    scene: SceneName | None = None,
    run: RunNumber = -1,
) -> int:
    """Explain one moment of a recorded run: commands, limits, energy and torques by term.

    The machine is driven again up to there.

    Args:
        bag: folder of the bag.
        at: logical time of the moment (s).
        when: condition instead: the first moment at which it holds, after that of --at if given.
        scene: scene file or name (default: the one that the bag names).
        run: which run of the bag, from 1 on (default: the last).
    """
    topics = RecordedTopics(Bag(bag))
    machine = RecordedMachine(topics, load_scene(scene or topics.scene), run)
    if at is None and when is None:
        raise Refusal("explain", "--at or --when", "be given", "neither")
    period = machine.scene.servo_period
    begin = 0.0 if at is None else at
    if not (math.isfinite(begin) and 0 <= round(begin / period) <= machine.last):
        rule = f"be within the run, 0 to {machine.last * period:g} s"
        raise Refusal("explain", "--at", rule, f"{begin:g}")
    machine.advance(round(begin / period))
    if when is not None and not _found(machine, Condition(when, machine.scene, "explain")):
        output.line(f"it never holds, up to {machine.last * period:g} s: {when}")
        output.facts({"scene": machine.scene.name, "tick": None})
        return 1
    _print(machine.scene, explain_moment(machine, topics))
    return 0


def _found(machine: RecordedMachine, condition: Condition) -> bool:
    """Advance to the first tick at which a condition holds."""
    if machine.tick == 0 and condition.holds(machine.session):
        return True
    line = Timeline(machine)
    return line.find(lambda run: condition.holds(run.session), machine.last) is not None


def _print(scene: Scene, now: Explanation) -> None:
    """Print a moment as tables, a column per joint."""
    names = scene.joint_names
    output.line(f"scene {scene.name}, tick {now.tick}, {now.t:g} s of logical time")
    if now.orders:
        output.line(f"motion controller: {now.orders}")
    rows: dict[str, Array | None] = {
        "target [rad or m]": now.q_target,
        "q [rad or m]": now.state.q,
        "v [rad/s or m/s]": now.state.v,
        "motor current [A]": now.state.current,
        "commanded": now.commanded,
        "the motor gets": now.applied,
    }
    _table("", names, rows)
    if now.flow is not None:
        _table(
            "power [W]",
            names,
            {"supplied": now.flow.given, "dissipated": now.flow.dissipated},
        )
    for title, terms in (("link", now.terms.link), ("rotor", now.terms.rotor)):
        table = np.array(list(terms.values()))
        sums = {"sum": np.nansum(table, axis=0)} if "inertia" in terms else {}
        _table(f"torques on each {title} [N m or N]", names, {**terms, **sums})
    for line in now.active:
        output.line(line)
    if now.applied is None:
        output.line("the record ends here: torques are those without a command")
    output.facts(_facts(scene, now))


def _table(title: str, names: tuple[str, ...], rows: dict[str, Array | None]) -> None:
    there = {name: row for name, row in rows.items() if row is not None}
    width = max(len(title), *map(len, there))
    columns = [max(11, len(name)) for name in names]
    heads = (f"{name:>{size}}" for name, size in zip(names, columns, strict=True))
    output.line("")
    output.line(f"{title:{width}}  {'  '.join(heads)}")
    for name, row in there.items():
        cells = (
            f"{'-' if math.isnan(one) else format(one + 0.0, '.5g'):>{size}}"
            for one, size in zip(row.tolist(), columns, strict=True)
        )
        output.line(f"{name:{width}}  {'  '.join(cells)}")


def _facts(scene: Scene, now: Explanation) -> dict[str, Any]:
    def by_joint(row: Array | None) -> dict[str, float | None] | None:
        if row is None:
            return None
        values = (None if math.isnan(one) else one for one in row.tolist())
        return dict(zip(scene.joint_names, values, strict=True))

    return {
        "scene": scene.name,
        "tick": now.tick,
        "t": now.t,
        "powered": now.powered,
        "orders": now.orders or None,
        "q_target": by_joint(now.q_target),
        "q": by_joint(now.state.q),
        "v": by_joint(now.state.v),
        "current": by_joint(now.state.current),
        "commanded": by_joint(now.commanded),
        "applied": by_joint(now.applied),
        "supplied": None if now.flow is None else by_joint(now.flow.given),
        "dissipated": None if now.flow is None else by_joint(now.flow.dissipated),
        "torques_on_links": {name: by_joint(row) for name, row in now.terms.link.items()},
        "torques_on_rotors": {name: by_joint(row) for name, row in now.terms.rotor.items()},
        "active": now.active,
    }

"""Explain one moment of a recorded run, or the first difference of two."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from arm_emulator.extension.bags import (
    Explanation,
    RecordedMachine,
    explain_moment,
    measure_stop,
)
from arm_emulator.extension.base import Array, Number, Refusal
from arm_emulator.extension.commands import RunNumber, SceneName, When, command, output
from arm_emulator.extension.machine import Diverged, Scene, list_differing_builds
from arm_emulator.extension.page import Condition, Timeline
from arm_emulator_analysis.first_difference import find_first_difference

BAND = Number("--stop", "mm", above=0.0, at_most=1e6)
TITLES = {
    "q_target": "target [rad or m]",
    "q": "q [rad or m]",
    "v": "v [rad/s or m/s]",
    "current": "motor current [A]",
    "commanded": "commanded",
    "applied": "the motor gets",
}


@command(
    keys=(
        "`scene`, `tick`, `t`, `powered`, `orders`, `q_target`, `q`, `v`, `current`, "
        "`commanded`, `applied`, `supplied`, `dissipated`, `torques_on_links`, "
        "`torques_on_rotors`, `active`; with a second bag, and the moment before the difference, "
        "`sides`, `equal_ticks`, `difference` (null if they are equal), `builds` (sentences on "
        "how builds differ); with the option stop, `truth` and `encoders`: `largest`, `swing`, "
        "`rms` [m], `frequency` [Hz] (null without a peak), `settled` [s]"
    ),
)
def explain_run(
    bag: Path,
    other: Path | None = None,
    /,
    *,
    at: Annotated[float | None, Parameter(metavar="S")] = None,
    when: When = None,
    stop: Annotated[float | None, Parameter(metavar="MM")] = None,
    scene: SceneName | None = None,
    other_scene: SceneName | None = None,
    run: RunNumber = -1,
    other_run: RunNumber = -1,
) -> int:
    """Explain one moment of a recorded run: commands, limits, energy and torques by term.

    The machine is driven again up to there. With a second bag it is the moment at which the two
    runs begin to differ; the exit code is 1 where they do.

    Args:
        bag: folder of the bag.
        other: folder of the bag whose run is compared.
        at: logical time of the moment (s).
        when: condition instead: the first moment at which it holds, after that of --at if given.
        stop: instead of a moment, the tool's vibration after the last targets, or from --at on; the
            time until it stays within so many mm of its rest.
        scene: scene file or name (default: the one that the bag names).
        other_scene: likewise of the other bag.
        run: which run of the bag, from 1 on (default: the last).
        other_run: likewise of the other bag.
    """
    machine = RecordedMachine.open_run(bag, scene, run)
    if other is not None:
        if at is not None or when is not None or stop is not None:
            rule = "stand without a second bag"
            raise Refusal("explain", "--at, --when and --stop", rule, "both")
        second = RecordedMachine.open_run(other, other_scene or scene, other_run)
        return _compare_runs((bag.name, other.name), machine, second)
    if stop is not None:
        if when is not None:
            raise Refusal("explain", "--stop", "stand without --when", "both")
        end = None if at is None else _find_tick(machine, at)
        return _print_stop(machine, 1e-3 * BAND.check_value("explain", stop), end)
    if at is None and when is None:
        raise Refusal("explain", "--at or --when", "be given", "neither")
    machine.advance(_find_tick(machine, 0.0 if at is None else at))
    if when is not None and not _is_satisfied(machine, Condition(when, machine.scene, "explain")):
        last = machine.last * machine.scene.servo_period
        output.print_line(f"it never holds, up to {last:g} s: {when}")
        output.add_facts({"scene": machine.scene.name, "tick": None})
        return 1
    _print_moment(machine.scene, explain_moment(machine))
    return 0


def _find_tick(machine: RecordedMachine, at: float) -> int:
    """Return the tick at a logical time [s]."""
    period = machine.scene.servo_period
    if not (math.isfinite(at) and 0 <= round(at / period) <= machine.last):
        rule = f"be within the run, 0 to {machine.last * period:g} s"
        raise Refusal("explain", "--at", rule, f"{at:g}")
    return round(at / period)


def _print_stop(machine: RecordedMachine, band: float, end: int | None) -> int:
    """Print the vibration of the tool after the last targets of a run, or from a tick on."""
    tick, *stops = measure_stop(machine, band, end)
    scene, sources = machine.scene, ("truth", "encoders")
    output.print_line(f"scene {scene.name}: the tool after {tick * scene.servo_period:g} s")
    rows = [
        (name, *(f"{1e3 * v:.4f}" for v in (stop.largest, stop.swing, stop.rms)),
         "-" if math.isnan(stop.frequency) else f"{stop.frequency:.2f}", f"{stop.settled:.3f}")
        for name, stop in zip(sources, stops, strict=True)
    ]  # fmt: skip
    heads = ("tool by", "largest, mm", "swing, mm", "rms, mm", "Hz", f"within {1e3 * band:g} mm, s")
    output.print_table(heads, rows)
    facts = [dataclasses.asdict(stop) for stop in stops]
    for fact in facts:
        fact["frequency"] = None if math.isnan(fact["frequency"]) else fact["frequency"]
    by_source = dict(zip(sources, facts, strict=True))
    output.add_facts({"scene": scene.name, "tick": tick, **by_source})
    return 0


def _compare_runs(names: tuple[str, str], first: RecordedMachine, second: RecordedMachine) -> int:
    """Print the first difference of two runs, and the moment from which it comes."""
    start = first.save()
    difference, equal = find_first_difference(first, second)
    builds = list_differing_builds(names, first.topics.build, second.topics.build)
    output.add_facts({"sides": names, "equal_ticks": equal, "difference": None, "builds": builds})
    for sentence in builds:
        output.print_line(f"other builds: {sentence}")
    if difference is None:
        output.print_line(f"equal to the last bit in what both have recorded: {equal} ticks")
        return 0
    t = difference.tick * first.scene.servo_period
    output.print_line(
        f"first difference: tick {difference.tick}, {t:g} s, after {equal} equal ticks"
    )
    owner = f"{difference.owner}, " if difference.owner else ""
    ulps = difference.ulps
    many = "" if ulps is None else f", {ulps} representable number{'s' * (ulps > 1)} apart"
    output.print_line(f"{difference.kind}: {owner}{difference.quantity}{many}")
    for name, value in zip(names, difference.values, strict=True):
        output.print_line(f"  {name}: {value!r}")
    output.add_facts({"difference": {**difference._asdict(), "ulps": ulps}})
    first.restore(start)
    try:
        first.advance(max(0, difference.tick - (difference.kind == "state")))
    except Diverged as fault:
        output.print_line(str(fault))
        return 1
    output.print_line(f"the moment from which it comes, of {names[0]}:")
    _print_moment(first.scene, explain_moment(first))
    return 1


def _is_satisfied(machine: RecordedMachine, condition: Condition) -> bool:
    """Advance to the first tick at which a condition holds."""
    if machine.tick == 0 and condition.holds(machine.session):
        return True
    line = Timeline(machine)
    return line.find(lambda run: condition.holds(run.session), machine.last) is not None


def _print_moment(scene: Scene, now: Explanation) -> None:
    """Print a moment as tables, a column per joint."""
    names = scene.joint_names
    output.print_line(f"scene {scene.name}, tick {now.tick}, {now.t:g} s of logical time")
    if now.orders:
        output.print_line(f"motion controller: {now.orders}")
    _print_table("", names, {TITLES[key]: row for key, row in now.rows.items()})
    if now.flow is not None:
        _print_table(
            "power [W]",
            names,
            {"supplied": now.flow.supplied, "dissipated": now.flow.dissipated},
        )
    for title, terms in (("link", now.terms.link), ("rotor", now.terms.rotor)):
        table = np.array(list(terms.values()))
        sums = {"sum": np.nansum(table, axis=0)} if "inertia" in terms else {}
        _print_table(f"torques on each {title} [N m or N]", names, {**terms, **sums})
    for line in now.active:
        output.print_line(line)
    if now.rows["applied"] is None:
        output.print_line("the record ends here: torques are those without a command")
    output.add_facts(_list_facts(scene, now))


def _print_table(title: str, names: tuple[str, ...], rows: dict[str, Array | None]) -> None:
    cells = (
        (
            name,
            *("-" if math.isnan(value) else format(value + 0.0, ".5g") for value in row.tolist()),
        )
        for name, row in rows.items()
        if row is not None
    )
    output.print_line("")
    output.print_table((title, *names), cells)


def _list_facts(scene: Scene, now: Explanation) -> dict[str, Any]:
    def map_joints(row: Array | None) -> dict[str, float | None] | None:
        if row is None:
            return None
        values = (None if math.isnan(value) else value for value in row.tolist())
        return dict(zip(scene.joint_names, values, strict=True))

    return {
        "scene": scene.name,
        "tick": now.tick,
        "t": now.t,
        "powered": now.powered,
        "orders": now.orders or None,
        **{key: map_joints(row) for key, row in now.rows.items()},
        "supplied": None if now.flow is None else map_joints(now.flow.supplied),
        "dissipated": None if now.flow is None else map_joints(now.flow.dissipated),
        "torques_on_links": {name: map_joints(row) for name, row in now.terms.link.items()},
        "torques_on_rotors": {name: map_joints(row) for name, row in now.terms.rotor.items()},
        "active": now.active,
    }

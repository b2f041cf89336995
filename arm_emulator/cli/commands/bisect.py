"""Find the first difference of two recorded runs, or of a run and the present code."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.bags.bad_commit import first_bad_commit
from arm_emulator.bags.first_difference import FirstDifference, Side, first_difference
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import Commit, RunNumber, SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.build_facts import other_builds


@command(
    of_ros=True,
    keys=(
        "`sides`, `equal_ticks`, `difference` (null if they are equal), `builds` (sentences on "
        "how builds differ); with the options good and bad `commit`, `title`"
    ),
)
def bisect(
    bag: Path,
    other: Path | None = None,
    /,
    *,
    scene: SceneName | None = None,
    other_scene: SceneName | None = None,
    run: RunNumber = -1,
    other_run: RunNumber = -1,
    good: Commit = None,
    bad: Commit = None,
) -> int:
    """Find the first tick and bit in which two runs differ, and the step that leads there.

    Args:
        bag: folder of a bag.
        other: folder of another bag (default: the machine, driven again by the first one).
        scene: scene file or name of the bag (default: the one that the bag names).
        other_scene: likewise of the other run (default: that of the first).
        run: which run of the bag, from 1 on (default: the last).
        other_run: likewise of the other bag.
        good: a commit of the emulator that repeats the bag, to find the first that does not.
        bad: a commit that does not; with --good.
    """
    if (good is None) != (bad is None):
        raise Refusal("bisect", "--good and --bad", "be given both", "one")
    if good is not None and bad is not None:
        if other is not None:
            raise Refusal("bisect", "the other bag", "be left out with commits", str(other))
        commit, title = first_bad_commit(bag, scene, good, bad)
        output.line(f"the first commit that does not repeat it: {commit[:12]} {title}")
        output.facts({"commit": commit, "title": title})
        return 1
    one = Side.of(bag, scene, run)
    if other is None:
        two = dataclasses.replace(Side.of(bag, other_scene or scene, run), again=True)
    else:
        two = Side.of(other, other_scene or scene, other_run)
    names = (bag.name, "driven again" if other is None else other.name)
    found, equal = first_difference(one, two)
    builds = other_builds(names, one.build, two.build)
    facts = {"sides": names, "equal_ticks": equal, "difference": _facts(found), "builds": builds}
    output.facts(facts)
    for sentence in builds:
        output.line(f"other builds: {sentence}")
    if found is None:
        output.line(f"equal to the last bit in what both have recorded: {equal} ticks")
        return 0
    t = found.tick * one.scene.servo_period
    output.line(f"first difference: tick {found.tick}, {t:g} s, after {equal} equal ticks")
    owner = f"{found.owner}, " if found.owner else ""
    output.line(f"{found.kind}: {owner}{found.quantity}{_distance(found)}")
    for name, value in zip(names, found.values, strict=True):
        output.line(f"  {name}: {value!r}")
    for name, rows in zip(names, found.inputs, strict=True):
        if rows:
            output.line(f"the step that leads there, {name}:")
            for quantity, row in rows.items():
                numbers = "  ".join(repr(float(one)) for one in row)
                output.line(f"  {quantity:12} {numbers}")
    return 1


def _distance(found: FirstDifference) -> str:
    if found.ulps is None:
        return ""
    return f", {found.ulps} representable number{'s' if found.ulps > 1 else ''} apart"


def _facts(found: FirstDifference | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "tick": found.tick,
        "kind": found.kind,
        "quantity": found.quantity,
        "owner": found.owner,
        "values": [one if isinstance(one, int | float | str) else str(one) for one in found.values],
        "ulps": found.ulps,
        "inputs": [{name: np.asarray(row) for name, row in side.items()} for side in found.inputs],
    }

"""A recorded run as a recording of Rerun; at will with torques by term, limits and modes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from arm_emulator.analysis.torque_terms import TermsNow, TorqueTerms
from arm_emulator.bags.explanation import acting, active_at
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.repetition import KINDS
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.ros.node_shell import nanoseconds_of
from arm_emulator.runs.view_of import view_of
from arm_emulator.view.rerun_stream import RerunStream


def write_view(
    topics: RecordedTopics,
    machine: RecordedMachine,
    file: Path,
    end: int,
    every: int,
    *,
    explained: bool,
) -> int:
    """Write the run of a machine from its present tick to another one; return how many samples.

    Args:
        topics: the bag.
        machine: of its run, at the first tick.
        file: new .rrd file.
        end: the last tick.
        every: ticks between two samples.
        explained: write torques by term, and what acts, too; they take a compiler.

    Raises:
        Refusal: Rerun is missing, there is no compiler, or the file cannot be written.
    """
    session, scene = machine.session, machine.scene
    angle = session.plant.link_angle_per_count
    torques = TorqueTerms(scene) if explained else None
    view, targets = view_of(scene), list(_targets(topics, machine))
    sensors = list(view["further"])
    if torques is not None:
        names = _named(torques.of(session.plant.save(), acting(machine)))
        view["further"] |= dict.fromkeys(names, "N m or N")
    stream = RerunStream(**view, file=file, targets=bool(targets))
    count, before = 0, set[str]()
    while True:
        now, state, measured = session.logical_ns, session.state, session.measured
        counts = measured.encoder_counts
        further = [np.asarray(getattr(measured, name), np.float64) for name in sensors]
        active: dict[str, str] = {}
        if torques is not None:
            terms = torques.of(session.plant.save(), acting(machine))
            further += _named(terms).values()
            # A sentence is written where it begins to hold; its numbers may change meanwhile.
            active = {text.split(",")[0]: text for text in active_at(machine, terms)}
        stream.wait_for_room()
        usual = state.q, state.v, state.gear_torque, state.current, measured.applied
        stream.offer(now, *usual, (counts + 0.5) * angle, further)
        while targets and targets[0][0] <= machine.tick:
            stream.offer_target(*targets.pop(0)[1:])
        for one in machine.changes.get(machine.tick, ()):
            stream.offer_text(now, f"changed by hand: {KINDS.get(one.kind, one.kind)}")
        for name in active.keys() - before:
            stream.offer_text(now, active[name])
        for name in before - active.keys():
            stream.offer_text(now, f"no longer: {name}")
        before, count = set(active), count + 1
        if machine.tick >= end:
            break
        machine.advance(min(every, end - machine.tick))
    if missing := stream.close_whole():
        raise Refusal("film", f"file {file}", "accept every sample", missing)
    return count


def _targets(
    topics: RecordedTopics, machine: RecordedMachine
) -> Iterator[tuple[int, int, list[float]]]:
    """Yield the tool's targets of a run: tick of publication, from when on [ns], p_WT [m]."""
    published = [one.published for one in machine.ticks]
    for _, target, when in topics.read_with_time("tool_target"):
        if published[0] <= when <= published[-1]:
            tick, p = int(np.searchsorted(published, when)), target.pose.position
            yield tick, max(0, nanoseconds_of(target.header.stamp)), [p.x, p.y, p.z]


def _named(terms: TermsNow) -> dict[str, Array]:
    """Return all terms by the names under which they are drawn."""
    sides = (("link", terms.link), ("rotor", terms.rotor))
    return {f"on {side}: {name}": row for side, rows in sides for name, row in rows.items()}

"""A recorded run as a recording of Rerun, with torques by term, and limits and modes as texts."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from arm_emulator.analysis.torque_terms import TermsNow, TorqueTerms
from arm_emulator.bags.explanation import acting, active_at
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.repetition import KINDS
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.runs.view_of import view_of
from arm_emulator.view.rerun_stream import RerunStream

BREATH = 1e-3  # s, wall
MOST_WAITING = 10_000  # samples
LONGEST_END = 60.0  # s, wall


def write_explained(machine: RecordedMachine, file: Path, end: int, every: int) -> int:
    """Write the run of a machine from its present tick to another one; return how many samples.

    Args:
        machine: the machine, at the first tick.
        file: new .rrd file.
        end: the last tick.
        every: ticks between two samples.

    Raises:
        Refusal: Rerun is missing, there is no compiler, or the file cannot be written.
    """
    session, scene = machine.session, machine.scene
    angle, torques = session.plant.link_angle_per_count, TorqueTerms(scene)
    view = view_of(scene)
    sensors = list(view["further"])
    names = _named(torques.of(session.plant.save(), acting(machine)))
    view["further"] |= dict.fromkeys(names, "N m or N")
    stream = RerunStream(**view, file=file)
    count, before = 0, set[str]()
    while True:
        now, state, measured = session.logical_ns, session.state, session.measured
        terms = torques.of(session.plant.save(), acting(machine))
        counts = measured.encoder_counts
        further = [np.asarray(getattr(measured, name), np.float64) for name in sensors]
        further += _named(terms).values()
        while stream.waiting >= MOST_WAITING:
            time.sleep(BREATH)
        usual = state.q, state.v, state.gear_torque, state.current, measured.applied
        stream.offer(now, *usual, (counts + 0.5) * angle, further)
        for one in machine.changes.get(machine.tick, ()):
            stream.offer_text(now, f"changed by hand: {KINDS.get(one.kind, one.kind)}")
        # A sentence is written where it begins to hold; its numbers may change meanwhile.
        active = {text.split(",")[0]: text for text in active_at(machine, terms)}
        for name in active.keys() - before:
            stream.offer_text(now, active[name])
        for name in before - active.keys():
            stream.offer_text(now, f"no longer: {name}")
        before, count = set(active), count + 1
        if machine.tick >= end:
            break
        machine.advance(min(every, end - machine.tick))
    stream.close(LONGEST_END)
    if stream.trouble or stream.dropped:
        got = stream.trouble or f"{stream.dropped} samples are missing"
        raise Refusal("film", f"file {file}", "accept every sample", got)
    return count


def _named(terms: TermsNow) -> dict[str, Array]:
    """Return all terms by the names under which they are drawn."""
    sides = (("link", terms.link), ("rotor", terms.rotor))
    return {f"on {side}: {name}": row for side, rows in sides for name, row in rows.items()}

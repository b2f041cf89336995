"""Write a moving picture of a recorded run."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter

from arm_emulator.analysis.torque_terms import TermsNow, TorqueTerms
from arm_emulator.bags.explanation import acting, active_at
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.repetition import KINDS
from arm_emulator.base.number import Number
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command import command
from arm_emulator.cli.options import RunNumber, SceneName
from arm_emulator.cli.output import output
from arm_emulator.machine.chain import Array
from arm_emulator.machine.scene import load_scene
from arm_emulator.ros.bag import Bag
from arm_emulator.ros.node_shell import nanoseconds_of
from arm_emulator.runs.view_of import view_of
from arm_emulator.view.film import RECORDING, check_film, write_film
from arm_emulator.view.rerun_stream import RerunStream

SPEED = Number("--speed", "", above=0.0, at_most=1e3)
RATE = Number("--rate", "pictures a second", above=0.0, at_most=120.0)
MOST = 20_000  # pictures
SAMPLES = 2000  # of each signal at least, and four a picture


@command(of_ros=True, keys="`file`, `pictures`, `begin`, `end`")
def film(
    bag: Path,
    file: Path,
    /,
    *,
    scene: SceneName | None = None,
    run: RunNumber = -1,
    begin: Annotated[float, Parameter(metavar="S")] = 0.0,
    end: Annotated[float | None, Parameter(metavar="S")] = None,
    speed: float = 1.0,
    rate: float = 25.0,
    size: Annotated[tuple[int, int], Parameter(metavar="W H")] = (1280, 720),
) -> int:
    """Write a moving picture of a recorded run: the arm, and its signals.

    Args:
        bag: folder of the bag.
        file: new .mp4 or .gif; .png, a picture of the end; or .rrd, a recording of Rerun with the
            torques by term.
        scene: scene file or name (default: the one that the bag names).
        run: which run of the bag, from 1 on (default: the last).
        begin: logical time at which it begins (s).
        end: logical time at which it ends (s; default: the run's end).
        speed: logical seconds per second of the picture.
        rate: pictures a second.
        size: width and height (points), even numbers.
    """
    check_film("film", file)
    speed, rate = SPEED.take("film", speed), RATE.take("film", rate)
    for one in size:
        if not (64 <= one <= 4096 and one % 2 == 0):
            raise Refusal("film", "--size", "be even numbers from 64 to 4096", list(size))
    topics = RecordedTopics(Bag(bag))
    machine = RecordedMachine(topics, load_scene(scene or topics.scene), run)
    period = machine.scene.servo_period
    last = machine.last * period
    until = last if end is None else end
    if not 0.0 <= begin <= until <= last + 0.5 * period:
        raise Refusal("film", "--begin and --end", f"be within 0 to {last:g} s", [begin, until])
    step = speed / rate
    moments = np.arange(begin, until + 1e-9, step)
    if len(moments) > MOST:
        raise Refusal("film", "pictures", f"be at most {MOST}", len(moments))
    ticks = min(step / 4, (until - begin) / SAMPLES) / period
    every = max(1, int(ticks))
    if file.suffix == RECORDING:
        machine.advance(round(begin / period))
        ends = round(until / period)
        samples = write_view(topics, machine, file, ends, every, explained=True)
        output.line(f"{file}: {samples} samples, {until - begin:g} s of logical time")
        output.facts({"file": file, "pictures": 0, "begin": begin, "end": until})
        return 0
    with tempfile.TemporaryDirectory() as folder:
        rrd = Path(folder) / "run.rrd"
        ends = min(machine.last, math.ceil((until + step) / period))
        write_view(topics, machine, rrd, ends, every, explained=False)
        write_film(rrd, file, moments.tolist(), rate, size)
    output.line(f"{file}: {len(moments)} pictures, {until - begin:g} s of logical time")
    output.facts({"file": file, "pictures": len(moments), "begin": begin, "end": until})
    return 0


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

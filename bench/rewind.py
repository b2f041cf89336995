"""Time to reach any tick of a run's past, and the cost of the checkpoints.

python -m bench.rewind [SCENE] [--seconds 3600]
"""

from __future__ import annotations

import argparse
import hashlib
import time
from collections.abc import Sequence
from functools import partial
from multiprocessing import Pool

import numpy as np
from numpy.typing import NDArray

from arm_emulator import OfflineRun, Pose, Timeline
from arm_emulator.runs.offline import load_offline_run
from bench.measure import progress

VISITS = 100
EVERY = 2.0  # s between two tool targets
REACH = 0.05  # m: of a target around the start


def new_target(run: OfflineRun, offset: NDArray[np.float64]) -> None:
    """Send the tool to a place beside the start."""
    R_WT, p_WT = run.controller.kinematics.forward(run.session.scene.start)
    run.instructor.add(run.session.logical_ns, Pose(p_WT + offset, R_WT))


def digest(run: OfflineRun) -> str:
    """Return all that decides how machine and servo go on, as a hash."""
    state = run.session.plant.save() + run.drives.servo.state.tobytes() + run.aimed.tobytes()
    return hashlib.sha256(state).hexdigest()


def straight_run(
    scene: str, offsets: NDArray[np.float64], per_target: int, looked: set[int]
) -> dict[int, str]:
    """Run without a timeline, and return the state at some ticks."""
    run, seen = load_offline_run(scene), dict[int, str]()
    for target, offset in enumerate(offsets):
        new_target(run, offset)
        begin = target * per_target
        for stop in sorted(looked & set(range(begin, begin + per_target))):
            run.advance(stop - run.tick)
            seen[stop] = digest(run)
        run.advance(begin + per_target - run.tick)
    return seen


def main(arguments: Sequence[str] | None = None) -> None:
    """Run with a timeline, and beside it as usual, then visit ticks of the past."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("scene", nargs="?", default="ur5")
    parser.add_argument("--seconds", type=float, default=3600.0)
    given = parser.parse_args(arguments)
    timeline = Timeline(load_offline_run(given.scene))
    per_target = round(EVERY / timeline.run.session.scene.servo_period)
    targets = max(1, round(given.seconds / EVERY))
    rng = np.random.default_rng(1)
    offsets = rng.uniform(-REACH, REACH, (targets, 3))
    looked = {int(tick) for tick in rng.integers(0, targets * per_target, VISITS)}
    spent = 0.0
    with Pool(1) as beside, progress("with checkpoints", targets) as done:
        straight = beside.apply_async(straight_run, (given.scene, offsets, per_target, looked))
        for target, offset in enumerate(offsets):
            timeline.change(f"target {target}", partial(new_target, offset=offset))
            timeline.advance(per_target)
            done()
        seen = straight.get()
    for _ in range(100):
        begun = time.process_time()
        timeline.run.save()
        spent += (time.process_time() - begun) / 100
    waits, equal = [], 0
    for tick in rng.permutation(sorted(looked)).tolist():
        begun_at = time.perf_counter()
        timeline.go_to(tick)
        waits.append(time.perf_counter() - begun_at)
        equal += digest(timeline.run) == seen[tick]
    hours = timeline.newest * timeline.run.session.scene.servo_period / 3600.0
    per_tick, size = spent / timeline.every, timeline.bytes / 1e6
    print(f"{given.scene}, {hours * 3600.0:g} s of logical time, {targets} tool targets")
    print(f"ticks visited      {len(looked)}, equal to the last bit {equal}")
    print(f"time to reach one  median {np.median(waits) * 1e3:.1f}, most {max(waits) * 1e3:.1f} ms")
    print(f"a checkpoint       {spent * 1e6:.0f} us of CPU, {per_tick * 1e6:.2f} us a tick")
    print(f"memory             {size:.1f} MB, {size / hours:.1f} MB an hour")


if __name__ == "__main__":
    main()

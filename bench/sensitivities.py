"""Time of a motion's derivatives, in runs of the machine without them.

python -m bench.sensitivities [SCENE] [--numbers 64]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence

import numpy as np

from arm_emulator import Fleet, Plant, load_scene
from arm_emulator.analysis.sensitivities import SensitiveMachine, differentiable, numbers_of

ROUNDS = 9
SECONDS = 1.0
SHARE = 0.2  # of the largest commands


def least_of(rounds: int, *calls: Callable[[], object]) -> list[float]:
    """Return the least time of each call [s], taken in turns."""
    times = []
    for _ in range(rounds):
        for call in calls:
            began = time.perf_counter()
            call()
            times.append(time.perf_counter() - began)
    return [min(times[k :: len(calls)]) for k in range(len(calls))]


def main(arguments: Sequence[str] | None = None) -> None:
    """Compare one run, its derivatives, and the runs of a fleet for central differences."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("scene", nargs="?", default="ur5")
    parser.add_argument("--numbers", type=int, default=64)
    given = parser.parse_args(arguments)
    scene = load_scene(given.scene)
    steps, N = scene.steps_per_period, len(scene.joints)
    ticks = np.arange(round(SECONDS / scene.servo_period))[:, np.newaxis]
    rows = SHARE * scene.largest_commands * np.sin(0.02 * ticks + np.arange(N))
    names = [name for name, one in numbers_of(scene).items() if one.value != 0.0][: given.numbers]
    plant = Plant(scene)
    machine = differentiable(scene, tuple(numbers_of(scene)[name] for name in names))
    fleet = Fleet(machine, 2 * len(names))
    both = np.repeat(rows[:, np.newaxis], 2 * len(names), axis=1)

    def run() -> None:
        plant.reset()
        plant.run(rows, steps)

    def differences() -> None:
        fleet.reset()
        fleet.run(both, steps)

    few, all_of_them = SensitiveMachine(scene, names[:1]), SensitiveMachine(scene, names)
    alone, single, exact, central = least_of(
        ROUNDS, run, lambda: few.run(rows), lambda: all_of_them.run(rows), differences
    )
    cores = len(os.sched_getaffinity(0))
    print(f"{scene.name}, {SECONDS:g} s, {cores} cores")
    for what, spent in (
        ("a run", alone),
        ("with the derivatives by 1 number", single),
        (f"with the derivatives by {len(names)} numbers", exact),
        (f"{len(fleet)} runs of a fleet, for central differences", central),
    ):
        print(f"{what:50} {1e3 * spent:8.2f} ms {spent / alone:7.1f} runs")


if __name__ == "__main__":
    main()

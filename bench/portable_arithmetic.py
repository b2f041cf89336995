"""Price of equal bits: steps as they are compiled, over those of a compiler that may reorder sums.

    python -m bench.portable_arithmetic [SCENE ...] [--schemes SCHEME ...] [--repetitions 15]

Ratios of times within one run, each pair in turn, of single arms and of an arm in a fleet. The last
column shows whether both kept the same motion, and with it the same events.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from rich.console import Console
from rich.table import Table

import arm_emulator.machine.compiler as of_machines
from arm_emulator import Fleet, Plant, Scene, load_scene
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES, SCHEMES
from bench.measure import Task, interleaved, progress

SHIPPED = ("three_axis", "ur5", "panda")
ARMS = 64
START = 250  # steps before those that are timed, in which joints break away
STEPS = {True: 100, False: 600}  # in one measurement, of a fleet or of a single arm
COMMAND = 0.3  # V or A: everything moves, and nothing reaches a limit
PORTABLE, FREE = "portable", "free"
FLAGS = {
    PORTABLE: of_machines.FLAGS,
    FREE: (
        *(one for one in of_machines.FLAGS if one != "-ffp-contract=off"),
        *"-ffp-contract=fast -fassociative-math -freciprocal-math".split(),
    ),
}


def main() -> None:
    """Print a row for each scene, scheme and way of stepping."""
    parser = argparse.ArgumentParser(
        prog="bench.portable_arithmetic", description=__doc__.splitlines()[0]
    )
    parser.add_argument("scenes", nargs="*", metavar="SCENE", default=SHIPPED)
    parser.add_argument("--schemes", nargs="+", choices=SCHEMES, default=SCHEMES)
    parser.add_argument("--repetitions", type=int, default=15)
    arguments = parser.parse_args()
    cases = [
        (scene, fleet)
        for scene in _scenes(arguments.scenes, arguments.schemes)
        for fleet in (False, True)
    ]
    table = Table(title="portable over free arithmetic")
    for column in ("scene", "scheme", "", "ns per step", "ratio", "apart [rad]"):
        table.add_column(column, justify="left" if len(table.columns) < 3 else "right")
    with progress("portable arithmetic", len(cases)) as done:
        for scene, fleet in cases:
            table.add_row(*_row(scene, fleet, arguments.repetitions))
            done(f"{scene.name}, {scene.integrator.scheme}")
    Console().print(table)


def _scenes(names: list[str], schemes: list[str]) -> Iterator[Scene]:
    for name in names:
        for scheme in schemes:
            events = "located" if scheme in LOCATING_SCHEMES else "step"
            own = {"integrator.scheme": scheme, "integrator.events": events}
            yield load_scene(name, overrides=own)


def _row(scene: Scene, fleet: bool, repetitions: int) -> list[str]:
    machines = {name: _machine(scene, fleet, flags) for name, flags in FLAGS.items()}
    tasks = {name: _stepping(machine) for name, machine in machines.items()}
    timings = interleaved(tasks, repetitions)
    steps = STEPS[fleet] * (ARMS if fleet else 1)
    # Other work on the machine only adds to times.
    least = {name: timing.low / steps for name, timing in timings.items()}
    ends = [np.asarray(machine.state.q) for machine in machines.values()]
    return [
        scene.name,
        scene.integrator.scheme,
        f"fleet of {ARMS}" if fleet else "single",
        f"{least[PORTABLE] * 1e9:.1f}",
        f"{least[PORTABLE] / least[FREE]:.2f}",
        f"{np.abs(ends[0] - ends[1]).max():.1e}",
    ]


def _machine(scene: Scene, fleet: bool, flags: tuple[str, ...]) -> Plant | Fleet:
    of_machines.FLAGS = flags
    try:
        return Fleet(scene, ARMS) if fleet else Plant(scene)
    finally:
        of_machines.FLAGS = FLAGS[PORTABLE]


def _stepping(machine: Plant | Fleet) -> Task:
    joints = len(machine.scene.joints)
    fleet = isinstance(machine, Fleet)
    rows = np.full((ARMS, joints) if fleet else joints, COMMAND)

    def start(_: int) -> None:
        machine.reset()
        machine.advance(rows, START)

    return Task(lambda _: machine.advance(rows, STEPS[fleet]), start, about=1e-3)


if __name__ == "__main__":
    main()

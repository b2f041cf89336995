"""Price of equal bits: steps as compiled, over those of a compiler that may reorder sums."""

from __future__ import annotations

from typing import Any

import numpy as np

import arm_emulator.machine.plant.compiler as of_machines
from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES, SCHEMES
from arm_emulator_fleet import Fleet
from bench.measure import Task, show_progress, time_interleaved
from bench.tables import format_table

TITLE = "Portable arithmetic"

SHIPPED = ("three_axis", "ur5", "panda")
ARMS = 64
START = 250  # steps before those that are timed, in which joints break away
STEPS = {True: 100, False: 600}  # in one measurement, of a fleet or of a single arm
COMMAND = 0.3  # V or A: everything moves, and nothing reaches a limit
PORTABLE, FREE = "portable", "free"
FLAGS = {
    PORTABLE: of_machines.FLAGS,
    FREE: (
        *(flag for flag in of_machines.FLAGS if flag != "-ffp-contract=off"),
        *"-ffp-contract=fast -fassociative-math -freciprocal-math".split(),
    ),
}


def run(quick: bool) -> dict[str, Any]:
    """Measure each scheme on each shipped scene, of single arms and of an arm in a fleet."""
    names = SHIPPED[:1] if quick else SHIPPED
    rows = []
    with show_progress("portable arithmetic", 2 * len(names) * len(SCHEMES)) as done:
        for name in names:
            for scheme in SCHEMES:
                events = "located" if scheme in LOCATING_SCHEMES else "step"
                own = {"integrator.scheme": scheme, "integrator.events": events}
                for fleet in (False, True):
                    scene = load_scene(name, overrides=own)
                    rows.append(_measure_row(scene, fleet, 5 if quick else 15))
                    done(f"{name}, {scheme}")
    return {"rows": rows}


def _measure_row(scene: Scene, fleet: bool, repetitions: int) -> dict[str, Any]:
    machines = {name: _make_machine(scene, fleet, flags) for name, flags in FLAGS.items()}
    tasks = {name: _make_stepping(machine) for name, machine in machines.items()}
    timings = time_interleaved(tasks, repetitions)
    steps = STEPS[fleet] * (ARMS if fleet else 1)
    # Other work on the machine only adds to times.
    portable, free = (timings[name].low / steps for name in (PORTABLE, FREE))
    ends = [np.asarray(machine.state.q) for machine in machines.values()]
    return {
        "scene": scene.name,
        "scheme": scene.integrator.scheme,
        "fleet": fleet,
        "per_step": portable,
        "ratio": portable / free,
        "apart": float(np.abs(ends[0] - ends[1]).max()),
    }


def report(figures: dict[str, Any]) -> str:
    """Return the section in Markdown."""
    rows = (
        (row["scene"], row["scheme"], f"fleet of {ARMS}" if row["fleet"] else "single",
         f"{1e9 * row['per_step']:.1f}", f"{row['ratio']:.2f}", f"{row['apart']:.1e}")
        for row in figures["rows"]
    )  # fmt: skip
    return "\n".join([
        "Steps as they are compiled, over steps of a compiler that may reorder sums: ratios of "
        "times within one run, each pair in turn. The last column shows whether both kept the same "
        "motion, and with it the same events.",
        "",
        format_table(("scene", "scheme", "", "ns per step", "ratio", "apart [rad]"), rows),
    ])  # fmt: skip


def _make_machine(scene: Scene, fleet: bool, flags: tuple[str, ...]) -> Plant | Fleet:
    of_machines.FLAGS = flags
    try:
        return Fleet(scene, ARMS) if fleet else Plant(scene)
    finally:
        of_machines.FLAGS = FLAGS[PORTABLE]


def _make_stepping(machine: Plant | Fleet) -> Task:
    joints = len(machine.scene.joints)
    fleet = isinstance(machine, Fleet)
    rows = np.full((ARMS, joints) if fleet else joints, COMMAND)

    def start(_: int) -> None:
        machine.reset()
        machine.advance(rows, START)

    return Task(lambda _: machine.advance(rows, STEPS[fleet]), start, about=1e-3)

"""Time that varied numbers add to a step: python -m bench.varied [SCENE] [--scheme SCHEME]"""

from __future__ import annotations

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from arm_emulator import Plant, Refusal, load_scene
from arm_emulator.machine.schemes.known import SCHEMES
from bench.measure import compile_all, interleaved, progress, stepping

STEPS = 20_000  # in one measurement
REPETITIONS = 15
VOLTAGE = 3.0  # V, of changing sign from joint to joint: everything moves
NONE, ALL = "nothing", "all of these"
PATTERNS = (
    "payload.mass",
    *(f"joints.*.motor.{key}" for key in ("resistance", "torque_constant", "rotor_inertia")),
    "joints.*.gear.stiffness",
    "joints.*.gear.damping",
    "joints.*.friction.viscous",
    "joints.*.friction.coulomb",
)


def main() -> None:
    """Print ns per step for each kind of number by itself, and for all of them together."""
    parser = argparse.ArgumentParser(prog="bench.varied", description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="three_axis")
    parser.add_argument("--scheme", choices=SCHEMES, default="rosenbrock")
    parser.add_argument("--payload", type=float, default=1.0, help="kg, where the scene has none")
    arguments = parser.parse_args()
    own = {"integrator.scheme": arguments.scheme, "payload.mass": arguments.payload}
    scenes = {NONE: load_scene(arguments.scene, overrides=own)}
    for pattern in PATTERNS:
        try:
            scenes[pattern] = load_scene(arguments.scene, overrides={**own, "varied": [pattern]})
        except Refusal:
            continue  # the scene has none of that kind
    scenes[ALL] = load_scene(arguments.scene, overrides={**own, "varied": [*scenes][1:]})
    compile_all(scenes.values())
    N = len(scenes[NONE].joints)
    rows = VOLTAGE * np.resize([1.0, -1.0], N)[None]
    tasks = {name: stepping(Plant(scene), rows, STEPS) for name, scene in scenes.items()}
    with progress("varied numbers", REPETITIONS * len(tasks)) as done:
        timings = interleaved(tasks, REPETITIONS, done)
    table = Table(title=f"{arguments.scene}, {arguments.scheme}")
    for column in ("varied", "numbers", "ns per step", "over constants"):
        table.add_column(column, justify="left" if column == "varied" else "right")
    least = timings[NONE].per(STEPS).median
    for name, timing in timings.items():
        each = timing.per(STEPS).median
        count = str(len(scenes[name].varied))
        table.add_row(name, count, f"{each * 1e9:.1f}", f"{each / least:.2f}")
    Console().print(table)


if __name__ == "__main__":
    main()

"""Cost of friction that knows the direction of power: steps of ur5 with it and with `load` alone.

    python -m bench.speed.load_friction

The arm as shipped, but the friction of its large or small motors, or of its links, grows with the
load. Both laws hold and slide by the same torques: pairs of runs, and the median of their ratios.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np

from arm_emulator import Plant, load_scene
from arm_emulator.base.arrays import Array
from bench.measure import compile_all, show_progress

PAIRS = 41
STEPS, ROWS = 4, 2000  # of a servo period of 2 ms
LOAD = 0.2
NEXT_TO_NOTHING = 1e-9  # no 0, which the compiler would leave out
DIRECTED = {
    key: NEXT_TO_NOTHING
    for key in ("rest_load", "rest_back_load", "motor_load", "rest_motor_load",
                "rest_load_square", "rest_motor_square")
} | {"back_load": LOAD}  # fmt: skip
PLACES = {
    "motor.friction": {"coulomb": 0.01, "breakaway": 0.012, "stribeck": 5.0, "load": LOAD},
    "friction": {"coulomb": 3.0, "breakaway": 3.6, "stribeck": 0.05, "load": LOAD},
}


def main() -> int:
    """Print the ratios."""
    rng = np.random.default_rng(1)
    for place, simple in PLACES.items():
        controllers: dict[str, dict[str, Any]] = {
            "load": simple,
            "directed": simple | DIRECTED,
            "directed with an exponent": simple | DIRECTED | {"exponent": 2.0},
        }
        plants = {}
        for name, law in controllers.items():
            sections = {f"joints.*.{place}": law}
            plants[name] = load_scene("ur5", sections)
        compile_all(plants.values())
        rows = _draw_rows(rng, len(plants["load"].joints))
        machines = {name: Plant(scene) for name, scene in plants.items()}
        times = dict[str, list[float]]({name: [] for name in machines})
        with show_progress(place, PAIRS) as done:
            for _ in range(PAIRS):
                for name, plant in machines.items():
                    times[name].append(_measure_time(plant, rows))
                done()
        for name, own in times.items():
            ratios = np.array(own) / np.array(times["load"])
            low, median, high = np.quantile(ratios, (0.25, 0.5, 0.75))
            print(
                f"{place}: {name}: {np.median(own):.0f} ns a step, "
                f"{median:.3f} of `load` ({low:.3f} to {high:.3f})"
            )
    return 0


def _measure_time(plant: Plant, rows: Array) -> float:
    """Return the time of the processor for a step of a run [ns], what other programs take apart."""
    plant.reset()
    began = time.process_time_ns()
    plant.run(rows, STEPS)
    return (time.process_time_ns() - began) / (STEPS * len(rows))


def _draw_rows(rng: np.random.Generator, joints: int) -> Array:
    """Return currents of a motion with stops and reversals [A]."""
    t = 0.002 * np.arange(ROWS)[:, None]
    amplitude = np.array([3.0, 6.0, 4.0, 1.0, 1.0, 1.0])[:joints]
    phase = rng.uniform(0.0, 6.0, joints)
    return np.asarray(amplitude * np.sin(2.0 * np.pi * 0.8 * t + phase))


if __name__ == "__main__":
    sys.exit(main())

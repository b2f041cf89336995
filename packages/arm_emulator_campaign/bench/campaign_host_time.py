"""Cost of a run of a campaign beside its machine, step by step: draw, bind, begin, collect.

``python -m bench.campaign_host_time [--device processor] FILE ...`` prints a row
for each campaign, by default those of this file. Each number is the least time of the processor of
several repetitions; a busy machine makes it larger. The column `run` is the rest: the machine, its
samples and judges, and calls of them.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from arm_emulator_campaign.definition.campaign_file import load_campaign
from arm_emulator_campaign.results.parts import write_part
from arm_emulator_campaign.simulation.batch_simulator import BatchSimulator
from arm_emulator_campaign.simulation.bound_cases import bind_cases
from arm_emulator_campaign.simulation.case import draw_cases
from arm_emulator_campaign.simulation.outcome import Outcomes

JUDGED = {
    "requirements": {"stays_near": "always[0.05, end] abs(error.*) < 0.3"},
    "measures": {"gear_torque": "max(abs(gear_torque.*))"},
}
CAMPAIGNS: dict[str, dict[str, Any]] = {
    "three_axis with faults": {
        "scene": "three_axis",
        "scenario": {"seconds": 0.1, "targets": [{"at": 0.0, "waist": 0.3, "elbow": 1.0}]},
        "vary": {
            "payload.mass": "triangular(0, 1, 3)",
            "joints.*.friction.viscous": "nominal * lognormal(1, 0.3)",
            "joints.*.gear.stiffness": "nominal * truncated(normal(1, 0.15), 0.5, 1.5)",
            "faults.push.force.2": "normal(0, 150)",
            "faults.push.at": "uniform(0.02, 0.05)",
            "faults.drop.mass": "uniform(0, 2)",
            "faults.drop.at": "uniform(0.02, 0.08)",
        },
        "set": {"payload": 1.0},
        "faults": {
            "push": {"kind": "wrench", "at": 0.05, "lasting": 0.02, "link": "tool",
                     "force": [0, 0, 0]},
            "drop": {"kind": "payload", "at": 0.05, "mass": 1.0},
        },
    },
    "three_axis with starts and gains": {
        "scene": "three_axis",
        "scenario": {"seconds": 0.1, "start": {"waist": 0.1},
                     "targets": [{"at": 0.0, "waist": 0.3, "elbow": 1.0}]},
        "vary": {
            "scenario.start.waist": "uniform(-1, 1)",
            "controller.joints.elbow.velocity_gain": "uniform(100, 200)",
        },
    },
    "ur5": {
        "scene": "ur5",
        "scenario": {"seconds": 0.05, "targets": [{"at": 0.0, "shoulder_pan_joint": 0.1}]},
        "vary": {"joints.*.friction.viscous": "nominal * lognormal(1, 0.3)"},
    },
}  # fmt: skip
COLUMNS = ("draw", "bind", "begin", "run", "collect")


def find_least(step: Callable[[], Any], repetitions: int) -> tuple[float, Any]:
    """Return the least time of the processor that a step took [s], and its result."""
    times = []
    for _ in range(repetitions):
        began = time.process_time()
        result = step()
        times.append(time.process_time() - began)
    return min(times), result


def measure_steps(file: Path, device: str | None, count: int, repetitions: int) -> dict[str, float]:
    """Return the microseconds of each step for a run, of so many runs."""
    campaign = load_campaign(file)
    simulator = BatchSimulator(campaign, device)
    width = min(simulator.width, count)
    times = {}
    times["draw"], cases = find_least(
        lambda: draw_cases(campaign.variation, np.arange(count)), repetitions
    )
    times["bind"], bound = find_least(lambda: bind_cases(campaign, cases), repetitions)

    def begin_all() -> None:
        for first in range(0, count, width):
            simulator.begin_runs(bound, first, min(first + width, count))

    times["begin"], _ = find_least(begin_all, repetitions)
    few = cases[: max(width, count // 8)]
    share = count / len(few)
    all_of_it, outcomes = find_least(lambda: [*simulator.simulate_runs(few)], repetitions)
    times["run"] = all_of_it * share - times["bind"] - times["begin"]
    every = [*outcomes] * math.ceil(share)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "parts").mkdir()
        collect, _ = find_least(
            lambda: write_part(Path(folder), campaign, Outcomes.join_outcomes(every)), repetitions
        )
    times["collect"] = collect * share / math.ceil(share)
    return {name: 1e6 * times[name] / count for name in COLUMNS}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--device")
    parser.add_argument("--count", type=int, default=16384)
    parser.add_argument("--repetitions", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        files = {file.name: file for file in options.files}
        for name, campaign in CAMPAIGNS.items() if not files else ():
            files[name] = Path(folder) / f"{name.replace(' ', '_')}.yaml"
            files[name].write_text(yaml.safe_dump({**JUDGED, **campaign}, sort_keys=False))
        print(f"us per run{'':24}" + "".join(f"{name:>9}" for name in COLUMNS))
        for name, file in files.items():
            row = measure_steps(file, options.device, options.count, options.repetitions)
            print(f"{name:34}" + "".join(f"{row[column]:9.2f}" for column in COLUMNS))


if __name__ == "__main__":
    main()

"""Processor time of the motion controller: of periods in which a target comes, and of others.

python -m bench.new_target [SCENE ...]
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from typing import Any

import numpy as np

from arm_emulator import Pose, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.motion.controller import controller_for
from arm_emulator.motion.instructor import Instructor
from arm_emulator.motion.kinematics import moving_joints
from bench.motion import Array

TITLE = "A new target, and a period"

SCENES = "ur5", "panda"
TARGETS = 80
PERIODS = 60, 400  # to the next target: on the way there mostly, and at rest mostly
FAR = 0.1  # m to each side along each axis


def run(quick: bool, scenes: tuple[str, ...] = SCENES) -> list[dict[str, Any]]:
    """Measure each scene with and without the check for collisions, in turns."""
    return [
        {"scene": name, "collisions": how, "periods": count, **cost(name, how, count)}
        for name in scenes[: 1 if quick else None]
        for count in PERIODS[: 1 if quick else None]
        for how in ("off", "stop")
    ]


def cost(name: str, collisions: str, count: int) -> dict[str, Array]:
    """Return processor times of this thread [s] of the periods with a new target and without."""
    file = find_scene(name)
    scene = load_scene(file)
    config = dataclasses.replace(load_gains(file).motion, collisions=collisions)
    controller = controller_for(scene.urdf, moving_joints(scene.urdf), config)
    instructor, rng = Instructor(config), np.random.default_rng(0)
    q, still = np.array(scene.start), np.zeros(len(scene.joints))
    R_WT, p_WT = controller.kinematics.forward(q)
    period_ns, now_ns = round(config.period * 1e9), 0
    new, others = list[float](), list[float]()
    for target in range(TARGETS + 1):
        if target:
            instructor.add(now_ns, Pose(p_WT + rng.uniform(-FAR, FAR, 3), R_WT))
        for k in range(count):
            now_ns += period_ns
            began = time.thread_time_ns()
            instruction = instructor.instruct(controller, now_ns, q, still)
            taken = (time.thread_time_ns() - began) * 1e-9
            if target:
                (others if k else new).append(taken)
            q = instruction.q.copy()  # the servo is where it is sent
    return {"new": np.array(new), "others": np.array(others)}


def report(rows: list[dict[str, Any]]) -> str:
    """Return the table."""
    lines = [
        "Processor time of the motion controller, median and 99 %. A target comes every "
        f"{' or '.join(map(str, PERIODS))} periods.",
        "",
        "| scene | collisions | a target every | with a new target | other periods |",
        "|---|---|---|---|---|",
    ]
    for row in rows:
        new, others = (np.percentile(row[key], [50, 99]) for key in ("new", "others"))
        lines.append(
            f"| {row['scene']} | {row['collisions']} | {row['periods']} periods "
            f"| {new[0] * 1e3:.2f}, {new[1] * 1e3:.2f} ms "
            f"| {others[0] * 1e6:.0f}, {others[1] * 1e6:.0f} us |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="bench.new_target", description=TITLE)
    parser.add_argument("scenes", nargs="*", default=SCENES, help="names or files")
    print(report(run(False, tuple(parser.parse_args().scenes))))


if __name__ == "__main__":
    main()

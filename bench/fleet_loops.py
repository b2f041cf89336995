"""Loops of many arms: our servo in lanes, a policy in NumPy, an environment; one core and all."""

from __future__ import annotations

import argparse
import os
import runpy
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from arm_emulator import Fleet, FleetFrame, ServoFleet, load_gains, load_scene
from bench.motion import Array

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NAME, COUNT = "ur5", 256
PERIODS = 1000  # of a closed loop
TICKS, ENV_STEPS = 10, 20  # ticks of a step; steps of an episode, so that 5 % begin anew
ROUNDS = 5


class Motion:
    """Swings of every joint, other ones for each arm."""

    def __init__(self, start: Array) -> None:
        rng = np.random.default_rng(1)
        shape = COUNT, len(start)
        self._start, self._size = start, rng.uniform(-0.5, 0.5, shape)
        self._rate = rng.uniform(1.0, 4.0, shape)

    def at(self, t: Any) -> tuple[Array, Array]:
        """Return angles and speeds at times that broadcast with (count, N)."""
        q = self._start + self._size * (1.0 - np.cos(self._rate * t))
        return q, self._size * self._rate * np.sin(self._rate * t)


def closed_loop(workers: int) -> Callable[[], tuple[float, float]]:
    """Return a run of our servo on every arm; it returns arm-seconds per second, and of CPU."""
    scene = load_scene(NAME)
    fleet = Fleet(scene, COUNT, workers=workers)
    servos = ServoFleet(fleet, load_gains(NAME).servo)
    times = scene.servo_period * TICKS * np.arange(PERIODS // TICKS)[:, np.newaxis, np.newaxis]
    servos.aim(*Motion(scene.start).at(times), every=TICKS)
    frame = fleet.frame()

    def run() -> tuple[float, float]:
        fleet.reset()
        servos.reset()
        began, used = time.perf_counter(), time.process_time()
        fleet.follow(servos, PERIODS, out=frame)
        worth = COUNT * PERIODS * scene.servo_period
        return worth / (time.perf_counter() - began), worth / (time.process_time() - used)

    return run


def policy() -> tuple[float, float]:
    """Return arm-seconds per second of CPU beside a policy in NumPy, and its own us a period."""
    scene, servo = load_scene(NAME), load_gains(NAME).servo
    fleet = Fleet(scene, COUNT, workers=1)
    motion, joints = Motion(scene.start), servo.joints
    torque = np.array([one.torque_constant / one.gear_ratio for one in joints])
    strength = np.array([one.velocity_gain for one in joints]) / torque
    stiff = strength * np.array([one.position_gain for one in joints])
    most = np.array([one.current_limit for one in joints])
    frame: FleetFrame = fleet.step(np.zeros(len(joints)), 0)
    q_before = frame.measured.encoder_counts * fleet.link_angle_per_count
    v = np.zeros_like(q_before)
    spent = {"policy": 0.0, "arms": 0.0}
    for tick in range(PERIODS):
        began = time.process_time()
        q = frame.measured.encoder_counts * fleet.link_angle_per_count
        v = v + 0.1 * ((q - q_before) / scene.servo_period - v)
        q_before, (wanted, speed) = q, motion.at(tick * scene.servo_period)
        current = np.clip(stiff * (wanted - q) + strength * (speed - v), -most, most)
        decided = time.process_time()
        fleet.step(current, out=frame)
        spent["policy"] += decided - began
        spent["arms"] += time.process_time() - decided
    rate = COUNT * PERIODS * scene.servo_period / spent["arms"]
    return rate, 1e6 * spent["policy"] / PERIODS


def environment(file: str, **more: Any) -> float:
    """Return steps of arms per second of an example's environment."""
    env = runpy.run_path(str(EXAMPLES / file))["ReachEnv"](num_envs=COUNT, **more)
    if "last" in more:  # MuJoCo's takes one tick a step
        env.steps *= TICKS
    env.reset(seed=1)
    rng = np.random.default_rng(1)
    actions = rng.uniform(-0.2, 0.2, (ENV_STEPS, COUNT, 3)).astype(np.float32)
    rounds = 1 if "last" in more else 10
    began = time.perf_counter()
    for _ in range(rounds):
        for action in actions:
            env.step(action)
    return COUNT * rounds * ENV_STEPS / (time.perf_counter() - began)


def copies() -> float:
    """Return arm-seconds per second of as many bare processes as there are cores, together."""
    command = [sys.executable, "-m", "bench.fleet_loops", "--bare"]
    cores = len(os.sched_getaffinity(0))
    running = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(cores)]
    return sum(float(one.communicate()[0]) for one in running)


def report() -> str:
    """Measure, and return lines of Markdown."""
    loops = {"one core": closed_loop(1), "all cores": closed_loop(len(os.sched_getaffinity(0)))}
    rates: dict[str, list[float]] = {name: [] for name in (*loops, "bare copies")}
    for _ in range(ROUNDS):
        for name, loop in loops.items():
            rate, of_cpu = loop()
            rates[name].append(rate)
            rates.setdefault(f"{name}, CPU", []).append(of_cpu)
        rates["bare copies"].append(copies())
    one = rates["one core"]
    gains = {
        name: median(many / alone for many, alone in zip(rates[name], one, strict=True))
        for name in ("all cores", "bare copies")
    }
    of_policy = [policy() for _ in range(ROUNDS)]
    ours = [environment("vector_env.py", seconds=0.2, ticks=TICKS) for _ in range(ROUNDS)]
    theirs = [environment("vector_env_mujoco.py", last=ENV_STEPS) for _ in range(ROUNDS)]
    return "\n".join(
        [
            f"| {COUNT} arms | |",
            "|---|---|",
            f"| our servo on {NAME} as shipped, one core | {median(rates['one core, CPU']):.0f} "
            "arm-seconds/s of CPU |",
            f"| the same on all cores | {gains['all cores']:.2f} times as many |",
            f"| as many bare copies in the same minute | {gains['bare copies']:.2f} times |",
            f"| {NAME}, policy in NumPy, one core | {median(r for r, _ in of_policy):.0f} "
            f"arm-seconds/s of CPU beside the policy's {median(p for _, p in of_policy):.0f} us |",
            f"| environment, three_axis, {TICKS} ticks a step | {median(ours):.3g} steps/s |",
            f"| the same by MuJoCo's rollout | {median(theirs):.3g} steps/s |",
        ]
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="bench.fleet_loops", description=__doc__)
    parser.add_argument("--bare", action="store_true", help="print one process's rate alone")
    if parser.parse_args().bare:
        loop = closed_loop(1)
        print(median(loop()[0] for _ in range(3)))
    else:
        print(report())


if __name__ == "__main__":
    main()

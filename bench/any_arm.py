"""Any serial arm, from its robot description alone: does it go where it is sent?

    python -m bench.any_arm [ROBOT ...] [--moves 100] [--out out/any_arm]

For every arm a scene is made by `arm_emulator new`; the whole machine, servo and motion controller
are then sent on random moves of 50 and 300 mm (less for small arms) between poses within the
joint limits. A move counts as arrived if the true tool rests where `predicted_residual` says.
Without names: every robot of example-robot-data with an arm, and those of bench/own_robots.py.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf_text import UNLIMITED
from arm_emulator.cli.new import write_new
from arm_emulator.machine.chain import Array
from arm_emulator.machine.plant import Diverged
from arm_emulator.machine.scene import Scene, example_robot_data, load_scene
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.predicted_residual import predicted_residual
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.offline import OfflineRun
from bench.measure import progress
from bench.own_robots import OWN

DISTANCES = (0.05, 0.3)  # m, for arms that reach `FULL_REACH`; smaller ones go as much less
FULL_REACH = 0.8  # m
SETTLE = 1.0  # s of logical time before the target comes
PATIENCE = 12.0  # s of logical time for a move
LOOK = 0.1  # s between two looks at whether the tool rests within the prediction
RESTS = 3  # looks in a row
NEAREST_SINGULAR = 0.05  # singular value; poses nearer are no fair target for a prediction
# Folders of example-robot-data whose robots walk, fly or are hands.
NO_ARMS = (
    *("a1", "alexander", "allegro", "anymal", "b1_", "bolt", "borinot", "cassie", "finger", "g1"),
    *("go1", "go2", "hector", "hextilt", "human", "hyq", "iris", "laikago", "quadruped", "solo"),
)


@dataclass
class Outcome:
    """What became of one arm."""

    name: str
    joints: int = 0
    arrived: dict[str, int] = field(default_factory=dict)
    """Moves that arrived, by the distance."""
    moves: dict[str, int] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    """Logical time to arrival."""
    peak_speed: float = 0.0
    """Largest link speed over the joint's limit."""
    failures: list[str] = field(default_factory=list)
    refused: str = ""


def arms() -> dict[str, Path | str]:
    """Return all arms by name: the file of a description, or the name of one of ours."""
    found: dict[str, Path | str] = {f"own: {name}": name for name in OWN}
    shipped = example_robot_data()
    for file in sorted(shipped.rglob("*.urdf")) if shipped is not None else ():
        if not file.parts[len(shipped.parts)].startswith(NO_ARMS):
            found[file.stem] = file
    return found


def examine(name: str, robot: Path | str, count: int) -> Outcome:
    """Make a scene of an arm and send it on moves."""
    outcome = Outcome(name)
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(robot, str):
            file = Path(folder) / f"{robot}.urdf"
            file.write_text(OWN[robot](), encoding="utf-8")
        else:
            file = robot
        try:
            written = write_new(file, Path(folder) / "new")
            scene, gains = load_scene(written.file), load_gains(written.file)
        except Refusal as refusal:
            outcome.refused = str(refusal)
            return outcome
        limits = np.array([drive.speed for drive in written.drives])
        outcome.joints = len(scene.joints)
        kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
        rng = np.random.default_rng(0)
        for distance in DISTANCES:
            length = distance * min(1.0, kinematics.reach / FULL_REACH)
            key = f"{distance * 1e3:g} mm"
            for k in range(count):
                pair = reachable(kinematics, length, rng)
                if pair is None:
                    continue
                outcome.moves[key] = outcome.moves.get(key, 0) + 1
                words, seconds, peak = move(scene, gains, *pair, limits)
                outcome.peak_speed = max(outcome.peak_speed, peak)
                if words:
                    outcome.failures.append(f"{key} #{k}: {words}")
                else:
                    outcome.arrived[key] = outcome.arrived.get(key, 0) + 1
                    outcome.seconds.append(seconds)
    return outcome


def reachable(
    kinematics: Kinematics, length: float, rng: np.random.Generator
) -> tuple[Array, Array] | None:
    """Draw two poses within the limits between which the tool moves by `length` [m].

    Both lie away from singular poses, and so does what is between them in joint space.
    None: none was found, as where the arm is too small for such a move.
    """
    low, high = np.maximum(kinematics.lower, -np.pi), np.minimum(kinematics.upper, np.pi)
    low, high = np.minimum(low, high), np.maximum(low, high)
    slide = kinematics.upper >= UNLIMITED
    low, high = np.where(slide, -1.0, low), np.where(slide, 1.0, high)
    high = np.maximum(high, low + 1e-6)  # a joint may have a range of nothing
    for _ in range(2000):
        q = low + (high - low) * (0.05 + 0.9 * rng.random(len(low)))
        way = rng.normal(size=len(low)) * (high - low)
        start = kinematics.forward(q)[1]
        ahead = 0.0
        for part in np.linspace(0.0, 0.5, 101)[1:]:
            at = q + part * way / np.abs(way / (high - low)).max()
            inside = (at > low + 0.02 * (high - low)) & (at < high - 0.02 * (high - low))
            if not inside.all() or kinematics.singular_values(at)[-1] < NEAREST_SINGULAR:
                break
            ahead = float(np.linalg.norm(kinematics.forward(at)[1] - start))
            if ahead >= length:
                return q, at
    return None


def move(
    scene: Scene, gains: Any, q: Array, goal: Array, limits: Array
) -> tuple[str, float, float]:
    """Send the arm from one pose to another.

    Returns:
        Why it did not arrive, empty if it did; logical time to arrival [s]; peak speed over limit.
    """
    joints = tuple(
        dataclasses.replace(joint, start=float(angle))
        for joint, angle in zip(scene.joints, q, strict=True)
    )
    run = OfflineRun(dataclasses.replace(scene, joints=joints), gains.servo, gains.motion)
    kinematics = run.controller.kinematics
    R_WT, p_WT = kinematics.forward(goal)
    target = Pose(p_WT, R_WT)
    settle_ns = round(SETTLE / gains.motion.period) * round(gains.motion.period * 1e9)
    run.instructor.add(settle_ns, target)
    counts = gains.servo.count_angles(scene.joint_names)
    ticks = round(0.01 / scene.servo_period)
    look, peak, rested = round(LOOK / 0.01), 0.0, 0
    words = ""
    try:
        run.advance(round(settle_ns * 1e-9 / scene.servo_period))
        for step in range(1, round(PATIENCE / 0.01) + 1):
            run.advance(ticks)
            state = run.session.state
            peak = max(peak, float((np.abs(state.v) / limits).max()))
            if step % look:
                continue
            error = kinematics.tool_error(state.q, target)
            wind_up = scene.wind_up(state.gear_torque)
            predicted = predicted_residual(run.controller, state.q, counts, wind_up)
            off = np.abs(error - predicted.wind_up) - predicted.encoder
            rested = rested + 1 if (off <= 0.0).all() else 0
            words = f"off by {np.abs(error[:3]).max() * 1e3:.3g} mm, " + "; ".join(
                run.controller.notices
            )
            if rested == RESTS:
                return "", (step - look * (RESTS - 1)) * 0.01, peak
    except (Diverged, Refusal) as fault:
        words = str(fault).splitlines()[0]
    return words, PATIENCE, peak


def main() -> None:
    """Print a row per arm; exit code 1 if fewer than 99 % of all moves arrived."""
    parser = argparse.ArgumentParser(prog="bench.any_arm", description=__doc__.splitlines()[0])
    parser.add_argument("robots", nargs="*", help="names, or parts of them, or files")
    parser.add_argument("--moves", type=int, default=100, help="of each distance")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=Path("out/any_arm"))
    arguments = parser.parse_args()
    chosen = arms()
    if arguments.robots:
        files = {Path(one).stem: Path(one) for one in arguments.robots if Path(one).is_file()}
        named = [one for one in arguments.robots if not Path(one).is_file()]
        chosen = files | {n: r for n, r in chosen.items() if any(one in n for one in named)}
    console = Console(highlight=False)
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(arguments.jobs) as pool, progress("arms", len(chosen)) as tick:
        began = time.monotonic()
        jobs = [pool.submit(examine, n, r, arguments.moves) for n, r in chosen.items()]
        for job in as_completed(jobs):
            outcomes.append(job.result())
            tick(outcomes[-1].name)
    outcomes.sort(key=lambda one: one.name)
    _tell(console, outcomes)
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "any_arm.json"
    file.write_text(json.dumps([asdict(one) for one in outcomes], indent=1), encoding="utf-8")
    console.print(f"{time.monotonic() - began:.0f} s, all failures are in {file}")
    arrived = sum(sum(one.arrived.values()) for one in outcomes)
    moves = sum(sum(one.moves.values()) for one in outcomes)
    console.print(f"{arrived} of {moves} moves arrived within the predicted residual")
    sys.exit(arrived < 0.99 * moves)


def _tell(console: Console, outcomes: list[Outcome]) -> None:
    table = Table(box=None, pad_edge=False)
    for column in ("arm", "joints", "50 mm", "300 mm", "median s", "worst s", "speed / limit"):
        table.add_column(column, justify="left" if column == "arm" else "right")
    for one in outcomes:
        if one.refused:
            continue
        cells = [
            f"{one.arrived.get(key, 0)}/{one.moves.get(key, 0)}" for key in ("50 mm", "300 mm")
        ]
        times = sorted(one.seconds) or [float("nan")]
        table.add_row(
            one.name,
            str(one.joints),
            *cells,
            f"{times[len(times) // 2]:.2f}",
            f"{times[-1]:.2f}",
            f"{one.peak_speed:.2f}",
        )
    console.print(table)
    for one in outcomes:
        for words in (one.refused, *one.failures):
            if words:
                console.print(f"{one.name}: {words}", markup=False)


if __name__ == "__main__":
    main()

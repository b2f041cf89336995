"""Any serial arm, from its robot description alone: does it go where it is sent?

For every arm a scene is made by `arm_emulator new`; the whole machine, servo and motion controller
are then sent on random moves of 50 and 300 mm (less for small arms) between poses within the
joint limits. A move counts as arrived if the true tool rests where `predicted_residual` predicts.
Without names: every robot of example-robot-data with an arm, and those of oracles/own_robots.py.
"""

from __future__ import annotations

import dataclasses
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf_text import UNLIMITED
from arm_emulator.cli.new import write_new
from arm_emulator.machine.chain import Array
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.scene import Scene, example_robot_data, load_scene
from arm_emulator.motion.kinematics import Kinematics
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.predicted_residual import predicted_residual
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.offline import OfflineRun
from oracles.own_robots import OWN

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
    """Result of one arm."""

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
        if shipped and not file.relative_to(shipped).parts[0].startswith(NO_ARMS):
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
            wind_up = scene.wind_up(state.gear_torque) - run.wound
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

"""Any serial arm, from its robot description alone: does it go where it is sent, and how?

For every arm `arm_emulator new` makes a scene. The whole machine, servo and motion controller then
make random moves of 50 and 300 mm (less for small arms) between poses within the joint limits. A
move counts as arrived if the true tool rests where `predict_residual` states. The motion of the
true tool is judged, too: how far it goes past its place of rest, and how far it is from the
straight line. The links' speeds, accelerations and torques are judged with it.
Without names: every robot of example-robot-data with an arm, and those of oracles/own_robots.py.
"""

from __future__ import annotations

import dataclasses
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from arm_emulator import (
    Diverged,
    Kinematics,
    OfflineRun,
    Pose,
    Refusal,
    Scene,
    load_gains,
    load_scene,
)
from arm_emulator.base.arrays import Array
from arm_emulator.base.urdf.urdf_text import UNLIMITED
from arm_emulator.design.new_scene import NewScene, write_new
from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.executor.goal_status import GoalState
from arm_emulator.runs.gains import Gains
from oracles.own_robots import OWN
from oracles.predicted_residual import predict_residual

DISTANCES = (0.05, 0.3)  # m, for arms that reach `FULL_REACH`; smaller ones go as much less
DISTANCES_NAMED = [f"{distance * 1e3:g} mm" for distance in DISTANCES]
FULL_REACH = 0.8  # m
SETTLE = 0.6  # s of logical time before the target comes
PATIENCE = 12.0  # s of logical time for a move
SAMPLE = 0.005  # s between samples of the way
LOOK = 0.1  # s between two looks at whether the tool rests within the prediction
RESTS = 3  # looks in a row
NEAREST_SINGULAR = 0.05  # singular value; poses nearer are no fair target for a prediction
# Folders of example-robot-data whose robots walk, fly or are hands.
NO_ARMS = (
    *("a1", "alexander", "allegro", "anymal", "b1_", "bolt", "borinot", "cassie", "finger", "g1"),
    *("go1", "go2", "hector", "hextilt", "human", "hyq", "iris", "laikago", "quadruped", "solo"),
)


@dataclass
class ToolMove:
    """Outcome of one move, judged over its whole length."""

    distance: str
    """Distance of the moves, the same for all arms; small arms move less in proportion."""
    length: float
    """From where the true tool began to where it rested [m]."""
    words: str = ""
    """Why it did not arrive; empty: it did."""
    seconds: float = 0.0
    """Logical time to arrival."""
    past: float = 0.0
    """Overshoot of the true tool along its line past its final position [m]."""
    aside: float = 0.0
    """Largest distance of the true tool from the line to there [m]."""
    peak_speed: float = 0.0
    """Largest link speed over the joint's limit."""
    peak_acceleration: float = 0.0
    """Largest link acceleration over the joint's limit, over a sample."""
    peak_torque: float = 0.0
    """Largest torque of a gear over the joint's limit."""
    way: str = ""
    """Reason of its way, as published by the motion controller."""

    @property
    def is_straight(self) -> bool:
        """Whether the motion controller announced a straight line."""
        return "tool's line" in self.way

    @property
    def is_off_line(self) -> bool:
        """Whether it left a line that was announced by more than 1 mm and 1 % of its length."""
        return self.is_straight and self.aside > max(1e-3, 1e-2 * self.length)

    @property
    def has_overshot(self) -> bool:
        """Whether it went past its rest by more than 1 mm and 0.5 % of its length."""
        return self.past > max(1e-3, 5e-3 * self.length)


@dataclass
class ArmOutcome:
    """Result of one arm."""

    name: str
    joints: int = 0
    moves: list[ToolMove] = field(default_factory=list)
    refused: str = ""

    def select_moves(self, distance: str) -> list[ToolMove]:
        """Return the moves of one distance."""
        return [tool_move for tool_move in self.moves if tool_move.distance == distance]

    @property
    def arrived(self) -> list[ToolMove]:
        """The moves that arrived."""
        return [tool_move for tool_move in self.moves if not tool_move.words]


def list_arms() -> dict[str, Path | str]:
    """Return all arms by name: the file of a description, or the name of one of ours."""
    robots: dict[str, Path | str] = {f"own: {name}": name for name in OWN}
    shipped = find_example_robot_data()
    for file in sorted(shipped.rglob("*.urdf")) if shipped is not None else ():
        if shipped and not file.relative_to(shipped).parts[0].startswith(NO_ARMS):
            robots[file.stem] = file
    return robots


def examine_arm(name: str, robot: Path | str, count: int) -> ArmOutcome:
    """Make a scene of an arm and send it on moves."""
    outcome = ArmOutcome(name)
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(robot, str):
            file = Path(folder) / f"{robot}.urdf"
            file.write_text(OWN[robot](), encoding="utf-8")
        else:
            file = robot
        try:
            written = make_arm_scene(file, Path(folder) / "new")
            scene, gains = load_scene(written.file), load_gains(written.file)
        except Refusal as refusal:
            outcome.refused = str(refusal)
            return outcome
        outcome.joints = len(scene.joints)
        kinematics = Kinematics(scene.urdf, scene.joint_names, scene.tool)
        rng = np.random.default_rng(0)
        for distance, key in zip(DISTANCES, DISTANCES_NAMED, strict=True):
            length = distance * min(1.0, kinematics.reach / FULL_REACH)
            for _ in range(count):
                pair = draw_reachable(kinematics, length, rng)
                if pair is not None:
                    outcome.moves.append(move_arm(scene, gains, key, *pair))
    return outcome


def make_arm_scene(file: Path, folder: Path) -> NewScene:
    """Make a scene of an arm; some robots of example-robot-data have impossible inertias."""
    try:
        return write_new(file, folder)
    except Refusal as refusal:
        if not refusal.quantity.startswith("inertia of link"):
            raise
        return write_new(file, folder, replace_inertias=True)


def draw_reachable(
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
        direction = rng.normal(size=len(low)) * (high - low)
        start = kinematics.forward(q)[1]
        ahead = 0.0
        for part in np.linspace(0.0, 0.5, 101)[1:]:
            at = q + part * direction / np.abs(direction / (high - low)).max()
            inside = (at > low + 0.02 * (high - low)) & (at < high - 0.02 * (high - low))
            if not inside.all() or kinematics.singular_values(at)[-1] < NEAREST_SINGULAR:
                break
            ahead = float(np.linalg.norm(kinematics.forward(at)[1] - start))
            if ahead >= length:
                return q, at
    return None


def move_arm(scene: Scene, gains: Gains, distance: str, q: Array, goal: Array) -> ToolMove:
    """Send the arm from one pose to another, and watch it all the way.

    The poses are drawn without regard to the arm's own parts, so it may run into itself.
    """
    motion = dataclasses.replace(gains.motion, collisions="off")
    gains = dataclasses.replace(gains, motion=motion)
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
    ticks = max(1, round(SAMPLE / scene.servo_period))
    sample = ticks * scene.servo_period
    look, rested = max(1, round(LOOK / sample)), 0
    tool_path, speeds, torques = list[Array](), list[Array](), list[Array]()
    words, seconds = "", PATIENCE
    try:
        run.advance(round(settle_ns * 1e-9 / scene.servo_period))
        for step in range(round(PATIENCE / sample) + 1):
            state = run.session.state
            tool_path.append(kinematics.forward(state.q)[1])
            speeds.append(state.v.copy())
            torques.append(state.gear_torque.copy())
            if step and step % look == 0:
                error = kinematics.tool_error(state.q, target)
                wind_up = scene.wind_up(state.gear_torque) - run.wind_up
                predicted = predict_residual(run.controller, state.q, counts, wind_up)
                off = np.abs(error - predicted.wind_up) - predicted.encoder
                rested = rested + 1 if (off <= 0.0).all() else 0
                words = f"off by {np.abs(error[:3]).max() * 1e3:.3g} mm, " + "; ".join(
                    run.controller.notices
                )
                if rested == RESTS:
                    words, seconds = "", (step - look * (RESTS - 1)) * sample
                    break
            run.advance(ticks)
    except (Diverged, Refusal) as fault:
        words = str(fault).splitlines()[0]
    reasons = [r.reason for r in run.instructor.reports.waiting if r.state is GoalState.MOVING]
    tool_move = ToolMove(distance, 0.0, words, seconds, way="; ".join(reasons))
    tool_move.peak_speed = _find_largest(np.array(speeds), kinematics.velocity_limit)
    accelerations = np.diff(speeds, axis=0) / sample
    tool_move.peak_acceleration = _find_largest(accelerations, kinematics.acceleration_limit)
    tool_move.peak_torque = _find_largest(np.array(torques), kinematics.effort_limit)
    tool_move.length, tool_move.past, tool_move.aside = measure_along_line(np.array(tool_path))
    return tool_move


def _find_largest(rows: Array, limits: Array) -> float:
    """Return the largest of rows (K, N) over limits (N,)."""
    return float((np.abs(rows) / limits).max(initial=0.0))


def measure_along_line(tool_path: Array) -> tuple[float, float, float]:
    """Return a line's length, overshoot and lateral distance [m] of a way with points (K, 3).

    The line goes from the first to the last point of the way.
    """
    line = tool_path[-1] - tool_path[0]
    length = float(np.linalg.norm(line))
    along = (tool_path - tool_path[0]) @ line / max(length, 1e-12)
    aside = tool_path - tool_path[0] - np.outer(along, line / max(length, 1e-12))
    return length, float(along.max() - length), float(np.linalg.norm(aside, axis=1).max())

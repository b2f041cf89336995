"""Pictures of each kind of move of ur5 through the whole machine: way, speeds, distance.

The distance is that of the true tool from the reference at the same moment.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import OfflineRun, Pose, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.motion.instruction import Instruction
from arm_emulator.motion.jog import twist_command
from arm_emulator.motion.joint_trajectory import TrajectoryPoint
from arm_emulator.motion.obstacles import Obstacle
from arm_emulator.motion.reference import Reference
from bench.motion import Array
from bench.pictures import new_figure

TABLE = 0.1  # m below the tool's start
SETTLE = 500  # servo periods

Ask = Callable[["Drawn", float], None]


class Drawn:
    """A run of ur5, a table below its tool, and what its true tool does."""

    def __init__(self) -> None:
        file = find_scene("ur5")
        scene, gains = load_scene(file), load_gains(file)
        start = OfflineRun(scene, gains.servo, gains.motion).controller.kinematics
        self.home = Pose(*reversed(start.forward(scene.start)))
        x, y, z = self.home.p_WT.tolist()
        table = Obstacle("table", size=(0.3, 0.8, 0.05), at=(x, y, z - TABLE - 0.025))
        motion = dataclasses.replace(
            gains.motion, obstacles=(table,), jog_command_in_type="speed_units"
        )
        self.run, self.motion = OfflineRun(scene, gains.servo, motion), motion
        self.start = scene.start
        self.run.advance(SETTLE)

    def at(self, x: float, y: float, z: float) -> Pose:
        """Return the pose so far from the start [m]."""
        return Pose(self.home.p_WT + np.array([x, y, z]), self.home.R_WT)

    def go(self, ask: Ask, seconds: float) -> tuple[Array, Array, Array, Array]:
        """Return times, true tools (K, 3), speeds over limits (K, N) and distances (K,) [mm]."""
        rows = []
        run, kinematics = self.run, self.run.controller.kinematics
        newest: list[Reference] = []
        instruct = run.instructor.instruct

        def kept(*given: Any) -> Instruction:
            answer = instruct(*given)
            newest[:] = [answer.now or Reference.at_rest(answer.q - run.instructor.wound)]
            return answer

        run.instructor.instruct = kept  # type: ignore[method-assign, assignment]
        for k in range(round(seconds / self.motion.period)):
            ask(self, k * self.motion.period)
            state = run.session.state
            run.advance(1)  # the reference is that of the moment before
            tool = kinematics.forward(state.q)[1]
            off = np.linalg.norm(tool - kinematics.forward(newest[0].q)[1])
            rows.append((tool - self.home.p_WT, np.abs(state.v) / kinematics.velocity_limit, off))
            run.advance(run.motion_ticks - 1)
        times = self.motion.period * np.arange(len(rows), dtype=np.float64)
        tools, speeds, offs = (np.array(column) for column in zip(*rows, strict=True))
        return np.asarray(times), np.asarray(tools), np.asarray(speeds), np.asarray(1e3 * offs)


def target(one: Drawn, time: float) -> None:
    """A tool target."""
    if time == 0.0:
        one.run.instructor.add(0, one.at(0.0, 0.3, 0.1))


def trajectory(one: Drawn, time: float) -> None:
    """A joint trajectory through three points."""
    if time == 0.0:
        way = np.array([0.5, -0.3, 0.4, -0.1, 0.2, 0.3])
        points = [
            TrajectoryPoint(
                round(part * 1.5e9), list(one.start + part * way), list(way / 1.5 * (part == 0.5))
            )
            for part in (0.0, 0.5, 1.0)
        ]
        names = one.run.controller.kinematics.joint_names
        one.run.instructor.add_trajectory(one.run.controller, names, points)


def tool_path(one: Drawn, time: float) -> None:
    """A tool path around a corner."""
    if time == 0.0:
        poses = [one.at(0.0, y, z) for y, z in ((0.0, 0.0), (0.2, 0.0), (0.2, 0.15))]
        one.run.instructor.add_path(one.run.controller, poses)


def jog(one: Drawn, time: float) -> None:
    """A jog, sidewards and then up, until no command comes."""
    if time < 1.5:
        twist = [0.0, 0.2, 0.0, 0.0, 0.0, 0.0] if time < 0.8 else [0.0, 0.0, 0.15, 0.0, 0.0, 0.0]
        now = one.run.session.logical_ns
        kinematics = one.run.controller.kinematics
        one.run.instructor.jog(twist_command(now, twist, "", kinematics, one.motion))


def stream(one: Drawn, time: float) -> None:
    """A stream of targets on a circle at 0.3 m/s."""
    turn = 3.0 * time
    if time < 2.0:
        pose = one.at(0.1 * np.cos(turn) - 0.1, 0.1 * np.sin(turn), 0.0)
        one.run.instructor.add(0, pose)


def collision(one: Drawn, time: float) -> None:
    """A jog to the table, which halts before it."""
    if time < 2.0:
        now, down = one.run.session.logical_ns, [0.0, 0.1, -0.2, 0.0, 0.0, 0.0]
        kinematics = one.run.controller.kinematics
        one.run.instructor.jog(twist_command(now, down, "", kinematics, one.motion))


KINDS: dict[str, tuple[Ask, float, int]] = {
    "target": (target, 1.5, 2),
    "trajectory": (trajectory, 2.0, 2),
    "tool path": (tool_path, 2.5, 2),
    "jog": (jog, 2.2, 2),
    "stream": (stream, 2.5, 0),
    "collision": (collision, 2.2, 2),
}


def picture(folder: Path) -> Path:
    """Draw all kinds: where the tool goes, link speeds over limits, distance from the reference."""
    figure = new_figure(15.0, 7.0)
    axes = figure.subplots(3, len(KINDS))
    for column, (kind, (ask, seconds, side)) in enumerate(KINDS.items()):
        t, tool, speeds, off = Drawn().go(ask, seconds)
        way, over, beside = axes[:, column]
        way.plot(tool[:, 1], tool[:, side], lw=1.2)
        way.plot(*tool[0, [1, side]], "o", ms=4)
        if kind == "collision":
            way.axhline(-TABLE, color="k", lw=1.5)
            way.text(-0.03, -TABLE, "table", va="bottom")
        way.set_title(kind)
        way.set_xlabel("y [m]")
        way.axis("equal")
        over.plot(t, speeds, lw=0.8)
        over.axhline(1.0, color="k", lw=0.8)
        over.set_ylim(0.0, 1.05)
        beside.plot(t, off, lw=0.8)
        beside.set_ylim(0.0, 0.5)
        beside.set_xlabel("t [s]")
        way.set_ylabel("z [m]" if side else "x [m]")
    joints = [f"joint {k}" for k in range(1, speeds.shape[1] + 1)]
    axes[1, 1].legend(joints, fontsize=6, ncols=2, loc="upper right", bbox_to_anchor=(1.0, 0.97))
    axes[1, 0].set_ylabel("link speed / limit")
    axes[2, 0].set_ylabel("off the reference [mm]")
    file = folder / "kinds_of_moves.png"
    figure.savefig(file, dpi=100)
    return file

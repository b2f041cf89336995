"""The joints along a line of the tool, or why no such way exists."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from arm_emulator.motion.arm_tree import ArmTree
from arm_emulator.motion.joint_curve import JointCurve
from arm_emulator.motion.pose import Pose
from arm_emulator.motion.poses import Poses, along_a_line

FloatArray = npt.NDArray[np.float64]

NODES = (32, 128, 512)  # of the spline; more where it leaves the line between them
OFF_THE_LINE = 1e-5  # rad, or m per reach: between nodes


def joints_along(
    arm: ArmTree,
    start: FloatArray,
    begin: Pose,
    end: Pose,
    goal: FloatArray | None,
    turns: bool = True,
    other_way: bool = False,
) -> JointCurve | str:
    """Return the joints' curve along a line of the tool, or why no such curve exists.

    Args:
        arm: the arm.
        start: its joints at the begin (N,).
        begin: pose of the tool there.
        end: pose of the tool at the end.
        goal: angles of the joints at the end (N,); None: those that the line reaches.
        turns: whether the tool turns evenly; else it turns as the joints go to the goal.
        other_way: whether it turns the other way round, by more than half a turn.
    """
    why = ""
    for nodes in NODES:
        halves = np.arange(1, 2 * nodes + 1) / (2 * nodes)  # and nodes, in turns
        every = along_a_line(begin, end, halves, other_way)
        poses, wanted = every[1::2], every[::2]
        q = arm.trace(start, poses.p, poses.R, goal, turns)
        if len(q) <= nodes:
            why = f"the arm cannot follow it at {(len(q) - 1) / nodes:.0%} of its length"
            if nodes < NODES[-1] and len(q) > 1:
                continue  # a finer one may pass where the arm moves fast
            return why
        curve = JointCurve.spline(q)
        beyond = curve.leaves(arm.kinematics.lower, arm.kinematics.upper)
        if beyond is not None:
            name = arm.kinematics.joint_names[beyond[1]]
            return f"{name} would leave its limits at {beyond[0]:.0%} of its length"
        between = halves[::2]
        off = errors(arm, curve.derivatives(between)[0], wanted, turns)
        if float(off.max()) <= OFF_THE_LINE:
            return curve
        why = f"the joints would jump at {between[int(np.argmax(off))]:.0%} of its length"
    return why


def errors(arm: ArmTree, q: FloatArray, wanted: Poses, turns: bool = True) -> FloatArray:
    """Return the tool's distances from poses at joint angles (K, N), scaled, (K,) [rad]."""
    kinematics = arm.kinematics
    p, R = arm.forward(q)
    off: FloatArray = _length(p - wanted.p) / kinematics.reach
    if turns and kinematics.turns_tool:
        # |R - 1| is 2 sqrt(2) sin(angle / 2).
        off += _length((R - wanted.R).reshape(-1, 9)) / np.sqrt(2.0)
    return off


def _length(rows: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", rows, rows)))

"""The joints along a line of the tool, or why no such way exists."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.arm_tree import ArmTree
from arm_emulator.motion.model.pose import Pose
from arm_emulator.motion.trajectory.joint_curve import JointCurve

NODES = (32, 128, 512)  # of the spline; more where it leaves the line between them
OFF_THE_LINE = 1e-5  # rad, or m per reach: between nodes


def trace_line(
    arm: ArmTree,
    start: Array,
    begin: Pose,
    end: Pose,
    goal: Array | None,
    rotates_evenly: bool = True,
    long_rotation: bool = False,
) -> JointCurve | str:
    """Return the joints' curve along a line of the tool, or why no such curve exists.

    Args:
        arm: the arm.
        start: its joints at the begin (N,).
        begin: pose of the tool there.
        end: pose of the tool at the end.
        goal: angles of the joints at the end (N,); None: those that the line reaches.
        rotates_evenly: whether the tool turns evenly; else it turns as the joints go to the goal.
        long_rotation: whether it turns the other way round, by more than half a turn.
    """
    why = ""
    for nodes in NODES:
        halves = np.arange(1, 2 * nodes + 1) / (2 * nodes)  # and nodes, in turns
        every = sample_line(begin, end, halves, long_rotation)
        poses, expected = every[1::2], every[::2]
        q = arm.trace_poses(start, poses.p, poses.R, goal, rotates_evenly)
        if len(q) <= nodes:
            why = f"the arm cannot follow it at {(len(q) - 1) / nodes:.0%} of its length"
            if nodes < NODES[-1] and len(q) > 1:
                continue  # a finer one may pass where the arm moves fast
            return why
        curve = JointCurve.fit_spline(q)
        beyond = curve.find_exit(arm.kinematics.lower, arm.kinematics.upper)
        if beyond is not None:
            name = arm.kinematics.joint_names[beyond[1]]
            return f"{name} would leave its limits at {beyond[0]:.0%} of its length"
        between = halves[::2]
        off = measure_errors(arm, curve.compute_derivatives(between)[0], expected, rotates_evenly)
        if float(off.max()) <= OFF_THE_LINE:
            return curve
        why = f"the joints would jump at {between[int(np.argmax(off))]:.0%} of its length"
    return why


def measure_errors(arm: ArmTree, q: Array, expected: Poses, rotates_evenly: bool = True) -> Array:
    """Return the tool's distances from poses at joint angles (K, N), scaled, (K,) [rad]."""
    kinematics = arm.kinematics
    p, R = arm.compute_tool_poses(q)
    off: Array = _measure_rows(p - expected.p) / kinematics.reach
    if rotates_evenly and kinematics.has_orientation:
        # |R - 1| is 2 sqrt(2) sin(angle / 2).
        off += _measure_rows((R - expected.R).reshape(-1, 9)) / np.sqrt(2.0)
    return off


def _measure_rows(rows: Array) -> Array:
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", rows, rows)))


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a tool in a row."""

    p: Array
    """(K, 3) [m]."""
    R: Array
    """(K, 3, 3)."""

    def __getitem__(self, places: slice) -> Poses:
        """Return some of them."""
        return Poses(self.p[places], self.R[places])


def sample_line(begin: Pose, end: Pose, parts: Array, long_rotation: bool = False) -> Poses:
    """Return poses at shares (K,) of a straight way that turns evenly about one axis.

    Half a turn at most, or the other way round: what is left of a whole one.
    """
    p = begin.p_WT + parts[:, None] * (end.p_WT - begin.p_WT)
    turn = pin.log3(end.R_WT @ begin.R_WT.T)
    angle = math.hypot(*turn)
    axis = pin.skew(turn / angle if angle > 0.0 else turn)
    if long_rotation:
        angle -= 2.0 * math.pi
    once, angles = axis @ begin.R_WT, parts[:, None, None] * angle
    twice = axis @ once
    return Poses(p, begin.R_WT + np.sin(angles) * once + 2.0 * np.sin(0.5 * angles) ** 2 * twice)


def compute_rotations(vectors: Array) -> Array:
    """Return the rotation matrices of rotation vectors (K, 3), (K, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    none = np.zeros_like(x)
    K = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=1).reshape(-1, 3, 3)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.where(angle > 1e-6, np.sin(angle) / angle, 1.0)
        second = np.where(angle > 1e-6, 2.0 * (np.sin(0.5 * angle) / angle) ** 2, 0.5)
    return np.asarray(np.eye(3) + first * K + second * (K @ K))

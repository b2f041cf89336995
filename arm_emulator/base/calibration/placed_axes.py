"""Deviations that put the axes of an arm where a maker's file has them.

A file may state an axis by any frame with z along it: the others differ by a turn about the axis
and a shift along it, which the joint's motion does not show. Files of Universal Robots have frames
hundreds of metres away where axes are almost parallel. Here each link's frame stays as near to the
description's as its axis lets it, so that bodies and shapes remain where they are.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.calibration.joint_path import JointPath, build_axis_frame
from arm_emulator.base.products import apply_matrix, multiply_matrices, multiply_scalar
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import Frame, compute_rotation, round_rotation
from arm_emulator.base.urdf.joint_tree import MOVING_KINDS

LARGEST_MISMATCH = 1e-9  # m and rad, of a flange that no fixed joint carries


def place_axes(path: JointPath, axes: Sequence[Frame], flange: Frame) -> Mapping[str, Deviation]:
    """Return the deviations of the joints of a path, by name.

    Args:
        path: of the description.
        axes: of the moving joints at 0, frames with z along them, seen from the root link.
        flange: frame of the flange, seen from there.

    Raises:
        Refusal: the flange is the last joint's own link, and not where that joint can have it.
    """
    left, link, placed = list(axes), Frame(), {}
    behind = path.behind
    for joint in path.joints[: len(path.joints) - len(behind)]:
        nominal = link @ joint.placement
        if joint.kind not in MOVING_KINDS:
            link = nominal
            continue
        axis = left.pop(0)
        z, own = axis.R[:, 2], build_axis_frame(joint.axis)
        Q = multiply_matrices(axis.R.T, nominal.R, own)
        turned = compute_rotation(2, math.atan2(Q[1, 0] - Q[0, 1], Q[0, 0] + Q[1, 1]))
        R = round_rotation(multiply_matrices(axis.R, turned, own.T))
        link = Frame(R, axis.p + z * multiply_scalar(nominal.p - axis.p, z))
        placed[joint.name] = nominal.inverse @ link
    if behind:
        rest = Frame()
        for joint in behind[1:]:
            rest = rest @ joint.placement
        placed[behind[0].name] = (link @ behind[0].placement).inverse @ flange @ rest.inverse
    else:
        _check_axis(path, axes[-1], flange)
        placed[path.joints[-1].name] = placed[path.joints[-1].name] @ link.inverse @ flange
    return {name: Deviation.from_frame(frame) for name, frame in placed.items()}


def _check_axis(path: JointPath, axis: Frame, flange: Frame) -> None:
    """Refuse a flange from which its joint's axis does not pass through its own link's origin."""
    z, there = axis.R[:, 2], apply_matrix(flange.R, path.joints[-1].axis)
    off = np.cross(z, flange.p - axis.p)
    if max(np.abs(off).max(), np.abs(z - there).max()) > LARGEST_MISMATCH:
        rule = "be fixed to the last joint's link by a joint of its own, which deviates too"
        raise Refusal(path.where, "calibration.flange", rule, path.joints[-1].child)

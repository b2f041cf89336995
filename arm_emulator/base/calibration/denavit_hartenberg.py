"""Frames of Denavit and Hartenberg of a description, and what deviations do to them.

Frame i-1 has z along the axis of joint i, and x along the common normal of the axes before:

    frame i = frame i-1  Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i)

(Denavit and Hartenberg, A kinematic notation for lower-pair mechanisms, 1955, with distal frames.)
The last frame has z along the flange's. Between parallel axes d is 0, as in the tables of Universal
Robots; at the last it leads to the flange's origin. Of both directions of a common normal x takes
the one within a quarter turn of the x before; the first x is the base's.
"""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.calibration.joint_path import JointPath
from arm_emulator.base.products import measure_length, multiply_scalar
from arm_emulator.base.urdf.frames import EYE, Frame, compute_rotation

PARALLEL = 1e-4  # rad: URDFs write right angles with 4 digits


def find_dh_frames(path: JointPath) -> list[Frame]:
    """Return the frames 0 to n of an arm of n moving joints at 0, seen from its root link."""
    axes, flange = path.axes, path.flange
    p, z = axes[0]
    frames = [_build_frame(_find_foot(path.base.p, p, z), path.base.R[:, 0], z, path.base.R[:, 2])]
    for place, (p, z) in enumerate([*axes[1:], (flange.p, flange.R[:, 2])]):
        before, ends = frames[-1], place + 1 == len(axes)
        x_before, z_before = before.R[:, 0], before.R[:, 2]
        across = np.cross(z_before, z)
        if (sine := measure_length(across)) > PARALLEL:
            x = across / sine
            # On the axis, where the common normal of both meets it.
            origin = p + z * (multiply_scalar(np.cross(p - before.p, z_before), across) / sine**2)
        else:
            origin = flange.p if ends else _find_foot(before.p, p, z)
            x = origin - _find_foot(origin, before.p, z_before)
            x = x_before if (a := measure_length(x)) < 1e-9 else x / a
        nearest = multiply_scalar(x, x_before)
        if abs(nearest) < 1e-6:
            nearest = multiply_scalar(x, np.cross(z_before, x_before))
        frames.append(_build_frame(origin, x if nearest >= 0.0 else -x, z, x_before))
    return frames


def displace_along_axes(
    deviation: Deviation, before: Deviation | None, frame: Frame, child: Frame
) -> Frame:
    """Return the frame to which numbers of Denavit and Hartenberg displace a joint's, seen from it.

    Args:
        deviation: of the joint.
        before: of the joint before it on the path, whose link leads to this axis.
        frame: frame of Denavit and Hartenberg with z along the axis.
        child: frame of the joint's child link.
    """
    there = frame.inverse @ child
    link = Frame() if before is None else compute_screw(0, before.delta_alpha, before.delta_a)
    return there.inverse @ link @ compute_screw(2, deviation.delta_theta, deviation.delta_d) @ there


def compute_screw(axis: int, angle: float, distance: float) -> Frame:
    """Return a turn about an axis of a frame [rad], with a shift along it [m]."""
    return Frame(compute_rotation(axis, angle) if angle else EYE, np.eye(3)[axis] * distance)


def _find_foot(point: Array, p: Array, z: Array) -> Array:
    """Return the point of an axis that is nearest to a point."""
    return np.asarray(p + z * multiply_scalar(point - p, z))


def _build_frame(origin: Array, x: Array, z: Array, otherwise: Array) -> Frame:
    """Return the frame with that z, and x as near as possible to the one given."""
    across = x - multiply_scalar(x, z) * z
    if measure_length(across) < 1e-6:
        across = otherwise - multiply_scalar(otherwise, z) * z
    across = across / measure_length(across)
    return Frame(np.column_stack([across, np.cross(z, across), z]), np.asarray(origin))

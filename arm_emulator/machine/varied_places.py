"""Places of a scene's joints that are data of each machine: varied numbers of its calibration."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.calibration.calibration import Calibration
from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.products import multiply_matrices
from arm_emulator.base.urdf.frames import Frame, compute_atan2
from arm_emulator.base.validation.number import list_numbers
from arm_emulator.machine.chain import Chain, ChainJoint
from arm_emulator.machine.cxx_literals import format_number, format_vector
from arm_emulator.machine.varied import Varied

SECTION = "calibration"
NAMES = ("x", "y", "z", "roll", "pitch", "yaw")


def vary_places(chain: Chain, calibration: Calibration) -> list[Varied]:
    """Return the numbers by which the moving joints of a calibration are displaced."""
    declared = list_numbers(Deviation)
    return [
        Varied(declared[key].rename(f"{SECTION}.joints.{link.name}.{key}"), value)
        for link in chain.joints
        for key, value in read_place(link, calibration).items()
    ]


def read_place(joint: ChainJoint, calibration: Calibration) -> dict[str, float]:
    """Return by how much a joint is displaced, x to yaw."""
    deviation = calibration.deviations.get(joint.name, Deviation())
    return {key: getattr(deviation, key) for key in NAMES}


def write_place(joint: ChainJoint, calibration: Calibration, places: Mapping[str, str]) -> str:
    """Return the C++ of a link's place in its parent's frame.

    The description's place follows from the true one with the displacement taken back.

    Args:
        joint: that moves the link.
        calibration: by which it is displaced.
        places: where the values of varied numbers stand, by their name.
    """
    own = {key: places.get(f"{SECTION}.joints.{joint.name}.{key}") for key in NAMES}
    if not any(own.values()):
        return f"{{{_write_axes(joint.R)}, {format_vector(joint.p)}}}"
    numbers, frame = read_place(joint, calibration), _find_described(joint, calibration)
    described = f"{{{_write_axes(frame.R)}, {format_vector(frame.p)}}}"
    terms = [own[key] or format_number(numbers[key]) for key in NAMES]
    vectors = (", ".join(terms[k : k + 3]) for k in (0, 3))
    xyz, rpy = (f"{{{vector}}}" for vector in vectors)
    return f"arm::displace_link({described}, {_write_axes(joint.axes)}, {xyz}, {rpy})"


def displace_joint(
    joint: ChainJoint, calibration: Calibration, values: Mapping[str, float]
) -> ChainJoint:
    """Return a joint where varied numbers of its calibration place it.

    Args:
        joint: as its scene has it.
        calibration: of the scene.
        values: of varied numbers, by their name.
    """
    own = {
        key: value
        for key in NAMES
        if (value := values.get(f"{SECTION}.joints.{joint.name}.{key}")) is not None
    }
    if not own:
        return joint
    deviation = replace(calibration.deviations.get(joint.name, Deviation()), **own)
    place = _find_described(joint, calibration) @ deviation.displaced
    R = multiply_matrices(place.R, joint.axes.T)
    x, y = float(R[0, 2]), -float(R[1, 2])
    length = math.hypot(x, y)
    c, s = (y / length, x / length) if length > 0.0 else (1.0, 0.0)
    R = multiply_matrices(np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), R)
    return replace(
        joint,
        cos_gamma=c,
        sin_gamma=s,
        cos_alpha=float(R[2, 2]),
        sin_alpha=float(-R[1, 2]),
        theta_0=compute_atan2(-float(R[0, 1]), float(R[0, 0])),
        p=place.p,
    )


def _find_described(joint: ChainJoint, calibration: Calibration) -> Frame:
    """Return the frame of a joint's child in the description, seen from its parent's link."""
    back = calibration.deviations.get(joint.name, Deviation()).displaced
    return Frame(multiply_matrices(joint.R, joint.axes), joint.p) @ back.inverse


def _write_axes(R: Array) -> str:
    return f"{{{', '.join(map(format_vector, R.T))}}}"

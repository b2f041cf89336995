"""Bodies of a URDF, in the frames of their links.

Numbers are collected first, then turned into bodies all at once.
"""

import xml.etree.ElementTree as ET

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.products import multiply_matrices
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.joint_tree import check_size, parse_numbers, read_frames
from arm_emulator.machine.chain import Bodies

# Beyond these a number in a URDF is a slip, and what is computed from it may overflow.
LARGEST_MASS = 1e9  # kg
LARGEST_INERTIA = 1e15  # kg m2
_TENSOR = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_FULL_TENSOR = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]  # places of the entries above


def read_bodies(robot: ET.Element, where: str) -> Bodies:
    """Return the bodies of all links, in their order; without an inertial a link has none."""
    links = robot.findall("link")
    rows, whats, origins, places = [], [], [], []
    for place, link in enumerate(links):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        label = f"link {link.get('name')}"
        mass, tensor = inertial.find("mass"), inertial.find("inertia")
        if mass is None or tensor is None:
            raise Refusal(where, f"{label}: inertial", "hold <mass> and <inertia>", "only a part")
        texts = [mass.get("value"), *map(tensor.get, _TENSOR)]
        try:
            rows.append([float(text) for text in texts])  # type: ignore[arg-type]
        except (TypeError, ValueError):
            for key, text in zip(("mass", *_TENSOR), texts, strict=True):
                parse_numbers(text, 1, f"{label}: {key}", where)
        whats.append(label)
        origins.append(inertial.find("origin"))
        places.append(place)
    values = np.array(rows).reshape(-1, 7)
    check_size(values[:, :1], LARGEST_MASS, whats, "mass", where)
    check_size(values[:, 1:], LARGEST_INERTIA, whats, "inertia", where)
    for place in np.flatnonzero(values[:, 0] < 0.0).tolist():
        raise Refusal(where, f"{whats[place]}: mass", "be >= 0 kg", float(values[place, 0]))
    frames = read_frames(origins, whats, "inertial origin", where)
    everywhere = Bodies(
        np.zeros(len(links)), np.zeros((len(links), 3)), np.zeros((len(links), 3, 3))
    )
    if not places:
        return everywhere
    R = np.array([frame.R for frame in frames])
    inertia = multiply_matrices(R, values[:, 1:][:, _FULL_TENSOR], R.transpose(0, 2, 1))
    bodies = Bodies.from_center(values[:, 0], np.array([frame.p for frame in frames]), inertia)
    everywhere.mass[places] = bodies.mass
    everywhere.moment[places] = bodies.moment
    everywhere.inertia[places] = bodies.inertia
    return everywhere


def check_inertia(inertia: Array, label: str, where: str) -> None:
    """Refuse a tensor (3, 3) [kg m2] about the centre of mass that is not positive definite."""
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 1e-12 * moments[2]:
        text = ", ".join(f"{moment:.3g}" for moment in moments)
        raise Refusal(
            where, label, "be positive definite, principal moments > 0 kg m2", f"({text})"
        )

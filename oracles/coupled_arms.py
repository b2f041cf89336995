"""Arms whose joints do not go each with a drive, and their equations by explicit constraints.

The solution does not use the shafts' mass matrix. It has all joints of the chain (Pinocchio, by the
description alone) and the shafts. Each row of q = C p + q_0 has a Lagrange multiplier.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from oracles.own_robots import RobotPart, write_serial

GRAVITY = (0.4, -1.1, -9.7)
Shares = dict[str, dict[str, float]]

TURN = RobotPart("0 0 1", (0.1, 0.0, 0.4), 6.0)
BOOM = [
    TURN,
    RobotPart("0 1 0", (0.8, 0.1, 0.0), 5.0, limits=(-1.2, 0.8)),
    RobotPart("1 0 0", (0.3, 0.0, 0.1), 3.0, "prismatic", (0.0, 0.6)),
    RobotPart("1 0 0", (0.2, 0.1, 0.0), 2.0, "prismatic", (0.0, 0.4)),
    RobotPart("1 0 0", (0.1, 0.0, 0.1), 1.0, "prismatic", (0.0, 0.3)),
]
PALLETIZER = [
    TURN,
    RobotPart("0 1 0", (0.0, 0.05, 0.8), 5.0, limits=(-0.7, 1.2)),
    RobotPart("0 1 0", (0.7, 0.0, 0.1), 4.0, limits=(-1.5, 1.0)),
    RobotPart("0 1 0", (0.1, 0.1, 0.0), 1.0, limits=(-1.5, 1.5)),
    RobotPart("0 0 -1", (0.1, 0.0, -0.1), 0.5),
]
WRIST = [
    TURN,
    RobotPart("0 1 0", (0.5, 0.0, 0.0), 4.0),
    RobotPart("1 0 0", (0.1, 0.05, 0.0), 1.5),
    RobotPart("0 1 0", (0.1, 0.0, 0.05), 1.0, limits=(-2.0, 2.0)),
    RobotPart("1 0 0", (0.1, 0.05, 0.0), 0.7),
]
ARMS: dict[str, tuple[list[RobotPart], Shares]] = {
    # One drive, three slides.
    "telescope": (BOOM, {"j4": {"j3": 0.7}, "j5": {"j3": -0.4}}),
    # The forearm's motor stands on the base, and rods keep the flange level.
    "palletizer": (PALLETIZER, {"j3": {"j3": 1.0, "j2": -1.0}, "j4": {"j3": -1.0}}),
    # Two motors turn both of the last axes through bevel gears.
    "bevel wrist": (WRIST, {"j4": {"j4": 1.0}, "j5": {"j5": 1.0, "j4": -0.8}}),
    "differential": (WRIST, {"j4": {"j4": 0.5, "j5": 0.5}, "j5": {"j4": 0.5, "j5": -0.5}}),
}


def list_shafts(parts: list[RobotPart], shares: Shares) -> list[str]:
    """Return the joints by whose names shafts go."""
    names = [f"j{k + 1}" for k in range(len(parts))]
    used = {shaft for row in shares.values() for shaft in row}
    return [name for name in names if name in used or name not in shares]


class Lagrange:
    """All joints of the chain and all shafts, with a multiplier for each joint's coupling."""

    def __init__(self, urdf: str, C: Array, q_0: Array) -> None:
        robot = ET.fromstring(urdf)
        for joint in robot.findall("joint"):
            for tag in ("mimic", "coupling"):
                for element in joint.findall(tag):
                    joint.remove(element)
            limit = joint.find("limit")
            if limit is not None:  # which Pinocchio wants to be complete
                limit.attrib |= {"effort": "1", "velocity": "1"}
        self.model = pin.buildModelFromXML(ET.tostring(robot, encoding="unicode"))
        self.model.gravity.linear = np.array(GRAVITY)
        self.data = self.model.createData()
        self.C, self.q_0 = C, q_0

    def compute_accelerations(
        self, p: Array, v: Array, T: Array, tau: Array | None = None
    ) -> Array:
        """Return those of the shafts (N,) under torques of theirs and of joints (L,)."""
        C, (L, N) = self.C, self.C.shape
        q = C @ p + self.q_0
        M = pin.crba(self.model, self.data, q)
        M = np.triu(M) + np.triu(M, 1).T
        nle = pin.nonLinearEffects(self.model, self.data, q, C @ v)
        if tau is not None:
            nle = nle - tau
        system = np.block([
            [M, np.zeros((L, N)), np.eye(L)],  # M q'' + nle + lambda = 0
            [np.zeros((N, L + N)), C.T],  # C^T lambda + T = 0
            [np.eye(L), -C, np.zeros((L, L))],  # q'' = C p''
        ])  # fmt: skip
        return np.linalg.solve(system, np.concatenate([-nle, -T, np.zeros(L)]))[L : L + N]


def make_coupling_matrix(parts: list[RobotPart], shares: Shares) -> Array:
    """Return C, a row per joint, a column per shaft."""
    shafts = list_shafts(parts, shares)
    rows = [shares.get(name, {name: 1.0}) for name in (f"j{k + 1}" for k in range(len(parts)))]
    return np.array([[row.get(shaft, 0.0) for shaft in shafts] for row in rows])


def write_mimic(text: str, joint: str, of: str, multiplier: float, offset: float) -> str:
    """Return a description one of whose joints copies another."""
    robot = ET.fromstring(text)
    for element in robot.findall("joint"):
        if element.get("name") == joint:
            ET.SubElement(
                element, "mimic", joint=of, multiplier=repr(multiplier), offset=repr(offset)
            )
    return ET.tostring(robot, encoding="unicode")


def write_description(name: str) -> str:
    """Return the description of one of `ARMS`, with its couplings."""
    parts, shares = ARMS[name]
    robot = ET.fromstring(write_serial(name.replace(" ", "_"), parts))
    for joint in robot.findall("joint"):
        for shaft, share in shares.get(joint.get("name", ""), {}).items():
            ET.SubElement(joint, "coupling", joint=shaft, multiplier=repr(share))
    return ET.tostring(robot, encoding="unicode")

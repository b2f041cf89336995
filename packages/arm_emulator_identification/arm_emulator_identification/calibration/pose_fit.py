"""Deviations of an arm's joints from measured poses of its tool.

Each joint from base to tool, and the tool's mount, may stand displaced by six numbers. Least
squares with prior deviations, by the steps of Gauss and Newton on residuals r(x) of K poses,

    minimise  |r(x) / sigma|^2 + |x / prior|^2,     (J'J + D) dx = -J'r - D x

The Jacobian is geometric: a twist of joint k in its own frame moves the tool by that twist. Not all
numbers are independent. Shifts along parallel axes move the tool alike, and of each joint's six
numbers a turn and a shift are the next joint's, too. (Hollerbach and Wampler, The calibration index
and taxonomy for robot kinematic calibration methods, 1996: 4 per turning joint, 2 per sliding one,
and 6 are independent.) Singular values and pivots of QR show the independent numbers; the prior
divides the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.spatial.transform import Rotation

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import (
    MOVING_KINDS,
    Deviation,
    Frame,
    JointPath,
    UrdfJoint,
    find_joint_path,
    parse_urdf,
)
from arm_emulator_identification.calibration.led_arm import ToolRest

NUMBERS = ("x", "y", "z", "roll", "pitch", "yaw")
PRIOR = np.array([1e-3] * 3 + [7e-3] * 3)  # m, rad: three times what three UR10 have
STEPS = 20
SMALL = 1e-9  # of a step against the prior: the fit has converged
# Singular values below this part of the largest are rounding: those of numbers that act alone lie
# above, down to lengths of millimetres in an arm of metres.
RANK = 1e-6
SHARE = 0.05  # of a number in a combination: smaller ones are not named


class PoseModel:
    """Forward kinematics of an arm whose joints are displaced.

    Attributes:
        path: of its joints, from the root link to the tool.
        displaced: those with numbers: the moving ones, and the first fixed one behind them.

    Args:
        urdf: the nominal description, locked joints fixed.
        joints: names of the positions, in their order.
        tool: the tool's link.
    """

    def __init__(self, urdf: str, joints: Sequence[str], tool: str) -> None:
        self.path: JointPath = find_joint_path(parse_urdf(urdf, "fit"), "fit", "", tool, tool)
        self.displaced: tuple[UrdfJoint, ...] = self.path.moving + self.path.behind[:1]
        self._columns = {name: place for place, name in enumerate(joints)}

    @property
    def names(self) -> list[str]:
        """Names of the numbers, in their order."""
        return [f"{joint.name}.{key}" for joint in self.displaced for key in NUMBERS]

    def place_tool(self, displacements: Sequence[Frame], q: Array) -> tuple[Array, Array, Array]:
        """Return the tool's poses and their Jacobian.

        Args:
            displacements: of the joints that have numbers, seen from their own frames.
            q: positions (K, N) [rad or m].

        Returns:
            Orientations (K, 3, 3), positions (K, 3) [m], and the derivatives (K, 6, M) of position
            and turn [m, rad] by twists of the displacements in their frames.
        """
        R, p = np.tile(np.eye(3), (len(q), 1, 1)), np.zeros((len(q), 3))
        left, frames = list(displacements), []
        for joint in self.path.joints:
            place, numbered = joint.placement, joint in self.displaced
            if numbered:
                place = place @ left.pop(0)
            p, R = p + R @ place.p, R @ place.R
            if numbered:
                frames.append((R, p))
            if joint.kind in MOVING_KINDS:
                position = q[:, self._columns[joint.name]]
                if joint.kind == "prismatic":
                    p = p + position[:, None] * (R @ joint.axis)
                else:
                    R = R @ Rotation.from_rotvec(position[:, None] * joint.axis).as_matrix()
        J = np.zeros((len(q), 6, 6 * len(frames)))
        for k, (R_k, p_k) in enumerate(frames):
            J[:, :3, 6 * k : 6 * k + 3] = R_k
            J[:, 3:, 6 * k + 3 : 6 * k + 6] = R_k
            J[:, :3, 6 * k + 3 : 6 * k + 6] = np.cross(R_k, (p - p_k)[:, :, None], axis=1)
        return R, p, J


@dataclass(frozen=True)
class PoseFit:
    """Result of a fit.

    Attributes:
        displacements: of the joints, by name.
        count: of numbers.
        rank: of those of them, or combinations, that poses show.
        alike: numbers that move the tool as others do at once, each with those.
    """

    displacements: dict[str, Frame]
    count: int
    rank: int
    alike: dict[str, tuple[str, ...]]

    @property
    def deviations(self) -> dict[str, Deviation]:
        """The displacements, as deviations of joints."""
        return {
            name: Deviation.from_frame(displacement)
            for name, displacement in self.displacements.items()
        }


def fit_poses(model: PoseModel, rests: Sequence[ToolRest], sigma: tuple[float, float]) -> PoseFit:
    """Return the displacements that explain measured poses.

    Args:
        model: of the nominal arm.
        rests: positions, and measured poses.
        sigma: standard deviations of measured positions [m] and turns [rad]; a turn of inf is not
            measured.
    """
    q = np.array([rest.q for rest in rests])
    weights = np.repeat([1.0 / sigma[0], 1.0 / sigma[1]], 3)
    prior = np.tile(PRIOR, len(model.displaced))
    frames = [Frame() for _ in model.displaced]
    for _ in range(STEPS):
        r, J = _weigh_residuals(model, frames, rests, q, weights)
        x = np.concatenate([_make_twist(frame) for frame in frames])
        augmented = np.vstack([J * prior, np.eye(len(prior))])
        step = np.linalg.lstsq(augmented, np.concatenate([r, -x / prior]), rcond=None)[0]
        frames = [frame @ _make_frame(dx) for frame, dx in
                 zip(frames, (step * prior).reshape(-1, 6), strict=True)]  # fmt: skip
        if np.abs(step).max() < SMALL:
            break
    _, J = _weigh_residuals(model, frames, rests, q, weights)
    rank, alike = _find_alike(J * prior, model.names)
    names = [joint.name for joint in model.displaced]
    return PoseFit(dict(zip(names, frames, strict=True)), len(prior), rank, alike)


def estimate_scale(
    model: PoseModel, fit: PoseFit, rests: Sequence[ToolRest], sigma: tuple[float, float]
) -> float:
    """Return how many times as large as `sigma` residuals of a fit are, at least 1.

    They are larger where links do not stand where they are taken to be, as after friction.
    """
    weights = np.repeat([1.0 / sigma[0], 1.0 / sigma[1]], 3)
    q = np.array([rest.q for rest in rests])
    r, _ = _weigh_residuals(model, [*fit.displacements.values()], rests, q, weights)
    free = len(rests) * int(np.count_nonzero(weights)) - fit.rank
    return max(1.0, float(np.sqrt(r @ r / max(1, free))))


def compare_poses(
    model: PoseModel, displacements: dict[str, Frame], rests: Sequence[ToolRest]
) -> tuple[Array, Array]:
    """Return by how much poses of a model miss the measured ones: (K,) [m] and (K,) [rad]."""
    frames = [displacements.get(joint.name, Frame()) for joint in model.displaced]
    R, p, _ = model.place_tool(frames, np.array([rest.q for rest in rests]))
    off = np.array([rest.p for rest in rests]) - p
    rotations = Rotation.from_matrix(np.array([rest.R for rest in rests]) @ R.transpose(0, 2, 1))
    return np.linalg.norm(off, axis=1), rotations.magnitude()


def _weigh_residuals(
    model: PoseModel, frames: Sequence[Frame], rests: Sequence[ToolRest], q: Array, weights: Array
) -> tuple[Array, Array]:
    """Return residuals and Jacobian in standard deviations."""
    R, p, J = model.place_tool(frames, q)
    rotations = Rotation.from_matrix(np.array([rest.R for rest in rests]) @ R.transpose(0, 2, 1))
    off = np.hstack([np.array([rest.p for rest in rests]) - p, rotations.as_rotvec()]) * weights
    return off.ravel(), (J * weights[:, None]).reshape(-1, J.shape[2])


def _find_alike(J: Array, names: Sequence[str]) -> tuple[int, dict[str, tuple[str, ...]]]:
    """Return the rank of a Jacobian, and the columns that depend on others, with those."""
    values = np.linalg.svd(J, compute_uv=False)
    rank = int(np.sum(values > RANK * values[0]))
    _, upper, order = scipy.linalg.qr(J, mode="economic", pivoting=True)
    shares = np.linalg.solve(upper[:rank, :rank], upper[:rank, rank:])
    alike = {}
    for column, place in zip(shares.T, order[rank:], strict=True):
        of = [k for k in np.argsort(-np.abs(column)) if abs(column[k]) > SHARE]
        alike[names[place]] = tuple(names[order[k]] for k in of)
    return rank, alike


def _make_twist(frame: Frame) -> Array:
    return np.concatenate([frame.p, Rotation.from_matrix(frame.R).as_rotvec()])


def _make_frame(twist: Array) -> Frame:
    return Frame(Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3])

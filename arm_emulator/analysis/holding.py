"""Check that an arm's motors hold it, with its payload, over the range of its joints."""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from arm_emulator.analysis.servo_loop import draw_poses
from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.scene import Scene

POSES = 400
NEARLY = 1.0 - 1e-9  # a motor with just the torque of the weight holds it


@dataclass(frozen=True, eq=False)
class Overload:
    """A joint whose motor is too weak to hold the links behind it."""

    joint: str
    unit: str
    gives: float
    takes: float  # N m or N, largest over the poses
    at: Array  # that pose
    at_start: float | None  # N m or N at the start, if too much
    poses: int  # of `POSES` in which the motor is too weak

    def __str__(self) -> str:
        if self.at_start is not None:
            where = f"{self.at_start:.3g} {self.unit} at its start"
        else:
            pose = ", ".join(f"{angle:.2f}" for angle in self.at)
            where = f"{self.takes:.3g} {self.unit} at q = ({pose})"
        return (
            f"joints.{self.joint}: its motor gives {self.gives:.3g} {self.unit}, to hold the arm "
            f"takes {where}; too much in {self.poses} of {POSES} poses within the limits"
        )


def find_overloads(scene: Scene) -> list[Overload]:
    """Return the joints that cannot hold the arm in every pose; the first pose is the start."""
    loads = LinkLoads(scene)
    at = np.array(draw_poses(scene, POSES))
    takes = np.abs(
        np.array([loads.compute_weight(q) + _compute_spring_torques(scene, q) for q in at])
    )
    overloaded = []
    for j, joint in enumerate(scene.joints):
        if joint.motor is None:
            continue
        gives = compute_largest_torque(joint, scene.supply_voltage)
        too_much = NEARLY * takes[:, j] > gives
        if too_much.any():
            worst = int(takes[:, j].argmax())
            overloaded.append(
                Overload(
                    joint.name,
                    "N" if scene.chain.joints[j].kind == "prismatic" else "N m",
                    gives,
                    float(takes[worst, j]),
                    at[worst],
                    float(takes[0, j]) if too_much[0] else None,
                    int(too_much.sum()),
                )
            )
    return overloaded


def compute_largest_torque(joint: Joint, supply_voltage: float) -> float:
    """Return the largest torque that a joint's motor puts on its link at rest [N m or N]."""
    largest = joint.compute_largest_command(supply_voltage)
    torque = math.inf if largest is None else abs(joint.torque_per_command) * largest
    current, data = getattr(joint.motor, "current_limit", None), joint.servo_data
    if current is not None and data is not None:
        torque = min(torque, current * data.torque_constant / abs(joint.gear.ratio))
    return torque


def _compute_spring_torques(scene: Scene, q: Array) -> Array:
    """Return the torques that hold counterbalances and the like at rest, (N,)."""
    torque, none = np.zeros(len(q)), np.zeros(1)
    for j, joint in enumerate(scene.joints):
        at = ShaftMotion(none, q[j : j + 1], none, none, none, none, joint.gear.ratio)
        for part in joint.extras:
            if part.of_angle and part.shaft == "link":
                effort = part.compute_effort(at)
                assert effort is not None, "its angle determines it"
                torque[j] += float(effort[0])
    return torque


# Mass matrix and weight of the links over poses, by Pinocchio.
#
# The bodies are the scene's own, payload and locked joints included.


class LinkLoads:
    """The links of a scene, by the angles of its joints; bearings are straight."""

    def __init__(self, scene: Scene) -> None:
        model = pin.Model()
        for joint in scene.chain.links:
            kind = pin.JointModelPZ() if joint.kind == "prismatic" else pin.JointModelRZ()
            at = pin.SE3(joint.R, joint.p)
            number = model.addJoint(joint.parent + 1, kind, at, joint.name)
            body = joint.body
            (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia
            # As they are about the joint: of a point, rounding leaves anything about its centre.
            numbers = np.array([body.mass, *body.moment, xx, xy, yy, xz, yz, zz])
            inertia = pin.Inertia.FromDynamicParameters(numbers)
            model.appendBodyToJoint(number, inertia, pin.SE3.Identity())
        gravity = np.array(scene.gravity or (0.0, 0.0, 0.0))
        model.gravity.linear = scene.chain.R_BW @ gravity
        self._model, self._data = model, model.createData()
        coupling = scene.chain.coupling
        self._C, self._offset = coupling.C[:, scene.joint_places], coupling.offset

    def compute_mass_matrix(self, q: Array) -> Array:
        """Return M(q), (N, N)."""
        C = self._C
        M = pin.crba(self._model, self._data, self._compute_joint_angles(q))
        M_reduced: Array = C.T @ (np.triu(M) + np.triu(M, 1).T) @ C
        return M_reduced

    def compute_weight(self, q: Array) -> Array:
        """Return the torques that hold the links at q, (N,) [N m or N]."""
        gravity = pin.computeGeneralizedGravity(
            self._model, self._data, self._compute_joint_angles(q)
        )
        torque: Array = self._C.T @ gravity
        return torque

    def _compute_joint_angles(self, q: Array) -> Array:
        joints: Array = self._C @ q + self._offset
        return joints

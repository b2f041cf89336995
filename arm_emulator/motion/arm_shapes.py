"""Shapes of an arm for tests of contact: Pinocchio with coal.

The shapes are those for collisions in the robot description. Every mesh stands beside its convex
hull, whose contacts are found faster and include those of the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import Lasting
from arm_emulator.base.shafts import Shafts
from arm_emulator.motion.instruction import FloatArray
from arm_emulator.motion.kinematics_model import WHERE
from arm_emulator.motion.package_folders import package_folders


class ArmShapes(Lasting):
    """Shapes of an arm, and its configurations as Pinocchio has them.

    Args:
        urdf_xml: the robot description.
        joint_names: the joints commanded, in the order of all arrays; the others stay at 0.

    Attributes:
        model: the arm.
        hulls: its shapes, meshes replaced by their convex hulls.
        meshes: its shapes as they are, in the same order.
        links: the link of each shape.

    Raises:
        Refusal: a description, or a mesh in it, that cannot be read.
    """

    def __init__(self, urdf_xml: str, joint_names: Sequence[str]) -> None:
        try:
            self.model = pin.buildModelFromXML(urdf_xml)
            self.hulls = pin.buildGeomFromUrdfString(
                self.model, urdf_xml, pin.GeometryType.COLLISION, package_dirs=package_folders()
            )
        except (ValueError, RuntimeError, IndexError) as error:
            rule = "have readable shapes for collisions (meshes by file:// or ROS_PACKAGE_PATH)"
            raise Refusal(WHERE, "the robot", rule, str(error).splitlines()[0]) from error
        self.meshes = pin.GeometryModel(self.hulls)
        for shape in self.hulls.geometryObjects:
            shape.geometry = _hull(shape.geometry)
        self.links = [
            str(self.model.frames[shape.parentFrame].name) for shape in self.hulls.geometryObjects
        ]
        self._shafts = Shafts(urdf_xml, joint_names)
        joints = [self.model.joints[self.model.getJointId(name)] for name in self._shafts.joints]
        self._columns = [joint.idx_v for joint in joints]
        self._neutral = pin.neutral(self.model)
        low = np.array([max(self._lower(joint), -np.pi) for joint in joints])
        high = np.array([min(self._upper(joint), np.pi) for joint in joints])
        self.low, self.high = self._shafts.positions(low, high)
        """Limits within a turn (N,)."""

    @property
    def rest(self) -> FloatArray:
        """All joints at 0, or in the middle of limits that exclude it (N,)."""
        middle = 0.5 * (self.low + self.high)
        rest: FloatArray = np.where((self.low > 0.0) | (self.high < 0.0), middle, 0.0)
        return rest

    def drawn(self, rng: np.random.Generator) -> FloatArray:
        """Return a configuration within the limits (N,)."""
        return self.low + (self.high - self.low) * rng.random(len(self.low))

    def whole(self, q: FloatArray) -> FloatArray:
        """Return Pinocchio's configuration at q (N,)."""
        step = np.zeros(self.model.nv)
        step[self._columns] = self._shafts.of_joints(q)
        configuration: FloatArray = pin.integrate(self.model, self._neutral, step)
        return configuration

    def _lower(self, joint: Any) -> float:
        return float(self.model.lowerPositionLimit[joint.idx_q]) if joint.nq == 1 else -np.pi

    def _upper(self, joint: Any) -> float:
        return float(self.model.upperPositionLimit[joint.idx_q]) if joint.nq == 1 else np.pi


def _hull(shape: Any) -> Any:
    if isinstance(shape, coal.BVHModelBase):
        shape.buildConvexHull(True, "Qt")
        return shape.convex
    return shape

"""Shapes of an arm for tests of contact: Pinocchio with coal.

The shapes are those for collisions in the robot description. Every mesh has its convex
hull, whose contacts are found faster and include those of the mesh.
"""

import math
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.base.urdf.shafts import Shafts
from arm_emulator.base.urdf.urdf_text import UNLIMITED
from arm_emulator.motion.model.mesh_units import list_package_folders, scale_to_metres
from arm_emulator.motion.model.pinocchio_model import WHERE


class CollisionShapes(SharedObject):
    """Shapes of an arm, and its configurations as Pinocchio has them.

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
                self.model,
                scale_to_metres(urdf_xml),
                pin.GeometryType.COLLISION,
                package_dirs=list_package_folders(),
            )
        except (ValueError, RuntimeError, IndexError) as error:
            rule = "have readable shapes for collisions (meshes by file:// or ROS_PACKAGE_PATH)"
            raise Refusal(WHERE, "the robot", rule, str(error).splitlines()[0]) from error
        self.meshes = pin.GeometryModel(self.hulls)
        for shape in self.hulls.geometryObjects:
            shape.geometry = _build_hull(shape.geometry)
        self.links = [
            str(self.model.frames[shape.parentFrame].name) for shape in self.hulls.geometryObjects
        ]
        self._shafts = Shafts(urdf_xml, joint_names)
        numbers = [self.model.getJointId(name) for name in self._shafts.joints]
        joints = [self.model.joints[number] for number in numbers]
        self._neutral = pin.neutral(self.model)
        self._turning = np.array([joint.nq == 2 for joint in joints])  # cosine and sine
        self._places = np.array([joint.idx_q for joint in joints])
        self.moved_by = [frozenset(numbers) & {*path} for path in self.model.supports]
        """The joints commanded that move each of the model's joints."""
        shapes = self.hulls.geometryObjects
        leads = [[self._bound_lead(number, shape) for number in numbers] for shape in shapes]
        self.leads = np.reshape(np.array(leads, dtype=float), (len(shapes), len(numbers)))
        """Largest travel of each shape per joint (shapes, joints) [m/rad, m/m]."""
        low = np.array([max(self._read_lower(joint), -np.pi) for joint in joints])
        high = np.array([min(self._read_upper(joint), np.pi) for joint in joints])
        self.low, self.high = self._shafts.bound_positions(low, high)
        """Limits within a turn (N,)."""

    @property
    def rest(self) -> Array:
        """All joints at 0, or in the middle of limits that exclude it (N,)."""
        middle = 0.5 * (self.low + self.high)
        rest: Array = np.where((self.low > 0.0) | (self.high < 0.0), middle, 0.0)
        return rest

    def sample_configuration(self, rng: np.random.Generator) -> Array:
        """Return a configuration within the limits (N,)."""
        return self.low + (self.high - self.low) * rng.random(len(self.low))

    def compute_configuration(self, q: Array) -> Array:
        """Return Pinocchio's configuration at q (..., N)."""
        angles = self._shafts.convert_to_joints(q)
        configuration: Array = np.tile(self._neutral, (*angles.shape[:-1], 1))
        turning, places = self._turning, self._places
        configuration[..., places] = np.where(turning, np.cos(angles), angles)
        configuration[..., places[turning] + 1] = np.sin(angles[..., turning])
        return configuration

    def compute_joint_ranges(self, motions: Array) -> Array:
        """Return how far each joint goes on ways of those commanded (..., N) [rad or m]."""
        return np.abs(motions @ self._shafts.C.T)

    def _bound_lead(self, joint: int, shape: Any) -> float:
        """Return how far a joint moves a shape per angle or way at most [m/rad, m/m]."""
        if joint not in self.model.supports[shape.parentJoint]:
            return 0.0
        if _is_sliding(self.model.joints[joint]):
            return 1.0
        shape.geometry.computeLocalAABB()
        centre = shape.placement.act(shape.geometry.aabb_center)
        length = math.hypot(*centre) + float(shape.geometry.aabb_radius)
        at = shape.parentJoint
        while at > joint:  # parents have lower numbers
            length += math.hypot(*self.model.jointPlacements[at].translation) + self._bound_travel(
                at
            )
            at = self.model.parents[at]
        return length

    def _bound_travel(self, joint: int) -> float:
        moving = self.model.joints[joint]
        if not _is_sliding(moving):
            return 0.0
        travel = max(-self._read_lower(moving), self._read_upper(moving))
        return travel if travel < UNLIMITED else 0.0

    def _read_lower(self, joint: Any) -> float:
        return float(self.model.lowerPositionLimit[joint.idx_q]) if joint.nq == 1 else -np.pi

    def _read_upper(self, joint: Any) -> float:
        return float(self.model.upperPositionLimit[joint.idx_q]) if joint.nq == 1 else np.pi


def _is_sliding(joint: Any) -> bool:
    return bool(joint.shortname().removeprefix("JointModel").startswith("P"))


def _build_hull(shape: Any) -> Any:
    if isinstance(shape, coal.BVHModelBase):
        try:
            shape.buildConvexHull(True, "Qt")
        except RuntimeError:  # qhull, or a corner with more neighbours than coal counts
            return shape
        return shape.convex
    return shape

"""An arm as arrays, for computations over many configurations together."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.base.urdf.shafts import Shafts
from arm_emulator.core import CORE
from arm_emulator.motion.cpp import FOLDER
from arm_emulator.motion.model.kinematics import (
    POSE_ROWS,
    POSITION_ROWS,
    Kinematics,
    build_arm_model,
    find_tool_frame,
)
from arm_emulator.motion.model.pinocchio_model import JOINT, WHERE
from arm_emulator.toolchain.c_header import NULL, CData, Header, make_pointer
from arm_emulator.toolchain.compile_unit import compile_once
from arm_emulator.toolchain.flags import CPP_FLAGS
from arm_emulator.toolchain.unit import Unit


class ArmTree(SharedObject):
    """Kinematics and inverse dynamics of an arm, a row per configuration.

    Numbers come from the Pinocchio model, of which it is a copy.

    Args:
        kinematics: of the arm.
        gravity: acceleration of gravity along the world's axes (3,) [m/s2].

    Attributes:
        struct: the arm as path.h takes it.
    """

    def __init__(
        self, kinematics: Kinematics, gravity: Sequence[float] = (0.0, 0.0, -9.81)
    ) -> None:
        self.kinematics = kinematics
        names = kinematics.joint_names
        shafts = Shafts(kinematics.urdf_xml, names)
        try:
            model = build_arm_model(
                kinematics.urdf_xml, names, shafts.joints, kinematics.tool, WHERE, masses=True
            )
        except Refusal:  # masses are missing
            model, shafts = kinematics.model, kinematics.shafts
        order = [model.getJointId(JOINT + name) for name in shafts.joints]
        chain = sorted(order)  # parents before children
        place_of = [order.index(joint) for joint in chain]
        self._coupling = np.ascontiguousarray(shafts.C[place_of])
        self._offset = np.ascontiguousarray(shafts.offset[place_of])
        data = model.createData()
        neutral = pin.neutral(model)
        pin.computeJointJacobians(model, data, neutral)
        slides, axis, parent, rotation, place = [], [], [], [], []
        mass, centre, inertia = [], [], []
        for joint in chain:
            column = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
            column = np.reshape(column, (POSE_ROWS, -1))[:, model.joints[joint].idx_v]
            sliding = bool(np.linalg.norm(column[3:]) < 0.5)
            slides.append(sliding)
            axis.append(column[:3] if sliding else column[3:])
            above = model.parents[joint]
            parent.append(chain.index(above) if above in chain else -1)
            rotation.append(model.jointPlacements[joint].rotation)
            place.append(model.jointPlacements[joint].translation)
            body = model.inertias[joint]
            mass.append(body.mass)
            centre.append(body.lever)
            inertia.append(body.inertia)
        frame = model.frames[find_tool_frame(model, kinematics.tool, WHERE)]
        self._arrays = {  # which the struct points to
            "parent": np.array(parent, dtype=np.int32),
            "slides": np.array(slides, dtype=np.int32),
            "axis": _copy_array(axis),
            "rotation": _copy_array(rotation),
            "place": _copy_array(place),
            "coupling": self._coupling,
            "offset": self._offset,
            "scale": _copy_array(kinematics.step_scale),
            "mass": _copy_array(mass),
            "centre": _copy_array(centre),
            "inertia": _copy_array(inertia),
            "gravity": _copy_array(gravity),
            "tool_rotation": _copy_array(frame.placement.rotation),
            "tool_place": _copy_array(frame.placement.translation),
        }
        self.struct: CData = PATH_HEADER.make_struct(
            "path_arm",
            joints=len(chain),
            coordinates=len(names),
            tool_parent=chain.index(frame.parentJoint) if frame.parentJoint else -1,
            tool_coordinates=int(kinematics.to_tool.sum()),
            reach=kinematics.reach,
            **self._arrays,
        )
        self._library = path_library()

    def compute_tool_poses(self, q: Array) -> tuple[Array, Array]:
        """Return tool positions (K, 3) [m] and rotations (K, 3, 3) of configurations (K, N)."""
        q = self._compute_joints(q)
        p, R = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
        self._library.path_forward(
            self.struct, len(q), make_pointer(q), make_pointer(p), make_pointer(R)
        )
        return p, R

    def compute_torques(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torques of the links, (K, N) [N m or N]."""
        q = self._compute_joints(q)
        v, a = (np.ascontiguousarray(rate @ self._coupling.T) for rate in (v, a))
        tau = np.empty_like(q)
        self._library.path_torques(self.struct, len(q), *map(make_pointer, (q, v, a, tau)))
        return np.asarray(tau @ self._coupling)

    def trace_poses(
        self,
        start: Array,
        p: Array,
        R: Array,
        goal: Array | None = None,
        rotates_evenly: bool = True,
    ) -> Array:
        """Return joint angles along poses of the tool, (1 + those that were reached, N).

        Args:
            start: joint angles of the arm (N,), where the poses begin.
            p: positions (K, 3) [m].
            R: rotations (K, 3, 3).
            goal: angles (N,) of joints that the poses leave free, or None if any will do.
            rotates_evenly: whether the rotations are asked for.
        """
        q = np.empty((len(p) + 1, len(start)))
        q[0] = start
        end = None if goal is None else np.ascontiguousarray(goal)
        p, R = np.ascontiguousarray(p), np.ascontiguousarray(R)
        reached = self._library.path_trace(
            self.struct,
            self.kinematics.rows if rotates_evenly else POSITION_ROWS,
            len(p),
            make_pointer(p),
            make_pointer(R),
            NULL if end is None else make_pointer(end),
            make_pointer(q),
        )
        return q[: reached + 1]

    def _compute_joints(self, q: Array) -> Array:
        """Return the joints of the tree, (K, joints)."""
        return np.ascontiguousarray(q @ self._coupling.T + self._offset)


def _copy_array(values: Any) -> Array:
    return np.ascontiguousarray(np.array(values, dtype=np.float64))


PATH_HEADER = Header(FOLDER / "path.h")


def make_path_unit() -> Unit:
    """Return the sources of planned paths."""
    source = '#include "path.cpp"\n'
    return Unit(
        "path", source, CPP_FLAGS, (FOLDER, CORE), (PATH_HEADER,), "motion", "the paths", "path.cpp"
    )


path_library = compile_once(make_path_unit)

"""Poses and speeds of an arm's links in the world, by Pinocchio."""

from collections.abc import Collection, Sequence

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.base.urdf.shafts import Shafts


class LinkMotions:
    """The links of a robot description, by the positions of its shafts.

    Attributes:
        names: of the links, the base first.

    Args:
        urdf: the description.
        joint_names: shafts, in the order of all arrays.
        hidden: links that `names` leaves out.
    """

    def __init__(self, urdf: str, joint_names: Sequence[str], hidden: Collection[str] = ()) -> None:
        self._shafts = Shafts(urdf, joint_names)
        self._model = pin.buildModelFromXML(urdf)
        self._data = self._model.createData()
        self._joints = [
            self._model.joints[self._model.getJointId(name)] for name in self._shafts.joints
        ]
        self._frames = {
            frame.name: number
            for number, frame in enumerate(self._model.frames)
            if frame.type == pin.FrameType.BODY and frame.name not in hidden
        }
        self.names = tuple(self._frames)

    def place_links(self, q: Array, v: Array) -> None:
        """Place the links, for positions q and speeds v of the shafts (N,) [rad or m, s]."""
        shafts = self._shafts
        at, speeds = pin.neutral(self._model), np.zeros(self._model.nv)
        for joint, x, xd in zip(
            self._joints, shafts.C @ q + shafts.offset, shafts.C @ v, strict=True
        ):
            on_circle = joint.nq == 2  # a joint without end
            at[joint.idx_q : joint.idx_q + joint.nq] = (np.cos(x), np.sin(x)) if on_circle else x
            speeds[joint.idx_v] = xd
        pin.forwardKinematics(self._model, self._data, at, speeds)
        pin.updateFramePlacements(self._model, self._data)

    def get_pose(self, link: str) -> tuple[Array, Array]:
        """Return where a link was placed: p_WL (3,) [m], and x, y, z, w of its quaternion (4,)."""
        place = self._data.oMf[self._frames[link]]
        return np.array(place.translation), np.array(pin.Quaternion(place.rotation).coeffs())

    def get_twist(self, link: str) -> tuple[Array, Array]:
        """Return a link's speeds along the world's axes: of its origin [m/s], angular [rad/s]."""
        frame, axes = self._frames[link], pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        twist = pin.getFrameVelocity(self._model, self._data, frame, axes)
        return np.array(twist.linear), np.array(twist.angular)

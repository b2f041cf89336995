"""The arm in the browser: its meshes, and the way of its tool."""

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from arm_emulator.extension.base import Array, Shafts
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.page import list_package_folders, scale_to_metres

GREY = (0.75, 0.76, 0.78)
PATH = (31, 119, 180)
OVER, OVER_PATH = (1.0, 0.5, 0.05), (255, 127, 14)  # of an arm that is laid over another
OPACITY = 0.35  # of its shapes


class ArmScene:
    """An arm in a server's scene.

    Attributes:
        missing: why its shapes are not shown; empty: they are.
        size: how far it reaches from the origin where it starts [m], roughly.

    Args:
        server: of viser.
        scene: the machine.
        name: of the arm in the tree of the browser's scene.
        over: whether it is laid over another arm: in a colour of its own, and translucent.
    """

    def __init__(
        self, server: Any, scene: Scene, name: str = "/arm", *, over: bool = False
    ) -> None:
        self._server, self._name, self._over = server, name, over
        self._path: Any = None
        self._shafts = Shafts(scene.urdf, scene.joint_names)
        self._model = pin.buildModelFromXML(scene.true_urdf)
        self._data = self._model.createData()
        self.missing = ""
        try:
            self._shapes = pin.buildGeomFromUrdfString(
                self._model,
                scale_to_metres(scene.true_urdf),
                pin.GeometryType.VISUAL,
                package_dirs=list_package_folders(),
            )
        except ValueError as error:  # a mesh that this machine has not
            self._shapes, self.missing = pin.GeometryModel(), str(error).strip()
        if not self._shapes.ngeoms and not self.missing:
            self.missing = "the robot description has none"
        self._places = pin.GeometryData(self._shapes)
        self._tool = self._model.getFrameId(scene.tool, pin.FrameType.BODY)
        joints = [
            self._model.joints[self._model.getJointId(joint)] for joint in self._shafts.joints
        ]
        self._revolute = [(joint.idx_q, joint.nq == 2) for joint in joints]
        self._handles = [
            self._add_mesh(k, shape) for k, shape in enumerate(self._shapes.geometryObjects)
        ]
        self._frame = server.scene.add_frame(f"{name}/tool", axes_length=0.1, axes_radius=0.003)
        self.show_arm(scene.start)
        places = [place.translation for place in (*self._places.oMg, *self._data.oMi)]
        self.size = 0.3 + float(np.linalg.norm(places, axis=1).max(initial=0.5))

    def show_arm(self, q: Array) -> None:
        """Show the arm at positions (N,) [rad or m]."""
        at = self._complete_configuration(q)
        pin.forwardKinematics(self._model, self._data, at)
        pin.updateGeometryPlacements(self._model, self._data, self._shapes, self._places)
        tool = pin.updateFramePlacement(self._model, self._data, self._tool)
        with self._server.atomic():
            for handle, place in zip(self._handles, self._places.oMg, strict=True):
                _place_handle(handle, place)
            _place_handle(self._frame, tool)

    @property
    def p_WT(self) -> Array:
        """The tool's position (3,) [m] as it is shown."""
        return np.array(self._data.oMf[self._tool].translation)

    @property
    def wxyz_WT(self) -> tuple[float, float, float, float]:
        """The tool's orientation as a quaternion, as it is shown."""
        x, y, z, w = pin.Quaternion(self._data.oMf[self._tool].rotation).coeffs()
        return float(w), float(x), float(y), float(z)

    def locate_link(self, link: str) -> Array:
        """Return the origin of a link (3,) [m] as it is shown."""
        frame = self._model.getFrameId(link, pin.FrameType.BODY)
        return np.array(pin.updateFramePlacement(self._model, self._data, frame).translation)

    def remove_arm(self) -> None:
        """Take the arm and its way out of the scene."""
        for handle in (*self._handles, self._frame, self._path):
            if handle is not None:
                handle.remove()

    def trace_tool(self, q: Array) -> Array:
        """Return the tool's positions (K, 3) [m] at positions of the shafts (K, N)."""
        path = np.empty((len(q), 3))
        for k, row in enumerate(q):
            pin.forwardKinematics(self._model, self._data, self._complete_configuration(row))
            path[k] = pin.updateFramePlacement(self._model, self._data, self._tool).translation
        return path

    def show_path(self, q: Array) -> None:
        """Show the way of the tool through positions of the shafts (K, N)."""
        path = self.trace_tool(q)
        pieces = np.stack([path[:-1], path[1:]], axis=1)
        moving = pieces[np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1) > 1e-6]
        if len(moving):
            color = OVER_PATH if self._over else PATH
            self._path = self._server.scene.add_line_segments(
                f"{self._name}/way", moving, color, thickness=2.0, thickness_units="screen"
            )

    def _complete_configuration(self, q: Array) -> Array:
        at = pin.neutral(self._model)
        for (place, revolute), angle in zip(
            self._revolute, self._shafts.convert_to_joints(q), strict=True
        ):
            if revolute:
                at[place : place + 2] = np.cos(angle), np.sin(angle)
            else:
                at[place] = angle
        return np.asarray(at)

    def _add_mesh(self, number: int, shape: Any) -> Any:
        vertices, faces = _make_mesh(shape.geometry)
        color = (
            tuple(float(channel) for channel in shape.meshColor[:3])
            if shape.overrideMaterial
            else GREY
        )
        look = {"color": OVER, "opacity": OPACITY} if self._over else {"color": color}
        return self._server.scene.add_mesh_simple(
            f"{self._name}/{number}_{shape.name}", vertices, faces, side="double", **look
        )


def _place_handle(handle: Any, place: Any) -> None:
    x, y, z, w = pin.Quaternion(place.rotation).coeffs()
    handle.position, handle.wxyz = place.translation, (w, x, y, z)


def _make_mesh(shape: Any) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Return vertices (V, 3) and triangles (T, 3) of a shape of Pinocchio."""
    import trimesh.creation as made

    match type(shape).__name__:
        case "Box":
            mesh = made.box(2.0 * shape.halfSide)
        case "Sphere":
            mesh = made.icosphere(radius=shape.radius)
        case "Cylinder":
            mesh = made.cylinder(shape.radius, 2.0 * shape.halfLength)
        case "Capsule":
            mesh = made.capsule(2.0 * shape.halfLength, shape.radius)
        case _:
            triangles = [shape.tri_indices(k) for k in range(shape.num_tris)]
            faces = np.array(
                [[triangle[0], triangle[1], triangle[2]] for triangle in triangles], np.uint32
            )
            return np.asarray(shape.vertices(), np.float32), faces
    return np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)

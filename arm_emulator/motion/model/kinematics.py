"""Kinematics of an arm's tool, by Pinocchio."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.base.urdf.shafts import Shafts, read_shafts
from arm_emulator.base.urdf.urdf_text import UNLIMITED
from arm_emulator.base.validation.bound import POSITION, TOOL_POSITION
from arm_emulator.base.validation.coerce import coerce_kind
from arm_emulator.base.validation.number import Number
from arm_emulator.motion.model.pinocchio_model import (
    JOINT,
    LINK,
    build_full_model,
    list_links,
    read_rate_limits,
)
from arm_emulator.motion.model.pose import Pose

_Q = POSITION.rename("q")
_REACH = TOOL_POSITION.rename("the length of the arm")
_TARGET_ROTATION = Number.bound_size(
    "the rotation", "", 1.001
)  # no entry is larger, up to rounding

# A joint of a redundant arm that is so many times as slow as the others is spared, in proportion.
SLOW, MIN_SHARE = 10.0, 0.1

POSITION_ROWS = 3
POSE_ROWS = 6


class Kinematics(SharedObject):
    """Tool pose, Jacobian and joint limits of any arm, or of a tree of arms with one tool.

    Tool errors and Jacobians have the rows of the task: translation, then in a pose task the
    rotation, both along the world's axes at the tool.

    Args:
        urdf_xml: the robot description. Moving joints that are not in `joint_names` stay at their
            neutral position.
        joint_names: the joints commanded, in the order of all arrays.
        tool: link (or any frame of the URDF) that is the tool.
        task: "position", "pose", or "auto": pose from 6 joints on.
        where: what to call what asks for these joints and this tool in refusals.

    Attributes:
        urdf_xml: the robot description.
        rows: of the task, 3 or 6.
        has_orientation: whether the task rules the tool's orientation.
        to_tool: whether a joint moves the tool, (N,): a second arm or a gripper does not.
        reach: length of the chain from its first joint to the tool, with what limited joints slide
            [m].
        shafts: which joints go with the coordinates that are commanded.
        links: names of the robot's links, the base first.
        base: link that stands in the world, in whose frame poses are given.
        scale: of the rows of the task, (rows,): translations are divided by `reach`, so that all
            entries of a scaled Jacobian are rad per rad.
        joint_scale: of the joints, (N,): 1 for one that turns, `reach` for one that slides.
        step_scale: the same, and less of slow joints where others can do without them, (N,).
        continuous: whether a joint is the same again after a turn, (N,).
        lower, upper: position limits, (N,) each [rad or m]; infinite without a limit.
        velocity_limit, acceleration_limit, effort_limit: (N,) each, in rad or m, s, and N m or N;
            infinite without a limit.

    Raises:
        Refusal: a description, name or value that is not taken.
    """

    def __init__(
        self,
        urdf_xml: str,
        joint_names: Sequence[str],
        tool: str,
        task: str = "auto",
        where: str = "motion_controller",
    ) -> None:
        for name, text in (("urdf_xml", urdf_xml), ("tool", tool)):
            if not isinstance(text, str):
                raise Refusal("Kinematics", name, "be text", text)
        if isinstance(joint_names, str) or not isinstance(joint_names, Iterable):
            raise Refusal("Kinematics", "joint_names", "be several, as in a tuple", joint_names)
        self.urdf_xml = urdf_xml
        self.joint_names = tuple(joint_names)
        self.tool = tool
        self.shafts = Shafts(urdf_xml, self.joint_names, tool)
        self.model = build_arm_model(urdf_xml, self.joint_names, self.shafts.joints, tool, where)
        self._data = self.model.createData()
        self._joints = [
            self.model.joints[self.model.getJointId(JOINT + n)] for n in self.shafts.joints
        ]
        self._columns = [joint.idx_v for joint in self._joints]
        self._turning = np.array([joint.nq == 2 for joint in self._joints])
        alone = np.count_nonzero(self.shafts.C, axis=0) == 1
        self.continuous = self._turning[: len(alone)] & alone
        self._places = np.array([joint.idx_q for joint in self._joints])
        self._neutral = pin.neutral(self.model)
        self._frame = find_tool_frame(self.model, tool, where)
        self.to_tool = self._find_tool_joints()
        self.rows = _count_rows(task, int(self.to_tool.sum()), where)
        self.has_orientation = self.rows == POSE_ROWS
        self._of_tool: Kinematics | None = None
        if not self.to_tool.all():
            names = [name for name, on in zip(joint_names, self.to_tool, strict=True) if on]
            self._of_tool = Kinematics(urdf_xml, names, tool, task, where)
        self.lower, self.upper = self._read_position_limits()
        rates = read_rate_limits(urdf_xml)
        moved = [rates[name] for name in self.shafts.joints]
        self.velocity_limit = self.shafts.bound_rates(np.array([limit.velocity for limit in moved]))
        self.acceleration_limit = self.shafts.bound_rates(
            np.array([limit.acceleration for limit in moved])
        )
        # Limit of a drive: a torque of its shaft, whichever joints it moves.
        self.effort_limit = np.array([rates[name].effort for name in self.joint_names])
        self.reach = self._measure_reach()
        _REACH.check_values("robot_description", [self.reach])
        pin.framesForwardKinematics(self.model, self._data, self._neutral)
        R_WT, p_WT = self._data.oMf[self._frame].rotation, self._data.oMf[self._frame].translation
        TOOL_POSITION.rename("tool").check_values("robot_description", p_WT.tolist())
        _TARGET_ROTATION.check_values("robot_description", np.ravel(R_WT).tolist())
        self.links = tuple(list_links(self.model))
        self.base = self.links[0]
        self.scale = np.ones(self.rows)
        self.scale[:POSITION_ROWS] = 1.0 / self.reach
        slides = [_is_sliding(joint) for joint in self._joints[: len(self.joint_names)]]
        self.joint_scale = np.where(slides, self.reach, 1.0)
        self.step_scale = self._step_scale()

    @property
    def of_tool(self) -> Kinematics:
        """Kinematics of only the joints that move the tool."""
        return self._of_tool or self

    @property
    def is_redundant(self) -> bool:
        """Whether more joints move the tool than the task has rows."""
        return int(self.to_tool.sum()) > self.rows

    def __repr__(self) -> str:
        return f"<Kinematics of {', '.join(self.joint_names)} to {self.tool}>"

    def __reduce__(self) -> tuple[Any, ...]:
        task = "pose" if self.has_orientation else "position"
        return Kinematics, (self.urdf_xml, self.joint_names, self.tool, task)

    def forward(self, q: npt.ArrayLike) -> tuple[Array, Array]:
        """Return the tool's pose: ``R_WT`` (3, 3) and ``p_WT`` (3,) [m]."""
        pin.framesForwardKinematics(self.model, self._data, self._compute_configuration(q))
        placement = self._data.oMf[self._frame]
        return placement.rotation.copy(), placement.translation.copy()

    def axes(self, link: str, q: npt.ArrayLike) -> Array:
        """Return the orientation R_WL of a link, or of the tool, at q, (3, 3).

        Raises:
            Refusal: no such link; or see `vector`.
        """
        link = coerce_kind(link, str, "Kinematics.axes", "link", "be the name of a link")
        if link == self.tool:
            return self.forward(q)[0]
        if not self.model.existFrame(LINK + link, pin.FrameType.BODY):
            raise Refusal("Kinematics.axes", "link", "be of the robot", link)
        number = self.model.getFrameId(LINK + link, pin.FrameType.BODY)
        pin.framesForwardKinematics(self.model, self._data, self._compute_configuration(q))
        axes: Array = self._data.oMf[number].rotation.copy()
        return axes

    def jacobian(self, q: npt.ArrayLike) -> Array:
        """Return J(q), (rows, N) [m/rad, rad/rad], along the world's axes at the tool."""
        return self._compute_jacobian(self._compute_configuration(q))

    def tool_error(self, q: npt.ArrayLike, target: Pose) -> Array:
        """Return ``X_target - X(q)``, (rows,) [m, rad]."""
        return self._compute_tool_error(*self.forward(q), target)

    def compute_error_and_jacobian(self, q: npt.ArrayLike, target: Pose) -> tuple[Array, Array]:
        """Return `tool_error` and `jacobian` at the cost of one of them."""
        J = self._compute_jacobian(self._compute_configuration(q))
        placement = pin.updateFramePlacement(self.model, self._data, self._frame)
        return self._compute_tool_error(placement.rotation, placement.translation, target), J

    def _compute_jacobian(self, configuration: Array) -> Array:
        J = pin.computeFrameJacobian(
            self.model,
            self._data,
            configuration,
            self._frame,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
        )
        J = np.reshape(J, (POSE_ROWS, -1))  # of a single joint it comes as a vector
        rows: Array = J[: self.rows, self._columns]
        return self.shafts.convert_columns(rows)

    def _compute_tool_error(self, R_WT: Array, p_WT: Array, target: Pose) -> Array:
        error = coerce_kind(target, Pose, "Kinematics", "target", "be a Pose").p_WT - p_WT
        if self.rows == POSITION_ROWS:
            return error
        both: Array = np.concatenate([error, pin.log3(target.R_WT @ R_WT.T)])
        return both

    def singular_values(self, q: npt.ArrayLike) -> Array:
        """Return the singular values of the scaled Jacobian, largest first [rad/rad]."""
        scaled = self.jacobian(q)[:, self.to_tool] * self.scale[:, None]
        return np.asarray(np.linalg.svd(scaled, compute_uv=False), dtype=np.float64)

    def vector(self, q: npt.ArrayLike) -> Array:
        """Return joint angles as an array (N,).

        Raises:
            Refusal: a wrong length, not finite or too large.
        """
        return _Q.check_row("Kinematics", q, len(self.joint_names))

    def _compute_configuration(self, q: npt.ArrayLike) -> Array:
        """Return Pinocchio's configuration: a continuous joint has cos and sin there."""
        q = self.shafts.convert_to_joints(self.vector(q))
        configuration: Array = self._neutral.copy()
        configuration[self._places] = q
        turning = self._turning
        if turning.any():
            configuration[self._places[turning]] = np.cos(q[turning])
            configuration[self._places[turning] + 1] = np.sin(q[turning])
        return configuration

    def _step_scale(self) -> Array:
        """Return by how much the joints move towards a target, relative to each other (N,)."""
        speeds = self.velocity_limit / self.joint_scale
        median = float(np.median(speeds[self.to_tool])) if self.to_tool.any() else np.inf
        if self.to_tool.sum() <= self.rows or not np.isfinite(median):
            return self.joint_scale  # nothing to choose from, or nothing known
        share: Array = np.clip(SLOW * speeds / median, MIN_SHARE, 1.0)
        return share * self.joint_scale

    def _read_position_limits(self) -> tuple[Array, Array]:
        """Return the position limits of the URDF, (N,) each; a continuous joint has none."""
        bounds = [
            (-math.inf, math.inf)
            if joint.nq == 2
            else (
                self.model.lowerPositionLimit[joint.idx_q],
                self.model.upperPositionLimit[joint.idx_q],
            )
            for joint in self._joints
        ]
        lower, upper = self.shafts.bound_positions(*np.array(bounds, dtype=np.float64).T)
        return lower, upper

    def _find_tool_joints(self) -> npt.NDArray[np.bool_]:
        """Return which joints move the tool (N,); where none does, all."""
        joint, chain = self.model.frames[self._frame].parentJoint, set[str]()
        while joint > 0:
            chain.add(self.model.names[joint].removeprefix(JOINT))
            joint = self.model.parents[joint]
        on_chain = np.array([name in chain for name in self.shafts.joints])
        moved = np.asarray((self.shafts.C[on_chain] != 0.0).any(axis=0))
        return moved if moved.any() else ~moved

    def _measure_reach(self) -> float:
        frame = self.model.frames[self._frame]
        length = math.hypot(*frame.placement.translation)
        joint = frame.parentJoint
        while joint > 0:
            if self.model.parents[joint] > 0:
                length += math.hypot(*self.model.jointPlacements[joint].translation)
            if _is_sliding(self.model.joints[joint]):
                place = self.model.joints[joint].idx_q
                travel = max(
                    abs(self.model.lowerPositionLimit[place]),
                    abs(self.model.upperPositionLimit[place]),
                )
                length += travel if travel < UNLIMITED else 0.0
            joint = self.model.parents[joint]
        return length or 1.0


def _is_sliding(joint: Any) -> bool:
    return bool(joint.shortname().removeprefix("JointModel").startswith("P"))


def list_moving_joints(urdf_xml: str) -> tuple[str, ...]:
    """Return the joints of a robot description that are commanded, base to tool.

    Mimic joints are not among them.

    Raises:
        Refusal: not a robot description, or one that Pinocchio does not take.
    """
    return read_shafts(_list_moving(build_full_model(urdf_xml)), urdf_xml)


def _count_rows(task: str, joints: int, where: str) -> int:
    """Return the number of task rows."""
    tasks = {
        "auto": POSE_ROWS if joints >= POSE_ROWS else POSITION_ROWS,
        "position": POSITION_ROWS,
        "pose": POSE_ROWS,
    }
    if task not in tasks:
        raise Refusal(where, "task", "be known", task, ", ".join(tasks))
    return tasks[task]


def _list_moving(model: Any) -> tuple[str, ...]:
    return tuple(name.removeprefix(JOINT) for name in list(model.names)[1:])


def build_arm_model(
    urdf_xml: str,
    joint_names: tuple[str, ...],
    moved: tuple[str, ...],
    tool: str,
    where: str,
    masses: bool = False,
) -> Any:
    """Return the Pinocchio model whose moving joints are exactly `moved`."""
    model = build_full_model(urdf_xml, tool, masses)
    moving = _list_moving(model)
    for name in joint_names:
        if name not in moving:
            raise Refusal(
                where,
                "joint_names",
                "be moving joints of the robot description",
                name,
                ", ".join(moving),
            )
    if not joint_names or len(set(joint_names)) != len(joint_names):
        raise Refusal(where, "joint_names", "be different names", joint_names)
    locked = [model.getJointId(JOINT + name) for name in moving if name not in moved]
    model = pin.buildReducedModel(model, locked, pin.neutral(model))
    for name in joint_names:
        if model.joints[model.getJointId(JOINT + name)].nv != 1:
            raise Refusal(where, name, "have one degree of freedom", "more")
    return model


def find_tool_frame(model: Any, tool: str, where: str) -> int:
    """Return the index of the link (or other frame) `tool`."""
    for name, kind in (
        (LINK + tool, pin.FrameType.BODY),
        (JOINT + tool, pin.FrameType.FIXED_JOINT),
    ):
        if model.existFrame(name, kind):
            return int(model.getFrameId(name, kind))
    raise Refusal(
        where,
        "tool",
        "be a link of the robot description",
        tool,
        ", ".join(list_links(model)),
    )

"""An arm led from pose to pose by its motion controller, and what is measured where it rests."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from arm_emulator.extension.base import Array, Refusal
from arm_emulator.extension.machine import Scene
from arm_emulator.extension.runs import Gains, MotionState, OfflineRun, Pose
from arm_emulator_identification.calibration import iso_9283

PATIENCE = 30.0  # s, for one pose


@dataclass(frozen=True)
class ToolRest:
    """The arm at rest in a pose."""

    q: Array  # positions of the links as motion control takes them to be (N,) [rad or m]
    R: Array  # true orientation of the tool (3, 3)
    p: Array  # its true position (3,) [m]


class LedArm:
    """A machine with its servo and its motion controller.

    Args:
        scene: the machine.
        gains: of servo and motion controller.
        dwell: time at rest before a pose is measured [s].
        calibration: file that corrects the controller's description; None: it is nominal.
    """

    def __init__(
        self, scene: Scene, gains: Gains, dwell: float, calibration: Path | None = None
    ) -> None:
        motion = gains.motion
        if calibration is not None:
            motion = replace(motion, calibration=str(calibration.resolve()))
        self.run = OfflineRun(scene, gains.servo, motion)
        self._dwell = max(1, round(dwell / scene.servo_period))
        self._patience = round(PATIENCE / scene.servo_period)
        names = self.run.controller.kinematics.joint_names
        self._order = [gains.servo.joint_names.index(name) for name in scene.joint_names]
        self.lower, self.upper = (
            bounds[[names.index(name) for name in scene.joint_names]]
            for bounds in (self.run.controller.kinematics.lower,
                           self.run.controller.kinematics.upper)
        )  # fmt: skip

    def compute_pose(self, q: Array) -> Pose:
        """Return the pose of the tool by the controller's description."""
        kinematics = self.run.controller.kinematics
        names = self.run.session.scene.joint_names
        R, p = kinematics.forward(q[[names.index(name) for name in kinematics.joint_names]])
        return Pose(p, R)

    def move_tool(self, pose: Pose) -> ToolRest | None:
        """Lead the tool to a pose and wait there; None: the controller does not reach it."""
        run = self.run
        run.instructor.add(run.session.logical_ns, pose)
        end = run.session.tick + self._patience
        run.advance(run.motion_ticks)
        while run.instructor.progress.state is not MotionState.REACHED:
            if run.instructor.progress.state.is_final or run.session.tick > end:
                return None
            run.advance(run.motion_ticks)
        run.advance(self._dwell)
        R, p = run.true_tool
        measured = run.drives.servo.q_measured - run.wind_up
        return ToolRest(measured[self._order], R, p)


@dataclass(frozen=True)
class Attained:
    """Rests of the arm in the poses of ISO 9283, a list per pose."""

    poses: tuple[Pose, ...]
    rests: tuple[list[ToolRest], ...]

    def judge_poses(self) -> list[iso_9283.PoseCharacteristics]:
        """Return the characteristics of each pose."""
        return [
            iso_9283.judge_pose(
                (pose.R_WT, pose.p_WT),
                np.array([rest.p for rest in rests]),
                np.array([rest.R for rest in rests]),
            )
            for pose, rests in zip(self.poses, self.rests, strict=True)
        ]


def find_cube(
    scene: Scene,
    gains: Gains,
    dwell: float,
    centre: tuple[float, float, float] | None,
    edge: float | None,
) -> tuple[Pose, ...]:
    """Return the five poses, oriented as at the start, in the largest cube that the arm reaches.

    Args:
        scene: the machine.
        gains: of its servo and motion controller.
        dwell: time at rest in a pose [s].
        centre: of the cube [m]; None: the tool's place at the start.
        edge: of the cube [m]; None: of those of the norm the largest.

    Raises:
        Refusal: it reaches none, or not the one whose edge is given [m].
    """
    for size in iso_9283.EDGES if edge is None else (edge,):
        arm = LedArm(scene, gains, dwell)
        start = arm.compute_pose(scene.start)
        middle = start.p_WT if centre is None else np.array(centre)
        places = iso_9283.place_poses(middle, size)
        poses = tuple(Pose(p, start.R_WT) for p in places)
        if all(arm.move_tool(pose) is not None for pose in (*poses, poses[0])):
            return poses
    if edge is not None:
        rule = "leave five poses about the centre within the arm's reach"
        raise Refusal("accuracy", "--edge", rule, edge)
    rule = f"have a cube of {iso_9283.EDGES[-1]:g} m about it within the arm's reach"
    place = " ".join(f"{x:.4g}" for x in middle)
    got = f"{place}, the tool's place at the start" if centre is None else place
    raise Refusal("accuracy", "--centre", rule, got, "another centre, or a smaller --edge")


def visit_cube(arm: LedArm, poses: tuple[Pose, ...], cycles: int) -> Attained:
    """Return the rests in the poses of a cube, visited in turn; the first cycle warms up."""
    rests = tuple(list[ToolRest]() for _ in poses)
    for cycle in range(cycles + 1):
        for pose, rests_of_pose in zip(poses, rests, strict=True):
            rest = _require_rest(arm.move_tool(pose))
            if cycle:
                rests_of_pose.append(rest)
    return Attained(poses, rests)


def visit_from_directions(arm: LedArm, poses: tuple[Pose, ...], edge: float, cycles: int) -> float:
    """Return the largest vAP [m] of P1, P2 and P4, approached along x, y and z."""
    largest = 0.0
    for place in iso_9283.DIRECTED:
        pose, rows = poses[place], []
        for axis in np.eye(3):
            inward = -1.0 if axis @ (pose.p_WT - poses[0].p_WT) > 0.0 else 1.0
            before = Pose(pose.p_WT + 0.2 * edge * inward * axis, pose.R_WT)
            reached = []
            for _ in range(cycles):
                _require_rest(arm.move_tool(before))
                reached.append(_require_rest(arm.move_tool(pose)).p)
            rows.append(np.array(reached))
        largest = max(largest, iso_9283.compute_direction_deviation(rows))
    return largest


def visit_at_random(arm: LedArm, count: int, rng: np.random.Generator) -> Iterator[ToolRest]:
    """Yield rests in random poses, until there are enough of them.

    Joint positions are drawn within the limits, at most half a turn from the start; poses that
    motion control does not reach, as it stops before a collision, are left out.
    """
    start = arm.run.session.scene.start
    low = np.maximum(arm.lower, start - np.pi)
    high = np.minimum(arm.upper, start + np.pi)
    margin = 0.05 * (high - low)
    left, tries = count, 20 * count
    while left and tries:
        tries -= 1
        q = rng.uniform(low + margin, high - margin)
        rest = arm.move_tool(arm.compute_pose(q))
        if rest is not None:
            left -= 1
            yield rest
    if left:
        rule = f"leave {count} poses that the arm reaches"
        raise Refusal("accuracy", "--fit", rule, f"{count - left} of {20 * count} drawn")


def measure_pose(rest: ToolRest, p: float, angle: float, rng: np.random.Generator) -> ToolRest:
    """Return a rest as a tracker measures it, with normal noise p [m] and angle [rad] per axis."""
    turned = Rotation.from_rotvec(rng.normal(0.0, angle, 3)).as_matrix() @ rest.R
    return ToolRest(rest.q, turned, rest.p + rng.normal(0.0, p, 3))


def _require_rest(rest: ToolRest | None) -> ToolRest:
    if rest is None:
        rule = "be reached in each cycle as in the first"
        raise Refusal("accuracy", "pose of the cube", rule, "not reached")
    return rest

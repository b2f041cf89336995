"""Accuracy of an arm by ISO 9283, and what a calibration from measured poses makes of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arm_emulator.extension.base import Array, write_atomically
from arm_emulator.extension.machine import Deviation, Scene
from arm_emulator.extension.runs import Gains
from arm_emulator_identification.calibration.iso_9283 import PoseCharacteristics
from arm_emulator_identification.calibration.led_arm import (
    LedArm,
    ToolRest,
    find_cube,
    measure_pose,
    visit_at_random,
    visit_cube,
    visit_from_directions,
)
from arm_emulator_identification.calibration.pose_fit import (
    PoseFit,
    PoseModel,
    compare_poses,
    estimate_scale,
    fit_poses,
)


@dataclass(frozen=True)
class AccuracyTest:
    """Measurements to make.

    Attributes:
        cycles: of the five poses.
        centre: of the cube [m]; None: the tool's place at the start.
        edge: of the cube [m]; None: the largest that is reached.
        dwell: time at rest before a pose is measured [s].
        directions: whether P1, P2 and P4 are approached from three directions.
        poses: random poses of the fit; 0: no fit.
        held: further ones, which judge it.
        tracker: standard deviation of measured positions [m].
        tracker_angle: of measured turns [rad]; inf: they are not measured.
        seed: of poses and noise.
    """

    cycles: int
    centre: tuple[float, float, float] | None
    edge: float | None
    dwell: float
    directions: bool
    poses: int
    held: int
    tracker: float
    tracker_angle: float
    seed: int


@dataclass(frozen=True)
class Accuracy:
    """Characteristics of the five poses; before the calibration, or after it."""

    poses: list[PoseCharacteristics]
    vAP: float | None  # [m]

    @property
    def AP(self) -> float:
        """The largest pose accuracy [m]."""
        return max(pose.AP for pose in self.poses)

    @property
    def RP(self) -> float:
        """The largest pose repeatability [m]."""
        return max(pose.RP for pose in self.poses)


@dataclass(frozen=True)
class Calibrated:
    """A fit and what it explains.

    Attributes:
        fit: the deviations found.
        before, after: by how much the nominal and the fitted model miss the held poses (K,): in
            position [m], in orientation [rad].
        file: the calibration, as a motion controller takes it.
    """

    fit: PoseFit
    before: tuple[Array, Array]
    after: tuple[Array, Array]
    file: Path


def measure_accuracy(
    scene: Scene, gains: Gains, test: AccuracyTest, stage: Callable[[str], None], file: Path
) -> tuple[float, Accuracy, Calibrated | None, Accuracy | None]:
    """Return the cube's edge [m], accuracy before, the calibration, and accuracy after it.

    Raises:
        Refusal: the arm does not reach the poses.
    """
    stage("cube")
    poses = find_cube(scene, gains, test.dwell, test.centre, test.edge)
    edge = float(np.abs(poses[1].p_WT - poses[3].p_WT)[0]) / 0.8
    stage("before")

    def judge_arm(calibration: Path | None) -> Accuracy:
        attained = visit_cube(LedArm(scene, gains, test.dwell, calibration), poses, test.cycles)
        if not test.directions:
            return Accuracy(attained.judge_poses(), None)
        arm = LedArm(scene, gains, test.dwell, calibration)
        return Accuracy(
            attained.judge_poses(), visit_from_directions(arm, poses, edge, test.cycles)
        )

    before = judge_arm(None)
    if not test.poses:
        return edge, before, None, None
    stage("random poses")
    calibrated = calibrate_arm(scene, gains, test, file)
    stage("after")
    return edge, before, calibrated, judge_arm(calibrated.file)


def calibrate_arm(scene: Scene, gains: Gains, test: AccuracyTest, file: Path) -> Calibrated:
    """Return the deviations that a tracker's poses show, written into a file."""
    rng = np.random.default_rng(test.seed)
    arm = LedArm(scene, gains, test.dwell)
    rests: list[ToolRest] = [
        measure_pose(rest, test.tracker, _replace_nan(test.tracker_angle), rng)
        for rest in visit_at_random(arm, test.poses + test.held, rng)
    ]
    fitted, checked = rests[: test.poses], rests[test.poses :]
    model = PoseModel(scene.urdf, scene.joint_names, scene.tool)
    sigma = test.tracker, test.tracker_angle
    fit = fit_poses(model, fitted, sigma)
    scale = estimate_scale(model, fit, fitted, sigma)
    fit = fit_poses(model, fitted, (scale * sigma[0], scale * sigma[1]))
    write_calibration(file, fit.deviations)
    judged = checked or fitted
    return Calibrated(
        fit, compare_poses(model, {}, judged), compare_poses(model, fit.displacements, judged), file
    )


def write_calibration(file: Path, deviations: Mapping[str, Deviation]) -> None:
    """Write deviations as a scene's `calibration.file` and motion controllers take them."""
    lines = ["# Deviations of the joints from the description: m, rad", "joints:"]
    for name, deviation in deviations.items():
        numbers = ", ".join(f"{key}: {value!r}" for key, value in deviation.nonzero.items())
        lines.append(f'  "{name}": {{{numbers}}}')
    write_atomically(file, "\n".join(lines) + "\n")


def _replace_nan(angle: float) -> float:
    """Return the noise of turns; 0 where they are not measured."""
    return angle if np.isfinite(angle) else 0.0

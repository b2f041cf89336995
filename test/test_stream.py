"""Tool targets at a high rate: the tool keeps up with them, and rests at the last."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from draws import some

from arm_emulator.base.config_files import find_scene
from arm_emulator.machine.scene import load_scene
from arm_emulator.motion.motion_report import State
from arm_emulator.motion.pose import Pose
from arm_emulator.runs.gains import load_gains
from arm_emulator.runs.offline import OfflineRun

SPEED = 0.3  # m/s
BEHIND = 5e-3  # m, what is promised at that speed


class Streamed:
    """An arm that gets a target every so often, through the whole machine."""

    def __init__(self, scene_name: str) -> None:
        file = find_scene(scene_name)
        self.scene, gains = load_scene(file), load_gains(file)
        self.run = OfflineRun(self.scene, gains.servo, gains.motion)
        self.kinematics = self.run.controller.kinematics
        self.run.advance(1000)
        self.R_WT, self.p_WT = self.kinematics.forward(self.scene.start)
        self.behind: list[float] = []

    def follow(self, at: Callable[[float], np.ndarray], seconds: float, rate: float) -> None:
        """Send `at(t)` as seen from the start, and note how far the true tool is behind."""
        ticks = round(1.0 / rate / self.scene.servo_period)
        for k in range(round(seconds * rate)):
            self.run.instructor.add(0, Pose(self.p_WT + at(k / rate), self.R_WT))
            self.run.advance(ticks)
            self.behind.append(float(np.linalg.norm(self.tool() - at((k + 1) / rate))))

    def tool(self) -> np.ndarray:
        """Return the position of the true tool, relative to the start."""
        return self.kinematics.forward(self.run.session.state.q)[1] - self.p_WT


def curve(rng: np.random.Generator) -> Callable[[float], np.ndarray]:
    """A drawn ellipse about a drawn axis that takes up `SPEED` within half a second."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]
    sizes = rng.uniform(0.06, 0.12, 2)
    rate = SPEED / sizes.max()

    def at(t: float) -> np.ndarray:
        phase = rate * (t * t if t < 0.5 else t - 0.25)
        return np.array(
            axes.T @ (sizes * np.array([np.sin(phase), 1.0 - np.cos(phase)])), dtype=np.float64
        )

    return at


@pytest.mark.parametrize("seed", some(range(30), 3))
@pytest.mark.parametrize("scene", ["ur5", "panda"])
def test_a_stream_is_followed_closely(scene: str, seed: int) -> None:
    """200 Hz at 0.3 m/s; then the tool rests where the stream has ended."""
    arm = Streamed(scene)
    at = curve(np.random.default_rng(seed))
    arm.follow(at, 2.5, 200.0)
    assert max(arm.behind) < BEHIND
    arm.run.advance(2000)
    assert arm.run.instructor.reports.take()[-1].state is State.REACHED
    assert np.linalg.norm(arm.tool() - at(2.5 - 1.0 / 200.0)) < 5e-4


def test_single_targets_are_no_stream() -> None:
    """Targets far apart, or with pauses between them, are gone to and rested at as ever."""
    arm = Streamed("ur5")
    for k in range(4):  # 50 ms apart, but a jump each time
        arm.run.instructor.add(0, Pose(arm.p_WT + np.array([0.0, 0.2 * (-1) ** k, 0.0]), arm.R_WT))
        arm.run.advance(50)
    arm.run.advance(3000)
    assert np.linalg.norm(arm.tool() - [0.0, -0.2, 0.0]) < 5e-4
    assert np.abs(arm.run.session.state.v).max() < 1e-3


def test_a_stream_that_stops_short_does_not_run_on() -> None:
    """Targets that stand after a fast stream: the tool passes them by what braking takes, once."""
    arm = Streamed("ur5")
    arm.follow(lambda t: np.array([0.0, SPEED * min(t, 0.5), 0.0]), 2.0, 200.0)
    tool = arm.tool()
    assert np.linalg.norm(tool - [0.0, 0.15, 0.0]) < 1e-3
    # 0.3 m/s are left within 0.3 / (2 x 8 m/s2) s and the 50 ms that the acceleration takes.
    assert max(arm.behind[110:]) < 0.03

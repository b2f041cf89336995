"""Whether a run has reached its goal: the joints' last target, or the motion controller's order."""

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.session.session import Session
from arm_emulator.motion.executor.goal_status import GoalProgress, GoalState, describe_left
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.target_table import TargetTable

# rad, or of the arm's length for a joint that slides: a tenth of the error of a servo without
# integral part is far below it. An arm that fell, or met a stop, is far beyond it.
NEAR = 0.01


def find_last_target(scene: Scene, targets: TargetTable, ticks: int) -> Array:
    """Return the joint targets that hold after so many ticks (N,) [rad or m]."""
    begun = sum(tick < ticks for tick in targets.compute_ticks(scene.servo_period))
    return np.asarray(targets.q[begun - 1] if begun else scene.start)


def find_missed_target(session: Session, q_target: Array) -> str:
    """Return as text which joint is not at its target (N,) [rad or m]; empty: all are near."""
    scene = session.scene
    scale = Kinematics(scene.urdf, scene.joint_names, scene.tool).joint_scale
    off = np.abs(session.state.q - q_target)
    j = int(np.argmax(off / scale))
    if off[j] <= NEAR * scale[j]:
        return ""
    unit = "rad" if scale[j] == 1.0 else "m"
    return (
        f"joint {scene.joint_names[j]} is {off[j]:.3g} {unit} off its target, "
        f"more than {NEAR * scale[j]:.3g}"
    )


def find_missed_order(run: OfflineRun) -> str:
    """Return as text why the motion controller's newest order is not reached; empty: it is."""
    executor = run.instructor
    newest, now = executor.reports.newest, executor.progress
    if newest is None:
        return "it was not taken"
    if newest.state is not GoalState.REACHED:
        is_unfinished = not newest.state.is_final
        if is_unfinished and executor.waits_for:
            return f"{newest.state.name.lower()}: {executor.waits_for}"
        return _describe_progress(newest.state, now if is_unfinished else newest)
    if now.state is GoalState.REACHED:
        return ""
    return f"reached, and left again, {_describe_progress(now.state, now)}"


def _describe_progress(state: GoalState, progress: GoalProgress) -> str:
    why = f": {progress.reason}" if progress.reason else ""
    return f"{state.name.lower()}{describe_left(progress.distance, progress.angle)}{why}"

"""Rest of the tool, predicted: the plan is carried out in one process before the network moves it.

Arithmetic is portable, so that a network in lock-step ends there to the last bit.
"""

from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.executor.goal_status import GoalState
from arm_emulator.runs.gains import Gains
from arm_emulator.runs.goal import find_missed_order
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.order import MoveTool

NEAR = 0.01  # of the way to the target: how near a network in real time comes to the prediction

_WORDS = {GoalState.UNREACHABLE: "out of reach", GoalState.MOVING: "not yet there"}


@dataclass(frozen=True, eq=False)
class PredictedRest:
    """Outcome of the plan in one process."""

    deviations: Array
    """Target minus true tool before instruction 0 .. K, (K + 1, 3) [m]."""
    target: str
    """Result of the target, by motion control: reached, out of reach, not yet there, ..."""
    missed: str
    """Why motion control has not reached the target; empty if it has."""

    def describe_miss(self, deviations: Array, exact: bool) -> str:
        """Return as text why a network misses target or prediction; empty if it meets both.

        Args:
            deviations: of the network, as those of the plan.
            exact: whether it must rest at the predicted place to the last bit.
        """
        off = float(np.linalg.norm(deviations[-1] - self.deviations[-1]))
        if off > (0.0 if exact else NEAR * float(np.linalg.norm(self.deviations[0]))):
            return f"the tool rests {off * 1e3:.4g} mm beside the predicted place"
        return self.missed and f"the target is {self.target}, as predicted: {self.missed}"


def predict_rest(scene: Scene, gains: Gains, plan: DemoPlan) -> PredictedRest:
    """Return the outcome of a plan.

    Raises:
        Diverged: the machine diverges on the way.
    """
    run = OfflineRun(scene, gains.servo, gains.motion)
    x, y, z = plan.displacement.tolist()
    target = MoveTool((x, y, z)).target(run)
    run.instructor.add(plan.settle_ns, target)
    run.advance(plan.settle_ns // run.session.period_ns)
    deviations = [target.p_WT - run.true_tool[1]]
    for _ in range(plan.instructions):
        run.advance(run.motion_ticks)
        deviations.append(target.p_WT - run.true_tool[1])
    newest = run.instructor.reports.newest
    state = GoalState.REFUSED if newest is None else newest.state
    words = _WORDS.get(state, state.name.lower())
    return PredictedRest(np.array(deviations), words, find_missed_order(run))

"""Instructions to the servo, one per motion period: what holds now, and the control law for it."""

from __future__ import annotations

import bisect

import numpy as np

from motion_controller_node.controller import Controller
from motion_controller_node.instruction import FloatArray, Instruction
from motion_controller_node.pose import Pose
from words.bound import EFFORT, POSITION, VELOCITY
from words.refusal import Refusal

MOST_TARGETS = 10_000  # that wait for their time
_Q = POSITION.named("q")
_Q_TARGET = POSITION.named("q_target")
_V_TARGET = VELOCITY.named("v_target")
_TAU = EFFORT.named("tau_feedforward")


class Instructor:
    """Answers joint angles with joint targets.

    Until a tool target holds these are the angles at first; then those of the control law. When a
    target begins to hold, the law begins at rest at the angles held so far, so that nothing jumps.

    Another source of motion is added beside the tool targets: kept under the time from which it
    holds, taken up in `_take_up`, answered in `_instruct`. Of all sources the newest holds, and one
    that gives joint targets of its own leaves `_hold` where it ends.

    What it computes is checked. If it is not finite, or beyond the bound of joint positions, the
    instructor forgets everything and holds the arm where it is.

    Attributes:
        restarts: how often that happened.
        trouble: why, the last time, in words.
    """

    def __init__(self) -> None:
        self.restarts = 0
        self.trouble = ""
        self.start_over()

    def start_over(self) -> None:
        """Forget all tool targets and where the arm stood."""
        self._hold: FloatArray | None = None
        self._tool_target: Pose | None = None
        self._coming: list[tuple[int, Pose]] = []  # in the order of their times

    @property
    def holding(self) -> bool:
        """Whether no tool target holds yet."""
        return self._tool_target is None

    def add(self, time_ns: int, target: Pose) -> None:
        """Take a tool target that holds from a logical time [ns] on, until the next one does.

        Of two with the same time the newer wins; a time that is past means at once.

        Raises:
            Refusal: more targets wait for their time than are taken.
        """
        place = bisect.bisect_left(self._coming, time_ns, key=lambda item: item[0])
        if place < len(self._coming) and self._coming[place][0] == time_ns:
            self._coming[place] = (time_ns, target)
            return
        if len(self._coming) >= MOST_TARGETS:
            rule = f"be one of at most {MOST_TARGETS} that wait for their time"
            raise Refusal("tool_target", "the target", rule, "one more")
        self._coming.insert(place, (time_ns, target))

    def instruct(self, controller: Controller, time_ns: int, q: FloatArray) -> Instruction:
        """Return the joint targets at a logical time [ns].

        Args:
            controller: the control law for the arm.
            time_ns: of the joint angles; never before that of the last call.
            q: measured joint angles (N,) [rad].

        Raises:
            Refusal: q is not finite or too large; nothing has changed then.
        """
        _Q.check("motion_controller", q.tolist())
        try:
            self._take_up(controller, time_ns, q)
            instruction = self._instruct(controller, q)
            _Q_TARGET.check("motion_controller", instruction.q.tolist())
            if instruction.v is not None:
                _V_TARGET.check("motion_controller", instruction.v.tolist())
            if instruction.tau is not None:
                _TAU.check("motion_controller", instruction.tau.tolist())
        except (Refusal, ArithmeticError, np.linalg.LinAlgError) as error:
            # q is within its bound and the targets were checked when they came. What remains is
            # this object's state, or a robot description that cannot be computed with.
            self.start_over()
            self._hold = q
            instruction = Instruction(q)
            self.restarts += 1
            self.trouble = str(error)
        return instruction

    def _take_up(self, controller: Controller, time_ns: int, q: FloatArray) -> None:
        """Let what waited for its time hold from now on."""
        while self._coming and self._coming[0][0] <= time_ns:
            if self._tool_target is None:
                controller.begin(q if self._hold is None else self._hold)
            self._tool_target = self._coming.pop(0)[1]

    def _instruct(self, controller: Controller, q: FloatArray) -> Instruction:
        if self._tool_target is not None:
            return controller.update(q, self._tool_target)
        if self._hold is None:
            self._hold = q
        return Instruction(self._hold)

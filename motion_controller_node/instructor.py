"""Instructions to the servo, one per motion period: which tool target holds, and eq. (6)."""

from __future__ import annotations

import bisect

from motion_controller_node.jacobian import FloatArray, JacobianController
from motion_controller_node.pose import Pose


class Instructor:
    """Answers joint angles with joint targets.

    Until a tool target holds these are the angles at first; then those of eq. (6).
    """

    def __init__(self) -> None:
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
        """
        bisect.insort(self._coming, (time_ns, target), key=lambda item: item[0])

    def instruct(self, controller: JacobianController, time_ns: int, q: FloatArray) -> FloatArray:
        """Return the joint targets (N,) [rad] at a logical time [ns].

        Args:
            controller: eq. (6) for the arm.
            time_ns: of the joint angles; never before that of the last call.
            q: measured joint angles (N,) [rad].

        Raises:
            Refusal: see `JacobianController.update`.
        """
        while self._coming and self._coming[0][0] <= time_ns:
            self._tool_target = self._coming.pop(0)[1]
        if self._tool_target is None:
            if self._hold is None:
                self._hold = q
            return self._hold
        return controller.update(q, self._tool_target)

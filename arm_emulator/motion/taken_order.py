"""An order that was accepted, and the reports of it."""

from __future__ import annotations

from dataclasses import dataclass

from arm_emulator.motion.motion_report import CANCELLED, MotionReport, Reports, State
from arm_emulator.motion.orders import Order, Progress


@dataclass(eq=False)
class TakenOrder:
    """An order that was accepted."""

    order: Order
    number: int
    """Number among those of its kind; 0: an internal one, without reports."""
    begins_ns: int = 0
    """Logical time at which it begins at the earliest."""
    state: State = State.ACCEPTED
    way: str = ""
    """Newest published report."""

    @property
    def replaces(self) -> Progress:
        """Progress of an order in whose place this one comes."""
        if not self.number:
            return Progress(State.ABORTED, CANCELLED)
        what = self.order.kind.name.lower().replace("_", " ")
        return Progress(State.REPLACED, f"by {what} {self.number}")

    def report(self, reports: Reports, progress: Progress, anew: bool = False) -> None:
        """Take over the state of a progress, and report what is new, or anything `anew`.

        After a final state only an unreachable target may still be reached.
        """
        later = self.state is State.UNREACHABLE and progress.state is State.REACHED
        if self.state.final and not later:
            return
        silent = progress.state is self.state is State.MOVING and not anew
        self.state = progress.state
        if silent or not self.number:
            return
        order = self.order
        reports.waiting.append(
            MotionReport(
                order.kind,
                self.number,
                order.stamp_ns,
                progress.state,
                progress.reason,
                progress.distance,
                progress.angle,
            )
        )

"""Breakpoints: logical time pauses where a condition starts to hold, or at an event."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.toolchain.c_header import NULL
from arm_emulator_msgs.srv import BreakWhen
from emulator_node.context import Context

if TYPE_CHECKING:
    from arm_emulator.runs.breakpoint import Breakpoint


class Breakpoints:
    """Reasons for which the machine of a context stops.

    Args:
        own: the context.
        catch_up: publishes all ticks that were reached.
    """

    def __init__(self, own: Context, catch_up: Callable[[], None]) -> None:
        self._catch_up = catch_up
        self._session, self._lock, self._logger = own.session, own.lock, own.node.get_logger()
        self._diagnostics, self._view = own.diagnostics, own.view
        self._breakpoint: Breakpoint | None = None
        self._on_events = self._on_refusals = False

    @property
    def stop(self) -> Any:
        """Pointer to a flag by which loops in C stop; NULL: none."""
        return NULL if self._breakpoint is None else self._breakpoint.stop

    def set_breakpoint(self, request: BreakWhen.Request) -> None:
        """Stop from now on where a request states; no tick may be under way.

        Raises:
            Refusal: a condition that is not valid; nothing has changed.
        """
        # It imports Pinocchio, which takes a tenth of a second.
        from arm_emulator.runs.breakpoint import Breakpoint

        text, plant = request.condition, self._session.plant
        new = Breakpoint(plant, text, "break_when") if text else None
        if self._breakpoint is not None:
            self._breakpoint.close()
        self._breakpoint = new
        self._on_events, self._on_refusals = request.events, request.refusals
        self._session.break_at(self.stop)

    def check_condition(self) -> None:
        """Pause if the condition has started to hold at this tick."""
        if self._breakpoint is not None and self._breakpoint.take_hit():
            self._pause_time(self._breakpoint.condition.text)

    def note_change(self) -> None:
        """Take note of a change by hand."""
        if self._on_events:
            self._pause_time("a change by hand")

    def report_refused(self, topic: str, reason: Refusal) -> None:
        """Count a message that is refused, and report it."""
        with self._lock:
            self._diagnostics.refuse_input(topic, reason)
            self._view.show_event(f"refused: {reason}", "WARN")
            if self._on_refusals:
                self._pause_time(str(reason))

    def _pause_time(self, why: str) -> None:
        self._session.paused = True
        self._catch_up()
        text = f"stopped at tick {self._session.tick}: {why}"
        self._diagnostics.values["newest breakpoint"] = text
        self._logger.info(text)

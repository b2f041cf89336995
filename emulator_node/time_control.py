"""Pause, steps, reset and power of the machine, for all services that ask for them."""

from collections.abc import Callable
from functools import partial

from arm_emulator.ros.node.node_shell import create_wall_timer
from arm_emulator_msgs.msg import MachineEvent
from emulator_node.changes import Changes
from emulator_node.context import Context
from emulator_node.health import Health, Status

AT_ONCE = 20  # steps, before topics and services are served
LOOK_AGAIN = 2e-3  # s, wall: for an answer, or a recorder that has caught up


class TimeControl:
    """Pauses, steps and resets logical time. The caller holds the lock of `own`."""

    def __init__(self, own: Context, changes: Changes, health: Health, status: Status) -> None:
        self._session, self._gate = own.session, own.gate
        self._changes, self._pacer, self._reports = changes, changes.pacer, changes.reports
        self._health, self._status, self._diagnostics = health, status, own.diagnostics

    def pause_time(self, paused: bool) -> None:
        """Pause logical time, or resume it."""
        self._session.paused = paused
        if paused:
            self._pacer.catch_up()
        if self._session.is_answered:
            self._pacer.go_on()

    def step_tick(self) -> str:
        """Advance a paused machine by one tick; return why it cannot, or ""."""
        trouble = ""
        if self._session.paused:
            at_start = self._session.tick == 0 and self._gate.is_closed(at_start=True)
            behind = self._gate.waited_for if at_start else self._gate.find_full_recorder()
            trouble = f"recorder {behind} has to catch up first, step again then" if behind else ""
        trouble = trouble or self._session.step()
        if not trouble:
            self._reports.publish_tick()
        self._health.report_fault()
        return trouble

    def reset_time(self, *, paused: bool = False) -> None:
        """Reset to tick 0, and stay there if `paused`."""

        def restart_session() -> None:
            self._session.reset()
            if paused:
                self._session.paused = True

        with self._changes.pause_between_ticks():
            self._changes.make_change(MachineEvent.KIND_RESET, restart_session)
            self._gate.begin_run()
            self._status.reset_rates()
            self._diagnostics.report_ok("reset")
            self._reports.publish_tick()

    def switch_power(self, on: bool) -> None:
        """Switch the drives' power."""
        switch = partial(setattr, self._session, "powered", on)
        self._changes.make_change(MachineEvent.KIND_POWER, switch)


class TickStepper:
    """Advances a paused machine by a number of ticks, one request at a time.

    Attributes:
        left: ticks that remain.
    """

    def __init__(self, own: Context, control: TimeControl) -> None:
        self._session, self._lock, self._control = own.session, own.lock, control
        self.left = 0
        self._stepped: Callable[[int], None] | None = None
        self._ended: Callable[[str], None] | None = None
        self._timer = create_wall_timer(own.node, LOOK_AGAIN, self.go_on)
        self._timer.cancel()

    def begin_steps(
        self, steps: int, ended: Callable[[str], None], stepped: Callable[[int], None] | None = None
    ) -> None:
        """Start to advance.

        Args:
            steps: how many.
            ended: called at the end, with the reason why there are fewer, or "".
            stepped: called after each step, with the number of those left.
        """
        trouble = "the machine is not paused" if not self._session.paused else ""
        trouble = trouble or ("other steps are not done yet" if self.left else "")
        trouble = trouble or ("steps must be at least 1" if steps < 1 else "")
        if trouble:
            ended(trouble)
            return
        self.left, self._ended, self._stepped = steps, ended, stepped
        self._timer.reset()

    def end_steps(self, trouble: str) -> None:
        """Stop before the last tick, for a reason."""
        ended, self._ended, self.left = self._ended, None, 0
        self._timer.cancel()
        if ended is not None:
            ended(trouble)

    def go_on(self) -> None:
        """Advance by the ticks that are answered now."""
        with self._lock:
            for _ in range(AT_ONCE):
                if not self.left:
                    return
                if self._control.step_tick():
                    break
                self.left -= 1
                if self._stepped is not None:
                    self._stepped(self.left)
                if not self.left:
                    self.end_steps("")
            session = self._session
            if self.left and session.fault is not None:
                self.end_steps(f"stopped: {session.fault}")
            elif self.left and not session.paused:
                self.end_steps("the machine is not paused any more")

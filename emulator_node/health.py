"""Health of the emulator: diagnostics as text, and emulator/status."""

import time
from collections.abc import Callable

from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.machine.session.phase import Phase
from arm_emulator.machine.session.session import EndOfTime
from arm_emulator.ros.messages.time_stamp import NANOSECONDS, convert_to_stamp
from arm_emulator.ros.node.node_shell import STATE_PUB_QOS
from arm_emulator_msgs.msg import EmulatorStatus
from emulator_node.context import Context
from emulator_node.reports import Reports


class Health:
    """Reports a fault once, and the phase as text.

    Args:
        own: context with log and machine.
        timeout: returns after how long a wait for an answer is a fault [s of wall time].
        page: gives how the page has ended before the machine, in words.
    """

    def __init__(self, own: Context, timeout: Callable[[], float], page: Callable[[], str]) -> None:
        self._session, self._gate, self._outgoing = own.session, own.gate, own.outgoing
        self._logger, self._diagnostics = own.node.get_logger(), own.diagnostics
        self._view = own.view
        self._timeout, self._page = timeout, page
        self._reported: Diverged | EndOfTime | None = None  # the fault that was published last

    def report_fault(self) -> None:
        """Report the machine's fault, if it has a new one."""
        fault = self._session.fault
        if fault is not None and fault is not self._reported:
            self._reported = fault
            from arm_emulator.analysis.stability import explain_divergence  # not needed before

            explain_divergence(fault)
            self._diagnostics.report_error(str(fault))
            self._logger.error(str(fault))
            self._view.show_event(str(fault), "ERROR")

    def publish_health(self, waited: float) -> None:
        """Publish the machine's health; `waited`: since this tick was published [s]."""
        session, diagnostics, record = self._session, self._diagnostics, self._outgoing.record
        late, page = waited > self._timeout(), self._page()
        if session.phase is Phase.STOPPED:
            diagnostics.report_error(str(session.fault))
        elif session.phase is Phase.PAUSED and page:
            diagnostics.report_warning(
                f"paused at tick {session.tick}, and the page is gone: {page}; "
                "emulator/pause with data: false lets time go on"
            )
        elif session.phase is Phase.PAUSED:
            diagnostics.report_ok(f"paused at tick {session.tick}")
        elif session.phase is Phase.FREE_RUNNING:
            diagnostics.report_warning("no motor command yet, running free at 0 V")
        elif session.phase is Phase.WAITING and late:
            # In whole seconds, so that the words change, and are published, once a second.
            diagnostics.report_warning(
                f"waiting for the motor command that answers tick {session.tick}, "
                f"for {waited:.0f} s"
            )
        elif self._gate.waited_for and late:
            diagnostics.report_warning(
                f"waiting for recorder {self._gate.waited_for} to write what led to tick "
                f"{session.tick}, for {waited:.0f} s"
            )
        elif record is not None and record.trouble:
            diagnostics.report_warning(f"the record is not complete: {record.trouble}")
        elif page:
            diagnostics.report_warning(f"running without its page: {page}")
        elif not session.powered:
            diagnostics.report_warning("the drives' power is off, motors at 0 V")
        else:
            diagnostics.report_ok("running")


class Status:
    """Publishes emulator/status, with rates since the one before.

    Attributes:
        publisher: of it.
    """

    def __init__(self, own: Context, reports: Reports) -> None:
        self._session, self._diagnostics, self._reports = own.session, own.diagnostics, reports
        self._outgoing, self._view = own.outgoing, own.view
        self.publisher = own.node.create_publisher(EmulatorStatus, "emulator/status", STATE_PUB_QOS)
        self.reset_rates()

    def reset_rates(self) -> None:
        """Reset the rates at tick 0."""
        # Wall time, ticks, ns spent on steps.
        self._mark = (time.monotonic_ns(), 0, self._session.step_wall_ns)

    def publish_status(self) -> None:
        """Publish it."""
        session, now = self._session, time.monotonic_ns()
        since, ticks, core_ns = self._mark
        new_ticks = max(0, session.tick - ticks)
        steps = new_ticks * session.scene.steps_per_period
        self._mark = (now, session.tick, session.step_wall_ns)
        # In lock-step every tick waits briefly for its answer; a machine that advances is running.
        phase = Phase.RUNNING if session.phase is Phase.WAITING and new_ticks else session.phase
        waited = time.monotonic() - self._reports.published_at
        figures = session.figures
        status = EmulatorStatus(
            tick=session.tick,
            phase=int(phase),
            answered=session.is_answered,
            powered=session.powered,
            logical_time=session.logical_ns / NANOSECONDS,
            real_time_factor=new_ticks * session.period_ns / (now - since),
            step_time=max(0, session.step_wall_ns - core_ns) / steps if steps else 0.0,
            energy=session.energy,
            commands_refused=self._diagnostics.refused,
            samples_dropped=self._view.dropped,
            waiting_time=waited if phase is Phase.WAITING else 0.0,
            overruns=figures.lost_periods,
            old_commands=figures.old_commands,
            worst_lateness=figures.worst_lateness / NANOSECONDS,
            median_lateness=figures.median_lateness / NANOSECONDS,
            p99_lateness=figures.p99_lateness / NANOSECONDS,
            real_time_priority=bool(figures.fifo),
            memory_locked=bool(figures.locked),
        )
        status.header.stamp = convert_to_stamp(session.logical_ns)
        self._outgoing.publish_message(self.publisher, status)

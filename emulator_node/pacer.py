"""The sequence of ticks: answers in lock-step, repeated states, a loop in real time."""

import threading
import time

import rclpy

from arm_emulator.machine.session.phase import Phase
from arm_emulator.ros.node.node_shell import create_wall_timer
from emulator_node.breakpoints import Breakpoints
from emulator_node.context import Context
from emulator_node.health import Health
from emulator_node.real_time_ticks import RealTimeTicks
from emulator_node.reports import Reports

LOOK = 0.02  # s, wall: interval at which Python looks at the ticks of a loop
# s, wall: a state without an answer is published again, for partners that come late.
REPEAT_AFTER = 0.2


class Pacer:
    """Advances the session from tick to tick, and publishes each."""

    def start(self) -> None:
        """Begin, or go on after `close`."""
        raise NotImplementedError

    def go_on(self) -> None:
        """Leave this tick, unless it waits for something, or a loop leaves it."""

    def check_time(self) -> None:
        """Check whether time has to advance, or has advanced."""
        raise NotImplementedError

    def catch_up(self) -> None:
        """Publish all ticks reached so far, before a change. Time must be paused."""
        raise NotImplementedError

    def note_change(self) -> None:
        """Take note of a machine that was changed at this tick. Time must be paused."""

    def close(self) -> None:
        """End what runs."""


class LockstepPacer(Pacer):
    """Ticks follow answers, and wait for the pace; a free run goes by the servo period."""

    def __init__(self, own: Context, reports: Reports, health: Health, breaks: Breakpoints) -> None:
        self._breaks = breaks
        self._session, self._gate = own.session, own.gate
        self._reports, self._health, self._lock = reports, health, own.lock
        self._pace = own.pace
        self._free_run = create_wall_timer(
            own.node, own.session.scene.servo_period, self._handle_free_run
        )
        self._due = create_wall_timer(own.node, own.session.scene.servo_period, self._handle_due)
        self._due.cancel()

    def start(self) -> None:
        """Begin the free run."""
        self._free_run.reset()

    def go_on(self) -> None:
        """Leave this tick if permitted, due, and if every recorder has kept up."""
        if not self._session.may_advance or self._gate.is_closed(self._session.tick == 0):
            return
        if (wait := self._pace.compute_wait(self._session.tick)) > 0.0:
            self._due.timer_period_ns = max(1, round(1e9 * wait))
            self._due.reset()
            return
        self._session.advance()
        if self._session.fault is None:
            self._reports.publish_tick()
        self._health.report_fault()
        self._breaks.check_condition()

    def check_time(self) -> None:
        """Go on with the free run if the machine has returned to it, and at another pace."""
        if self._free_run.is_canceled() and self._session.phase is Phase.FREE_RUNNING:
            self._free_run.reset()
        if self._session.is_answered:
            self.go_on()

    def catch_up(self) -> None:
        """Do nothing: every tick is published when reached."""
        self._health.report_fault()

    def _handle_free_run(self) -> None:
        with self._lock:
            if self._session.phase is Phase.FREE_RUNNING:
                self.go_on()
            else:
                self._free_run.cancel()

    def _handle_due(self) -> None:
        with self._lock:
            self._due.cancel()
            self.go_on()


class LoopPacer(Pacer):
    """Ticks come from a loop. A thread in C publishes them; Python looks at the newest ones.

    Attributes:
        ticks: what C publishes.
    """

    def __init__(self, own: Context, reports: Reports, health: Health, breaks: Breakpoints) -> None:
        self._breaks, self._own = breaks, own
        self._session, self._gate, self._lock = own.session, own.gate, own.lock
        self._reports, self._health = reports, health
        self.ticks = RealTimeTicks(own, reports)
        self._topic = own.node.resolve_topic_name("motor_commands")
        self._closing = False
        self._thread: threading.Thread | None = None
        own.outgoing.before_record = self._record_ticks
        create_wall_timer(own.node, LOOK, self._handle_look)

    def start(self) -> None:
        """Publish ticks from now on."""
        self._closing = False
        self.ticks.begin_publishing()
        self._thread = threading.Thread(target=self._run_loop, name="publisher")
        self._thread.start()

    def check_time(self) -> None:
        """Take note of the newest tick."""
        session, before = self._session, self._session.tick
        while session.take(newest=not self._own.view.is_open):
            if session.fault is None:  # otherwise it has not reached another tick
                self._own.view.show_tick()
        if session.tick != before:
            self._reports.published_at = self._reports.repeated_at = time.monotonic()
            self._gate.published += session.tick - before
        self._record_ticks()
        self._health.report_fault()
        self._breaks.check_condition()

    def catch_up(self) -> None:
        """Publish all ticks that the loop has reached, so that a change follows them."""
        self.ticks.catch_up()
        self.check_time()

    def note_change(self) -> None:
        """Go on from the machine as it is now."""
        self.ticks.set_machine()

    def close(self) -> None:
        """End the thread."""
        self._closing = True
        self.ticks.stop_publishing()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            self.ticks.release_publishers()

    def _record_ticks(self) -> None:
        with self._lock:
            self.ticks.record_messages(self._topic)

    def _handle_look(self) -> None:
        with self._lock:
            self.check_time()

    def _run_loop(self) -> None:
        while not self._closing and rclpy.ok():
            if self.ticks.publish_ticks():
                with self._lock:
                    self.check_time()


class Retransmitter:
    """Checks every `REPEAT_AFTER` whether the machine waits, and for which partner."""

    def __init__(self, own: Context, pacer: Pacer, reports: Reports, health: Health) -> None:
        self._session, self._gate = own.session, own.gate
        self._pacer, self._reports, self._health = pacer, reports, health

    def check_answer(self) -> None:
        """Publish an unanswered state again; report a partner that stays silent."""
        session, gate, now = self._session, self._gate, time.monotonic()
        unanswered = session.phase in (Phase.WAITING, Phase.PAUSED) and not session.is_answered
        if session.lockstep and (gate.waited_for or session.tick == 0):
            # A recorder may have ended meanwhile, or have joined a paused machine.
            if gate.is_closed(session.tick == 0):
                unanswered = unanswered or session.tick == 0  # the recorder may lack this state
            elif session.is_answered:
                self._pacer.go_on()
        late = now - self._reports.repeated_at >= REPEAT_AFTER
        if unanswered and late and not gate.find_full_recorder():
            self._reports.repeat_tick()
        self._health.publish_health(waited=now - self._reports.published_at)
        self._pacer.check_time()

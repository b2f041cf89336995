"""The sequence of ticks: answers in lock-step, a loop in real time."""

from __future__ import annotations

import threading
from typing import Protocol

import rclpy

from arm_emulator.machine.phase import Phase
from arm_emulator.ros.node_shell import wall_timer
from emulator_node.breaks import Breaks
from emulator_node.context import Context
from emulator_node.health import Health
from emulator_node.reports import Reports

AT_ONCE = 10  # ticks in real time taken, and messages published, at a time


class Pacer(Protocol):
    """Advances the session from tick to tick, and publishes each."""

    def start(self) -> None:
        """Begin, or go on after `close`."""

    def go_on(self) -> None:
        """Leave this tick, unless it waits for something."""

    def look(self) -> None:
        """Check, several times a second, whether time has to advance."""

    def catch_up(self) -> None:
        """Publish all ticks reached so far, before a change. Time must stand still."""

    def close(self) -> None:
        """End."""


class LockstepPacer:
    """Ticks follow answers, and wait for the pace; a free run goes by the servo period."""

    def __init__(self, own: Context, reports: Reports, health: Health, breaks: Breaks) -> None:
        self._breaks = breaks
        self._session, self._gate = own.session, own.gate
        self._reports, self._health, self._lock = reports, health, own.lock
        self._pace = own.pace
        self._free_run = wall_timer(own.node, own.session.scene.servo_period, self._on_free_run)
        self._due = wall_timer(own.node, own.session.scene.servo_period, self._on_due)
        self._due.cancel()

    def start(self) -> None:
        """Begin the free run."""
        self._free_run.reset()

    def go_on(self) -> None:
        """Leave this tick if permitted, due, and if every recorder has kept up."""
        if not self._session.may_advance or self._gate.behind():
            return
        if (wait := self._pace.due(self._session.tick)) > 0.0:
            self._due.timer_period_ns = max(1, round(1e9 * wait))
            self._due.reset()
            return
        self._session.advance()
        if self._session.fault is None:
            self._reports.tick()
        self._health.report_fault()
        self._breaks.look()

    def look(self) -> None:
        """Go on with the free run if the machine has returned to it, and at another pace."""
        if self._free_run.is_canceled() and self._session.phase is Phase.FREE_RUNNING:
            self._free_run.reset()
        if self._session.answered:
            self.go_on()

    def catch_up(self) -> None:
        """Do nothing: every tick is published when reached."""
        self._health.report_fault()

    def close(self) -> None:
        """Do nothing: no thread is running."""

    def _on_free_run(self) -> None:
        with self._lock:
            if self._session.phase is Phase.FREE_RUNNING:
                self.go_on()
            else:
                self._free_run.cancel()

    def _on_due(self) -> None:
        with self._lock:
            self._due.cancel()
            self.go_on()


class LoopPacer:
    """Ticks come from a loop. A thread of its own takes and publishes them."""

    def __init__(self, own: Context, reports: Reports, health: Health, breaks: Breaks) -> None:
        self._breaks = breaks
        self._session, self._outbox, self._lock = own.session, own.outbox, own.lock
        self._reports, self._health = reports, health
        self._closing = False
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Take ticks from now on."""
        self._closing = False
        self._thread = self._outbox.taker = threading.Thread(target=self._run, name="taker")
        self._thread.start()

    def go_on(self) -> None:
        """Do nothing: the loop advances by itself."""

    def look(self) -> None:
        """Do nothing: the loop checks by itself."""

    def catch_up(self) -> None:
        """Publish all ticks that the loop has reached, in order, so that a change follows them."""
        self._outbox.send()
        while self._take():
            pass
        self._health.report_fault()

    def close(self) -> None:
        """End the thread."""
        self._closing = True
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        while not self._closing and rclpy.ok():
            if self._session.wait(timeout=0.1):
                try:
                    while self._take_some() and not self._closing:
                        pass
                except RuntimeError:  # of rclpy, if a signal has ended it meanwhile
                    if rclpy.ok():
                        raise

    def _take_some(self) -> bool:
        """Take some ticks, publish some waiting messages; return whether more of either remain.

        On a machine that is too slow this never ends: topics and services are served in between.
        """
        with self._lock:
            taken = 0
            while taken < AT_ONCE and self._take():
                taken += 1
            self._health.report_fault()
            return self._outbox.send(AT_ONCE) or taken == AT_ONCE

    def _take(self) -> bool:
        """Take a tick and publish its state; False after the last."""
        if not self._session.take():
            self._breaks.look()
            return False
        if self._session.fault is None:  # otherwise it has not reached another tick
            self._reports.tick()
        return True

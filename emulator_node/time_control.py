"""Pause, step, reset and power of the machine, for all services that ask for them."""

from __future__ import annotations

from functools import partial

from arm_emulator_msgs.msg import MachineEvent
from emulator_node.changes import Changes
from emulator_node.context import Context
from emulator_node.health import Health, Status


class TimeControl:
    """Lets logical time stand, pass and begin anew. The caller holds the lock of `own`."""

    def __init__(self, own: Context, changes: Changes, health: Health, status: Status) -> None:
        self._session, self._gate = own.session, own.gate
        self._changes, self._pacer, self._reports = changes, changes.pacer, changes.reports
        self._health, self._status, self._diagnostics = health, status, own.diagnostics

    def pause(self, paused: bool) -> None:
        """Let time stand, or go on."""
        self._session.paused = paused
        if paused:
            self._pacer.catch_up()
        if self._session.answered:
            self._pacer.go_on()

    def step(self) -> str:
        """Leave one tick of a paused machine; return why not, or ""."""
        trouble = self._step()
        if not trouble:
            self._reports.publish_tick()
        self._health.report_fault()
        return trouble

    def _step(self) -> str:
        if self._session.paused:
            at_start = self._session.tick == 0 and self._gate.is_closed(at_start=True)
            behind = self._gate.waited_for if at_start else self._gate.find_full_recorder()
            if behind:
                return f"recorder {behind} has to catch up first, step again then"
        return self._session.step()

    def reset(self, *, paused: bool = False) -> None:
        """Return to tick 0, to stand there if `paused`."""

        def reset() -> None:
            self._session.reset()
            if paused:
                self._session.paused = True

        with self._changes.between_ticks():
            self._changes.make(MachineEvent.KIND_RESET, reset)
            self._gate.begin()
            self._status.begin()
            self._diagnostics.report_ok("reset")
            self._reports.publish_tick()

    def power(self, on: bool) -> None:
        """Switch the drives' power."""
        switch = partial(setattr, self._session, "powered", on)
        self._changes.make(MachineEvent.KIND_POWER, switch)

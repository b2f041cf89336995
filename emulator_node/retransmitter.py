"""Repetition of unanswered states, and the time for which the machine has waited."""

from __future__ import annotations

import time

from arm_emulator.machine.session.phase import Phase
from emulator_node.context import Context
from emulator_node.health import Health
from emulator_node.pacer import Pacer
from emulator_node.reports import Reports

REPEAT_AFTER = (
    0.2  # s, wall: a state without an answer is published again, for partners that come late
)


class Retransmitter:
    """Checks every `REPEAT_AFTER` whether the machine waits, and for which partner."""

    def __init__(self, own: Context, pacer: Pacer, reports: Reports, health: Health) -> None:
        self._session, self._gate = own.session, own.gate
        self._pacer, self._reports, self._health = pacer, reports, health

    def look(self) -> None:
        """Publish an unanswered state again; report a partner that stays silent."""
        session, gate, now = self._session, self._gate, time.monotonic()
        unanswered = session.phase in (Phase.WAITING, Phase.PAUSED) and not session.answered
        if session.lockstep and (gate.waited_for or session.tick == 0):
            # A recorder may have ended meanwhile, or have joined a paused machine.
            if gate.is_closed(session.tick == 0):
                unanswered = unanswered or session.tick == 0  # the recorder may lack this state
            elif session.answered:
                self._pacer.go_on()
        late = now - self._reports.repeated_at >= REPEAT_AFTER
        if unanswered and late and not gate.find_full_recorder():
            self._reports.repeat_tick()
        self._health.report(waited=now - self._reports.published_at)
        self._pacer.look()

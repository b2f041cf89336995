"""Recorders that have to keep up: in lock-step the machine waits for them beside its commands."""

from __future__ import annotations

import time
from functools import partial

from rclpy.node import Node

from arm_emulator.machine.session.session import Session
from arm_emulator.ros.node_shell import KEPT, Diagnostics
from arm_emulator.ros.recorder_presence import recorders_of
from arm_emulator.ros.recorders import Recorders
from arm_emulator_msgs.msg import RecorderReport


class RecorderGate:
    """Open while every recorder has kept up. In real time it is always open.

    Attributes:
        waited_for: the recorder that has to catch up before the machine advances, or empty.

    Args:
        node: node of log and topics.
        session: the machine.
        diagnostics: of the node.
        topic: of motor states, which recorders write.
    """

    def __init__(self, node: Node, session: Session, diagnostics: Diagnostics, topic: str) -> None:
        self.waited_for = ""
        self._logger, self._session, self._diagnostics = node.get_logger(), session, diagnostics
        self._recorders = Recorders(partial(recorders_of, topic))

    def begin(self) -> None:
        """Begin anew at tick 0."""
        self._recorders.begin()

    def count(self, states: int) -> None:
        """Count published motor states."""
        self._recorders.published += states

    def room(self) -> int:
        """Return how many ticks may be left before a recorder has to catch up."""
        return self._recorders.room()

    def behind(self) -> bool:
        """Return whether a recorder has to catch up before the machine may leave this tick."""
        session, recorders = self._session, self._recorders
        self.waited_for = ""
        if session.lockstep:
            self.waited_for = recorders.behind(session.tick == 0, time.monotonic())
        for sentence in recorders.news:
            self._logger.warn(sentence)
            self._diagnostics.values["newest of recorders"] = sentence
        recorders.news.clear()
        return bool(self.waited_for)

    def without_room(self) -> str:
        """Return the recorder that would lose one more motor state, or ""."""
        return self._recorders.without_room(KEPT) if self._session.lockstep else ""

    def on_report(self, report: RecorderReport) -> None:
        """Take a recorder's report.

        Raises:
            Refusal: see `Recorders.report`.
        """
        self._recorders.report(report.recorder, report.written, report.leaving)
        self._diagnostics.values["recorders"] = len(self._recorders.names)

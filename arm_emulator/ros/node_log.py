"""A node's log of refusals and outcomes: throttled, so that a bad partner does not flood it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

PAUSE = 5.0  # s, wall: between two lines of one kind


@dataclass
class _Written:
    """The newest line of one kind."""

    at: float
    left_out: int = 0


class NodeLog:
    """Lines of several kinds; of each at most one every `PAUSE`.

    A line counts those that were left out before it.

    Args:
        logger: of the node.
        now: clock [s].
    """

    def __init__(self, logger: Any, now: Callable[[], float] = time.monotonic) -> None:
        self._logger, self._now = logger, now
        self._written: dict[str, _Written] = {}

    def trouble(self, kind: str, line: str) -> None:
        """Log a warning of a kind."""
        if due := self._due(kind, line):
            self._logger.warning(due)

    def outcome(self, kind: str, line: str) -> None:
        """Log a regular outcome of a kind."""
        if due := self._due(kind, line):
            self._logger.info(due)

    def _due(self, kind: str, line: str) -> str:
        """Return the line as it is to be written, nothing if it is too early for it."""
        now, last = self._now(), self._written.get(kind)
        if last is not None and now - last.at < PAUSE:
            last.left_out += 1
            return ""
        more = f" (and {last.left_out} more before)" if last is not None and last.left_out else ""
        self._written[kind] = _Written(now)
        return line + more

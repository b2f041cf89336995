"""The process that serves the page of a running machine, see `arm_emulator.page.watched`.

It ends when its input does: the run is over, however it ended.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import sys
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.record_ring import SharedRing
from arm_emulator.page.hands import Hands
from arm_emulator.page.live_page import LivePage

FRAME = 0.05  # s, wall, between two pictures


def main() -> None:
    """Serve the page until the run is over; hand the run the page's address at first."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.nice(10)
    task = pickle.load(sys.stdin.buffer)
    try:
        ring = SharedRing(task["memory"], task["kind"])
        hands: Hands = task["hands"]()
        page = LivePage(
            task["scene"], task["columns"], task["kind"], hands, task["at"], task["varied"]
        )
    except Refusal as no:
        _hand_over(no)
        return
    _hand_over(page.url)
    _show_all(ring, page)
    hands.close()
    page.close()
    _hand_over("")


def _show_all(ring: SharedRing, page: LivePage) -> None:
    """Show rows until input ends."""
    while not select.select([sys.stdin], [], [], FRAME)[0]:
        page.take(ring.take(), ring.dropped)
        page.draw()


def _hand_over(what: Any) -> None:
    with contextlib.suppress(BrokenPipeError):  # the run was killed
        pickle.dump(what, sys.stdout.buffer)
        sys.stdout.flush()


if __name__ == "__main__":
    main()

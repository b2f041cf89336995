"""Many steps of a paused machine, each as soon as its tick is answered."""

from __future__ import annotations

from collections.abc import Callable

from arm_emulator.ros.node.node_shell import create_wall_timer
from emulator_node.context import Context
from emulator_node.time_control import TimeControl

AT_ONCE = 20  # steps, before topics and services are served
LOOK_AGAIN = 2e-3  # s, wall: for an answer, or a recorder that has caught up


class Stepper:
    """Leaves a number of ticks, one request at a time.

    Attributes:
        left: ticks to be left.
    """

    def __init__(self, own: Context, control: TimeControl) -> None:
        self._session, self._lock, self._control = own.session, own.lock, control
        self.left = 0
        self._stepped: Callable[[int], None] | None = None
        self._ended: Callable[[str], None] | None = None
        self._timer = create_wall_timer(own.node, LOOK_AGAIN, self.go_on)
        self._timer.cancel()

    def begin(
        self, steps: int, ended: Callable[[str], None], stepped: Callable[[int], None] | None = None
    ) -> None:
        """Begin to leave ticks.

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

    def end(self, trouble: str) -> None:
        """Leave no more ticks, for a reason."""
        ended, self._ended, self.left = self._ended, None, 0
        self._timer.cancel()
        if ended is not None:
            ended(trouble)

    def go_on(self) -> None:
        """Leave the ticks that can be left now."""
        with self._lock:
            for _ in range(AT_ONCE):
                if not self.left:
                    return
                if self._control.step():
                    break
                self.left -= 1
                if self._stepped is not None:
                    self._stepped(self.left)
                if not self.left:
                    self.end("")
            session = self._session
            if self.left and session.fault is not None:
                self.end(f"stopped: {session.fault}")
            elif self.left and not session.paused:
                self.end("the machine is not paused any more")

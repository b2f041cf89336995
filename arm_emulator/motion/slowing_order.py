"""Motion to rest on the way that an order was going."""

from __future__ import annotations

from dataclasses import replace

from arm_emulator.base.given import FloatArray
from arm_emulator.motion.instruction import Instruction
from arm_emulator.motion.laws import Laws
from arm_emulator.motion.motion_report import Kind, State
from arm_emulator.motion.orders import MOVING, Planned, Progress
from arm_emulator.motion.paced import Paced
from arm_emulator.motion.reference import Motion, Reference
from arm_emulator.motion.take_over import Rest

_SECONDS = 1e-9
_HARDER = 2.0  # jerk, of that of ways: a way at its limit could not be left before its end


class SlowingOrder:
    """Comes to rest on a way that is known to be free, instead of each joint by itself.

    Args:
        laws: of the arm.
        now_ns: logical time [ns].
        planned: the way, and the place on it.
    """

    kind = Kind.JOG
    stamp_ns = 0
    way = ""

    def __init__(self, laws: Laws, now_ns: int, planned: Planned) -> None:
        self._motion: Motion = planned.motion
        since = planned.gone
        if not isinstance(planned.motion, Paced):  # which slows down already
            limits = laws.ways.limits
            limits = replace(limits, jerk=_HARDER * limits.jerk)
            self._motion = Paced(planned.motion, since, 1.0, 0.0, limits)
            since = 0.0
        self._began_ns = now_ns - round(since / _SECONDS)

    def begin(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """See `Order`."""
        laws.nobody_leads()

    def go_on(self, laws: Laws, now_ns: int, reference: Reference) -> None:
        """See `Order`."""
        self._motion, self._began_ns = Rest(reference.q), now_ns

    def instruct(self, laws: Laws, now_ns: int, q: FloatArray) -> Instruction:
        """See `Order`."""
        now, then = self.reference(now_ns), self.reference(now_ns + laws.period_ns)
        self._at_ns = now_ns + laws.period_ns
        return Instruction(now.q, (then.q - now.q) / laws.config.period, None, now, then)

    def reference(self, now_ns: int) -> Reference:
        """See `Order`."""
        return self._motion.at((now_ns - self._began_ns) * _SECONDS)

    def planned(self) -> Planned:
        """See `Order`."""
        return Planned(self._motion, (self._at_ns - self._began_ns) * _SECONDS)

    def progress(self, now_ns: int, q: FloatArray, v: FloatArray | None) -> Progress:
        """See `Order`."""
        over = (now_ns - self._began_ns) * _SECONDS > self._motion.duration
        return Progress(State.REACHED, "at rest") if over else MOVING

"""The reference as the servo gets it: shaped, so that the arm does not shake when it has ended.

All joints are shaped alike, so a straight line of the joints remains one. Each value is a mean of
earlier ones with positive weights. Limits of position, speed, acceleration and jerk therefore hold.
"""

from collections import deque
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.input_shaper import InputShaper
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference

_APART = 1e-9  # rad or m: rounding between the end of a motion period and the begin of the next


@dataclass(frozen=True, eq=False)
class _ShapedPeriod:
    """The reference of one motion period; in between it is the quintic through both ends."""

    begin: Reference
    end: Reference
    duration: float
    """[s]."""
    has_end: bool
    """Whether `end` was given, not extrapolated."""
    tau: Array | None

    @cached_property
    def terms(self) -> Array:
        """Coefficients of the quintic by share of the period (6, N) [rad or m]."""
        T, begin, end = self.duration, self.begin, self.end
        v0, a0 = begin.v * T, 0.5 * begin.a * T**2
        q = end.q - begin.q - v0 - a0
        v, a = end.v * T - v0 - 2.0 * a0, 0.5 * end.a * T**2 - a0
        rest = 10.0 * q - 4.0 * v + a, 7.0 * v - 15.0 * q - 2.0 * a, 6.0 * q - 3.0 * v + a
        return np.array([begin.q, v0, a0, *rest])

    @property
    def is_resting(self) -> bool:
        """Whether nothing moves in it."""
        ends = (self.begin.v, self.begin.a, self.end.v, self.end.a, self.end.q - self.begin.q)
        return not any(rate.any() for rate in ends)


class ShapedReference:
    """Shapes setpoints one motion period after the other.

    A reference may jump to the measured position of the arm, as behind closed brakes. From then
    until it rests, it is passed on unchanged: a delay would send the arm back.

    Args:
        shaper: its impulses.
        period: motion period [s].

    Attributes:
        lag: by how much the reference is ahead of what the servo got, at the next period (N,).
        v_lag: the same of its speeds.
    """

    def __init__(self, shaper: InputShaper, period: float) -> None:
        self.lag: Array | float = 0.0
        self.v_lag: Array | float = 0.0
        self._period = period
        self._coming: InputShaper | None = shaper
        self._past: deque[_ShapedPeriod] = deque(maxlen=1)
        self._sent: Reference | None = None  # end of the newest shaped period
        self._take_shaper()

    def set_shaper(self, shaper: InputShaper) -> None:
        """Continue with another shaper from the next rest on."""
        self._coming = None if shaper == self._shaper else shaper
        if self._sent is None:
            self._take_shaper()

    def pass_reference(self) -> None:
        """Pass the reference on as it is, until it rests."""
        self._past.clear()
        self._sent, self.lag, self.v_lag = None, 0.0, 0.0
        self._take_shaper()

    @property
    def delay(self) -> float:
        """Time by which it ends motions later [s]."""
        return self._shaper.delay

    def compute_sent(self, reference: Reference) -> Reference:
        """Return what the servo got of a reference at this moment."""
        return self._sent or reference

    @property
    def is_settled(self) -> bool:
        """Whether the servo got all of the reference."""
        return not np.any(self.lag) and not np.any(self.v_lag)

    def filter_setpoint(self, setpoint: JointSetpoint) -> JointSetpoint:
        """Return the setpoint of this motion period."""
        if self._shaper.delay == 0.0 and self._coming is None:
            return setpoint
        present = self._read_setpoint(setpoint)
        if self._past and (np.abs(self._past[-1].end.q - present.begin.q) > _APART).any():
            self.pass_reference()
        if self._past and not self._past[-1].has_end:
            self._past[-1] = replace(self._past[-1], end=present.begin)
        if present.is_resting and self.is_settled:
            self.pass_reference()
            self._past.extend([present] * (self._past.maxlen or 1))
            self._sent = present.end
            return setpoint
        self._past.append(present)
        if self._sent is None:
            return setpoint
        now = self._sent
        then = self._sum_periods()
        self._sent = then
        self.lag, self.v_lag = present.end.q - then.q, present.end.v - then.v
        now = Reference(now.q, now.v, now.a, (then.a - now.a) / self._period)
        v = (then.q - now.q) / self._period
        return JointSetpoint(now.q, v, self._sum_effort(), now, then)

    def _take_shaper(self) -> None:
        """Begin to use the shaper that was given last."""
        if self._coming is None:
            return
        self._shaper, self._coming = self._coming, None
        back = self._shaper.times / self._period
        self._places = -1 - np.floor(back).astype(int)  # of the impulses, among past periods
        # Terms of the quintics there as place, speed and acceleration, by their shares.
        within = 1.0 - (back - np.floor(back))
        powers = np.vander(within, 6, increasing=True)
        k = np.arange(6.0)
        slopes = np.column_stack([np.zeros_like(within), k[1:] * powers[:, :-1]])
        bends = np.column_stack([np.zeros((len(within), 2)), (k * (k - 1.0))[2:] * powers[:, :-2]])
        parts = powers, slopes / self._period, bends / self._period**2
        self._weights = self._shaper.shares[:, np.newaxis] * np.array(parts)
        self._past = deque(maxlen=-int(self._places[-1]))

    def _read_setpoint(self, setpoint: JointSetpoint) -> _ShapedPeriod:
        q, period = setpoint.q, self._period
        mean = np.zeros_like(q) if setpoint.v is None else setpoint.v
        now = setpoint.now or Reference(q, mean, np.zeros_like(q))
        then = setpoint.then or now.extrapolate_to(period, q + period * mean)
        return _ShapedPeriod(now, then, period, setpoint.then is not None, setpoint.tau)

    def _sum_periods(self) -> Reference:
        """Return the shaped motion at the end of the newest period."""
        newest = self._past[-1].end
        terms = np.array([self._past[place].terms for place in self._places])
        terms[:, 0] -= newest.q  # so that the sum is exactly 0 where all of them rest
        off, v, a = np.einsum("rki,kin->rn", self._weights, terms)
        return Reference(newest.q + off, v, a)

    def _sum_effort(self) -> Array | None:
        """Return the shaped torques; None where some of them are not known."""
        parts = [self._past[place].tau for place in self._places]
        declared = [tau for tau in parts if tau is not None]
        if len(declared) < len(parts):
            return None
        return np.asarray(self._shaper.shares @ np.array(declared))

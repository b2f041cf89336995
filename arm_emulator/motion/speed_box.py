"""The joint speeds that keep a joint's limits, now and for ever after."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


class SpeedBox:
    """Bounds on the speeds of the coming motion period, which are constant within it.

    A joint that moves towards its position limit must still be able to brake before it. So the
    speed towards a limit at distance d is at most `stopping_speed`, and a joint that has kept to
    that finds a speed that keeps to it in every later period, whatever it was given: the box is
    never empty (Del Prete 2018, Joint position and velocity bounds in discrete-time
    acceleration/torque control of robot manipulators).

    Args:
        lower: position limits, (N,), or infinite.
        upper: (N,), or infinite.
        velocity: largest speeds, (N,) > 0, or infinite.
        acceleration: largest changes of speed per time, (N,) > 0, finite.
        period: motion period [s].
    """

    def __init__(
        self,
        lower: FloatArray,
        upper: FloatArray,
        velocity: FloatArray,
        acceleration: FloatArray,
        period: float,
    ) -> None:
        self.lower, self.upper, self.period = lower, upper, period
        # Python floats: for N below about 20 a loop over them beats NumPy's call overhead.
        self._velocity, self._acceleration = velocity.tolist(), acceleration.tolist()

    def bounds(
        self,
        q: FloatArray,
        v: FloatArray,
        lower: FloatArray | None = None,
        upper: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the smallest and largest speeds of the coming period, (N,) each.

        A joint outside its position limits may only come back. Where the limits contradict each
        other, which they do only if somebody else has moved the joint or changed the limits, that
        of acceleration is kept.

        Args:
            q: positions at the period's begin, (N,).
            v: speeds of the period before, (N,).
            lower: position limits (N,) that hold now; None: those of always.
            upper: (N,).
        """
        low, high, T = [], [], self.period
        lowers = (self.lower if lower is None else lower).tolist()
        uppers = (self.upper if upper is None else upper).tolist()
        for least_q, most_q, fastest, a, at, speed in zip(
            lowers, uppers, self._velocity, self._acceleration, q.tolist(), v.tolist(), strict=True
        ):
            least, most = speed - a * T, speed + a * T
            down = min(fastest, stopping_speed(at - least_q, a, T))
            up = min(fastest, stopping_speed(most_q - at, a, T))
            low.append(min(max(-down, least), most))
            high.append(min(max(up, least), most))
        return np.array(low), np.array(high)

    def approach(self, way: FloatArray, part: float) -> FloatArray:
        """Return the speeds, each with the sign of its way, that can end at the ways' ends, (N,).

        Args:
            way: of each joint, (N,).
            part: of the acceleration limit that is used to brake.
        """
        return np.array(
            [
                math.copysign(min(fastest, stopping_speed(abs(d), part * a, self.period)), d)
                for d, fastest, a in zip(
                    way.tolist(), self._velocity, self._acceleration, strict=True
                )
            ]
        )

    def rate(
        self, way: FloatArray, part: float, most: float, low: FloatArray, high: FloatArray
    ) -> float:
        """Return the rate [1/s] at which all joints can go their ways together.

        It is the largest of which every joint can brake, and at most `most`; but if rates exist
        for which the speeds are within [low, high] it is one of these.

        Args:
            way: of each joint, (N,).
            part: of the acceleration limit that is used to brake.
            most: largest rate [1/s].
            low: of `bounds`, (N,).
            high: (N,).
        """
        least, limit = -math.inf, math.inf
        for d, fastest, a, lo, hi in zip(
            way.tolist(), self._velocity, self._acceleration, low.tolist(), high.tolist(),
            strict=True,
        ):  # fmt: skip
            size = abs(d)
            if size < 1e-12:
                continue
            most = min(most, min(fastest, stopping_speed(size, part * a, self.period)) / size)
            one, other = (lo / d, hi / d) if d > 0.0 else (hi / d, lo / d)
            least, limit = max(least, one), min(limit, other)
        return min(max(most, least), limit) if least <= limit else most


def stopping_speed(distance: float, deceleration: float, period: float) -> float:
    """Return the largest speed for the coming period from which a joint stops within a distance.

    A speed ``u a T`` with m <= u < m + 1, of deceleration a and period T, is left in m more
    periods, over ``a T^2 ((m + 1) u - m (m + 1) / 2)`` in all. This is the inverse.
    """
    if distance <= 0.0:
        return 0.0
    change = deceleration * period
    d = distance / (change * period)
    if d > 1e15:  # periods without end; it may be infinite
        return math.inf
    m = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * d) - 1.0))
    return change * (d / (m + 1.0) + 0.5 * m)

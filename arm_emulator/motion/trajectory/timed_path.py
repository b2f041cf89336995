"""A planned way of the joints: a curve and its timing.

Its timing is the one of least duration within the limits of speed, acceleration, jerk and torque,
from rest to rest. The result is checked at more places. Where it exceeds a limit there, it is
slowed down.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.motion.model.arm_tree import PATH_HEADER, ArmTree, path_library
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.trajectory.joint_curve import JointCurve
from arm_emulator.toolchain.c_header import NULL, make_pointer

FEWEST_PIECES = 24  # of the timing
MAX_PIECES = 400  # of a way in which the ramps decide how many it has
IN_A_RAMP = 12  # pieces of it
MAX_TIMINGS = 3  # that are found for a way with as many pieces
CLOSE = 0.94  # factor of c with which a timing is slowed down as a whole
FAR, FINER = 0.83, 4  # with which its pieces are too long, and so many more are tried
MARGIN = 1.002  # of time: for what lies between the checks
JERK_MARGIN = 1.01  # likewise, of the jerk, which steps
_CHECKED, _CHECKED_AGAIN = 5, 17  # places in a piece where limits are held against it
_LOOKS = np.linspace(0.0, 1.0, 17)  # at which the length of the ramps is judged


@dataclass(frozen=True, eq=False)
class JointPathLimits:
    """Limits of the joints along a way, (N,) each; speed, acceleration and jerk > 0."""

    speed: Array
    """[rad/s or m/s]."""
    acceleration: Array
    """[rad/s2 or m/s2]."""
    jerk: Array
    """[rad/s3 or m/s3]."""
    torque: Array
    """[N m or N]; infinite: no limit."""


@dataclass(frozen=True, eq=False)
class ToolPathLimits:
    """Limits of the tool along its curve, which ends at s = 1."""

    length: float
    """Measure of the curve [m]."""
    speed: float
    """[m/s]."""
    acceleration: float
    """Along, and again across [m/s2]."""
    jerk: float
    """Along [m/s3]."""
    ends: Array
    """Ends of the curve's parts in s, ascending (S,)."""
    curvature: Array
    """Curvature of these parts: acceleration across at speed 1, (S,) [1/m]."""

    @classmethod
    def limit_line(
        cls, length: float, speed: float, acceleration: float, jerk: float
    ) -> ToolPathLimits:
        """Return those of a line."""
        return cls(length, speed, acceleration, jerk, np.ones(1), np.zeros(1))


class TimedPath(SharedObject):
    """A way from rest to rest.

    Args:
        curve: of the joints.
        limits: of the joints.
        arm: for torques; None: they are not limited.
        along: of the tool; None: it is as fast as the joints.
        requested: time in which the curve was meant to be followed evenly [s], below which no part
            of it falls; 0: none.
        where: names the motion in refusals.

    Attributes:
        duration: [s].

    Raises:
        Refusal: at some place of the curve not even rest keeps the limits of torque.
    """

    def __init__(
        self,
        curve: JointCurve,
        limits: JointPathLimits,
        arm: ArmTree | None = None,
        along: ToolPathLimits | None = None,
        requested: float = 0.0,
        where: str = "motion",
    ) -> None:
        self.curve = curve
        self._limits, self._along, self._requested = limits, along, requested
        self._loaded = np.flatnonzero(np.isfinite(limits.torque))
        self._arm = arm if len(self._loaded) else None
        ramp, pieces = self._choose_ramp()
        self._ramps = Ramps(ramp)
        arguments = self._make_arguments()
        self._timing = self._find_timing(pieces, arguments, where)
        self.duration = self._timing.duration

    def evaluate_at(self, time: float) -> Reference:
        """Return the joints at a time since the start [s]."""
        q, v, a, jerk = self.curve.derive_by_time(*self._derive_place(time))
        return Reference(q, v, a, jerk)

    def compute_distance(self, time: float) -> float:
        """Return s at a time since the start [s]."""
        return self._derive_place(time)[0]

    def _derive_place(self, time: float) -> tuple[float, float, float, float]:
        """Return s and its first three derivatives by time."""
        sigma, d1, d2, d3 = self._timing.compute_derivatives(max(0.0, time))
        s, s1, s2, s3 = self._ramps.evaluate_at(sigma)
        return s, s1 * d1, s1 * d2 + s2 * d1**2, s1 * d3 + 3.0 * s2 * d1 * d2 + s3 * d1**3

    def _choose_ramp(self) -> tuple[float, int]:
        """Return the share of sigma of the ramps, and its number of pieces."""
        _, f1, _, _ = self.curve.compute_derivatives(_LOOKS)
        limits, tiny = self._limits, 1e-12
        slow = (np.abs(f1) / limits.speed).max(axis=1) + tiny  # seconds per s
        stiff = (np.abs(f1) / limits.acceleration).max(axis=1) + tiny
        if self._along is not None:
            slow = np.maximum(slow, self._along.length / self._along.speed)
            stiff = np.maximum(stiff, self._along.length / self._along.acceleration)
        cruise = max(float(slow.mean()), self._requested)
        ends = float(stiff[[0, -1]].max()) / cruise + float(
            (limits.acceleration / limits.jerk).max()
        )
        # Ways of any length are planned in so many pieces at most; a longer ramp is gentler.
        ramp = min(0.5, max(ends / (cruise + ends), IN_A_RAMP / MAX_PIECES))
        # Two checks or more in each piece of the curve, whose third derivative steps.
        in_curve = math.ceil(2.0 * (len(self.curve.breaks) - 1) / _CHECKED)
        return ramp, max(FEWEST_PIECES, round(IN_A_RAMP / ramp), in_curve)

    def _find_timing(self, pieces: int, arguments: tuple[Any, ...], where: str) -> PathTiming:
        """Return the quickest timing found that keeps every limit at every check.

        A timing may exceed limits between the places for which it was found. It is then found again
        with tighter limits there, and with more pieces, too, if the excess is large. The remaining
        excess slows the whole timing down.
        """
        law, timings, first = path_library(), list[PathTiming](), 0.0
        # Once more with as many: now what is exceeded is known from more looks.
        for count in (pieces, pieces, min(FINER * pieces, max(pieces, MAX_PIECES))):
            sigma, keeps, coefficients = compute_places(count), np.empty(count), np.empty(count + 2)
            max_rates, firsts, thirds = self._compute_rows(sigma, arguments)
            for _ in range(MAX_TIMINGS):
                rows = (
                    make_pointer(max_rates),
                    firsts.shape[2],
                    make_pointer(firsts),
                    thirds.shape[2],
                )
                fault = law.path_time(
                    count, *rows, make_pointer(thirds), _GAP, make_pointer(coefficients)
                )
                if fault >= 0:
                    raise self._refuse_torque(sigma[fault], where)
                looks = _CHECKED_AGAIN if timings else _CHECKED
                law.path_keeps(
                    *arguments,
                    count,
                    make_pointer(coefficients),
                    looks,
                    JERK_MARGIN,
                    make_pointer(keeps),
                )
                smallest = float(keeps.min())
                first = first or smallest
                timings.append(PathTiming(coefficients * smallest / MARGIN**2))
                if smallest > CLOSE:
                    break
                k = np.repeat(keeps, len(POINTS))
                max_rates, thirds = max_rates * k, thirds / (k**1.5)[:, None]
                firsts[1:] /= k[:, None]
            if first > FAR:
                break
        return min(timings, key=lambda timing: timing.duration)

    def _compute_rows(self, sigma: Array, arguments: tuple[Any, ...]) -> tuple[Array, Array, Array]:
        """Return the limits at places (P,), as path_time takes them: (P,), (3, P, F), (3, P, G)."""
        joints, along = len(self._limits.speed), self._along is not None
        torques = 0 if self._arm is None else len(self._loaded)
        max_rates = np.empty(len(sigma))
        firsts = np.empty((3, len(sigma), joints + torques + along))
        thirds = np.empty((3, len(sigma), joints + along))
        path_library().path_rows(
            *arguments, len(sigma), *map(make_pointer, (sigma, max_rates, firsts, thirds))
        )
        return max_rates, firsts, thirds

    def _make_arguments(self) -> tuple[Any, ...]:
        """Return arm, curve, limits and ramp as path.h takes them."""
        limits, along = self._limits, self._along
        struct = PATH_HEADER.make_struct(
            "path_limits",
            speed=limits.speed,
            acceleration=limits.acceleration,
            jerk=limits.jerk,
            torque=limits.torque,
            requested=self._requested,
        )
        if along is not None:
            PATH_HEADER.fill_struct(
                struct,
                length=along.length,
                tool_speed=along.speed,
                tool_acceleration=along.acceleration,
                tool_jerk=along.jerk,
                parts=len(along.ends),
                ends=along.ends,
                curvature=along.curvature,
            )
        arm = NULL if self._arm is None else self._arm.struct
        return arm, self.curve.struct, struct, self._ramps.ramp

    def _refuse_torque(self, sigma: float, where: str) -> Refusal:
        assert self._arm is not None
        s = self._ramps.evaluate_at(sigma)[0]
        q = self.curve.compute_derivatives(np.array([s]))[0]
        still = np.zeros_like(q)
        share = np.abs(self._arm.compute_torques(q, still, still)[0]) / self._limits.torque
        j = int(np.argmax(share))
        name = self._arm.kinematics.joint_names[j]
        rule = f"need no more torque of {name} than its limit, {self._limits.torque[j]:.4g} N m"
        value = f"{share[j] * self._limits.torque[j]:.4g} N m to hold it at {s:.0%} of the way"
        return Refusal(where, "the way", rule, value)


# A place s of the way is a function of sigma in [0, 1], `Ramps`, whose slope rises smoothly from 0
# and falls to 0 again. A motion that is even in sigma therefore begins and ends at rest, with
# continuous accelerations. The rate c = (dsigma/dt)^2 that remains to be found is an ordinary
# function: the quadratic spline of cpp/path.h.

POINTS = (0.0, 0.5, 1.0)  # of a piece, at which path.h asks for the limits
_BESIDE = 1e-9  # of a piece: an end belongs to the piece that it is asked for
_GAUSS, _WEIGHTS = np.polynomial.legendre.leggauss(6)
_GAUSS, _WEIGHTS = 0.5 * (_GAUSS + 1.0), 0.5 * _WEIGHTS
_PAIRS = list(zip(_GAUSS.tolist(), _WEIGHTS.tolist(), strict=True))
_GAP = 0.02  # of the shortest duration, that the search leaves


class Ramps:
    """s over sigma, both in [0, 1]: faster over a part `ramp`, evenly, slower over as long a part.

    Args:
        ramp: in (0, 1/2].
    """

    def __init__(self, ramp: float) -> None:
        self.ramp = ramp

    def evaluate_at(self, sigma: float) -> tuple[float, float, float, float]:
        """Return s and its first three derivatives."""
        r, top = self.ramp, 1.0 / (1.0 - self.ramp)
        falling = sigma > 0.5
        x = (1.0 - sigma if falling else sigma) / r
        if x >= 1.0:
            s, s1, s2, s3 = top * r * (x - 0.5), top, 0.0, 0.0
        else:
            s, s1 = top * r * x**3 * (1.0 - 0.5 * x), top * x * x * (3.0 - 2.0 * x)
            s2, s3 = top / r * 6.0 * x * (1.0 - x), top / r**2 * (6.0 - 12.0 * x)
        return (1.0 - s, s1, -s2, s3) if falling else (s, s1, s2, s3)


def compute_places(pieces: int) -> Array:
    """Return sigma at the `POINTS` of each of so many equal pieces."""
    inside = np.clip(np.array(POINTS), _BESIDE, 1.0 - _BESIDE)
    return np.asarray(((np.arange(pieces)[:, None] + inside) / pieces).ravel())


class PathTiming:
    """sigma over time.

    Args:
        coefficients: of c, (pieces + 2,).

    Attributes:
        duration: [s].
    """

    def __init__(self, coefficients: Array) -> None:
        self.coefficients = coefficients
        self._pieces = len(coefficients) - 2
        x0, x1, x2 = coefficients[:-2], coefficients[1:-1], coefficients[2:]
        # c = k0 + u (k1 + u k2) in a piece, u from 0 to 1.
        k = np.stack([0.5 * (x0 + x1), x1 - x0, 0.5 * (x0 - 2.0 * x1 + x2)])
        at = k[0] + _GAUSS[:, None] * (k[1] + _GAUSS[:, None] * k[2])
        if not (at > 0.0).all():
            raise ArithmeticError("the timing of a way would stand still")
        spans = _WEIGHTS @ (1.0 / np.sqrt(at)) / self._pieces
        self._times = [0.0, *np.cumsum(spans).tolist()]
        self.duration: float = self._times[-1]
        self._polynomials = k.T.tolist()

    def compute_derivatives(self, time: float) -> tuple[float, float, float, float]:
        """Return sigma and its first three derivatives by time [s]."""
        if time >= self.duration:
            return 1.0, 0.0, 0.0, 0.0
        piece = max(0, bisect.bisect_right(self._times, time) - 1)
        k0, k1, k2 = self._polynomials[piece]
        left = (time - self._times[piece]) * self._pieces
        u = min(1.0, left * math.sqrt(k0))
        for _ in range(8):  # Newton's method: the rate is nearly even in a piece
            elapsed = u * sum(w / math.sqrt(k0 + g * u * (k1 + g * u * k2)) for g, w in _PAIRS)
            step = (left - elapsed) * math.sqrt(k0 + u * (k1 + u * k2))
            before, u = u, min(1.0, max(0.0, u + step))
            if abs(u - before) < 1e-12:
                break
        n = self._pieces
        c = k0 + u * (k1 + u * k2)
        rate = math.sqrt(c)
        slope, bend = n * (k1 + 2.0 * u * k2), n * n * 2.0 * k2
        return (piece + u) / n, rate, 0.5 * slope, 0.5 * bend * rate

"""A planned way of the joints: a curve and its timing.

Its timing is the one of least duration within the limits of speed, acceleration, jerk and torque,
from rest to rest. The result is checked at more places. Where it exceeds a limit there, it is
slowed down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import Lasting
from arm_emulator.build.c_header import NULL, pointer
from arm_emulator.motion.arm_tree import ArmTree
from arm_emulator.motion.joint_curve import JointCurve
from arm_emulator.motion.reference import Reference
from arm_emulator.motion.timing import Ramps, Rows, Timing, least_duration, places
from arm_emulator.motion.way_library import WAY, way_library

FloatArray = npt.NDArray[np.float64]

FEWEST_PIECES = 24  # of the timing
MOST_PIECES = 400  # of a way in which the ramps decide how many it has
IN_A_RAMP = 12  # pieces of it
MOST_TIMINGS = 3  # that are found for a way with as many pieces
CLOSE = 0.94  # factor of c with which a timing is slowed down as a whole
FAR, FINER = 0.83, 4  # with which its pieces are too long, and so many more are tried
MARGIN = 1.002  # of time: for what lies between the checks
JERK_MARGIN = 1.01  # likewise, of the jerk, which steps
_CHECKED, _CHECKED_AGAIN = 5, 17  # places in a piece where limits are held against it
_LOOKS = np.linspace(0.0, 1.0, 17)  # at which the length of the ramps is judged


@dataclass(frozen=True, eq=False)
class WayLimits:
    """Limits of the joints along a way, (N,) each; speed, acceleration and jerk > 0."""

    speed: FloatArray
    """[rad/s or m/s]."""
    acceleration: FloatArray
    """[rad/s2 or m/s2]."""
    jerk: FloatArray
    """[rad/s3 or m/s3]."""
    torque: FloatArray
    """[N m or N]; infinite: no limit."""


@dataclass(frozen=True, eq=False)
class AlongLimits:
    """Limits of the tool along its curve, which ends at s = 1."""

    length: float
    """Measure of the curve [m]."""
    speed: float
    """[m/s]."""
    acceleration: float
    """Along, and again across [m/s2]."""
    jerk: float
    """Along [m/s3]."""
    ends: FloatArray
    """Ends of the curve's parts in s, ascending (S,)."""
    curvature: FloatArray
    """Of these parts, acceleration across at speed 1, (S,) [1/m]."""

    @classmethod
    def straight(cls, length: float, speed: float, acceleration: float, jerk: float) -> AlongLimits:
        """Return those of a line."""
        return cls(length, speed, acceleration, jerk, np.ones(1), np.zeros(1))


class Way(Lasting):
    """A way from rest to rest.

    Args:
        curve: of the joints.
        limits: of the joints.
        arm: for torques; None: they are not limited.
        along: of the tool; None: it is as fast as the joints.
        asked: time in which the curve was meant to be gone through evenly [s], which no part of it
            falls below; 0: none.
        where: names the motion in refusals.

    Attributes:
        duration: [s].

    Raises:
        Refusal: at some place of the curve not even rest keeps the limits of torque.
    """

    def __init__(
        self,
        curve: JointCurve,
        limits: WayLimits,
        arm: ArmTree | None = None,
        along: AlongLimits | None = None,
        asked: float = 0.0,
        where: str = "motion",
    ) -> None:
        self.curve = curve
        self._limits, self._along, self._asked = limits, along, asked
        self._loaded = np.flatnonzero(np.isfinite(limits.torque))
        self._arm = arm if len(self._loaded) else None
        ramp, pieces = self._ramp()
        self._ramps = Ramps(ramp)
        given = self._given()
        self._timing = self._found(pieces, given, where)
        self.duration = self._timing.duration

    @property
    def loaded(self) -> bool:
        """Whether limits of torque are kept."""
        return self._arm is not None

    def at(self, time: float) -> Reference:
        """Return the joints at a time since the start [s]."""
        q, v, a, jerk = self.curve.moving(*self._over_time(time))
        return Reference(q, v, a, jerk)

    def place(self, time: float) -> float:
        """Return s at a time since the start [s]."""
        return self._over_time(time)[0]

    def _over_time(self, time: float) -> tuple[float, float, float, float]:
        """Return s and its first three derivatives by time."""
        sigma, d1, d2, d3 = self._timing.derivatives(max(0.0, time))
        s, s1, s2, s3 = self._ramps.at(sigma)
        return s, s1 * d1, s1 * d2 + s2 * d1**2, s1 * d3 + 3.0 * s2 * d1 * d2 + s3 * d1**3

    def _ramp(self) -> tuple[float, int]:
        """Return the share of sigma of the ramps, and its number of pieces."""
        _, f1, _, _ = self.curve.derivatives(_LOOKS)
        limits, tiny = self._limits, 1e-12
        slow = (np.abs(f1) / limits.speed).max(axis=1) + tiny  # seconds per s
        stiff = (np.abs(f1) / limits.acceleration).max(axis=1) + tiny
        if self._along is not None:
            slow = np.maximum(slow, self._along.length / self._along.speed)
            stiff = np.maximum(stiff, self._along.length / self._along.acceleration)
        cruise = max(float(slow.mean()), self._asked)
        ends = float(stiff[[0, -1]].max()) / cruise + float(
            (limits.acceleration / limits.jerk).max()
        )
        # Ways of any length are planned in so many pieces at most; a longer ramp is gentler.
        ramp = min(0.5, max(ends / (cruise + ends), IN_A_RAMP / MOST_PIECES))
        # Two checks or more in each piece of the curve, whose third derivative steps.
        in_curve = math.ceil(2.0 * (len(self.curve.breaks) - 1) / _CHECKED)
        return ramp, max(FEWEST_PIECES, round(IN_A_RAMP / ramp), in_curve)

    def _found(self, pieces: int, given: tuple[Any, ...], where: str) -> Timing:
        """Return the quickest timing found that keeps every limit at every check.

        Where one exceeds limits between the places for which it was found, it is found again with
        tighter ones there, and slowed down as a whole by the rest; and of more pieces, too, if the
        first exceeds them by much.
        """
        law, timings, first = way_library(), list[Timing](), 0.0
        # Once more with as many: now what is exceeded is known from more looks.
        for count in (pieces, pieces, min(FINER * pieces, max(pieces, MOST_PIECES))):
            sigma, keeps = places(count), np.empty(count)
            rows = self._rows(sigma, given)
            for _ in range(MOST_TIMINGS):
                found = least_duration(count, rows)
                if isinstance(found, int):
                    raise self._too_heavy(sigma[found], where)
                looks = _CHECKED_AGAIN if timings else _CHECKED
                law.way_keeps(*given, count, pointer(found), looks, JERK_MARGIN, pointer(keeps))
                least = float(keeps.min())
                first = first or least
                timings.append(Timing(found * least / MARGIN**2))
                if least > CLOSE:
                    break
                rows = rows.within(keeps)
            if first > FAR:
                break
        return min(timings, key=lambda one: one.duration)

    def _rows(self, sigma: FloatArray, given: tuple[Any, ...]) -> Rows:
        """Return the limits at places (P,), in parts of them; those of torque with an arm."""
        joints, along, torques = len(self._limits.speed), self._along is not None, 0
        if self._arm is not None:
            torques = len(self._loaded)
        most = np.empty(len(sigma))
        firsts = np.empty((3, len(sigma), joints + torques + along))
        thirds = np.empty((3, len(sigma), joints + along))
        way_library().way_rows(*given, len(sigma), *map(pointer, (sigma, most, firsts, thirds)))
        return Rows(most, firsts, thirds)

    def _given(self) -> tuple[Any, ...]:
        """Return arm, curve, limits and ramp as way.h takes them."""
        limits, along = self._limits, self._along
        struct = WAY.new(
            "way_limits",
            speed=limits.speed,
            acceleration=limits.acceleration,
            jerk=limits.jerk,
            torque=limits.torque,
            asked=self._asked,
        )
        if along is not None:
            WAY.fill(
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

    def _too_heavy(self, sigma: float, where: str) -> Refusal:
        assert self._arm is not None
        s = self._ramps.derivatives(np.array([sigma]))[0]
        q = self.curve.derivatives(s)[0]
        still = np.zeros_like(q)
        share = np.abs(self._arm.torques(q, still, still)[0]) / self._limits.torque
        j = int(np.argmax(share))
        name = self._arm.kinematics.joint_names[j]
        rule = f"need no more torque of {name} than its limit, {self._limits.torque[j]:.4g} N m"
        got = f"{share[j] * self._limits.torque[j]:.4g} N m to hold it at {s[0]:.0%} of the way"
        return Refusal(where, "the way", rule, got)

"""A planned way of the joints: a curve and its timing.

Its timing is the one of least duration within the limits of speed, acceleration, jerk and torque,
from rest to rest. The result is checked at more places, and slowed down if it exceeds a limit
there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import Lasting
from arm_emulator.motion.arm_tree import ArmTree
from arm_emulator.motion.joint_curve import JointCurve
from arm_emulator.motion.reference import Reference
from arm_emulator.motion.timing import Ramps, Rows, Timing, least_duration, places

FloatArray = npt.NDArray[np.float64]

FEWEST_PIECES = 24  # of the timing
MOST_PIECES = 400  # of a way in which the ramps decide how many it has
IN_A_RAMP = 12  # pieces of it
MARGIN = 1.002  # of time: for what lies between the checks
JERK_MARGIN = 1.01  # likewise, of the jerk, which steps
_CHECKS = (0.0, 0.25, 0.5, 0.75, 1.0)  # places in a piece where limits are held against
_BESIDE = 1e-7  # of sigma
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
        rows = self._rows(self._places(places(pieces)), self._arm)
        timing = least_duration(pieces, rows)
        if not isinstance(timing, Timing):
            raise self._too_heavy(places(pieces)[timing], where)
        self._timing = timing.slower(self._excess(pieces, timing))
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
        in_curve = math.ceil(2.0 * (len(self.curve.breaks) - 1) / len(_CHECKS))
        return ramp, max(FEWEST_PIECES, round(IN_A_RAMP / ramp), in_curve)

    def _places(self, sigma: FloatArray) -> _Places:
        s = self._ramps.derivatives(sigma)
        return _Places(s, _composed(self.curve, s))

    def _rows(self, at: _Places, arm: ArmTree | None) -> Rows:
        """Return the limits at places, in parts of them; those of torque with an arm."""
        s = at.s
        q, f1, f2, f3 = at.joints
        limits = self._limits
        with np.errstate(divide="ignore"):
            most = ((limits.speed / np.maximum(np.abs(f1), 1e-12)) ** 2).min(axis=1)
        if self._asked > 0.0:
            most = np.minimum(most, 1.0 / np.maximum(self._asked * s[1], 1e-12) ** 2)
        a, j = limits.acceleration, limits.jerk
        firsts = [np.zeros_like(f1), f2 / a, 0.5 * f1 / a]
        thirds = [f3 / j, 1.5 * f2 / j, 0.5 * f1 / j]
        if arm is not None:
            torques = self._torques(arm, q, f1, f2)
            firsts = [np.hstack(pair) for pair in zip(firsts, torques, strict=True)]
        if self._along is not None:
            along = self._along
            g1, g2, g3 = (along.length * s[1:])[:, :, None]
            most = np.minimum(most, (along.speed / np.maximum(np.abs(g1[:, 0]), 1e-12)) ** 2)
            part = np.minimum(np.searchsorted(along.ends, s[0]), len(along.ends) - 1)
            across = along.curvature[part] * g1[:, 0] ** 2
            most = np.minimum(most, along.acceleration / np.maximum(across, 1e-12))
            b, k = along.acceleration, along.jerk
            firsts = [
                np.hstack([one, more])
                for one, more in zip(firsts, (0.0 * g1, g2 / b, 0.5 * g1 / b), strict=True)
            ]
            thirds = [
                np.hstack([one, more])
                for one, more in zip(thirds, (g3 / k, 1.5 * g2 / k, 0.5 * g1 / k), strict=True)
            ]
        return Rows(most, np.stack(firsts), np.stack(thirds))

    def _torques(
        self, arm: ArmTree, q: FloatArray, f1: FloatArray, f2: FloatArray
    ) -> list[FloatArray]:
        """Return what torques are by 1, c and c', in parts of their limits, (P, L) each."""
        still, used = np.zeros_like(q), self._loaded
        limit = self._limits.torque[used]
        weight = arm.torques(q, still, still)
        rate = arm.torques(q, f1, f2) - weight
        change = arm.torques(q, still, f1) - weight
        return [weight[:, used] / limit, rate[:, used] / limit, 0.5 * change[:, used] / limit]

    def _excess(self, pieces: int, timing: Timing) -> float:
        """Return the factor of duration with which the way keeps every limit at every check."""
        # Third derivatives step at the ends of the ramps and at the breaks of the curve.
        ramp = np.array([self._ramps.ramp, 1.0 - self._ramps.ramp])
        breaks = np.concatenate([ramp, self._ramps.inverse(self.curve.breaks[1:-1])])
        sigma = np.concatenate([places(pieces, _CHECKS), breaks - _BESIDE, breaks + _BESIDE])
        c, d, e = timing.rates(sigma)
        at = self._places(sigma)
        rows = self._rows(at, self._arm if self._overloaded(at, c, d) else None)
        slower = max(1.0, float((c / rows.most).max()))  # of c
        f0, fc, fd = rows.firsts
        moving = fc * c[:, None] + fd * d[:, None]
        room = np.maximum(1.0 - np.sign(moving) * f0, 1e-6)
        slower = max(slower, float((np.abs(moving) / room).max()))
        tc, td, te = rows.thirds
        third = np.abs(tc * c[:, None] + td * d[:, None] + te * e[:, None]) * np.sqrt(c)[:, None]
        slower = max(slower, (JERK_MARGIN * float(third.max())) ** (2.0 / 3.0))
        return math.sqrt(slower) * MARGIN

    def _overloaded(self, at: _Places, c: FloatArray, d: FloatArray) -> bool:
        """Whether a torque exceeds its limit at places."""
        if self._arm is None:
            return False
        q, f1, f2, _ = at.joints
        a = f2 * c[:, None] + 0.5 * f1 * d[:, None]
        torques = self._arm.torques(q, f1 * np.sqrt(c)[:, None], a)
        return bool((np.abs(torques) > self._limits.torque).any())

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


class _Places(NamedTuple):
    """Places of a way."""

    s: FloatArray
    """With its first three derivatives by sigma, (4, K)."""
    joints: FloatArray
    """Likewise, (4, K, N)."""


def _composed(curve: JointCurve, s: FloatArray) -> FloatArray:
    """Return the joints and their first three derivatives by sigma, (4, K, N)."""
    q, q1, q2, q3 = curve.derivatives(s[0])
    s1, s2, s3 = s[1:, :, None]
    return np.stack([q, q1 * s1, q2 * s1**2 + q1 * s2, q3 * s1**3 + 3.0 * q2 * s1 * s2 + q1 * s3])

"""Guard against collisions: the joints can always stop before two parts touch."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.collision.collisions import collisions_of
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import Motion, PlanningError, Reference
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.obstacles import OBSTACLES
from arm_emulator.motion.trajectory.jerk_limited_velocity import JerkLimitedVelocity

_BETWEEN = 0.05  # m that parts of the arm may move to each other between two looks
_FINEST = 5e-3  # m, likewise, that they may move near an obstacle whatever the margin is
_ROUNDING = 1e-6  # m
_FIRST, _MOST = 33, 2000  # configurations of a way

Angles = Callable[[Array], Array]
"""Angles of the joints (K, N) at parts of a way (K,), 0 to 1."""


class CollisionGuard:
    """Tests the reference ahead.

    In each period it tests the way on which the joints would come to rest if they braked after it.
    When parts touch there they brake now, on the way that the period before has tested. So they
    rest before they touch, by the margin, whatever was asked for. Motions that are known to their
    end are checked before they begin: where joints that brake each by itself would touch beside
    such a way, the arm goes on, and could stop on it.

    The looks at a motion are so near that no part touches an obstacle between two of them, however
    thin it is: parts that are the margin or more away before and after a look would have to move
    twice the margin (or `_FINEST`) to touch between. Parts of the arm are no plates: they are
    looked at every `_BETWEEN`.

    Args:
        kinematics: of the arm.
        config: obstacles and margin.

    Raises:
        Refusal: see `Collisions`, or obstacles beside an arm without shapes.
    """

    def __init__(self, kinematics: Kinematics, config: MotionConfig) -> None:
        self._kinematics, self._margin = kinematics, config.collision_margin
        self.collisions = collisions_of(
            kinematics.urdf_xml, kinematics.joint_names, config.obstacles, config.collision_margin
        )
        if config.obstacles and not self.collisions.meets_obstacles:
            rule = "be met by shapes for collisions of the robot description"
            got = "no collision shapes of moving links"
            raise Refusal(config.where, OBSTACLES, rule, got, "<collision> in its links")
        self._rested: Array | None = None  # a state at rest without contact

    def ahead(self, joints: JerkLimitedVelocity, now: Array, then: Reference) -> str:
        """Return which parts touch where the joints stop if they brake from `then` on; empty: none.

        Where parts touch already at `now` (N,), a motion that brings them no nearer is allowed.
        """
        way = joints.stopping_way(then, self._step)
        if len(way) == 1 and self._rested is not None and np.array_equal(way[0], self._rested):
            return ""
        for q in way[::-1]:
            if touching := self.collisions.fresh(q, now, _ROUNDING):
                return touching
        self._rested = way[0] if len(way) == 1 else None
        return ""

    def frees(self, motion: Motion) -> bool:
        """Whether no parts touch on a motion that `check` has passed, nor after it."""
        end = motion.at(motion.duration)
        return not end.v.any() and not self.collisions.first(motion.at(0.0).q)

    def along(self, angles: Angles) -> tuple[float, str] | None:
        """Return at which part of a way parts touch first, and which; None: they do not."""
        part, q = self._apart(angles)
        gone = np.concatenate([[0.0], np.cumsum(self._parts(np.diff(q, axis=0)))])
        looks = [0]
        for k in range(1, len(q)):
            if k + 1 == len(q) or gone[k + 1] - gone[looks[-1]] > 1.0:
                looks.append(k)
        found = None
        # Parts that touch where it begins may move apart: `ahead` watches them.
        for k in self.collisions.suspects(q[looks[1:]]):
            if touching := self.collisions.fresh(q[looks[1 + k]], q[0], math.inf):
                found = float(part[looks[1 + k]]), touching
                break
        return self._met(angles, part, q, found)

    def _met(
        self, angles: Angles, part: Array, q: Array, found: tuple[float, str] | None
    ) -> tuple[float, str] | None:
        """Return where an obstacle is met before what was found, or that.

        Conservative advancement, pair by pair: from a look at which parts are d apart they may move
        d to touch, and the margin more until they are as far apart again as the next look accepts.

        Args:
            angles: of the joints on the way.
            part: places on it (K,), not far apart.
            q: angles there (K, N).
            found: place and words of a touch.
        """
        tested = self.collisions
        pairs = tested.foreign
        gaps = tested.gaps(pairs, np.broadcast_to(q[0], (len(pairs), q.shape[1])))
        if not gaps:
            return found
        # A joint that turns round between two places goes farther than from one to the other.
        turns = np.pad(np.abs(np.diff(q, 2, axis=0)), ((1, 1), (0, 0)))
        ways = np.abs(np.diff(q, axis=0)) + 0.25 * np.maximum(turns[1:], turns[:-1])
        gone = np.vstack([np.zeros(tested.pairs), np.cumsum(tested.moved(ways), axis=0)])
        end, at = 1.0 if found is None else found[0], dict.fromkeys(gaps, 0.0)
        while gaps:
            places = {}
            for k, gap in gaps.items():
                at[k] += max(gap + tested.margins[k], _FINEST)
                if at[k] < gone[-1, k]:
                    place = float(np.interp(at[k], gone[:, k], part))
                    if place < end:
                        places[k] = place
            if not places:
                break
            gaps = tested.gaps([*places], angles(np.array([*places.values()])))
            for k, place in places.items():
                if k not in gaps and place < end:
                    end, found = place, (place, tested.name(k))
        return found

    def check(self, where: str, angles: Angles) -> None:
        """Check a whole motion before it begins.

        Args:
            where: names the motion.
            angles: of the joints on it.

        Raises:
            PlanningError: with the pair and the place.
        """
        found = self.along(angles)
        if found is None:
            return
        part, touching = found
        place = np.array2string(
            self._kinematics.forward(angles(np.array([part]))[0])[1],
            precision=3,
            suppress_small=True,
        )
        got = f"{touching} would touch at {part:.0%} of it, the tool at {place} m"
        raise PlanningError(where, "the way", f"keep parts {self._margin * 1e3:g} mm apart", got)

    def _apart(self, angles: Angles) -> tuple[Array, Array]:
        """Return parts of a way (K,), and angles there (K, N), no farther apart than is tested."""
        part = np.linspace(0.0, 1.0, _FIRST)
        q = angles(part)
        while len(part) < _MOST:
            pieces = np.ceil(self._parts(np.diff(q, axis=0)) - 1e-9)
            if (pieces <= 1.0).all():
                break
            finer = (len(part) - 1) * min(int(pieces.max()), _MOST)
            part = np.linspace(0.0, 1.0, min(finer, 2 * _MOST) + 1)
            q = angles(part)
        return part, q

    def _step(self, way: Array) -> int:
        """Return the number of pieces in which a way of the joints (N,) is tested."""
        moved = self.collisions.moved(way)
        foreign = self.collisions.foreign
        nearest = np.maximum(2.0 * self.collisions.margins[foreign], _FINEST)
        obstacles = float((moved[foreign] / nearest).max(initial=0.0))
        return max(1, math.ceil(max(float(self._parts(way)), obstacles)))

    def _parts(self, ways: Array) -> Array:
        """Return how many pieces ways of the joints (..., N) are."""
        return np.asarray(self.collisions.moved(ways).max(axis=-1, initial=0.0) / _BETWEEN)

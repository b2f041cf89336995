"""Guard against collisions: the joints can always stop before two parts touch."""

import math
from collections.abc import Callable

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.collision.collisions import load_collisions
from arm_emulator.motion.model.config import MotionConfig
from arm_emulator.motion.model.joint_reference import PlanningError, Reference, ReferenceMotion
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.obstacles import OBSTACLES
from arm_emulator.motion.trajectory.jerk_limited_velocity import JerkLimitedVelocity

_BETWEEN = 0.05  # m that parts of the arm may move to each other between two looks
_FINEST = 5e-3  # m, likewise, that they may move near an obstacle whatever the margin is
_ROUNDING = 1e-6  # m
_FIRST, _MAX_LOOKS = 33, 2000  # configurations of a way

Angles = Callable[[Array], Array]
"""Angles of the joints (K, N) at parts of a way (K,), 0 to 1."""


class CollisionGuard:
    """Tests the reference ahead.

    In each period it tests the way on which the joints would come to rest if they braked after it.
    When parts touch there they brake now, on the way that the period before has tested. So they
    rest before they touch, at the distance of the margin, under any command. Motions that are known
    to their end are checked before they begin: where joints that brake each by itself would touch
    next to such a way, the arm goes on, and could stop on it.

    The checks of a motion are so near that no part touches an obstacle between two of them, even a
    thin one: parts that are the margin or more away before and after a look would have to move
    twice the margin (or `_FINEST`) to touch between. Parts of the arm are no plates: they are
    looked at every `_BETWEEN`.

    Raises:
        Refusal: see `Collisions`, or obstacles for an arm without shapes.
    """

    def __init__(self, kinematics: Kinematics, config: MotionConfig) -> None:
        self._kinematics, self._margin = kinematics, config.collision_margin
        self.collisions = load_collisions(
            kinematics.urdf_xml, kinematics.joint_names, config.obstacles, config.collision_margin
        )
        if config.obstacles and not self.collisions.has_obstacle_pairs:
            rule = "be met by shapes for collisions of the robot description"
            shapes = "no collision shapes of moving links"
            raise Refusal(config.where, OBSTACLES, rule, shapes, "<collision> in its links")
        self._rested: Array | None = None  # a state at rest without contact

    def check_ahead(self, joints: JerkLimitedVelocity, now: Array, then: Reference) -> str:
        """Return which parts touch where the joints stop if they brake from `then` on; empty: none.

        Where parts touch already at `now` (N,), a motion that brings them no nearer is allowed.
        """
        stop_path = joints.sample_stop(then, self._count_steps)
        if (
            len(stop_path) == 1
            and self._rested is not None
            and np.array_equal(stop_path[0], self._rested)
        ):
            return ""
        for q in stop_path[::-1]:
            if touching := self.collisions.find_new_contact(q, now, _ROUNDING):
                return touching
        self._rested = stop_path[0] if len(stop_path) == 1 else None
        return ""

    def is_free(self, motion: ReferenceMotion) -> bool:
        """Whether no parts touch on a motion that `check_motion` has passed, nor after it."""
        end = motion.evaluate_at(motion.duration)
        return not end.v.any() and not self.collisions.find_first_contact(motion.evaluate_at(0.0).q)

    def find_contact_along(self, angles: Angles) -> tuple[float, str] | None:
        """Return at which part of a way parts touch first, and which; None: they do not."""
        part, q = self._sample_path(angles)
        travelled = np.concatenate([[0.0], np.cumsum(self._count_pieces(np.diff(q, axis=0)))])
        looks = [0]
        for k in range(1, len(q)):
            if k + 1 == len(q) or travelled[k + 1] - travelled[looks[-1]] > 1.0:
                looks.append(k)
        contact = None
        # Parts that touch where it begins may move apart: `check_ahead` watches them.
        for k in self.collisions.find_touching(q[looks[1:]]):
            if touching := self.collisions.find_new_contact(q[looks[1 + k]], q[0], math.inf):
                contact = float(part[looks[1 + k]]), touching
                break
        return self._find_obstacle_contact(angles, part, q, contact)

    def _find_obstacle_contact(
        self, angles: Angles, part: Array, q: Array, contact: tuple[float, str] | None
    ) -> tuple[float, str] | None:
        """Return where an obstacle is met before what was found, or that.

        Conservative advancement, pair by pair: parts that are d apart at a check may move d until
        they touch. They move the margin more until they are as far apart again as the next check
        accepts.

        Args:
            angles: of the joints on the way.
            part: places on it (K,), not far apart.
            q: angles there (K, N).
            contact: place and words of a touch.
        """
        tested = self.collisions
        pairs = tested.foreign
        gaps = tested.measure_gaps(pairs, np.broadcast_to(q[0], (len(pairs), q.shape[1])))
        if not gaps:
            return contact
        # A joint that turns round between two places goes farther than from one to the other.
        reversals = np.pad(np.abs(np.diff(q, 2, axis=0)), ((1, 1), (0, 0)))
        moves = np.abs(np.diff(q, axis=0)) + 0.25 * np.maximum(reversals[1:], reversals[:-1])
        travelled = np.vstack(
            [np.zeros(tested.pairs), np.cumsum(tested.bound_motions(moves), axis=0)]
        )
        end, at = 1.0 if contact is None else contact[0], dict.fromkeys(gaps, 0.0)
        while gaps:
            places = {}
            for k, gap in gaps.items():
                at[k] += max(gap + tested.margins[k], _FINEST)
                if at[k] < travelled[-1, k]:
                    place = float(np.interp(at[k], travelled[:, k], part))
                    if place < end:
                        places[k] = place
            if not places:
                break
            gaps = tested.measure_gaps([*places], angles(np.array([*places.values()])))
            for k, place in places.items():
                if k not in gaps and place < end:
                    end, contact = place, (place, tested.name_pair(k))
        return contact

    def check_motion(self, where: str, angles: Angles) -> None:
        """Check a whole motion before it begins."""
        contact = self.find_contact_along(angles)
        if contact is None:
            return
        part, touching = contact
        place = np.array2string(
            self._kinematics.forward(angles(np.array([part]))[0])[1],
            precision=3,
            suppress_small=True,
        )
        met = f"{touching} would touch at {part:.0%} of it, the tool at {place} m"
        raise PlanningError(where, "the way", f"keep parts {self._margin * 1e3:g} mm apart", met)

    def _sample_path(self, angles: Angles) -> tuple[Array, Array]:
        """Return parts of a way (K,), and angles there (K, N), no farther apart than is tested."""
        part = np.linspace(0.0, 1.0, _FIRST)
        q = angles(part)
        while len(part) < _MAX_LOOKS:
            pieces = np.ceil(self._count_pieces(np.diff(q, axis=0)) - 1e-9)
            if (pieces <= 1.0).all():
                break
            finer = (len(part) - 1) * min(int(pieces.max()), _MAX_LOOKS)
            part = np.linspace(0.0, 1.0, min(finer, 2 * _MAX_LOOKS) + 1)
            q = angles(part)
        return part, q

    def _count_steps(self, motion: Array) -> int:
        """Return the number of pieces in which a way of the joints (N,) is tested."""
        moved = self.collisions.bound_motions(motion)
        foreign = self.collisions.foreign
        nearest = np.maximum(2.0 * self.collisions.margins[foreign], _FINEST)
        obstacles = float((moved[foreign] / nearest).max(initial=0.0))
        return max(1, math.ceil(max(float(self._count_pieces(motion)), obstacles)))

    def _count_pieces(self, motions: Array) -> Array:
        """Return how many pieces ways of the joints (..., N) are."""
        return np.asarray(
            self.collisions.bound_motions(motions).max(axis=-1, initial=0.0) / _BETWEEN
        )

"""Load of the gears at rest, from the torques that the motors give there.

The weight that a robot description predicts may be wrong, and then so is the gears' wind-up; at
rest, motors give the weight that there really is. The factor between both multiplies what the
links load their gears with. It follows slowly while the reference rests, and stays as it is in
motion, so that it never makes a target jump.

Friction holds a part of the weight at rest, of either sign: what it leaves uncertain counts as
predicted right, and a weight of that size is no evidence. When the joint starts to move, friction
releases that part: it is taken off the announced torques then, as the servo has it in its integral.

A joint without evidence of its own, as one that turns about a vertical axis, moves what the next
joints carry: it is taken to be as wrong as they are. A factor within 0.5 to 2 cannot wind up a gear
against an obstacle indefinitely.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from arm_emulator.base.arrays import Array

MIN_FACTOR, MAX_FACTOR = 0.5, 2.0
_SETTLED = 0.1  # s at rest before the motors' torques count: links swing after a motion
_FOLLOWS = 0.3  # s, in which the factor follows
_TAKEN = 1.0  # s of motion, in which the servo's integral takes over what friction has let go of
_FINE = 1e-5  # rad: a wind-up that nobody sees
# Known friction is known within this factor; more of it holds a joint that stands.
_FRICTION = 1.5


class RestLoad:
    """Factor of the torques that links load their gears with, joint by joint.

    Attributes:
        factor: (N,), 1 at first.

    Args:
        dry: dry friction of the joints, links and rotors (N,) [N m].
        softness: wind-up per torque (N,) [rad/(N m)]; 0: rigid.
        period: motion period [s].
        outboard: see `LinkTorques`.
    """

    def __init__(
        self,
        dry: Array,
        softness: Array,
        period: float,
        outboard: Sequence[tuple[int, Sequence[int]]],
    ) -> None:
        self.factor: Array = np.ones(len(dry))
        with np.errstate(divide="ignore"):
            self._uncertain: Array = _FRICTION * dry + _FINE / softness
        self._period, self._outboard = period, outboard
        self._dry = dry
        self._friction_torque: Array = np.zeros(len(dry))  # by friction at rest, N m
        self._rested = 0.0  # s

    def note_motion(self) -> None:
        """Take note that the joints do not rest, or cannot move."""
        self._rested = 0.0

    def note_brakes(self, free: npt.NDArray[np.bool_]) -> None:
        """Take note which joints can move (N,): brakes hold the others, or nothing does."""
        self._friction_torque = np.where(free, self._friction_torque, 0.0)
        self.note_motion()

    def release_friction(self, sliding: Array) -> Array:
        """Return what friction held at rest and holds no longer in a motion period (N,) [N m].

        Args:
            sliding: share of its dry friction with which a joint slides (N,), 0 at rest.
        """
        released = sliding * self._friction_torque
        self._friction_torque = self._friction_torque - min(1.0, self._period / _TAKEN) * released
        return released

    def observe_rest(self, tau: Array, weight: Array) -> None:
        """Follow the load in a motion period of rest.

        `tau` are torques that the motors give, `weight` those predicted, at the links (N,) [N m].
        """
        self._rested += self._period
        if self._rested < _SETTLED:
            return
        factors = np.empty_like(self.factor)
        for j, carried in self._outboard:
            expected = float(np.mean([factors[k] for k in carried])) if carried else 1.0
            w, uncertain = float(weight[j]), float(self._uncertain[j])
            surplus = float(tau[j]) - expected * w
            surplus -= min(max(surplus, -uncertain), uncertain)
            factor = expected + surplus * w / (w**2 + uncertain**2)
            factors[j] = min(max(factor, MIN_FACTOR), MAX_FACTOR)
        self._friction_torque = np.clip(tau - self.factor * weight, -self._dry, self._dry)
        self.factor = self.factor + min(1.0, self._period / _FOLLOWS) * (factors - self.factor)

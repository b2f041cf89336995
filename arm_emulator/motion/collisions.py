"""Contacts between parts of an arm, or with obstacles, in a configuration: Pinocchio with coal.

The shapes are those for collisions in the robot description. Meshes are tested triangle by
triangle where their convex hulls touch; distances are those of the hulls. Two parts count as
touching when they are nearer than a margin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from arm_emulator.base.saved_objects import Lasting
from arm_emulator.motion.arm_shapes import ArmShapes
from arm_emulator.motion.instruction import FloatArray
from arm_emulator.motion.obstacles import Obstacle

_DRAWN = 100  # configurations
_ALWAYS = 0.95  # share of them above which two touching parts count as joined
_FAR = 1e3  # m
OWN_SHARE = 0.2  # of the margin, between parts of the arm: their shapes and places are known


class Collisions(Lasting):
    """Tests configurations.

    Two parts of the arm are not tested against each other where one joint or none is between them,
    where they touch with all joints at 0 (or in the middle of their limits), and where they touch
    in nearly all configurations; obstacles not against what stands still.

    Args:
        urdf_xml: the robot description.
        joint_names: the joints commanded, in the order of all arrays; the others stay at 0.
        obstacles: in the world.
        margin: to obstacles, and `OWN_SHARE` of it between parts of the arm [m].

    Attributes:
        pairs: how many pairs are tested.

    Raises:
        Refusal: a description, or a mesh in it, that cannot be read.
    """

    def __init__(
        self,
        urdf_xml: str,
        joint_names: Sequence[str],
        obstacles: Sequence[Obstacle],
        margin: float,
    ) -> None:
        self._arm = ArmShapes(urdf_xml, joint_names)
        self._shapes, self._meshes = self._arm.hulls, self._arm.meshes
        self._model = self._arm.model
        self._data = self._model.createData()
        self._own = len(self._arm.links)
        self._names = list(self._arm.links)
        for obstacle in obstacles:
            for shapes in (self._shapes, self._meshes):
                shapes.addGeometryObject(_solid(obstacle))
            self._names.append(obstacle.name)
        self._pair()
        self._leave_out(margin)
        self._made(margin)

    @property
    def pairs(self) -> int:
        """Number of pairs tested."""
        return len(self._shapes.collisionPairs)

    def first(self, q: FloatArray) -> str:
        """Return which two parts touch at q (N,), ``forearm_link and floor``; empty: none do."""
        touching = self._touching(q) if self.pairs else []
        return self._name(touching[0]) if touching else ""

    def fresh(self, q: FloatArray, now: FloatArray, nearer: float) -> str:
        """Return which two parts touch at q and not at `now`, or have come nearer; empty: none.

        Args:
            q: where the joints would be (N,).
            now: where they are (N,).
            nearer: distance that parts which touch already may lose [m].
        """
        if not self.first(q):
            return ""
        touched, touching = self._all(now), self._all(q)
        for k in np.flatnonzero(touching & ~touched):
            return self._name(int(k))
        both = np.flatnonzero(touching & touched)
        if math.isinf(nearer) or not len(both):
            return ""
        lost = self._distances(now)[both] - self._distances(q)[both]
        return self._name(int(both[np.argmax(lost)])) if lost.max() > nearer else ""

    def nearest(self, q: FloatArray) -> float:
        """Return the distance of the two nearest parts at q (N,) [m]; < 0: they overlap."""
        return float(self._distances(q).min())

    def _distances(self, q: FloatArray) -> FloatArray:
        whole = self._arm.whole(q)
        pin.computeDistances(self._model, self._data, self._shapes, self._tested, whole)
        return np.array([one.min_distance for one in self._tested.distanceResults])

    def _touching(self, q: FloatArray) -> list[int]:
        """Return the pairs whose meshes touch at q, of those whose convex hulls do."""
        whole = self._arm.whole(q)
        if not pin.computeCollisions(
            self._model, self._data, self._shapes, self._tested, whole, False
        ):
            return []
        hulls = [k for k, one in enumerate(self._tested.collisionResults) if one.isCollision()]
        pin.updateGeometryPlacements(self._model, self._data, self._meshes, self._exact)
        return [k for k in hulls if pin.computeCollision(self._meshes, self._exact, k)]

    def _name(self, k: int) -> str:
        pair = self._shapes.collisionPairs[k]
        return f"{self._names[pair.first]} and {self._names[pair.second]}"

    def _pair(self) -> None:
        shapes, parents, own = self._shapes.geometryObjects, self._model.parents, self._own
        for i in range(own):
            one = shapes[i].parentJoint
            for k in range(i + 1, len(shapes)):
                other = shapes[k].parentJoint
                near = one == other or (k < own and one in (parents[other],))
                near = near or (k < own and other == parents[one])
                if not near:
                    for one_of in (self._shapes, self._meshes):
                        one_of.addCollisionPair(pin.CollisionPair(i, k))

    def _leave_out(self, margin: float) -> None:
        """Leave out pairs of the arm's own parts that touch in valid poses."""
        self._made(margin)
        count = np.zeros(self.pairs)
        rng = np.random.default_rng(0)
        for _ in range(_DRAWN):
            count += self._all(self._arm.drawn(rng))
        always = (count > _ALWAYS * _DRAWN) | self._all(self._arm.rest)
        # Numbers, not the pairs: those move when one before them is removed.
        pairs = [(pair.first, pair.second) for pair in self._shapes.collisionPairs]
        kept = [
            pair
            for pair, together in zip(pairs, always, strict=True)
            if pair[1] >= self._own or not together
        ]
        for shapes in (self._shapes, self._meshes):
            shapes.removeAllCollisionPairs()
            for pair in kept:
                shapes.addCollisionPair(pin.CollisionPair(*pair))

    def _all(self, q: FloatArray) -> npt.NDArray[np.bool_]:
        touching = np.zeros(self.pairs, dtype=bool)
        touching[self._touching(q)] = True
        return touching

    def _made(self, margin: float) -> None:
        self._tested = self._shapes.createData()
        self._exact = self._meshes.createData()
        for tested in (self._tested, self._exact):
            for pair, request in zip(
                self._shapes.collisionPairs, tested.collisionRequests, strict=True
            ):
                request.security_margin = margin * (OWN_SHARE if pair.second < self._own else 1.0)


def _solid(obstacle: Obstacle) -> Any:
    if obstacle.height is not None:
        # A box as deep as wide: not all pairs of shapes support a half space.
        shape, at = coal.Box(2.0 * _FAR, 2.0 * _FAR, _FAR), [0.0, 0.0, obstacle.height - 0.5 * _FAR]
    else:
        shape, at = coal.Box(*obstacle.size), list(obstacle.at)
    place = pin.SE3(pin.rpy.rpyToMatrix(*obstacle.rpy), np.array(at))
    return pin.GeometryObject(obstacle.name, 0, place, shape)

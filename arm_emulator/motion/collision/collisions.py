"""Contacts between parts of an arm, or with obstacles, in a configuration: Pinocchio with coal.

The shapes are those for collisions in the robot description. Meshes are tested triangle by
triangle where their convex hulls touch; distances are those of the hulls. Two parts count as
touching when they are nearer than a margin.
"""

from __future__ import annotations

import functools
import math
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.motion.collision.shapes import CollisionShapes
from arm_emulator.motion.model.obstacles import Obstacle

_SAMPLES = 100  # configurations
# Share of them above which two touching parts count as joined. Parts that only collide do so in at
# most 0.26 (14 arms); shapes that overlap where they belong together in 0.44 and more.
_JOINED = 0.35
_NEAR = 0.02  # share of them above which two parts that are near without touching belong there
_MANY = 40  # pairs from which on it is quicker to look at boxes first
_FAR = 1e3  # m
OWN_SHARE = 0.2  # of the margin, between parts of the arm: their shapes and places are known


@functools.lru_cache(maxsize=8)
def load_collisions(
    urdf_xml: str, joint_names: tuple[str, ...], obstacles: tuple[Obstacle, ...], margin: float
) -> Collisions:
    """Return `Collisions`, the same for the same arguments."""
    return Collisions(urdf_xml, joint_names, obstacles, margin)


class Collisions(SharedObject):
    """Tests configurations.

    Two parts of the arm are not tested against each other if at most one joint is between them. Nor
    are parts that touch with all joints at 0 (or in the middle of their limits), or in more than a
    third of all configurations. Obstacles are not tested against parts that stand still. Parts that
    are near each other by design may come as near as in the design.

    Args:
        urdf_xml: the robot description.
        joint_names: the joints commanded, in the order of all arrays; the others stay at 0.
        obstacles: in the world.
        margin: to obstacles, and `OWN_SHARE` of it between parts of the arm [m].

    Attributes:
        pairs: how many pairs are tested.
        margins: of each pair (pairs,) [m].
        foreign: the numbers of pairs with an obstacle.

    Raises:
        Refusal: a description, or a mesh in it, that cannot be read.
    """

    _boxes: Any

    def __init__(
        self,
        urdf_xml: str,
        joint_names: Sequence[str],
        obstacles: Sequence[Obstacle],
        margin: float,
    ) -> None:
        self._arm = CollisionShapes(urdf_xml, joint_names)
        self._shapes, self._meshes = self._arm.hulls, self._arm.meshes
        self._model = self._arm.model
        self._data = self._model.createData()
        self._own = len(self._arm.links)
        self._names = list(self._arm.links)
        for obstacle in obstacles:
            for shapes in (self._shapes, self._meshes):
                shapes.addGeometryObject(_make_solid(obstacle))
            self._names.append(obstacle.name)
        self._alone = threading.Lock()  # arms of one kind share it, also those of threads
        self._close = set[tuple[int, int]]()
        self._add_pairs()
        self._leave_out(margin)
        self._prepare_tests(margin)
        pairs = [(pair.first, pair.second) for pair in self._shapes.collisionPairs]
        self.foreign = [k for k, pair in enumerate(pairs) if pair[1] >= self._own]
        # No joint moves an obstacle; one that moves both parts moves neither towards the other.
        still = np.zeros((len(obstacles), self._arm.leads.shape[1]))
        leads = np.concatenate([self._arm.leads, still])
        first_leads, second_leads = (leads[[pair[side] for pair in pairs]] for side in (0, 1))
        self._leads = np.where(
            (first_leads > 0.0) & (second_leads > 0.0), 0.0, np.maximum(first_leads, second_leads)
        ).T

    @property
    def has_obstacle_pairs(self) -> bool:
        """Whether any part of the arm is tested against an obstacle."""
        return bool(self.foreign)

    @property
    def pairs(self) -> int:
        """Number of pairs tested."""
        return len(self._shapes.collisionPairs)

    def find_first_contact(self, q: Array) -> str:
        """Return which two parts touch at q (N,), ``forearm_link and floor``; empty: none do."""
        with self._alone:
            touching = self._find_contacts(self._arm.compute_configuration(q)) if self.pairs else []
        return self.name_pair(touching[0]) if touching else ""

    def find_touching(self, q: Array) -> Iterator[int]:
        """Yield the numbers of those of some configurations (K, N) in which any parts touch."""
        if self.pairs:
            for k, configuration in enumerate(self._arm.compute_configuration(q)):
                with self._alone:
                    touching = self._find_contacts(configuration)
                if touching:
                    yield k

    def sample_configuration(self, rng: np.random.Generator) -> Array:
        """Return a configuration within the limits (N,)."""
        return self._arm.sample_configuration(rng)

    def bound_motions(self, motions: Array) -> Array:
        """Return how far the parts of each pair move at most, seen from each other [m].

        Args:
            motions: of the joints (..., N); returned are (..., pairs).
        """
        return np.asarray(self._arm.compute_joint_ranges(motions) @ self._leads)

    def measure_gaps(self, pairs: Sequence[int], q: Array) -> dict[int, float]:
        """Return distances that the parts of pairs have at least [m], each at q (pairs, N).

        That of their convex hulls, or the margin, where the meshes within those do not touch; pairs
        that touch are left out.
        """
        apart = {}
        for k, configuration in zip(pairs, self._arm.compute_configuration(q), strict=True):
            with self._alone:
                if (gap := self._measure_gap(k, configuration)) is not None:
                    apart[k] = gap
        return apart

    def _measure_gap(self, k: int, configuration: Array) -> float | None:
        shapes, meshes, margin = self._shapes, self._meshes, float(self.margins[k])
        pin.updateGeometryPlacements(self._model, self._data, shapes, self._tested, configuration)
        apart = float(pin.computeDistance(shapes, self._tested, k).min_distance)
        if apart > margin:
            return apart
        pin.updateGeometryPlacements(self._model, self._data, meshes, self._exact)
        return None if pin.computeCollision(meshes, self._exact, k) else margin

    def find_new_contact(self, q: Array, now: Array, nearer: float) -> str:
        """Return which two parts touch at q and not at `now`, or have come nearer; empty: none.

        Args:
            q: where the joints would be (N,).
            now: where they are (N,).
            nearer: distance that parts which touch already may lose [m].
        """
        if not self.find_first_contact(q):
            return ""
        with self._alone:
            touched, touching = self._check_pairs(now), self._check_pairs(q)
        for k in np.flatnonzero(touching & ~touched):
            return self.name_pair(int(k))
        both = np.flatnonzero(touching & touched)
        if math.isinf(nearer) or not len(both):
            return ""
        lost = self._measure_distances(now)[both] - self._measure_distances(q)[both]
        return self.name_pair(int(both[np.argmax(lost)])) if lost.max() > nearer else ""

    def _measure_distances(self, q: Array) -> Array:
        configuration, tested = self._arm.compute_configuration(q), self._tested
        with self._alone:
            pin.computeDistances(self._model, self._data, self._shapes, tested, configuration)
            return np.array([result.min_distance for result in tested.distanceResults])

    def _find_contacts(self, configuration: Array) -> list[int]:
        """Return the pairs whose meshes touch, of those whose convex hulls do."""
        if not self._may_touch(configuration) or not pin.computeCollisions(
            self._model, self._data, self._shapes, self._tested, configuration, False
        ):
            return []
        hulls = [
            k for k, result in enumerate(self._tested.collisionResults) if result.isCollision()
        ]
        pin.updateGeometryPlacements(self._model, self._data, self._meshes, self._exact)
        return [k for k in hulls if pin.computeCollision(self._meshes, self._exact, k)]

    def _may_touch(self, configuration: Array) -> bool:
        """Return whether any hulls touch, by their boxes first, where there are many pairs."""
        if self._boxes is None:
            return True
        pin.updateGeometryPlacements(
            self._model, self._data, self._shapes, self._tested, configuration
        )
        self._boxes.update(False)
        return bool(pin.computeCollisions(self._boxes, True))

    def name_pair(self, k: int) -> str:
        """Return the names of a pair's parts, ``forearm_link and floor``."""
        pair = self._shapes.collisionPairs[k]
        return f"{self._names[pair.first]} and {self._names[pair.second]}"

    def _add_pairs(self) -> None:
        """Pair what can move towards each other, beyond neighbours."""
        shapes, parents, moved_by = (
            self._shapes.geometryObjects,
            self._model.parents,
            self._arm.moved_by,
        )
        for i in range(self._own):
            parent = shapes[i].parentJoint
            for k in range(i + 1, len(shapes)):
                second_parent = shapes[k].parentJoint
                near = k < self._own and (
                    parent == parents[second_parent] or second_parent == parents[parent]
                )
                if not near and moved_by[parent] != moved_by[second_parent]:
                    for geometry in (self._shapes, self._meshes):
                        geometry.addCollisionPair(pin.CollisionPair(i, k))

    def _leave_out(self, margin: float) -> None:
        """Leave out pairs of the arm's own parts that touch in valid poses, or their margin."""
        # Numbers, not the pairs: those move when one before them is removed.
        pairs = [(pair.first, pair.second) for pair in self._shapes.collisionPairs]
        rng = np.random.default_rng(0)
        poses = [self._arm.rest, *(self._arm.sample_configuration(rng) for _ in range(_SAMPLES))]
        shares = []
        for tested_margin in (0.0, margin):
            self._prepare_tests(tested_margin)
            touching = np.array([self._check_pairs(q) for q in poses])
            shares.append((touching[0], touching[1:].mean(axis=0)))
        (at_rest, always), (near_at_rest, near) = shares
        out = at_rest | (always > _JOINED)
        close = near_at_rest | (near - always > _NEAR)
        self._close = {pair for pair, belongs in zip(pairs, close, strict=True) if belongs}
        for shapes in (self._shapes, self._meshes):
            shapes.removeAllCollisionPairs()
            for pair, together in zip(pairs, out, strict=True):
                if pair[1] >= self._own or not together:
                    shapes.addCollisionPair(pin.CollisionPair(*pair))

    def _check_pairs(self, q: Array) -> npt.NDArray[np.bool_]:
        touching = np.zeros(self.pairs, dtype=bool)
        touching[self._find_contacts(self._arm.compute_configuration(q))] = True
        return touching

    def _prepare_tests(self, margin: float) -> None:
        self._tested = self._shapes.createData()
        self._exact = self._meshes.createData()
        self.margins = np.zeros(self.pairs)
        for tested in (self._tested, self._exact):
            requests = zip(self._shapes.collisionPairs, tested.collisionRequests, strict=True)
            for k, (pair, request) in enumerate(requests):
                own = pair.second < self._own
                near = own and (pair.first, pair.second) in self._close
                self.margins[k] = 0.0 if near else margin * (OWN_SHARE if own else 1.0)
                request.security_margin = self.margins[k]
        self._boxes = None
        if self.pairs > _MANY:
            self._boxes = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(
                self._model, self._shapes, self._tested
            )


def _make_solid(obstacle: Obstacle) -> Any:
    if obstacle.height is not None:
        # A box as deep as wide: not all pairs of shapes support a half space.
        shape, at = coal.Box(2.0 * _FAR, 2.0 * _FAR, _FAR), [0.0, 0.0, obstacle.height - 0.5 * _FAR]
    else:
        shape, at = coal.Box(*obstacle.size), list(obstacle.at)
    place = pin.SE3(pin.rpy.rpyToMatrix(*obstacle.rpy), np.array(at))
    return pin.GeometryObject(obstacle.name, 0, place, shape)

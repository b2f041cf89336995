"""Pairs of links that need no test for contact, with the reason, as MoveIt's SRDF lists them."""

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from arm_emulator.base.arrays import Array
from arm_emulator.motion.collision.shapes import CollisionShapes

SAMPLES = 10_000  # configurations: MoveIt's own assistant draws as many
_JUDGED = 200  # of them for `ALWAYS`
_ALWAYS = 0.95  # share of them
_ROUND = 100  # drawn until pairs that have touched are left out


class Reason(Enum):
    """The first that holds, in this order."""

    ADJACENT = "Adjacent"  # one joint between them, and at most links without shapes
    DEFAULT = "Default"  # they touch with all joints at 0, or in the middle of their limits
    ALWAYS = "Always"  # they touch in nearly all configurations
    NEVER = "Never"  # they touched in none


class LinkPair(NamedTuple):
    """Two links, the first before the second by name."""

    first: str
    second: str
    reason: Reason


def find_link_pairs(
    urdf_xml: str, joint_names: Sequence[str], samples: int = SAMPLES
) -> list[LinkPair]:
    """Return the pairs of links that need no test for contact, sorted.

    Raises:
        Refusal: a description, or a mesh in it, that cannot be read.
    """
    arm = CollisionShapes(urdf_xml, joint_names)
    links = sorted(set(arm.links))
    reasons = dict.fromkeys(_find_adjacent(urdf_xml, links), Reason.ADJACENT)
    left = [pair for pair in itertools.combinations(links, 2) if pair not in reasons]
    contacts = _Contacts(arm, left)
    reasons |= dict.fromkeys(contacts.find_contacts(arm.rest), Reason.DEFAULT)
    contacts = _Contacts(arm, [pair for pair in left if pair not in reasons])
    rng = np.random.default_rng(0)
    count = dict.fromkeys(contacts.pairs, 0)
    for number in range(samples):
        if number >= _JUDGED and number % _ROUND == 0:
            contacts = _Contacts(arm, [pair for pair in contacts.pairs if not count[pair]])
        for pair in contacts.find_contacts(arm.sample_configuration(rng)):
            count[pair] += 1
    for pair, times in count.items():
        if times > _ALWAYS * min(_JUDGED, samples):
            reasons[pair] = Reason.ALWAYS
        elif not times:
            reasons[pair] = Reason.NEVER
    return sorted(LinkPair(*pair, reason) for pair, reason in reasons.items())


class _Contacts:
    """Finds which of some pairs of links touch."""

    def __init__(self, arm: CollisionShapes, pairs: Iterable[tuple[str, str]]) -> None:
        self.pairs = list(pairs)
        self._arm = arm
        self._hulls, self._meshes = pin.GeometryModel(arm.hulls), pin.GeometryModel(arm.meshes)
        self._links = list[tuple[str, str]]()  # of each pair of shapes
        shapes = {
            link: [k for k, name in enumerate(arm.links) if name == link] for link in arm.links
        }
        for pair in self.pairs:
            for both in itertools.product(*(shapes[link] for link in pair)):
                for model in (self._hulls, self._meshes):
                    model.addCollisionPair(pin.CollisionPair(*both))
                self._links.append(pair)
        self._data = arm.model.createData()
        self._tested, self._exact = self._hulls.createData(), self._meshes.createData()

    def find_contacts(self, q: Array) -> set[tuple[str, str]]:
        """Return the pairs that touch at q (N,)."""
        model, data = self._arm.model, self._data
        if not self.pairs or not pin.computeCollisions(
            model, data, self._hulls, self._tested, self._arm.compute_configuration(q), False
        ):
            return set()
        hulls = [
            k for k, result in enumerate(self._tested.collisionResults) if result.isCollision()
        ]
        pin.updateGeometryPlacements(model, data, self._meshes, self._exact)
        return {self._links[k] for k in hulls if pin.computeCollision(self._meshes, self._exact, k)}


def _find_adjacent(urdf_xml: str, links: Sequence[str]) -> set[tuple[str, str]]:
    """Return the pairs of links that joints connect, beyond links without shapes."""
    near: dict[str, set[str]] = {}
    for joint in ET.fromstring(urdf_xml).findall("joint"):
        ends = [
            link_of.get("link", "") for tag in ("parent", "child") for link_of in joint.findall(tag)
        ]
        for link_of, neighbour in itertools.permutations(ends, 2):
            near.setdefault(link_of, set()).add(neighbour)
    pairs = set[tuple[str, str]]()
    for link in links:
        reached, front = {link}, [link]
        while front:
            for neighbour in near.get(front.pop(), set()) - reached:
                reached.add(neighbour)
                if neighbour in links:
                    pairs.add((min(link, neighbour), max(link, neighbour)))
                else:
                    front.append(neighbour)
    return pairs

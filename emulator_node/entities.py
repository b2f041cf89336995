"""The arm and its links as entities of simulation_interfaces: names, tags, true motions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from arm_emulator.machine.session.session import Session
from arm_emulator.ros.messages.time_stamp import set_stamp
from emulator_node.name_search import search_names

if TYPE_CHECKING:
    from arm_emulator.motion.model.link_motions import LinkMotions

ROBOT, OBJECT = 1, 0  # EntityCategory
ALL_OF_THEM = 1  # TagsFilter


class SimulationEntities:
    """The arm, by the name of its scene, and its links, by theirs.

    Args:
        session: the machine.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._robot = session.scene.name

    @cached_property
    def _links(self) -> LinkMotions:
        # Imported at the first question: Pinocchio takes longer than a node's whole start.
        from arm_emulator.motion.model.link_motions import LinkMotions

        scene = self._session.scene
        return LinkMotions(scene.true_urdf, list(scene.machine_joints), scene.chain.deflections)

    @property
    def names(self) -> list[str]:
        """All names, the arm's first."""
        return list(dict.fromkeys((self._robot, *self._links.names)))

    def is_link(self, name: str) -> bool:
        """Return whether an entity is a link."""
        return name in self._links.names

    def get_category(self, name: str) -> int:
        """Return the category of an entity."""
        return OBJECT if self.is_link(name) else ROBOT

    def get_tags(self, name: str) -> list[str]:
        """Return the tags of an entity."""
        return ["link", self._robot] if self.is_link(name) else ["arm"]

    def filter_names(self, filters: Any) -> list[str]:
        """Return the names that EntityFilters let through.

        Raises:
            Refusal: see `search_names`.
        """
        categories = {category.category for category in filters.categories}
        tags = set(filters.tags.tags)
        enough = tags.issubset if filters.tags.filter_mode == ALL_OF_THEM else tags.intersection
        return [
            name
            for name in search_names(filters.filter, self.names)
            if (not categories or self.get_category(name) in categories)
            and (not tags or enough(self.get_tags(name)))
        ]

    def place_links(self) -> None:
        """Place all links as they are at this tick."""
        self._links.place_links(*self._session.plant.machine_motion)

    def fill_state(self, name: str, state: Any) -> None:
        """Fill an EntityState with the motion of an entity that was placed.

        Its acceleration is not known: NaN.
        """
        link = name if self.is_link(name) else self._links.names[0]
        (p, quaternion), (v, omega) = self._links.get_pose(link), self._links.get_twist(link)
        set_stamp(state.header.stamp, self._session.logical_ns)
        state.header.frame_id = "world"
        _set_values(state.pose.position, p)
        _set_values(state.pose.orientation, quaternion)
        _set_values(state.twist.linear, v)
        _set_values(state.twist.angular, omega)
        unknown = np.full(3, np.nan)
        _set_values(state.acceleration.linear, unknown)
        _set_values(state.acceleration.angular, unknown)


def _set_values(message: Any, values: Sequence[float] | np.ndarray[Any, Any]) -> None:
    for name, value in zip("xyzw", values, strict=False):
        setattr(message, name, float(value))

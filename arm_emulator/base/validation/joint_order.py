"""Joints are matched by name, never by their place in a message."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import Number


def check_joints_exist(where: str, names: Iterable[object], joints: Sequence[str]) -> None:
    """Refuse a name that no joint has."""
    for name in names:
        if name not in joints:
            raise Refusal(where, "joint", "be one of the arm", name, ", ".join(joints))


def check_joint_names(where: str, names: Iterable[object], joints: Sequence[str]) -> None:
    """Refuse names that are not those of all joints, in any order.

    Raises:
        Refusal: a name that no joint has, or a joint that is named twice or not at all.
    """
    listed = [str(name) for name in names]
    check_joints_exist(where, listed, joints)
    if len(listed) != len(joints) or len(set(listed)) != len(listed):
        actual = ", ".join(listed) or "none"
        raise Refusal(where, "joint names", "name every joint once", actual, ", ".join(joints))


class JointOrder:
    """Brings the arrays of a topic into the receiver's order of joints.

    Args:
        topic: name for refusals.
        names: the receiver's joints, in its order.
    """

    def __init__(self, topic: str, names: Sequence[str]) -> None:
        self.topic = topic
        self.names = list(names)
        self._index = {name: index for index, name in enumerate(self.names)}

    def arrange_values(
        self, names: Sequence[str], values: Sequence[float], bound: Number
    ) -> NDArray[np.float64]:
        """Return `values`, given one per entry of `names`, in the receiver's order (N,).

        Args:
            names: of joints, in any order.
            values: one per name.
            bound: of the values, in the receiver's order.

        Raises:
            Refusal: the names differ from the receiver's, the number of values is wrong, or a
                value is not finite or too large.
        """
        if isinstance(names, str | bytes) or not isinstance(names, Sequence):
            raise Refusal(self.topic, "joint names", "be a list of names", names)
        array = np.array(bound.check_numbers(self.topic, values))
        if array.shape != (len(names),):
            rule = f"have one value per joint name ({len(names)})"
            actual = f"{len(array)} values" if array.ndim == 1 else values
            raise Refusal(self.topic, bound.name, rule, actual)
        if list(names) != self.names:
            check_joint_names(self.topic, names, self.names)
            unordered, array = array, np.empty_like(array)
            array[[self._index[name] for name in names]] = unordered
        bound.check_values(self.topic, array.tolist(), self.names)
        return array

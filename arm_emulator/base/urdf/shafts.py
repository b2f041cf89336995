"""Coupling of an arm's joints to its shafts, and the limits of shafts from those of joints."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.couplings import Follows, list_followers, list_own_shafts
from arm_emulator.base.urdf.urdf_text import parse_urdf, read_limits

WHERE = "robot_description"
_ROUNDING = 1e-9  # rad or m


def read_shafts(joints: Sequence[str], urdf_xml: str) -> tuple[str, ...]:
    """Return those of a description's moving joints by whose names shafts go."""
    couplings = list_followers(parse_urdf(urdf_xml, WHERE), WHERE)
    return tuple(list_own_shafts(joints, couplings))


def _find_path_to(tool: str, robot: ET.Element) -> set[str]:
    """Return the joints between a description's base and a link or fixed joint."""
    above, ends = dict[str, tuple[str, str]](), dict[str, str]()
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            name, end = joint.get("name", ""), child.get("link", "")
            above[end] = name, parent.get("link", "")
            ends[name] = end
    link, path = tool if tool in above else ends.get(tool, tool), set[str]()
    while link in above and above[link][0] not in path:
        name, link = above[link]
        path.add(name)
    return path


class Shafts:
    """The joints that are commanded, and those that follow them: q = C p + q_0.

    Args:
        urdf_xml: the robot description.
        names: of the shafts, in the order of all arrays.
        tool: link or fixed joint: of what follows, only what is on the way there counts; None: all.

    Attributes:
        joints: all that move, those of the shafts first.
        C: (joints, shafts).
        offset: (joints,) [rad or m].
        names: of the shafts.
        coupled: whether any joint does not go with a shaft of its own alone.
    """

    def __init__(self, urdf_xml: str, names: Sequence[str], tool: str | None = None) -> None:
        robot = parse_urdf(urdf_xml, WHERE)
        couplings = list_followers(robot, WHERE)
        path = couplings if tool is None else _find_path_to(tool, robot)
        # A command to a joint that only follows would move it separately.
        for name in {*names} - {*list_own_shafts(tuple(names), couplings)}:
            del couplings[name]
        along = [
            name
            for name, coupling in couplings.items()
            if name not in names and set(coupling.shares) <= {*names} and name in path
        ]
        self.names = tuple(names)
        self.joints = (*names, *along)
        all_names = {*names}
        self.C, self.offset = np.zeros((len(self.joints), len(names))), np.zeros(len(self.joints))
        for k, name in enumerate(self.joints):
            row = couplings.get(name, Follows({name: 1.0}, 0.0))
            if not set(row.shares) <= all_names:  # it follows what is held, and moves by itself
                row = Follows({name: 1.0}, 0.0)
            self.C[k] = [row.shares.get(shaft, 0.0) for shaft in names]
            self.offset[k] = row.offset
        self.coupled = len(along) > 0 or bool((self.C != np.eye(len(names))).any())

    def convert_to_joints(self, p: Array) -> Array:
        """Return the joints' angles, of shafts' angles (..., N)."""
        return p @ self.C.T + self.offset if self.coupled else p

    def convert_rates(self, p: Array) -> Array:
        """Return the joints' speeds or accelerations."""
        return self.C @ p if self.coupled else p

    def convert_columns(self, J: Array) -> Array:
        """Return columns (or torques) by the shafts, of those by the joints."""
        return J @ self.C if self.coupled else J

    def bound_positions(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return limits of the shafts within which no joint passes its own.

        Where a joint goes with several shafts, these are a box around the middle of the joints'
        limits: it leaves some corners out, and none of it is beyond a limit.

        Raises:
            Refusal: no angle of a shaft keeps all joints that it moves within theirs.
        """
        if not self.coupled:
            return lower, upper
        low, high = np.full(self.C.shape[1], -np.inf), np.full(self.C.shape[1], np.inf)
        several = np.count_nonzero(self.C, axis=1) > 1
        boxed = np.abs(self.C[several]).sum(axis=0) > 0.0
        for row, offset, lowest, highest in zip(self.C, self.offset, lower, upper, strict=True):
            (own,) = np.nonzero(row)
            if len(own) == 1 and not boxed[own[0]]:
                ends = (np.array([lowest, highest]) - offset) / row[own[0]]
                low[own[0]] = max(low[own[0]], ends.min())
                high[own[0]] = min(high[own[0]], ends.max())
        limited = np.isfinite(upper - lower) & (np.abs(self.C[:, boxed]).sum(axis=1) > 0.0)
        if boxed.any() and limited.any():
            C = self.C[limited]
            middle, half = 0.5 * (lower + upper)[limited], 0.5 * (upper - lower)[limited]
            centre = np.linalg.lstsq(C, middle - self.offset[limited])[0]
            spare = np.maximum(half - np.abs(C @ centre + self.offset[limited] - middle), 0.0)
            reach = self._find_smallest(spare, C)
            low[boxed], high[boxed] = (centre - reach)[boxed], (centre + reach)[boxed]
        lowest, highest = self._bound_joints(low, high)
        beyond = (lowest < lower - _ROUNDING) | (highest > upper + _ROUNDING) | (highest < lowest)
        for k in np.flatnonzero(beyond).tolist():
            rule = "have limits that its couplings can keep"
            actual = f"{lower[k]:g} to {upper[k]:g}, its shafts' {lowest[k]:g} to {highest[k]:g}"
            raise Refusal(WHERE, f"joint {self.joints[k]}", rule, actual)
        return low, high

    def _bound_joints(self, low: Array, high: Array) -> tuple[Array, Array]:
        """Return between which angles joints are where shafts are within a box."""
        up, down = np.maximum(self.C, 0.0), np.minimum(self.C, 0.0)
        with np.errstate(invalid="ignore"):  # 0 times infinite: a shaft that is not the joint's
            ends = [
                np.nansum(up * upwards + down * downwards, axis=1) + self.offset
                for upwards, downwards in ((low, high), (high, low))
            ]
        return ends[0], ends[1]

    def bound_rates(self, of_joints: Array) -> Array:
        """Return limits of the shafts' rates with which no joint passes its own."""
        return self._find_smallest(of_joints, self.C) if self.coupled else of_joints

    @staticmethod
    def _find_smallest(limits: Array, C: Array) -> Array:
        sums = np.abs(C).sum(axis=1)
        shares = limits / np.where(sums > 0.0, sums, 1.0)
        smallest: Array = np.where(C != 0.0, shares[:, None], np.inf).min(axis=0)
        return smallest


def read_shaft_limits(urdf_xml: str, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the position limits of the shafts that have both, by name [rad or m].

    Within them no joint of the description passes its own.
    """
    shafts = Shafts(urdf_xml, names)
    of_joints = read_limits(parse_urdf(urdf_xml, WHERE))
    ends = [of_joints.get(name, (-np.inf, np.inf)) for name in shafts.joints]
    low, high = shafts.bound_positions(*np.array(ends, dtype=np.float64).T)
    limited = np.isfinite(high - low)
    pairs = zip(names, low.tolist(), high.tolist(), limited, strict=True)
    return {name: (lower, upper) for name, lower, upper, is_limited in pairs if is_limited}

"""Choice of the arm's joints, its tool link and the held joints in a robot description."""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.couplings import Follows, list_followers, list_own_shafts
from arm_emulator.base.urdf.joint_tree import FREE_KINDS, MOVING_KINDS

MOVING = tuple(MOVING_KINDS)
KINDS = (*MOVING, "fixed", *FREE_KINDS)
# A fork behind MIN_ARM joints or more begins a gripper if a branch has at most MAX_FINGER joints. A
# fork with FINGERS branches begins a hand, with any number of joints.
MIN_ARM, MAX_FINGER, FINGERS = 3, 4, 4
_GRIPPER = re.compile(r"grip|finger|jaw|knuckle|claw", re.IGNORECASE)
# Frames that makers of arms put at the flange for what is mounted there, the best first.
_TOOLS = ("tcp", "tool0", "tool", "ee", "eef", "end_effector", "grasp", "flange", "hand")


@dataclass(frozen=True)
class LockedJoint:
    """A joint that does not move."""

    position: float  # rad or m
    reason: str


@dataclass(frozen=True)
class JointChoice:
    """The arm in a robot description."""

    tool: str
    """Link that is the tool."""
    joints: tuple[str, ...]
    """Moving joints."""
    locked: dict[str, LockedJoint]
    """All other joints that could move."""
    guesses: tuple[str, ...]
    """Choices made, as text."""


@dataclass(frozen=True)
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    follows: tuple[str, ...]  # the joints with which it moves, where none alone is its own
    limits: tuple[float, float]

    @property
    def can_move(self) -> bool:
        return self.kind in MOVING and not self.follows


class _Tree:
    """The joints of a robot description by their links."""

    def __init__(self, robot: ET.Element, where: str) -> None:
        self.where = where
        self.links = [link.get("name", "") for link in robot.findall("link")]
        self.followers = _read_followers(robot, where)
        follows = _find_followed(robot, self.followers)
        self.joints = [
            _read_joint(element, follows.get(element.get("name", ""), ()), where)
            for element in robot.findall("joint")
        ]
        self.above = {joint.child: joint for joint in self.joints}
        self.below: dict[str, list[_Joint]] = {}
        for joint in self.joints:
            self.below.setdefault(joint.parent, []).append(joint)
        if len(self.above) != len(self.joints):
            rule = "be the child of one joint, as in a tree"
            raise Refusal(where, "each link", rule, "one of several")

    def find_path(self, link: str) -> list[_Joint]:
        """Return the joints from the base to a link."""
        path: list[_Joint] = []
        while link in self.above:
            path.append(self.above[link])
            link = path[-1].parent
            if len(path) > len(self.joints):
                raise Refusal(self.where, f"link {link}", "have no loop above it", "one")
        return path[::-1]

    def list_ordered(self) -> list[_Joint]:
        """Return all joints, each behind what carries it, and with all that it carries."""
        left = [link for link in self.links if link not in self.above]
        ordered: list[_Joint] = []
        while left:
            below = self.below.get(left.pop(), [])
            left += [joint.child for joint in below[::-1]]
            ordered += below
        return ordered

    def find_fixed(self, link: str) -> list[str]:
        """Return a link and all that are fixed to it, towards the tips."""
        links = [link]
        for fixed_link in links:
            links += [
                joint.child for joint in self.below.get(fixed_link, []) if joint.kind == "fixed"
            ]
        return links

    def count_branches(self, joint: _Joint) -> int:
        """Return how many joints begin on the body on which a joint begins.

        Those that follow a joint of the way there count not: rods of a palletizer.
        """
        body = joint.parent
        while body in self.above and self.above[body].kind == "fixed":
            body = self.above[body].parent
        beside = [begun for link in self.find_fixed(body) for begun in self.below.get(link, [])]
        path = {moved.name for moved in self.find_path(body)}
        return sum(begun.kind in MOVING and not path & {*begun.follows} for begun in beside)


def choose_joints(
    robot: ET.Element,
    where: str,
    tool: str | None = None,
    joints: Sequence[str] | None = None,
    *,
    tree: bool = False,
) -> JointChoice:
    """Choose the arm in a robot description.

    Given nothing, the arm is the longest row of joints from the base; a gripper at its end, named
    by a fork or by its name, is held. A joint on the way to the tool that follows joints of the arm
    (mimic, coupling) moves along with them; another one that follows is held.

    Args:
        robot: the URDF's root element.
        where: what to call it in refusals.
        tool: the link that is the tool; the arm ends there.
        joints: the joints that move, on any branch, with those that follow them; all others are
            held.
        tree: whether all joints move, those beside the arm, too.

    Raises:
        Refusal: no such link or joint, or nothing that moves.
    """
    if tree and joints is not None:
        raise Refusal("new", "--tree", "stand without --joints", "both")
    limbs = _Tree(robot, where)
    guesses: list[str] = []
    if joints is not None:
        chosen = _find_named(limbs, joints, tool)
        rows = [limbs.find_path(joint.child) for joint in chosen] or [[]]
        path = max(rows, key=len) if tool is None else limbs.find_path(_find_tip(limbs, tool))
    else:
        path = limbs.find_path(_find_tip(limbs, tool))
        chosen = [joint for joint in path if joint.can_move]
        if tool is None:
            chosen = _remove_gripper(limbs, chosen, [] if tree else guesses)
    if not chosen:
        raise Refusal(where, "the robot", "have a joint that moves", "none on the way to the tool")
    if tool is None:
        along = _find_along(path, chosen)
        last = [joint for joint in path if joint in chosen or joint in along][-1]
        tool = _find_tool_link(limbs, last.child)
        guesses.append(f"tool: {tool} (--tool names another)")
    if tree:
        chosen = [joint for joint in limbs.list_ordered() if joint.can_move]
    along = _find_along(path if joints is None and not tree else limbs.joints, chosen)
    guesses[:0] = [f"{joint.name} moves along with {', '.join(joint.follows)}" for joint in along]
    names = tuple(joint.name for joint in chosen)
    positions = _compute_positions(limbs)
    locked = {
        joint.name: _hold_joint(joint, chosen, positions[joint.name])
        for joint in limbs.joints
        if joint.kind != "fixed" and joint.name not in names and joint not in along
    }
    beside = [
        joint.name for joint in limbs.joints
        if joint.can_move and joint.name in locked and joint not in path
    ]  # fmt: skip
    if beside and joints is None and not tree:
        guesses.append(f"held beside the arm: {', '.join(beside)} (--tree moves them, too)")
    return JointChoice(tool, names, locked, tuple(guesses))


def _read_followed(robot: ET.Element) -> dict[str, tuple[str, ...]]:
    """Return the joints that each joint names as those which it follows."""
    rows = {
        joint.get("name", ""): [*joint.findall("mimic"), *joint.findall("coupling")]
        for joint in robot.findall("joint")
    }
    return {name: tuple(row.get("joint", "") for row in of) for name, of in rows.items()}


def _find_lost(robot: ET.Element) -> dict[str, tuple[str, ...]]:
    """Return the joints that follow one which the robot has not, with all that they follow."""
    named = _read_followed(robot)
    return {name: others for name, others in named.items() if not {*others} <= {*named}}


def _read_followers(robot: ET.Element, where: str) -> dict[str, Follows]:
    """Return the laws of the joints that follow joints of the robot, by name."""
    return list_followers(robot, where, list(_find_lost(robot)))


def _find_followed(
    robot: ET.Element, couplings: Mapping[str, Follows]
) -> dict[str, tuple[str, ...]]:
    """Return with which joints those move that have no shaft of their own, by name."""
    alone = list_own_shafts(list(_read_followed(robot)), couplings)
    return {
        name: tuple(coupling.shares) for name, coupling in couplings.items() if name not in alone
    } | _find_lost(robot)


def _read_joint(element: ET.Element, follows: tuple[str, ...], where: str) -> _Joint:
    kind = element.get("type", "")
    if kind not in KINDS:
        rule = "be supported"
        raise Refusal(where, f"joint {element.get('name')}: type", rule, kind, ", ".join(KINDS))
    ends = {}
    for tag in ("parent", "child"):
        end = element.find(tag)
        ends[tag] = "" if end is None else end.get("link", "")
    limit = element.find("limit")
    bounds = {"lower": -math.inf, "upper": math.inf}
    if limit is not None and kind != "continuous":
        for key in bounds:
            if limit.get(key) is not None:
                bounds[key] = _read_number(limit.get(key, ""), element, key, where)
    return _Joint(
        name=element.get("name", ""),
        kind=kind,
        parent=ends["parent"],
        child=ends["child"],
        follows=follows,
        limits=(bounds["lower"], bounds["upper"]),
    )


def _read_number(text: str, element: ET.Element, key: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise Refusal(where, f"joint {element.get('name')}: limit {key}", "be a number", repr(text))
    return value


def _find_tip(tree: _Tree, tool: str | None) -> str:
    """Return the link at which the arm ends: the tool, or the end of the longest row of joints."""
    if tool is not None:
        if tool not in tree.links:
            raise Refusal("new", "--tool", "be a link of the robot", tool, ", ".join(tree.links))
        return tool
    tips = [link for link in tree.links if link not in tree.below]
    if not tips:
        raise Refusal(tree.where, "the robot", "have a link at which it ends", "none")
    return max(tips, key=lambda link: sum(joint.can_move for joint in tree.find_path(link)))


def _find_along(path: Sequence[_Joint], chosen: Sequence[_Joint]) -> list[_Joint]:
    """Return the joints among some that move with those chosen alone."""
    names = {joint.name for joint in chosen}
    return [
        joint
        for joint in path
        if joint.kind in MOVING and joint.follows and names.issuperset(joint.follows)
    ]


def _find_named(tree: _Tree, joints: Sequence[str], tool: str | None) -> list[_Joint]:
    """Return the joints of these names."""
    by_name = {joint.name: joint for joint in tree.joints if joint.kind != "fixed"}
    for name in joints:
        if name not in by_name:
            rule = "be joints of the robot that can move"
            raise Refusal("new", "--joints", rule, name, ", ".join(by_name))
        if not by_name[name].can_move:
            others = ", ".join(by_name[name].follows)
            kind = f"one that follows {others}" if others else by_name[name].kind
            raise Refusal("new", f"--joints: {name}", "move on its own", kind, ", ".join(MOVING))
    if tool is not None:
        _find_tip(tree, tool)
    return [joint for joint in tree.list_ordered() if joint.name in joints]


def _remove_gripper(tree: _Tree, chosen: list[_Joint], guesses: list[str]) -> list[_Joint]:
    """Return the joints without those at the end that look like a gripper's."""
    for k, joint in enumerate(chosen[MIN_ARM:], start=MIN_ARM):
        short = len(chosen) - k <= MAX_FINGER
        branches = tree.count_branches(joint)
        named = _GRIPPER.search(joint.name) is not None
        if branches >= FINGERS or (short and (branches > 1 or named)):
            names = ", ".join(joint.name for joint in chosen[k:])
            to_move = "--joints names the joints that move, --tree moves all"
            guesses.append(f"held as a gripper: {names} ({to_move})")
            return chosen[:k]
    return chosen


def _find_tool_link(tree: _Tree, link: str) -> str:
    """Return the link fixed to `link` that its maker meant for tools, or the link itself."""
    fixed = tree.find_fixed(link)
    for word in _TOOLS:
        for name in fixed:
            if re.search(rf"(^|[^a-z]){word}([^a-z]|$)", name.lower()):
                return name
    return fixed[0]


def _compute_positions(tree: _Tree) -> dict[str, float]:
    """Return where joints stand that are held [rad or m], by name.

    A joint that moves by itself stands next to 0 within its limits, and those that follow it as it
    takes them along: a law of the description goes before their limits.
    """
    positions = {
        joint.name: min(max(0.0, joint.limits[0]), joint.limits[1]) if joint.kind in MOVING else 0.0
        for joint in tree.joints
    }
    couplings = {
        joint.name: tree.followers[joint.name]
        for joint in tree.joints
        if joint.follows and joint.kind in MOVING and joint.name in tree.followers
    }
    return positions | {name: law.compute_position(positions) for name, law in couplings.items()}


def _hold_joint(joint: _Joint, chosen: Sequence[_Joint], position: float) -> LockedJoint:
    if joint.follows:
        moved = {driven.name for driven in chosen}.issuperset(joint.follows)
        off = ", which moves, but not on the way to the tool" if moved else ""
        return LockedJoint(position, f"follows {', '.join(joint.follows)}{off}")
    return LockedJoint(position, "not part of the arm" if joint.kind in MOVING else joint.kind)

"""Joints of a robot description that have no drive of their own.

A mimic joint follows another one; an element <coupling joint= multiplier=> in a joint, of which
there may be several, adds a share of a shaft. The angles of all joints are q = C p + q_0, with p
those of the shafts, each called after a joint.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal

MAX_SIZE = 1e4  # of a share, and of an offset [rad or m]
RANK = 1e-9  # singular values below, by the largest, count as 0
_MIMIC, _COUPLING = "mimic", "coupling"


@dataclass(frozen=True)
class Follows:
    """A joint's angle as shares of shaft angles."""

    shares: Mapping[str, float]  # by the shaft's name
    offset: float  # rad or m

    def compute_position(self, shafts: Mapping[str, float]) -> float:
        """Return the joint's position [rad or m] at positions of the shafts; 0 of those left out.

        A joint that is fixed in the URDF is left out: it stands at 0.
        """
        return self.offset + sum(
            share * shafts.get(name, 0.0) for name, share in self.shares.items()
        )


def list_followers(robot: ET.Element, where: str, but: Sequence[str] = ()) -> dict[str, Follows]:
    """Return the joints that follow shafts other than one of their own, by name.

    Args:
        robot: the URDF's root element.
        where: its name in refusals.
        but: joints that are held, whatever they follow.

    Raises:
        Refusal: a joint follows an unknown one or, indirectly, itself; a value is not a number.
    """
    elements = {joint.get("name", ""): joint for joint in robot.findall("joint")}
    couplings = {
        name: _read_mimic(joint, elements, where)
        for name, joint in elements.items()
        if name not in but
        and joint.get("type") != "fixed"
        and (joint.find(_MIMIC) is not None or joint.find(_COUPLING) is not None)
    }
    return {name: _resolve_followers(name, couplings, where) for name in couplings}


def _read_mimic(joint: ET.Element, elements: Mapping[str, ET.Element], where: str) -> Follows:
    label = f"joint {joint.get('name')}"
    shares: dict[str, float] = {}
    offset = 0.0
    rows = joint.findall(_COUPLING) or joint.findall(_MIMIC)
    for row in rows:
        shaft = row.get("joint", "")
        if shaft not in elements:
            raise Refusal(where, f"{label}: {row.tag}", "name a joint of the URDF", repr(shaft))
        share = _parse_number(row.get("multiplier", "1"), f"{label}: multiplier", where)
        shares[shaft] = shares.get(shaft, 0.0) + share
        offset += _parse_number(row.get("offset", "0"), f"{label}: offset", where)
    return Follows(shares, offset)


def _parse_number(text: str, label: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_SIZE:
        raise Refusal(where, label, f"be a number from {-MAX_SIZE:g} to {MAX_SIZE:g}", repr(text))
    return value


def _resolve_followers(name: str, rows: Mapping[str, Follows], where: str) -> Follows:
    """Return the shafts that a joint follows, directly or through other followers."""
    shares, offset = dict(rows[name].shares), rows[name].offset
    for _ in range(len(rows)):
        through = [shaft for shaft in shares if shaft in rows and shaft not in rows[shaft].shares]
        if not through:
            return Follows(shares, offset)
        for middle in through:
            share = shares.pop(middle)
            offset += share * rows[middle].offset
            for shaft, factor in rows[middle].shares.items():
                shares[shaft] = shares.get(shaft, 0.0) + share * factor
    raise Refusal(where, f"joint {name}", "follow a joint that moves by itself", "a circle")


@dataclass(frozen=True, eq=False)
class Coupling:
    """Coupling of joints to shafts: q = C p + q_0."""

    joints: tuple[str, ...]  # that move, base to tool
    shafts: tuple[str, ...]
    C: Array  # (joints, shafts)
    offset: Array  # (joints,) [rad or m]

    @property
    def apart(self) -> set[str]:
        """The shafts that move no joint which another shaft moves, too."""
        shared = (np.count_nonzero(self.C, axis=1) > 1) @ (self.C != 0.0)
        return {name for name, others in zip(self.shafts, shared, strict=True) if not others}

    @property
    def is_mimic(self) -> bool:
        """Whether each shaft is the joint of its name, and no other joint follows two of them."""
        own = [self.joints.index(shaft) for shaft in self.shafts]
        others = np.delete(self.C, own, axis=0)
        alone = bool((np.count_nonzero(others, axis=1) <= 1).all())
        return (
            alone and bool((self.C[own] == np.eye(len(own))).all()) and not self.offset[own].any()
        )

    @property
    def is_identity(self) -> bool:
        """Whether every joint has a shaft of its own."""
        return self.C.shape[0] == self.C.shape[1] and bool((np.eye(len(self.C)) == self.C).all())


def list_own_shafts(joints: Sequence[str], followers: Mapping[str, Follows]) -> list[str]:
    """Return the joints that name shafts: those that follow none, or that others follow."""
    followed = {shaft for value in followers.values() for shaft in value.shares}
    return [name for name in joints if name not in followers or name in followed]


def _suggest_remedy(
    name: str, follows: Follows, shafts: Sequence[str], locked: Mapping[str, float] | None
) -> str:
    """Return how a joint may be held that follows a joint which does not move."""
    moving = [shaft for shaft in follows.shares if shaft in shafts]
    if moving:
        return f"lock it in the scene, at a position of {', '.join(moving)} that you choose"
    return f"lock it in the scene: locked: {{{name}: {follows.compute_position(locked or {})!r}}}"


def read_coupling(
    joints: Sequence[str],
    followers: Mapping[str, Follows],
    where: str,
    locked: Mapping[str, float] | None = None,
) -> Coupling:
    """Return the coupling of joints in a row.

    Args:
        joints: that move, base to tool.
        followers: joints that follow shafts other than one of their own, by name.
        where: name of the URDF in refusals.
        locked: positions of joints that are held [rad or m].

    Raises:
        Refusal: a joint follows one that is not in the row, or a shaft moves no joint of its
            own.
    """
    shafts = list_own_shafts(joints, followers)
    for name, row in followers.items():
        for shaft in row.shares:
            if name in joints and shaft not in shafts:
                rule = "follow joints on the way from base to tool"
                remedy = _suggest_remedy(name, row, shafts, locked)
                raise Refusal(where, f"joint {name}", rule, shaft, remedy)
    rows = [followers.get(name, Follows({name: 1.0}, 0.0)) for name in joints]
    C = np.array([[row.shares.get(shaft, 0.0) for shaft in shafts] for row in rows])
    values = np.linalg.svd(C, compute_uv=False) if shafts else np.zeros(1)
    if len(values) < len(shafts) or values[-1] <= RANK * values[0]:
        rule = "have independent columns, one per shaft"
        raise Refusal(where, "couplings", rule, np.array2string(C, separator=", "))
    return Coupling(tuple(joints), tuple(shafts), C, np.array([row.offset for row in rows]))

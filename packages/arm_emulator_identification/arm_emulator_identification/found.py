"""Identified numbers, as text for the user."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import VARIED_NAMES, Body, ChainJoint, Scene, varied_of_child
from arm_emulator_identification import inertia
from arm_emulator_identification.torque_fit import IDENTIFIED, TorqueFit

UNITS = {"mass": "kg", "moment": "kg m", "inertia": "kg m2"}


@dataclass(frozen=True)
class Found:
    """One number of the scene or its URDF."""

    name: str
    unit: str
    before: float
    value: float
    deviation: float  # standard deviation; NaN: unknown
    identified: bool  # by the record; otherwise it is close to its prior
    width: float = np.inf  # standard deviation of its prior
    left: str = ""  # reason for keeping its value

    @property
    def remark(self) -> str:
        """A remark on it, if any."""
        if self.left:
            return self.left
        if self.deviation == 0.0:
            return "held"
        return "" if self.identified else "not identifiable"

    @property
    def far(self) -> float:
        """Its shift in standard deviations of the prior."""
        return abs(self.value - self.before) / self.width if self.width > 0.0 else 0.0

    @property
    def line(self) -> str:
        """The number, its confidence, and its former value."""
        remark = self.remark or f"+- {self.deviation:.2g}"
        return f"{self.name}: {self.value:.6g} {self.unit}, {remark}, before {self.before:.6g}"


def list_bodies(scene: Scene, fit: TorqueFit) -> list[Body]:
    """Return the links' bodies, in the core's frames, without the payload."""
    n = inertia.NUMBERS
    rows = [slice(n * k, n * (k + 1)) for k in range(len(scene.chain.links))]
    return [
        inertia.make_body(inertia.map_exponential(fit.values[row]))
        if fit.fitted[row].any()
        else bare
        for row, bare in zip(rows, scene.bare, strict=True)
    ]


def list_found(scene: Scene, fit: TorqueFit) -> list[Found]:
    """Return the sought numbers: links as mass, first moment and inertia of the URDF's links."""
    n, found = inertia.NUMBERS, list[Found]()
    for k, joint in enumerate(scene.chain.links):
        if fit.fitted[n * k : n * k + n].any():
            found += _list_link(joint, fit, n * k)
    units = fit.unknowns[n * len(scene.chain.links) :]
    for u, one in enumerate(units, len(fit.unknowns) - len(units)):
        if fit.fitted[u]:
            value, deviation = float(fit.values[u]), float(fit.deviations[u])
            identified = deviation < IDENTIFIED * one.width
            found.append(
                Found(one.name, one.unit, one.value, value, deviation, identified, one.width)
            )
        elif u in fit.left:
            left = fit.left[u]
            found.append(Found(one.name, one.unit, one.value, one.value, np.nan, False, left=left))
    return found


def _list_link(joint: ChainJoint, fit: TorqueFit, first: int) -> Iterator[Found]:
    here = slice(first, first + inertia.NUMBERS)
    start = np.array([one.value for one in fit.unknowns[here]])
    widths = np.array([one.width for one in fit.unknowns[here]]) * fit.fitted[here]
    turn = np.array([_rotate_to_child(joint, row) for row in np.eye(inertia.NUMBERS)]).T
    J = turn @ inertia.differentiate_exponential(fit.values[here])
    after = np.sqrt(np.maximum(np.diag(J @ fit.covariance[here, here] @ J.T), 0.0))
    before = np.sqrt(np.diag(J @ np.diag(widths**2) @ J.T))
    old, new = (turn @ inertia.map_exponential(row) for row in (start, fit.values[here]))
    for k, name in enumerate(VARIED_NAMES):
        unit = UNITS[name.split("_")[0]]
        identified = bool(after[k] < IDENTIFIED * before[k])
        yield Found(
            f"links.{joint.link}.{name}", unit, float(old[k]), float(new[k]), float(after[k]),
            identified, float(before[k]),
        )  # fmt: skip


def _rotate_to_child(joint: ChainJoint, numbers: Array) -> list[float]:
    """Return the ten numbers of `inertia.dynamic` in the frame of the joint's child link."""
    body = inertia.make_body(numbers)
    return list(varied_of_child(joint, body).values())

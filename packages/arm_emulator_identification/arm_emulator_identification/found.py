"""Identified numbers, as text for the user."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import VARIED_NAMES, Body, ChainJoint, Scene, varied_of_child
from arm_emulator_identification import inertia
from arm_emulator_identification.torque_fit import IDENTIFIED, TorqueFit
from arm_emulator_identification.torque_model import Unknown

UNITS = {"mass": "kg", "moment": "kg m", "inertia": "kg m2"}
MIXED = 0.5  # correlation from which a number is named beside another
MAX_MIXED = 2  # of such names


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
    shown: str = ""  # what a record must have to show it
    mixed: tuple[str, ...] = ()  # numbers from which this record does not distinguish it

    @classmethod
    def keep_number(cls, name: str, unit: str, value: float, **why: Any) -> Self:
        """Return a number that was not sought; `why`: `left`, `shown` or `mixed`."""
        return cls(name, unit, value, value, np.nan, False, **why)

    @property
    def brief(self) -> str:
        """A remark on it without its reason, if any."""
        if self.left:
            return self.left
        if self.deviation == 0.0:
            return "held"
        return "" if self.identified else "not identifiable"

    @property
    def reason(self) -> str:
        """Why this record does not identify it, where that is known."""
        if self.brief != "not identifiable":
            return ""
        if self.mixed:
            return f"this record does not distinguish it from {' and '.join(self.mixed)}"
        return f"it needs {self.shown}" if self.shown else ""

    @property
    def remark(self) -> str:
        """A remark on it, if any."""
        return ": ".join(text for text in (self.brief, self.reason) if text)

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


def list_numbers(scene: Scene, fit: TorqueFit) -> list[Found]:
    """Return the sought numbers: links as mass, first moment and inertia of the URDF's links."""
    n, numbers = inertia.NUMBERS, list[Found]()
    mixed = list_mixed(fit)
    for k, joint in enumerate(scene.chain.links):
        if fit.fitted[n * k : n * k + n].any():
            numbers += _list_link(joint, fit, n * k)
    units = fit.unknowns[n * len(scene.chain.links) :]
    for u, of in enumerate(units, len(fit.unknowns) - len(units)):
        if fit.fitted[u]:
            value, deviation = float(fit.values[u]), float(fit.deviations[u])
            identified = deviation < IDENTIFIED * of.width
            numbers.append(
                Found(
                    of.name, of.unit, of.value, value, deviation, identified, of.width,
                    shown=of.shown, mixed=mixed.get(u, ()),
                )
            )  # fmt: skip
        elif u in fit.left:
            numbers.append(Found.keep_number(of.name, of.unit, of.value, left=fit.left[u]))
    return numbers


def list_mixed(fit: TorqueFit) -> dict[int, tuple[str, ...]]:
    """Return which numbers the record shows only together with others, and with which.

    Such a number would be identified if the others were known: its deviation under that condition
    is small, that of its own is not.
    """
    fitted = np.flatnonzero(fit.fitted & (fit.deviations > 0.0))
    widths = np.array([fit.unknowns[u].width for u in fitted])
    share = fit.covariance[np.ix_(fitted, fitted)] / np.outer(widths, widths)
    own = np.sqrt(np.diag(share))
    alone = 1.0 / np.sqrt(np.diag(np.linalg.pinv(share, hermitian=True)))
    alike = np.abs(share / np.outer(own, own)) - 2.0 * np.eye(len(own))
    mixed = dict[int, tuple[str, ...]]()
    for k in np.flatnonzero((own >= IDENTIFIED) & (alone < IDENTIFIED)):
        near = [m for m in np.argsort(-alike[k])[:MAX_MIXED] if alike[k][m] > MIXED]
        names = (fit.unknowns[fitted[m]].name for m in near)
        mixed[int(fitted[k])] = tuple(dict.fromkeys(_name_link(name) for name in names))
    return mixed


def _name_link(name: str) -> str:
    """Return the name of a number, of a link's that of the link: its parameters are logarithms."""
    return name.rpartition(".")[0] if name.startswith("links.") else name


def list_unfitted(scene: Scene, unknowns: Sequence[Unknown], is_requested: Callable[[str], bool],
              ) -> list[Found]:  # fmt: skip
    """Return numbers of parts that no record of torques determines, or beside another one.

    Args:
        scene: the nominal machine.
        unknowns: all that could be sought.
        is_requested: whether a number of this name is asked for.
    """
    fitted_names = {unknown.name for unknown in unknowns if unknown.width > 0.0}
    numbers = list[Found]()
    for joint in scene.joints:
        own_names = [name for name in fitted_names if name.startswith(f"joints.{joint.name}.")]
        for part in joint.parts:
            for key, number in part.list_numbers().items():
                name, value = f"joints.{joint.name}.{part.section}.{key}", getattr(part, key)
                if value is None or name in fitted_names or not is_requested(name):
                    continue
                beside = tuple(name for name in own_names if name.rpartition(".")[2] == key)
                why: dict[str, object] | None = None
                if number.prior and value and beside:
                    why = {"mixed": beside}
                elif number.excitation and number.prior:
                    why = {"left": "held: 0 in the scene, which has no relative deviation"}
                elif number.excitation:
                    why = {"shown": number.excitation}
                if why is not None:
                    numbers.append(Found.keep_number(name, number.unit, value, **why))
    return numbers


def _list_link(joint: ChainJoint, fit: TorqueFit, first: int) -> Iterator[Found]:
    here = slice(first, first + inertia.NUMBERS)
    start = np.array([unknown.value for unknown in fit.unknowns[here]])
    widths = np.array([unknown.width for unknown in fit.unknowns[here]]) * fit.fitted[here]
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

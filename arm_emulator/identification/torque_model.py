"""What the motors' torques are for a motion, as a function of the numbers that are looked for.

At the link, per joint, with motors that turn along with their links:

    tau / Ng = Y phi + Jm / Ng^2 a + (Dv_m / Ng^2 + Dv) v + (Dc_m / |Ng| + Dc) sign(v) - T(q) + e

phi follows from log-Cholesky parameters, all else is linear. T is the torque of springs and tables;
e is the offset of the measured torque, and no number of the machine.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from arm_emulator.identification import inertia
from arm_emulator.identification.filtered import Filtered, Mask
from arm_emulator.identification.link_regressor import LinkRegressor
from arm_emulator.identification.spring_torque import spring_torque, table_torque
from emulator_node.chain import Array
from emulator_node.parts.counterbalance import Counterbalance
from emulator_node.parts.torque_table import TorqueTable
from emulator_node.scene import Joint, Scene
from words.refusal import Refusal

LINK = ("log_mass", "log_x", "log_y", "log_z", "xy", "yz", "xz", "x", "y", "z")  # log-Cholesky
EVERYTHING = "*"
UNKNOWN = 3.0  # times what the torque could at most hide: how far friction may be off


@dataclass(frozen=True)
class Unknown:
    """A number to be found."""

    name: str  # dotted, as in the scene
    unit: str
    value: float  # that the scene has
    width: float  # standard deviation of what is known of it before
    least: float = -np.inf


@dataclass(frozen=True)
class _Column:
    """What a number adds to the torque at one joint, for 1 of its unit."""

    joint: int
    of: Callable[[Filtered], Array]  # (K,)


def matches(name: str, patterns: Sequence[str]) -> bool:
    """Return whether one of the patterns means a number: its name, or some parts of it in a row."""
    return any(
        fnmatch.fnmatchcase(name, before + pattern + after)
        for pattern in patterns
        for before in ("", "*.")
        for after in ("", ".*")
    )


class TorqueModel:
    """Torques of a scene's motors for any motion, and their slopes in the unknowns.

    Attributes:
        unknowns: all that could be found.
        start: their values in the scene.

    Args:
        scene: the machine as it is known.
        typical: how large torques (N,) at the links and speeds (N,) are that friction belongs to.
        trust: share to which inertias and forces of the scene are good.
    """

    def __init__(self, scene: Scene, typical: tuple[Array, Array], trust: float) -> None:
        self.scene = scene
        self._regressor = LinkRegressor(scene)
        self.unknowns = list[Unknown]()
        self._columns = list[_Column]()
        for geometry in scene.chain.joints:
            numbers = inertia.log_cholesky(geometry.body)
            width = inertia.widths(geometry.body, trust)
            for name, value, off in zip(LINK, numbers, width, strict=True):
                unit = "" if name.startswith("log") else "m"
                self._unknown(f"links.{geometry.link}.{name}", unit, value, off)
        self._links = len(self.unknowns)
        for j, joint in enumerate(scene.joints):
            self._add(j, joint, float(typical[0][j]), float(typical[1][j]), trust)
        self.start = np.array([one.value for one in self.unknowns])
        self.widths = np.array([one.width for one in self.unknowns])

    def _unknown(self, name: str, unit: str, value: float, width: float,
                 least: float = -np.inf) -> None:  # fmt: skip
        self.unknowns.append(Unknown(name, unit, float(value), float(width), least))

    def _add(self, j: int, joint: Joint, torque: float, speed: float, trust: float) -> None:
        place, Ng = f"joints.{joint.name}", joint.gear.ratio

        def add(name: str, unit: str, value: float, width: float, of: Callable[[Filtered], Array],
                least: float = 0.0) -> None:  # fmt: skip
            self._unknown(f"{place}.{name}", unit, value, width, least)
            self._columns.append(_Column(j, of))

        if joint.motor is not None:
            Jm = float(vars(joint.motor)["rotor_inertia"])
            add("motor.rotor_inertia", "kg m2", Jm, trust * Jm, lambda d: d.a[:, j] / Ng**2)
        rotor = joint.rotor_friction
        own, at, per = (joint.friction, "friction", 1.0)
        if rotor is not None:
            own, at, per = rotor, "motor.friction", 1.0 / abs(Ng)
        viscous, coulomb = getattr(own, "viscous", 0.0), getattr(own, "coulomb", 0.0)
        add(f"{at}.viscous", "N m s/rad", viscous, UNKNOWN * torque / speed / per**2,
            lambda d: per**2 * d.v[:, j])  # fmt: skip
        add(f"{at}.coulomb", "N m", coulomb, UNKNOWN * torque / per,
            lambda d: per * d.direction[:, j])  # fmt: skip
        for part in joint.extras:
            if isinstance(part, Counterbalance):
                of = partial(_of_spring, part, j)
                least = -np.inf if part.force < 0.0 else 0.0
                add("counterbalance.force", "N", part.force, trust * abs(part.force),
                    partial(of, 1.0, 0.0), least)  # fmt: skip
                if part.stiffness:
                    add("counterbalance.stiffness", "N/m", part.stiffness,
                        trust * part.stiffness, partial(of, 0.0, 1.0))  # fmt: skip
        add("measured_torque.offset", "N m", 0.0, abs(Ng) * torque,
            lambda d: np.full(len(d.q), 1.0 / Ng), -np.inf)  # fmt: skip

    def choose(self, patterns: Sequence[str], where: str) -> Mask:
        """Return which unknowns (U,) the patterns name.

        Offsets of torques hide what weight and friction are, and must be named themselves.

        Raises:
            Refusal: a pattern that names none.
        """
        names = [one.name for one in self.unknowns]
        for pattern in patterns:
            if not any(matches(name, [pattern]) for name in names) and pattern != EVERYTHING:
                known = sorted({name.rsplit(".", 1)[0] for name in names})
                rule = "name what can be found of this scene"
                raise Refusal(where, "--fit", rule, pattern, ", ".join(known))
        offsets = [one for one in patterns if "offset" in one or "measured" in one]
        return np.array(
            [matches(name, offsets if name.endswith(".offset") else patterns) for name in names]
        )

    def of(self, data: Filtered) -> MotionTorques:
        """Return the torques of a motion as a function of the unknowns."""
        Y = self._regressor(data.q, data.v, data.a)
        X = np.zeros((len(data.q), len(self.scene.joints), len(self._columns)))
        for k, column in enumerate(self._columns):
            X[:, column.joint, k] = column.of(data)
        known = np.zeros_like(data.q)
        for j, joint in enumerate(self.scene.joints):
            for part in joint.extras:
                if isinstance(part, TorqueTable):
                    known[:, j] -= table_torque(part, data.q[:, j])
        return MotionTorques(Y, X, known, self._links)


def _of_spring(
    spring: Counterbalance, joint: int, force: float, stiffness: float, data: Filtered
) -> Array:
    return -spring_torque(spring, data.q[:, joint], force, stiffness)


@dataclass(frozen=True)
class MotionTorques:
    """Torques of one motion, at the links."""

    Y: Array  # (K, N, 10 N), see `LinkRegressor`
    X: Array  # (K, N, columns)
    known: Array  # (K, N)
    links: int  # unknowns that are log-Cholesky parameters of links, the first ones

    def torques(self, unknowns: Array) -> Array:
        """Return the torques (K, N) [N m or N]."""
        links = unknowns[: self.links].reshape(-1, inertia.NUMBERS)
        phi = np.concatenate([inertia.exponential(one) for one in links])
        torques: Array = self.known + self.Y @ phi + self.X @ unknowns[self.links :]
        return torques

    def slopes(self, unknowns: Array) -> Array:
        """Return the derivatives of the torques in the unknowns (K, N, U)."""
        K, N, _ = self.Y.shape
        links = unknowns[: self.links].reshape(-1, inertia.NUMBERS)
        pieces = self.Y.reshape(K, N, len(links), inertia.NUMBERS)
        of_links = [pieces[:, :, k] @ inertia.slope(one) for k, one in enumerate(links)]
        return np.concatenate([*of_links, self.X], axis=2)

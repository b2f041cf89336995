"""Motor torques of a motion, as a function of the sought numbers.

At the link, per joint, with motors that turn along with their links:

        tau / Ng = Y phi + sum of the torques of parts at the link + of those at the rotor / Ng + e

phi follows from log-Cholesky parameters. Each part declares its torque as a function of its numbers
(`Part.compute_effort`); trials show in which of them it is linear. e is the offset of the measured
torque, and not a number of the machine.
"""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from arm_emulator.extension.base import Array, Refusal
from arm_emulator.extension.machine import Joint, Part, Scene, ShaftMotion
from arm_emulator_identification import inertia
from arm_emulator_identification.filtered import Filtered, Mask
from arm_emulator_identification.link_regressor import LinkRegressor

LINK = ("log_mass", "log_x", "log_y", "log_z", "xy", "yz", "xz", "x", "y", "z")  # log-Cholesky
EVERYTHING = "*"
UNKNOWN = 3.0  # times the most that the torque could hide: width of friction
FARTHEST = 20.0  # factor by which a number above 0 may differ from the scene's
TRIED = 0.1  # of its width: perturbation of a number in the test of linearity
LINEAR = 1e-9  # relative tolerance of a part's linearity
SMALL = 1e-4  # of its width: perturbation for differences
LOADED = 4  # turns, from measured torques of motors to those that the scene's numbers take


@dataclass(frozen=True)
class Unknown:
    """A sought number."""

    name: str  # dotted, as in the scene
    unit: str
    value: float  # in the scene
    width: float  # standard deviation of its prior
    least: float = -np.inf
    most: float = np.inf
    shown: str = ""  # what a record must have to show it, if not every motion does


@dataclass(frozen=True)
class Piece:
    """A part of a joint, and its sought numbers."""

    joint: int
    part: Part
    first: int  # of its unknowns, in the row of all
    keys: tuple[str, ...]

    def select_numbers(self, unknowns: Array) -> dict[str, float]:
        """Return its numbers of a row of unknowns, by key."""
        return {key: float(unknowns[self.first + k]) for k, key in enumerate(self.keys)}


def has_match(name: str, patterns: Sequence[str]) -> bool:
    """Return whether a pattern matches a number: its name, or consecutive parts of it."""
    return any(
        fnmatch.fnmatchcase(name, before + pattern + after)
        for pattern in patterns
        for before in ("", "*.")
        for after in ("", ".*")
    )


class TorqueModel:
    """Torques of a scene's motors for any motion, and their slopes in the unknowns.

    Attributes:
        unknowns: all that could be sought: of the links, without the payload, then of the parts,
            then offsets.
        start: their values in the scene.
        links: number of unknowns of links, the first ones.
        rest: remainder of the links: payload, and links that are not physical bodies (10 L,).
        pieces: the parts.

    Args:
        scene: the nominal machine.
        typical: torques (N,) at the links and speeds (N,) for the scale of friction.
        trust: relative accuracy of inertias and forces of the scene.

    Raises:
        Refusal: a part of the scene does not state its torque for a motion.
    """

    def __init__(self, scene: Scene, typical: tuple[Array, Array], trust: float) -> None:
        self.scene = scene
        _check_stated(scene)
        self.regressor = LinkRegressor(scene)
        self.unknowns = list[Unknown]()
        self.rest = np.zeros(inertia.NUMBERS * len(scene.chain.links))
        for k, (geometry, body) in enumerate(zip(scene.chain.links, scene.bare, strict=True)):
            sound = inertia.is_body(body)
            numbers = inertia.map_logarithm(body if sound else inertia.make_ball(body))
            widths = inertia.estimate_widths(body, trust) if sound else np.zeros(inertia.NUMBERS)
            beside = inertia.list_dynamic(body) if sound else inertia.map_exponential(numbers)
            here = slice(inertia.NUMBERS * k, inertia.NUMBERS * (k + 1))
            self.rest[here] = inertia.list_dynamic(geometry.body) - beside
            for name, value, off in zip(LINK, numbers, widths, strict=True):
                unit = "" if name.startswith("log") else "m"
                number_name = f"links.{geometry.link}.{name}"
                self.unknowns.append(Unknown(number_name, unit, float(value), float(off)))
        self.links = len(self.unknowns)
        self.pieces = list[Piece]()
        for j, joint in enumerate(scene.joints):
            self._add_joint(j, joint, (float(typical[0][j]), float(typical[1][j])), trust)
        self.offsets = len(self.unknowns)
        for joint, torque in zip(scene.joints, typical[0], strict=True):
            name = f"joints.{joint.name}.measured_torque.offset"
            off = abs(joint.gear.ratio) * float(torque)
            self.unknowns.append(Unknown(name, "N m", 0.0, off))
        self.start = np.array([unknown.value for unknown in self.unknowns])
        self.widths = np.array([unknown.width for unknown in self.unknowns])

    def _add_joint(self, j: int, joint: Joint, typical: tuple[float, float], trust: float) -> None:
        place = f"joints.{joint.name}"
        fitted_keys = _choose_keys(joint)
        for part in joint.parts:
            piece = Piece(j, part, len(self.unknowns), tuple(fitted_keys.get(part.section, ())))
            per = abs(joint.gear.ratio) if part.shaft == "rotor" else 1.0
            torque, speed = typical[0] * per, typical[1] / per
            for key in piece.keys:
                number, value = part.list_numbers()[key], float(getattr(part, key))
                if number.prior == "unknown":
                    width = UNKNOWN * (torque / speed if number.unit == "N m s/rad" else torque)
                else:
                    width = trust * abs(value)
                low, high = number.least, number.most
                if number.above is not None:
                    low, high = max(low, value / FARTHEST), min(high, value * FARTHEST)
                if low < 0.0 and value:  # a pulling spring does not push
                    low, high = (0.0, high) if value > 0.0 else (low, 0.0)
                name = f"{place}.{part.section}.{key}"
                self.unknowns.append(
                    Unknown(name, number.unit, value, width, low, high, number.excitation)
                )
            self.pieces.append(piece)

    def choose_unknowns(self, patterns: Sequence[str], where: str) -> Mask:
        """Return the unknowns (U,) that match the patterns.

        Offsets of torques hide errors of weight and friction, and must be named themselves.

        Raises:
            Refusal: a pattern matches none.
        """
        names = [unknown.name for unknown in self.unknowns]
        for pattern in patterns:
            if not any(has_match(name, [pattern]) for name in names) and pattern != EVERYTHING:
                groups = sorted({name.rsplit(".", 1)[0] for name in names})
                rule = "name numbers that can be identified"
                raise Refusal(where, "--fit", rule, pattern, ", ".join(groups))
        offsets = [offset for offset in patterns if "offset" in offset or "measured" in offset]
        matches = [
            has_match(name, offsets if name.endswith(".offset") else patterns) for name in names
        ]
        chosen: Mask = np.array(matches) & (self.widths > 0.0)
        return chosen

    def bind_motion(self, data: Filtered) -> MotionTorques:
        """Return the torques of a motion as a function of the unknowns.

        Gears transmit the torques of the scene's links, see `MotionTorques.update_loads`.
        """
        Y = self.regressor(data.q, data.v, data.a)
        at_link = data.fine.tau / self.scene.gear_ratios
        motion = MotionTorques(self, data, Y, np.zeros_like(at_link), at_link, [])
        for _ in range(LOADED):
            motion = motion.update_loads(self.start)
        return motion

    @property
    def at_links(self) -> Mask:
        """Unknowns that take their torque at a link, which the gear carries (U,)."""
        at_link: Mask = np.arange(len(self.unknowns)) < self.links
        for piece in self.pieces:
            at_link[piece.first : piece.first + len(piece.keys)] = piece.part.shaft != "rotor"
        return at_link

    def compute_bodies(self, unknowns: Array) -> Array:
        """Return the ten numbers of each link (L, 10), without the payload."""
        links = unknowns[: self.links].reshape(-1, inertia.NUMBERS)
        return np.array([inertia.map_exponential(link) for link in links])


def _check_stated(scene: Scene) -> None:
    """Refuse a scene with a part that does not state its torque for a motion."""
    t, none = np.linspace(0.0, 1.0, 3), np.zeros(3)
    for joint in scene.joints:
        at_rest = ShaftMotion(t, none, none, none, none, none, joint.gear.ratio)
        for part in joint.parts:
            if part.compute_effort(at_rest) is None:
                rule = "be without parts whose torque does not follow from the measured motion"
                valid = "the scene without this section, where the motion was recorded without it"
                place = f"joints.{joint.name}.{part.section}"
                raise Refusal(scene.where, place, rule, type(part).__name__, valid)


def _choose_keys(joint: Joint) -> dict[str, list[str]]:
    """Return the sought keys of each part of a joint, by its section.

    If several parts have the same number, such as friction of link and of rotor, only one is
    sought: one given in the scene, and preferably the rotor's.
    """
    ranked = sorted(joint.parts, key=lambda part: part.shaft != "rotor")
    keys = dict[str, list[str]]()
    for key in {key: None for part in ranked for key in part.list_numbers()}:
        having = [
            part for part in ranked if key in part.list_numbers() and part.list_numbers()[key].prior
        ]
        having = [part for part in having if getattr(part, key) is not None]
        if not having:
            continue
        part_with_value = next((part for part in having if getattr(part, key)), having[0])
        if getattr(part_with_value, key) or part_with_value.list_numbers()[key].prior == "unknown":
            keys.setdefault(part_with_value.section, []).append(key)
    return keys


@dataclass(frozen=True)
class _Effort:
    """Torque of a part at the link: linear in its unknowns, or evaluated each time."""

    piece: Piece
    constant: Array  # (K,), with all its unknowns 0
    columns: Array | None  # (K, keys); None: not linear


@dataclass(frozen=True)
class MotionTorques:
    """Torques of one motion, at the links."""

    model: TorqueModel
    data: Filtered
    Y: Array  # (K, N, 10 L), see `LinkRegressor`
    load: Array  # N m or N, of the gears on the links, at the samples of `data.fine`
    motor: Array  # N m or N, of the motors, at the links and the same samples
    efforts: list[_Effort]

    def update_loads(self, unknowns: Array) -> MotionTorques:
        """Return the torques at these unknowns, of gears and motors that drive these links.

        The measured torque of a motor is no measure of its own friction: its noise would stand on
        both sides.
        """
        # Below the low-pass, a curve through the rows reproduces the samples.
        t = np.clip(self.data.fine.t, self.data.t[0], self.data.t[-1])
        load = CubicSpline(self.data.t, self._compute_link_torques(unknowns))(t)
        of_rotors = np.zeros_like(load)
        for piece in self.model.pieces:
            into = of_rotors if piece.part.shaft == "rotor" else load
            into[:, piece.joint] += self._compute_action(piece, piece.select_numbers(unknowns))
        motor = load + of_rotors
        rigid = [joint.gear.stiffness is None for joint in self.model.scene.joints]
        load[:, rigid] = motor[:, rigid]  # there, the full motor torque
        loaded = dataclasses.replace(self, load=load, motor=motor)
        efforts = [loaded.examine_piece(piece) for piece in self.model.pieces]
        return dataclasses.replace(loaded, efforts=efforts)

    def compute_torques(self, unknowns: Array) -> Array:
        """Return the torques (K, N) [N m or N]."""
        torques = self._compute_link_torques(unknowns)
        for effort in self.efforts:
            torques[:, effort.piece.joint] += self._compute_effort(effort, unknowns)
        return torques + self._offsets * unknowns[self.model.offsets :]

    def compute_slopes(self, unknowns: Array) -> Array:
        """Return the derivatives of the torques in the unknowns (K, N, U)."""
        model = self.model
        K, N, _ = self.Y.shape
        links = unknowns[: model.links].reshape(-1, inertia.NUMBERS)
        pieces = self.Y.reshape(K, N, len(links), inertia.NUMBERS)
        slopes = np.zeros((K, N, len(model.unknowns)))
        for k, link in enumerate(links):
            here = slice(inertia.NUMBERS * k, inertia.NUMBERS * (k + 1))
            slopes[:, :, here] = pieces[:, :, k] @ inertia.differentiate_exponential(link)
        for effort in self.efforts:
            here = slice(effort.piece.first, effort.piece.first + len(effort.piece.keys))
            slopes[:, effort.piece.joint, here] = self._compute_effort_slopes(effort, unknowns)
        for j, offset in enumerate(self._offsets):
            slopes[:, j, model.offsets + j] = offset
        return slopes

    @property
    def _offsets(self) -> Array:
        return 1.0 / self.model.scene.gear_ratios

    def _compute_link_torques(self, unknowns: Array) -> Array:
        phi = self.model.compute_bodies(unknowns).ravel() + self.model.rest
        tau: Array = self.Y @ phi
        return tau

    def _compute_effort(self, effort: _Effort, unknowns: Array) -> Array:
        piece = effort.piece
        if effort.columns is None:
            return self._smooth_action(piece, piece.select_numbers(unknowns))
        here = unknowns[piece.first : piece.first + len(piece.keys)]
        torque: Array = effort.constant + effort.columns @ here
        return torque

    def _compute_effort_slopes(self, effort: _Effort, unknowns: Array) -> Array:
        if effort.columns is not None:
            return effort.columns
        piece, columns = effort.piece, []
        for k, (key, value) in enumerate(piece.select_numbers(unknowns).items()):
            unknown = self.model.unknowns[piece.first + k]
            by = SMALL * unknown.width
            ends = [min(value + by, unknown.most), max(value - by, unknown.least)]
            up, down = (
                self._smooth_action(piece, piece.select_numbers(unknowns) | {key: end})
                for end in ends
            )
            columns.append((up - down) / (ends[0] - ends[1]))
        return np.column_stack(columns)

    def examine_piece(self, piece: Piece) -> _Effort:
        """Determine whether a part is linear in its unknowns."""
        numbers = {key: float(getattr(piece.part, key)) for key in piece.keys}
        by = {
            key: TRIED * self.model.unknowns[piece.first + k].width
            for k, key in enumerate(piece.keys)
        }
        base = self._smooth_action(piece, numbers)
        nothing = np.zeros((len(base), 0))
        columns = [
            (self._smooth_action(piece, numbers | {key: numbers[key] + by[key]}) - base) / by[key]
            for key in piece.keys
        ]
        X = np.column_stack(columns) if columns else nothing
        twice = self._smooth_action(
            piece, {key: numbers[key] + 2.0 * by[key] for key in piece.keys}
        )
        expected = base + 2.0 * (X @ np.array(list(by.values())) if columns else 0.0)
        size = np.abs(twice).max() + np.abs(base).max()
        if np.abs(twice - expected).max() > LINEAR * size:
            return _Effort(piece, base, None)
        return _Effort(piece, base - X @ np.array(list(numbers.values())), X)

    def _smooth_action(self, piece: Piece, numbers: Mapping[str, float]) -> Array:
        """Return the torque of a part with given numbers at the link (K,), low-passed."""
        return self.data.smooth_samples(self._compute_action(piece, numbers))

    def _compute_action(self, piece: Piece, numbers: Mapping[str, float]) -> Array:
        """Return the torque of a part with given numbers at the link, at every sample."""
        fine, j = self.data.fine, piece.joint
        ratio = self.model.scene.joints[j].gear.ratio
        per = ratio if piece.part.shaft == "rotor" else 1.0
        at = ShaftMotion(
            fine.t, fine.q[:, j] / per, fine.v[:, j] / per, fine.a[:, j] / per,
            self.load[:, j] * per, self.motor[:, j] * per, ratio,
        )  # fmt: skip
        effort = piece.part.replace_numbers(**numbers).compute_effort(at)
        assert effort is not None, "checked at the beginning"
        gains: Array = effort / per
        return gains

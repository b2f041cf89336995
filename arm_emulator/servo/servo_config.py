"""Parameters of the servo: data-sheet values and gains of its joints, validated in one place."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from arm_emulator.base.io.config_files import find_config
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.saved_objects import SharedObject
from arm_emulator.base.validation.bound import bound_encoder_counts
from arm_emulator.base.validation.coerce import coerce_kind
from arm_emulator.base.validation.number import Number, list_numbers, number
from arm_emulator.base.validation.parameters import (
    ROS_PARAMETERS,
    check_keys,
    read_numbers,
    read_ros_parameters,
    split_tables,
)


@dataclass(frozen=True)
class JointServo:
    """One joint as its drive sees it: motor, gear and encoder from the data sheets, and the gains.

    Link-side quantities (``velocity_limit``, ``velocity_gain``) are those a joint has behind its
    gear; ``gear_ratio`` is link turns per motor turn.
    """

    name: str
    gear_ratio: float = number(
        above=0,
        in_size=True,
        text="link turns per motor turn; negative: the link turns the other way",
    )
    counts_per_turn: int = number(at_least=1, whole=True, text="encoder counts per motor turn")
    resistance: float = number(
        "ohm",
        at_least=0,
        text="resistance of the winding; 0 only where the command is a current or a torque",
    )
    torque_constant: float = number(
        "N m/A", above=0, text="motor torque per current; 1 where the command is a torque"
    )
    back_emf_constant: float = number("V s/rad", at_least=0, text="induced voltage per motor speed")
    rotor_inertia: float = number(
        "kg m2", above=0, text="inertia of the rotor and the primary side of the gear"
    )
    velocity_limit: float = number(
        "rad/s", above=0, text="largest link speed that the position loop commands"
    )
    position_gain: float = number("1/s", above=0, text="link speed per position error")
    velocity_gain: float = number("N m s/rad", above=0, text="link torque per link speed error")
    integral_time: float = number(
        "s", above=0, text="reset time of the velocity loop's integral action"
    )
    observer_bandwidth: float = number(
        "rad/s", above=0, text="the three poles of the speed observer"
    )
    inductance: float = number(
        "H",
        at_least=0,
        default=0.0,
        text="inductance of the winding; 0: the current follows the voltage at once",
    )
    link_inertia: float = number(
        "kg m2",
        at_least=0,
        default=0.0,
        text="link inertia behind a rigid gear; 0: an elastic gear",
    )
    current_limit: float = number(
        "A",
        above=0,
        default=math.inf,
        text="largest current, or torque, that the servo commands; none: the voltage limits",
    )
    current_bandwidth: float = number(
        "Hz",
        at_least=0,
        default=0.0,
        text="bandwidth of the drive's current loop, whose command is a current; 0: no loop",
    )
    torque_bandwidth: float = number(
        "Hz",
        at_least=0,
        default=0.0,
        text="bandwidth of the drive's torque control, whose command is a torque; 0: none",
    )
    voltage_limit: float = number(
        "V",
        above=0,
        default=math.inf,
        text="largest voltage of the drive (synchronous motors: amplitude); none: the supply's",
    )
    encoder_bits: int = number(
        ends=(0, 48),
        whole=True,
        default=0,
        text="word length of an absolute encoder; 0: an incremental one",
    )

    @property
    def commanded(self) -> CommandPath:
        """Electrical model behind the motor's command."""
        emf = self.back_emf_constant
        return CommandPath.compute_path(self.resistance, self.inductance, emf, self.loop_bandwidth)

    @property
    def loop_bandwidth(self) -> float:
        """Bandwidth of the loop in the drive [Hz]; 0 if its command is a voltage."""
        return self.torque_bandwidth or self.current_bandwidth

    def compute_largest_command(self, supply_voltage: float) -> float:
        """Return the largest command [V, A, N m]: what the supply, or its limit, leaves."""
        voltage = min(supply_voltage, self.voltage_limit)
        if self.loop_bandwidth == 0.0:
            return voltage
        return min(self.current_limit, voltage / self.resistance if self.resistance else math.inf)

    def check_command(self, where: str, unit: str) -> None:
        """Refuse a motor of a scene that is commanded something else than this servo gives.

        Args:
            where: the scene's file.
            unit: of what the scene's motor is commanded.

        Raises:
            Refusal: it is.
        """
        for key, of, reason in (
            ("current_bandwidth", "A", "the motor's drive closes a current loop"),
            ("torque_bandwidth", "N m", "the scene's motor takes a torque"),
        ):
            bandwidth, quantity = getattr(self, key), f"servo.joints.{self.name}.{key}"
            if unit == of and bandwidth == 0.0:
                raise Refusal(where, quantity, f"be given: {reason}", "nothing")
            if unit != of and bandwidth > 0.0:
                takes = {"A": "current", "N m": "torque"}.get(unit, "voltage")
                rule = f"be absent: the scene's motor takes a {takes}"
                raise Refusal(where, quantity, rule, f"{bandwidth:g} Hz")

    @property
    def inertia(self) -> float:
        """Inertia that turns rigidly with the motor, referred to the motor [kg m2]."""
        return self.rotor_inertia + self.gear_ratio**2 * self.link_inertia

    @property
    def count_angle(self) -> float:
        """Link angle of one encoder count [rad], >= 0."""
        return 2.0 * math.pi / self.counts_per_turn * abs(self.gear_ratio)


@dataclass(frozen=True)
class ServoConfig(SharedObject):
    """Parameters of the servo: periods, supply and its joints in the order of its arrays."""

    period: float = number("s", above=0, text="servo period, that of the scene")
    motion_period: float = number(
        "s",
        at_least=0,
        text="period of the joint targets in lock-step; 0: targets act when they arrive",
    )
    hold_after: float = number(
        "s",
        above=0,
        text="logical time without joint targets after which the watchdog holds the joints",
    )
    cut_after: float = number(
        "s",
        above=0,
        text="the same until it cuts the power; in real time also wall time without motor states",
    )
    supply_voltage: float = number("V", above=0, text="largest voltage at a motor, of either sign")
    joints: tuple[JointServo, ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of all arrays."""
        return tuple(joint.name for joint in self.joints)

    @property
    def counts(self) -> Number:
        """Bounds of the encoders' counts, (N,)."""
        going_on = bound_encoder_counts([joint.count_angle for joint in self.joints])
        words = np.array([2.0**joint.encoder_bits for joint in self.joints])
        largest = np.where(words > 1.0, words - 1.0, going_on.at_most)  # type: ignore[arg-type]
        return Number.bound_size(going_on.name, "", largest)

    def count_angles(self, joint_names: Iterable[str]) -> list[float]:
        """Return the link angle of one encoder count for each of some joints [rad]."""
        angles = {joint.name: joint.count_angle for joint in self.joints}
        return [angles[name] for name in joint_names]

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], where: str) -> ServoConfig:
        """Validate the parameters of a servo.

        Args:
            mapping: ``period``, ``motion_period``, ``hold_after``, ``cut_after``,
                ``supply_voltage``, ``joint_names`` and, for each name, ``joints.<name>.<field of
                JointServo>``. Nested mappings and ROS's dotted names are both taken.
            where: name of their source, for refusals.

        Raises:
            Refusal: an unknown, missing or impossible value.
        """
        parameters = _flatten_names(mapping, where)
        for name in parameters:
            if any(name.startswith(f"{scalar}.") for scalar in _SCALARS if scalar in parameters):
                raise Refusal(where, name, "be given once", parameters[name])
        for name in list(parameters):
            if name.split(".")[0] in ROS_PARAMETERS:
                del parameters[name]
        names = _check_joint_names(parameters.pop("joint_names", None), where)
        below = [key for key in parameters if key.startswith("joints.")]
        rest = {key.removeprefix("joints."): parameters.pop(key) for key in below}
        tables = split_tables(parameters.pop("joints", rest), where, "joints")
        for name in tables:
            # ROS changes the meaning of a section under a name with dots.
            if name not in names and any("." in dotted for dotted in names):
                rule = "be a joint (one whose name has dots is written out in parameter files)"
                raise Refusal(where, f"joints.{name}", rule, name, "joints.NAME.gear_ratio: VALUE")
        check_keys(tables, names, where, "joints")
        scalars = read_numbers(parameters, ServoConfig, where)
        _check_periods(scalars, where)
        joints = []
        for name in names:
            if name not in tables:
                raise Refusal(where, f"joints.{name}", "be given", "nothing")
            numbers = read_numbers(tables[name], JointServo, where, f"joints.{name}")
            joints.append(JointServo(name=name, **numbers))
        for joint in joints:
            check_rates(joint, scalars["period"], where)
        return cls(**scalars, joints=tuple(joints))


_SHORTEST_PERIOD, _LONGEST_PERIOD = 1e-9, 1e6  # s

_SCALARS = list_numbers(ServoConfig)
_FIELDS = list_numbers(JointServo)


# Settable at run time: not the data sheet.
SETTABLE = (
    "hold_after",
    "cut_after",
    "velocity_limit",
    "current_limit",
    "position_gain",
    "velocity_gain",
    "integral_time",
    "observer_bandwidth",
)


def find_declared_number(name: str) -> Number | None:
    """Return what the parameter of a dotted name may be, None if it is no number."""
    leaf = name.rsplit(".", 1)[-1]
    declared: Number | None = (_FIELDS | _SCALARS).get(leaf)
    return declared


def load_servo_config(path: str | Path) -> ServoConfig:
    """Read a ROS parameter file of the node ``servo``.

    Args:
        path: the file, or the name of one that comes with the emulator.

    Raises:
        Refusal: no such file, not a parameter file, or a value that is not taken.
    """
    path = find_config(str(path), ".yaml", "servo")
    return ServoConfig.from_mapping(read_ros_parameters(path, "servo"), path.name)


def check_joints(where: str, config: object, joint_names: Sequence[str]) -> None:
    """Refuse a config for other joints, or for them in another order."""
    names = coerce_kind(config, ServoConfig, where, "config", "be a ServoConfig").joint_names
    if names != tuple(joint_names):
        received, valid = ", ".join(names), ", ".join(joint_names)
        raise Refusal(where, "config", "have the servo's joints in its order", received, valid)


def _flatten_names(mapping: object, where: str, path: str = "") -> dict[str, Any]:
    """Return nested mappings as one of dotted names, as ROS has them."""
    if not isinstance(mapping, Mapping):
        raise Refusal(where, path or "the parameters", "be a mapping", mapping)
    flat: dict[str, Any] = {}
    for key, value in mapping.items():
        name = f"{path}.{key}" if path else str(key)
        below = _flatten_names(value, where, name) if isinstance(value, Mapping) else {name: value}
        for key_below in below:
            if key_below in flat:
                raise Refusal(where, key_below, "be given once", value)
        flat |= below
    return flat


def _check_joint_names(value: object, where: str) -> tuple[str, ...]:
    if (
        not isinstance(value, list | tuple)
        or not value
        or not all(isinstance(name, str) and name for name in value)
        or len(set(value)) != len(value)
    ):
        raise Refusal(where, "joint_names", "be a list of different joint names", value)
    return tuple(value)


def _check_periods(scalars: Mapping[str, float], where: str) -> None:
    period, motion_period = scalars["period"], scalars["motion_period"]
    if not _SHORTEST_PERIOD <= period <= _LONGEST_PERIOD:
        rule = f"be a number from {_SHORTEST_PERIOD:g} to {_LONGEST_PERIOD:g} s"
        raise Refusal(where, "period", rule, period)
    if motion_period > _LONGEST_PERIOD:
        rule = f"be a number from 0 to {_LONGEST_PERIOD:g} s"
        raise Refusal(where, "motion_period", rule, motion_period)
    cycles = motion_period / period
    if abs(cycles - round(cycles)) > 1e-9 * max(1.0, cycles):
        raise Refusal(
            where, "motion_period", f"be a whole multiple of period = {period} s", motion_period
        )
    if scalars["cut_after"] <= scalars["hold_after"]:
        rule = f"be > hold_after = {scalars['hold_after']} s"
        raise Refusal(where, "cut_after", rule, scalars["cut_after"])


def check_rates(joint: JointServo, period: float, where: str) -> None:
    """Refuse what a law that is computed once per period cannot do."""
    path = f"joints.{joint.name}"
    if joint.torque_bandwidth > 0.0:
        if joint.current_bandwidth > 0.0:
            rule = "be absent together with a current_bandwidth"
            raise Refusal(where, f"{path}.torque_bandwidth", rule, joint.torque_bandwidth)
        if joint.torque_constant != 1.0:
            rule = "be 1 with a torque_bandwidth: commands are torques"
            raise Refusal(where, f"{path}.torque_constant", rule, joint.torque_constant)
    if joint.resistance == 0.0 and joint.loop_bandwidth == 0.0:
        rule = "be a number > 0 ohm where the command is a voltage"
        raise Refusal(where, f"{path}.resistance", rule, joint.resistance)
    fastest = 1.0 / period
    for key in ("observer_bandwidth", "position_gain"):
        if (value := getattr(joint, key)) > fastest:
            raise Refusal(where, f"{path}.{key}", f"be <= 1/period = {fastest:g} 1/s", value)
    if joint.integral_time < period:
        rule = f"be >= period = {period} s"
        raise Refusal(where, f"{path}.integral_time", rule, joint.integral_time)


# Electrical model behind a motor's command, so that one servo law serves voltages and currents.
#
# A drive that closes a current loop of bandwidth f makes of a command u [A] the current
#
#     1 / (2 pi f) di/dt = u - i
#
# at any speed. That is the winding L di/dt = V - R i - Kb omega with R = 1, L = 1 / (2 pi f) and
# Kb = 0, whose volts are amperes. So it is with a drive that makes a torque of its command, whose
# volts and amperes are N m.


class CommandPath(NamedTuple):
    """The winding that a command meets: L di/dt = u - R i - Kb omega."""

    resistance: float
    inductance: float
    back_emf_constant: float

    @classmethod
    def compute_path(
        cls,
        resistance: float,
        inductance: float,
        back_emf_constant: float,
        bandwidth: float,
    ) -> CommandPath:
        """Return what a motor's command meets.

        Args:
            resistance: of the winding [ohm].
            inductance: of the winding [H].
            back_emf_constant: [V s/rad].
            bandwidth: of the drive's loop of the current or the torque [Hz]; 0: the command is a
                voltage.
        """
        if bandwidth > 0.0:
            return cls(1.0, 1.0 / (2.0 * math.pi * bandwidth), 0.0)
        return cls(resistance, inductance, back_emf_constant)

"""Published figures of well-known arms and servos, which come before any rule.

An arm is known by the name of its description and the number of its joints. Every entry has its
source; torques are those that the maker states as the largest of a joint.
"""

import math
import re
from dataclasses import dataclass
from typing import Self

from arm_emulator.design.joint_data import JointData

USABLE = (
    0.45  # of stall torque and no-load speed at a time: 10 % of the supply are left for control
)


@dataclass(frozen=True)
class SmartServo:
    """A hobby servo: a dc motor with its gear, by its ends at one supply voltage."""

    name: str
    supply: float  # V
    stall_torque: float  # N m at the horn
    no_load_speed: float  # rad/s at the horn
    turns: float  # of the motor per turn of the horn
    source: str
    stall_current: float | None = None  # A

    @property
    def torque(self) -> float:
        """The largest torque that is asked for [N m]."""
        return USABLE * self.stall_torque

    @property
    def speed(self) -> float:
        """The largest speed that is asked for [rad/s]."""
        return USABLE * self.no_load_speed

    @property
    def back_emf_constant(self) -> float:
        """Back EMF constant of its motor [V s/rad]."""
        return self.supply / (self.no_load_speed * self.turns)

    @property
    def torque_constant(self) -> float:
        """Torque constant with the losses of the gear [N m/A]; by default that of the back EMF."""
        if self.stall_current is None:
            return self.back_emf_constant
        return self.stall_torque / self.turns / self.stall_current

    @property
    def resistance(self) -> float:
        """Resistance of its winding [ohm]."""
        return self.supply * self.torque_constant * self.turns / self.stall_torque


@dataclass(frozen=True)
class JointSheet:
    """Published figures of a joint's drive."""

    torque: float  # N m
    speed: float  # rad/s
    source: str
    servo: SmartServo | None = None
    data: JointData | None = None  # its parts, where they are known, too

    @classmethod
    def load_sheet(cls, data: JointData) -> Self:
        """Return the figures of a joint with a data file."""
        return cls(data.torque, data.speed, f"config/joints/{data.name}.yaml", data=data)

    @property
    def supply(self) -> float | None:
        """Voltage for which its figures hold [V]; None: any."""
        source = self.servo or self.data
        return None if source is None else source.supply


@dataclass(frozen=True)
class _Arm:
    names: str  # a pattern for the whole name
    joints: tuple[JointSheet, ...]


def _convert_rpm(value: float) -> float:
    return value * 2.0 * math.pi / 60.0


STS3215 = SmartServo(
    "STS3215", 12.0, 30.0 * 0.0980665, _convert_rpm(45.0), 345.0,
    "maker's figures at 12 V in https://robonine.com/"
    "testing-of-feetech-sts3215-servomotor-backlash-repeatability-and-torque",
)  # fmt: skip
XM430_W350 = SmartServo(
    "XM430-W350", 12.0, 4.1, _convert_rpm(46.0), 353.5,
    "https://emanual.robotis.com/docs/en/dxl/x/xm430-w350", stall_current=2.3,
)  # fmt: skip

_UR = "https://www.universal-robots.com/articles/ur-articles/max-joint-torques"
_FRANKA = "https://frankarobotics.github.io/docs/robot_specifications.html"


def _make_servo_arm(names: str, *servos: SmartServo) -> _Arm:
    return _Arm(
        names,
        tuple(
            JointSheet(servo.torque, servo.speed, f"{servo.name}, {servo.source}", servo)
            for servo in servos
        ),
    )


def _make_arm(
    names: str, torques: tuple[float, ...], degrees: tuple[float, ...], source: str
) -> _Arm:
    pairs = zip(torques, degrees, strict=True)
    return _Arm(names, tuple(JointSheet(T, math.radians(w), source) for T, w in pairs))


_ARMS = (
    _make_servo_arm(r"so[-_ ]?(arm)?[-_ ]?10[01].*", *[STS3215] * 5),
    _make_servo_arm(r"open_?manipulator(_?x)?", *[XM430_W350] * 4),
    _make_arm(r"ur3([-_]?(robot|cb3?))?", (56.0, 56.0, 28.0, 12.0, 12.0, 12.0),
           (180.0,) * 3 + (360.0,) * 3, _UR),
    _make_arm(r"ur5([-_]?(robot|cb3?))?", (150.0,) * 3 + (28.0,) * 3, (180.0,) * 6, _UR),
    _make_arm(r"ur10([-_]?(robot|cb3?))?", (330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
           (120.0, 120.0) + (180.0,) * 4, _UR),
    _make_arm(r"(franka[-_]?(emika[-_]?)?)?panda([-_]?arm)?", (87.0,) * 4 + (12.0,) * 3,
           tuple(map(math.degrees, (2.175,) * 4 + (2.61,) * 3)), _FRANKA),
)  # fmt: skip


def find_published(robot: str, joints: int) -> tuple[JointSheet, ...] | None:
    """Return what is published of the joints of an arm, base to tool; None: it is not known.

    Args:
        robot: name of the robot in its description.
        joints: how many of them move.
    """
    for arm in _ARMS:
        if len(arm.joints) == joints and re.fullmatch(arm.names, robot, re.IGNORECASE):
            return arm.joints
    return None

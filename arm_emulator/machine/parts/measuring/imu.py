"""Inertial measurement units on links."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from arm_emulator.base.urdf.frames import Frame, make_frame
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.chain import Chain
from arm_emulator.machine.parts.key import Key
from arm_emulator.machine.parts.measuring.analog_sensor import LARGEST_ERROR, AnalogConverter
from arm_emulator.machine.parts.measuring.encoder import DELAY
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.part import number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.varied import Varied

_XYZ = Number.bound_size("xyz", "m", 100.0)
_RPY = Number.bound_size("rpy", "rad", 100.0)

BIASES = ("bias_x", "bias_y", "bias_z")


def _declare_bias() -> Any:
    ends = -LARGEST_ERROR, LARGEST_ERROR
    return number("offset", "", ends=ends, default=None, text="added on this axis")


class Axes(AnalogConverter):
    """Three sensors along the axes of a unit's frame, equal except for their biases."""

    owners = "imus"
    zero = "bias_x"

    bias_x: float | None = _declare_bias()
    bias_y: float | None = _declare_bias()
    bias_z: float | None = _declare_bias()

    def write_initialiser(self, joint: str, places: Mapping[str, str]) -> str:
        """Return the three sensors in C++."""
        axes = []
        for own in BIASES:
            others = [key for key in BIASES if key != own]
            alone = replace(self, **dict.fromkeys(others))
            its = {name: at for name, at in places.items() if name.split(".")[-1] not in others}
            members = alone.list_members(joint, its)
            axes.append("{" + ", ".join(f".{name} = {value}" for name, value in members) + "}")
        return "{" + ", ".join(axes) + "}"


@register_part
class Accelerometer(Axes):
    """Sensor of specific force."""

    section = "accelerometer"
    unit = "m/s2"


@register_part
class Gyroscope(Axes):
    """Sensor of angular rate."""

    section = "gyroscope"
    unit = "rad/s"


@dataclass(frozen=True)
class Imu:
    """Specific force and angular rate in a frame fixed to a link.

    Attributes:
        keys: of its section.
        outputs: of each unit.

    Args:
        name: of the unit.
        place: of the link that carries it, in the chain.
        frame: its frame in that of the link (core/mechanics/scene.hpp).
        delay: servo periods by which its readings come late.
        accelerometer, gyroscope: their errors; None: ideal.
    """

    section: ClassVar[str] = ""
    keys: ClassVar[tuple[Key | Number, ...]] = (
        Key(
            "link",
            range="a link of the URDF that a joint moves",
            absent="refused",
            text="link that carries the unit; links fixed to it are valid, too",
        ),
        Key(
            "xyz",
            unit="m",
            range="3 numbers, each ±100",
            absent="`[0, 0, 0]`",
            text="its origin in the link's frame (that of the URDF)",
        ),
        Key(
            "rpy",
            unit="rad",
            range="3 numbers, each ±100",
            absent="`[0, 0, 0]`",
            text="its frame, by roll, pitch and yaw as in a URDF",
        ),
        DELAY,
    )
    outputs: ClassVar[tuple[Output, ...]] = (
        Output("specific_force", "specific force, in the frame of the unit", "imu.specific_force",
               "m/s2", per_unit=True),
        Output("angular_rate", "angular rate, in the frame of the unit", "imu.angular_rate",
               "rad/s", per_unit=True),
    )  # fmt: skip

    name: str
    place: int
    frame: Frame
    delay: int
    accelerometer: Accelerometer | None
    gyroscope: Gyroscope | None

    @classmethod
    def read_section(cls, name: str, section: Section, chain: Chain) -> Self:
        """Return the unit that a section describes.

        Raises:
            Refusal: a value breaks its rule, or the link does not move.
        """
        link = section.read_text("link")
        if link not in chain.carried:
            valid = ", ".join(chain.carried)
            raise section.make_refusal("link", "be a link that a joint moves", link, valid)
        xyz = section.read_vector(_XYZ) or (0.0, 0.0, 0.0)
        rpy = section.read_vector(_RPY) or (0.0, 0.0, 0.0)
        place, frame = chain.place_of(link)
        accelerometer, gyroscope = (
            section.get_section("accelerometer"),
            section.get_section("gyroscope"),
        )
        return cls(
            name=name,
            place=place,
            frame=frame @ make_frame(xyz, rpy),
            delay=section.read_integer(DELAY),
            accelerometer=None
            if accelerometer is None
            else Accelerometer.read_section(accelerometer),
            gyroscope=None if gyroscope is None else Gyroscope.read_section(gyroscope),
        )

    def list_variable_numbers(self) -> list[Varied]:
        """Return the numbers that a scene may list as varied."""
        return [number for three in self.parts for number in three.list_variable_numbers(self.name)]

    @property
    def parts(self) -> tuple[Axes, ...]:
        """Its sensors that are not ideal."""
        return tuple(part for part in (self.accelerometer, self.gyroscope) if part is not None)

    def write_initialiser(self, places: Mapping[str, str]) -> str:
        """Return the unit in C++; `places` as for a part."""
        members = {
            "link": str(self.place),
            "p": cxx_literals.format_vector(self.frame.p),
            "axis": "{" + ", ".join(map(cxx_literals.format_vector, self.frame.R.T)) + "}",
            "delay": str(self.delay),
        }
        for three in self.parts:
            members[three.section] = three.write_initialiser(self.name, places)
        text = ", ".join(f".{name} = {value}" for name, value in members.items())
        return f"arm::Imu{{{text}}}"

"""Bearings of joints that give way: a spring and a damper in each direction."""

from typing import Any, ClassVar

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.output import READINGS, Output
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion

SECTION = "bearing"


def _declare(symbol: str, unit: str, **declared: Any) -> float:
    value: float = number(symbol, unit, text=f"{symbol}, in this direction", **declared)
    return value


class Deflection(Part):
    """A direction in which a bearing gives way: a degree of freedom behind its joint."""

    header = "bearing.hpp"
    cxx = "Bearing"
    shaft = "bearing"  # one of its own
    axis: ClassVar[str]  # of the joint's frame, which turns with its link: x, y or z
    slides: ClassVar[bool]  # whether it is a displacement along the axis, or a turn about it

    @classmethod
    def name_direction(cls) -> str:
        """Return its key below the joint's bearing."""
        return cls.section.partition(".")[2]

    def effort(self, motion: ShaftMotion) -> Array | None:
        """None: the motion of its joint does not determine the deflection."""
        return None


class Tilt(Deflection):
    """A bearing that tilts about an axis across its joint's."""

    slides = False

    stiffness: float = _declare("K", "N m/rad", above=0.0)
    damping: float = _declare("D", "N m s/rad", at_least=0.0, default=0.0)


class Shift(Deflection):
    """A bearing that is displaced along an axis."""

    slides = True

    stiffness: float = _declare("K", "N/m", above=0.0)
    damping: float = _declare("D", "N s/m", at_least=0.0, default=0.0)


def _report(direction: str, about: str, unit: str) -> tuple[Output, ...]:
    text = f"true deflection of each joint's bearing {about}"
    return (Output(f"bearing_{direction}", text, READINGS, unit),)


@register_part
class ShiftX(Shift):
    """A displacement of the bearing along x."""

    section, axis = "bearing.shift_x", "x"
    outputs = _report("shift_x", "along x", "m")


@register_part
class ShiftY(Shift):
    """A displacement of the bearing along y."""

    section, axis = "bearing.shift_y", "y"
    outputs = _report("shift_y", "along y", "m")


@register_part
class ShiftZ(Shift):
    """A displacement of the bearing along z."""

    section, axis = "bearing.shift_z", "z"
    outputs = _report("shift_z", "along z", "m")


@register_part
class TiltX(Tilt):
    """A tilt of the bearing about x."""

    section, axis = "bearing.tilt_x", "x"
    outputs = _report("tilt_x", "about x", "rad")


@register_part
class TiltY(Tilt):
    """A tilt of the bearing about y."""

    section, axis = "bearing.tilt_y", "y"
    outputs = _report("tilt_y", "about y", "rad")


@register_part
class TiltZ(Tilt):
    """A tilt of the bearing about z."""

    section, axis = "bearing.tilt_z", "z"
    outputs = _report("tilt_z", "about z", "rad")


def name_deflection(joint: str, kind: type[Deflection]) -> str:
    """Return the name of a deflection: its place in the scene, below `joints`."""
    return f"{joint}.{kind.section}"

"""Bearings of joints that give way: a spring and a damper in each direction."""

from typing import Any, ClassVar

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.output import READINGS, Output
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion

SECTION = "bearing"


def _declare_number(symbol: str, unit: str, **declared: Any) -> float:
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

    def compute_effort(self, motion: ShaftMotion) -> Array | None:
        """None: the motion of its joint does not determine the deflection."""
        return None


class Tilt(Deflection):
    """A bearing that tilts about an axis across its joint's."""

    slides = False

    stiffness: float = _declare_number("K", "N m/rad", above=0.0)
    damping: float = _declare_number("D", "N m s/rad", at_least=0.0, default=0.0)


class Shift(Deflection):
    """A bearing that is displaced along an axis."""

    slides = True

    stiffness: float = _declare_number("K", "N/m", above=0.0)
    damping: float = _declare_number("D", "N s/m", at_least=0.0, default=0.0)


def _declare_direction(base: type[Deflection], axis: str) -> type[Deflection]:
    """Return the registered part of a direction."""
    key, motion, about, unit = (
        (f"shift_{axis}", "displacement", f"along {axis}", "m")
        if base.slides
        else (f"tilt_{axis}", "tilt", f"about {axis}", "rad")
    )
    text = f"true deflection of each joint's bearing {about}"
    members = {
        "__module__": __name__,
        "__doc__": f"A {motion} of the bearing {about}.",
        "section": f"{SECTION}.{key}",
        "axis": axis,
        "outputs": (Output(f"bearing_{key}", text, READINGS, unit),),
    }
    return register_part(type(f"{base.__name__}{axis.upper()}", (base,), members))


ShiftX, ShiftY, ShiftZ = (_declare_direction(Shift, axis) for axis in "xyz")
TiltX, TiltY, TiltZ = (_declare_direction(Tilt, axis) for axis in "xyz")


def name_deflection(joint: str, kind: type[Deflection]) -> str:
    """Return the name of a deflection: its place in the scene, below `joints`."""
    return f"{joint}.{kind.section}"

"""Gears between motor and link, eq. (2): their base, and the rigid gear."""

from typing import ClassVar

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.registry import register_part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion

RATIO_UNIT = "link turns per motor turn"  # m per rad for a prismatic joint


class Gear(Part):
    """Interface of all gears."""

    section = "gear"
    shaft = "rotor"
    named_by: ClassVar[tuple[str, ...]] = ()  # keys of a gear of this kind, beside the ratio
    stiffens: ClassVar[bool] = False  # with its wind-up
    has_play: ClassVar[bool] = False
    is_linear: ClassVar[bool] = False  # its spring, in the difference of the angles of its sides

    # Negative: the link turns the other way.
    ratio: float = number(
        "Ng",
        RATIO_UNIT,
        above=0.0,
        at_most=1e3,
        in_size=True,
        varied=False,
        text="Ng; 0.01 is a 100:1 reduction; with a negative one the link turns the other way",
    )
    stiffness: float | None = None  # at the link, not wound up; None: rigid
    damping: float = 0.0  # at the link

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """None: rotor and link move alike below the resonances."""
        return np.zeros_like(motion.t)

    @classmethod
    def name_place(cls) -> str:
        """Return its section and the keys that distinguish it."""
        return " with ".join([super().name_place(), *sorted(cls.named_by)])

    def compute_wind_up(self, torque: float) -> float:
        """Return the wind-up of the gear at rest [rad], at the link."""
        raise NotImplementedError


@register_part
class RigidGear(Gear):
    """The rotor turns with its link."""

    header = "gears/gear.hpp"
    cxx = "RigidGear"

    def compute_wind_up(self, torque: float) -> float:  # noqa: D102
        return 0.0

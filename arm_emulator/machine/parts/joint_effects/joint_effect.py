"""Parts of a joint in sections of their own."""

import math
from collections.abc import Sequence
from typing import ClassVar

from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.part import Part


class JointEffect(Part):
    """A part that exerts a torque on the link or the rotor, beside motor, gear and friction.

    A class that inherits it and is registered (`register_part`) is a section of joints.
    Torques are added in the order of ranks, then of sections.
    """

    rank: ClassVar[float] = math.inf
    of_angle: ClassVar[bool] = False  # whether the angle alone determines its torque
    friction_wrapper: ClassVar[str] = ""  # C++ template around the joint's laws of friction

    @classmethod
    def put_limits(cls, section: Section, limits: tuple[float, float] | None) -> None:
        """Put the URDF's limits of the joint into a section that asks for them.

        Raises:
            Refusal: it asks for what is not there.
        """

    def check_parts(self, parts: Sequence[Part], joint: Section) -> None:
        """Refuse a joint whose other parts do not go with it."""

    @property
    def stops(self) -> tuple[float, float] | None:
        """Positions between which it keeps the link [rad or m]; None: anywhere."""
        return None

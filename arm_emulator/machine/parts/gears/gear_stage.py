"""Parts that act within a gear, beside its spring."""

from typing import ClassVar

from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.gears.gear import Gear
from arm_emulator.machine.parts.part import Part


class GearStage(Part):
    """A part in a section below `gear`, whose C++ wraps that of the gear.

    A class that inherits it is registered (`register_part`).
    """

    shaft: ClassVar[str] = "rotor"

    def check_gear(self, gear: Gear, joint: Section) -> None:
        """Refuse a gear that has no place for it."""

    def wrap_gear(self, kind: str, gear: str, own: str) -> tuple[str, str]:
        """Return type and initialiser of a gear with it, in C++.

        Args:
            kind: type of the gear.
            gear: its initialiser.
            own: initialiser of this part.
        """
        raise NotImplementedError

"""Parts around a motor, each of which makes a motor of a motor."""

from typing import ClassVar, NamedTuple, Self

from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.motors.motor import CxxMotor, Motor, Rating
from arm_emulator.machine.parts.part import Part


class Supply(NamedTuple):
    """Voltage of the drives' supply [V], and in C++ the share that is left of it, if any."""

    voltage: float
    share: str = ""


class DriveStage(Part):
    """A part around a motor.

    A class that inherits it and is registered (`register_part`) is a section of motors.
    A joint's decorators are folded over its motor, those of lower layers first.
    """

    shaft = "rotor"
    layer: ClassVar[int]
    inputs: ClassVar[tuple[Input, ...]] = ()  # of the motor with it, if they are others
    around_kind: ClassVar[str] = ""  # of motors that it is for; none: of any
    hides: ClassVar[str] = ""  # a number of its motor that faults cannot change beside it
    electrical: ClassVar[bool] = True  # whether it stands between the command and the torque
    needs_circuit: ClassVar[bool] = False  # a winding with an inductance

    @classmethod
    def name_place(cls) -> str:
        """Return its section and the motors that it is for."""
        return " of ".join([super().name_place(), *[cls.around_kind] * bool(cls.around_kind)])

    @classmethod
    def find_kind(cls, motor: Motor) -> type[Self]:
        """Return the kind of it that goes around a motor, which may be for such motors alone."""
        from arm_emulator.machine.parts.registry import list_kinds

        return next((kind for kind in list_kinds(cls) if kind.around_kind == motor.kind), cls)

    @classmethod
    def size_part(cls, motor: Motor, rating: Rating) -> Self | None:
        """Return the part for a drive that is sized with a motor; None: without it."""
        return None

    def check_motor(self, motor: Motor, joint: Section) -> None:
        """Refuse a motor with which it is incompatible."""
        if self.needs_circuit and motor.circuit is None:
            rule = "belong to a motor that has an inductance (dc, pmsm)"
            at_once = " without one" if motor.has_algebraic_current else ""
            raise joint.make_refusal(self.section, rule, motor.kind + at_once)

    def wrap_motor(self, motor: Motor, inner: CxxMotor, own: str, supply: Supply) -> CxxMotor:
        """Return a motor with it in C++.

        Args:
            motor: the bare motor.
            inner: the motor with the decorators of lower layers.
            own: this part in C++.
            supply: of the drive.
        """
        raise NotImplementedError

    def convert_unit_command(self, motor: Motor) -> float:
        """Return the inner motor's command at rest per unit of command."""
        return 1.0

    def compute_bandwidth(self, motor: Motor) -> float:
        """Return how fast the current follows the command [Hz]; 0: it closes no loop."""
        return 0.0

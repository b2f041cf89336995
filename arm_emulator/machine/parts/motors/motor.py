"""Common base of all motors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.input import VOLTAGE, Input
from arm_emulator.machine.parts.part import Part, number
from arm_emulator.machine.parts.shaft_motion import ShaftMotion


@dataclass(frozen=True)
class Circuit:
    """A winding: L di/dt = V - R i - Kb omega."""

    resistance: float  # ohm
    inductance: float  # H, above 0
    back_emf_constant: float  # V s/rad


class CxxMotor(NamedTuple):
    """A motor in C++, with what is around it."""

    type: str
    value: str


OPEN = 1e6  # of its resistance an open winding has, as in open_winding.hpp
AT_ONCE = 1e9  # Hz, the bandwidth of what follows its command at once


@dataclass(frozen=True, kw_only=True)
class ServoData:
    """Data of a motor for a servo: the response to its command, and the resulting torque.

    The command is a voltage across the winding, a current behind a bandwidth, or a torque behind
    one; a torque replaces the current, with a torque constant of 1.
    """

    torque_constant: float  # N m/A
    resistance: float = 0.0  # ohm
    inductance: float = 0.0  # H
    back_emf_constant: float = 0.0  # V s/rad
    current_bandwidth: float = 0.0  # Hz
    torque_bandwidth: float = 0.0  # Hz


@dataclass(frozen=True, kw_only=True)
class Rating:
    """Requirements on a drive, for sizing a motor of any kind, and a winding that meets them.

    The winding is that of a direct-current motor; other kinds take their numbers from it.
    """

    torque: float  # N m at the rotor, the largest
    rotor_inertia: float  # kg m2
    torque_constant: float  # N m/A
    back_emf_constant: float  # V s/rad
    resistance: float  # ohm
    inductance: float  # H
    bandwidth: float  # Hz, of current and torque

    @property
    def current(self) -> float:
        """Current of the largest torque [A]."""
        return self.torque / self.torque_constant


def declare_rotor_inertia() -> Any:
    """Return the declaration of the inertia of a motor's rotor."""
    text = "Mm, rotor and primary side of the gear"
    return number("Mm", "kg m2", above=0.0, prior="known", text=text)


class Motor(Part):
    """A motor, with the gear's primary side on its rotor."""

    section = "motor"
    shaft = "rotor"
    kind: ClassVar[str]  # `motor.kind` in the scene
    is_default: ClassVar[bool] = False  # whether it is meant where a scene gives no kind
    has_winding: ClassVar[bool] = False  # whose resistance and magnets are known, see winding.py
    hides: ClassVar[tuple[str, ...]] = ()  # numbers of its joint that change nothing beside it
    regulated: ClassVar[bool] = False  # whether its drive regulates its currents or its torque
    cia_type: ClassVar[int] = 0  # in object 0x6402 of CiA 402; 0: none of the profile's
    inputs: ClassVar[tuple[Input, ...]] = (VOLTAGE,)  # its command, and what it takes beside it
    limit: ClassVar[str] = ""  # the key that bounds its command, where that is not a voltage
    rules: ClassVar[tuple[str, ...]] = ()
    """Rules of `size_part`, for people who read a scene; empty if no drive is sized with it."""

    @classmethod
    def name_place(cls) -> str:
        """Return its section and its kind."""
        return f"{super().name_place()} of kind {cls.kind}"

    @classmethod
    def size_part(cls, rating: Rating) -> Self:
        """Return a motor of this kind that gives what is asked for."""
        raise NotImplementedError

    def compute_effort(self, motion: ShaftMotion) -> Array:
        """The rotor's inertia; what is measured is the torque that the windings give."""
        torque: Array = self.inertia * motion.acceleration
        return torque

    def wrap_motor(self, inner: CxxMotor, joint: str, places: Mapping[str, str]) -> CxxMotor:
        """Return the motor in C++ with what its faults put around it and its decorators.

        Args:
            inner: the motor with its decorators.
            joint: the joint's name.
            places: where the values of varied numbers stand, by their name.
        """
        opened = self._find_opening(joint, places)
        if not opened or not self.regulated:
            return inner
        kind = f"arm::OpenedMotor<{inner.type}>"
        return CxxMotor(kind, f"{kind}{{{inner.value}, {opened}}}")

    def list_headers(self, joint: str, places: Mapping[str, str]) -> tuple[str, ...]:  # noqa: D102
        opened = self.regulated and self._find_opening(joint, places)
        return (self.header, *(["drive_stages/open_winding.hpp"] if opened else []))

    def list_members(self, joint: str, places: Mapping[str, str]) -> list[tuple[str, str]]:
        """Its numbers, and the resistance of a contact or an open wire if a voltage drives it."""
        members = super().list_members(joint, places)
        if self.regulated:
            return members
        series = []
        if contact := places.get(f"joints.{joint}.{self.section}.contact"):
            series.append(contact)
        if opened := self._find_opening(joint, places):
            series.append(f"{OPEN:g} * {dict(members)['R']} * {opened}")
        return [*members, ("R_contact", " + ".join(series))] if series else members

    def list_fault_numbers(self) -> dict[str, float | None]:
        """Its numbers, how far its winding is open, and the resistance of its contacts.

        A current that is regulated by an ideal drive does not depend on a resistance.
        """
        contact = {} if self.regulated else {"contact": 0.0}
        return {**super().list_fault_numbers(), **contact, "open": 0.0}

    def _find_opening(self, joint: str, places: Mapping[str, str]) -> str | None:
        """Return how far its winding is open, in C++; None: no fault of it is listed."""
        return places.get(f"joints.{joint}.{self.section}.open")

    @property
    def has_algebraic_current(self) -> bool:
        """Whether its current follows the speed without delay: it has no inductance."""
        return False

    @property
    def command_limit(self) -> float | None:
        """The bound of a command that is not a voltage [N m or A]; None: unlimited."""
        limit: float | None = getattr(self, self.limit) if self.limit else None
        return limit

    @property
    def circuit(self) -> Circuit | None:
        """Return the winding that a drive can close a current loop around, if it has one."""
        return None

    def read_data_sheet(self, supply_voltage: float) -> tuple[float, ...]:
        """Return the numbers by which its drive's current loop is set up, in the order of C++.

        Args:
            supply_voltage: of the scene [V].
        """
        raise NotImplementedError

    @property
    def inertia(self) -> float:
        """Inertia of its rotor with the gear's primary side [kg m2]."""
        inertia: float = vars(self)["rotor_inertia"]
        return inertia

    @property
    def servo_data(self) -> ServoData | None:
        """Return its data for a servo; None: our servo cannot drive it."""
        return None

    def reflect_to_link(self, ratio: float) -> dict[str, float]:
        """Return its largest torques at the link through a gear, by their causes."""
        raise NotImplementedError

    @property
    def torque_per_command(self) -> float:
        """Torque at rest for a unit of its command [N m/V, N m/(N m), N m/A]."""
        raise NotImplementedError

    def compute_largest_command(self, supply_voltage: float) -> float | None:
        """Return its largest command in either direction; None: unlimited.

        Args:
            supply_voltage: of the scene [V].
        """
        raise NotImplementedError

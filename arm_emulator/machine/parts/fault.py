"""A kind of fault: the numbers of a machine that it changes, and their new values."""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass

from arm_emulator.base.validation.number import Number


@dataclass(frozen=True)
class Fault:
    """A kind of fault; parts declare theirs, the package `faults` those of several.

    Attributes:
        name: in scenes, behind the name of what has it.
        of: what has it: "joints", "links" or "imus" of the scene, or "" for the machine.
        text: what happens, in a line.
        sets: expressions by places of numbers, such as ``{"gear.stiffness": "{x} * (1.0 - {m})"}``;
            ``x`` is the number without the fault, ``m`` the magnitude. At magnitude 0 they give x,
            and those that begin with ``{x} *`` are proportional to it. Numbers that the scene does
            not have are left out, and one must be there.
        magnitude: unit and range; its default is the magnitude that shows the fault well.
        absent: what a number is that could be there and that the scene leaves out; None: such a
            number cannot be changed.
        needs: a place that must be there; none: any of `sets`.
    """

    name: str
    text: str
    _: KW_ONLY
    of: str = "joints"
    sets: Mapping[str, str]
    magnitude: Number
    absent: float | None = None
    needs: str = ""

    @property
    def can_change_commands(self) -> bool:
        """Whether motors get other commands than were sent, within their limits."""
        return any(place.startswith(("line.", "supply.")) for place in self.sets)

    def can_change(self, value: float, place: str) -> bool:
        """Return whether it changes the number at a place of `sets` from a value."""
        return value != 0.0 or not self.sets[place].startswith("{x} *")

    @property
    def sections(self) -> set[str]:
        """Sections of the parts whose numbers it changes."""
        return {place.rpartition(".")[0] for place in self.sets}


def bound_share(default: float = 1.0, maximum: float = 1.0) -> Number:
    """Return a magnitude that is a share of the sound number."""
    return Number("magnitude", "1", at_least=0.0, at_most=maximum, default=default)


def bound_rise(unit: str, default: float, maximum: float, *, signed: bool = False) -> Number:
    """Return a magnitude that is added to a number."""
    minimum = -maximum if signed else 0.0
    return Number("magnitude", unit, at_least=minimum, at_most=maximum, default=default)


RISES = "{x} + {m}"
FALLS = "{x} * (1.0 - {m})"
HOLDS = "{x} + {m} * (1.0 - {x})"  # of probabilities that do not depend on each other
STUCK = "readings are lost with a probability, and the one before stands; at 1 for good"
GROWS = "{x} * (1.0 + {m})"


def declare_rise(*places: str) -> dict[str, str]:
    """Return a fault that raises numbers by the magnitude."""
    return dict.fromkeys(places, RISES)


def declare_fall(*places: str) -> dict[str, str]:
    """Return a fault that lowers numbers by the magnitude's share."""
    return dict.fromkeys(places, FALLS)


def declare_sensor_fault(
    section: str, about: str, name: str, text: str, key: str, magnitude: Number, to: str = RISES,
    *, of: str = "joints", absent: float | None = 0.0,
) -> Fault:  # fmt: skip
    """Return a fault of a sensor, which changes one of its numbers.

    Args:
        section: of the sensor.
        about: name of the sensor in texts.
        name: of the fault, behind the sensor's section.
        text: what happens to the sensor.
        key: of the number.
        magnitude: see `Fault`.
        to: expression of the number, see `Fault.sets`.
        of: see `Fault`.
        absent: see `Fault`.
    """
    sets = {f"{section}.{key}": to}
    name, text = f"{section}_{name}", f"{about}: {text}"
    return Fault(name, text, of=of, sets=sets, magnitude=magnitude, absent=absent)

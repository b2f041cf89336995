"""The faults that a scene can have, and those that it lists: numbers of each machine."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.fault import Fault
from arm_emulator.machine.varied import Varied


@dataclass(frozen=True)
class FaultChange:
    """The change of one number of the scene by a fault."""

    number: str  # its place in the scene
    value: float  # without the fault
    expression: str  # see `Fault.sets`


@dataclass(frozen=True)
class SceneFault:
    """A fault of one joint, link, measurement unit, or of the machine."""

    kind: Fault
    varied: Varied  # its magnitude, 0 in the beginning
    changes: tuple[FaultChange, ...]

    @property
    def name(self) -> str:
        """In the scene's list, such as ``elbow.encoder_slips``."""
        return self.varied.name.removeprefix("faults.")


def list_scene_faults(
    kinds: Iterable[Fault],
    owners: Mapping[str, Iterable[str]],
    numbers: Mapping[str, float | None],
    varied: Collection[str],
) -> dict[str, SceneFault]:
    """Return the faults that a scene can have, by their names.

    They leave out those that would change no motion and no measurement.

    Args:
        kinds: of faults.
        owners: names of joints, links and measurement units, by the sections of the scene.
        numbers: all numbers that can be changed, by their places in the scene; None: left out.
        varied: places of numbers that get other values while the machine runs.
    """
    faults_by_name = {}
    for kind in kinds:
        for owner in owners.get(kind.of, ("",)):
            of = f"{kind.of}.{owner}." if kind.of else ""
            changes = {}
            for place, expression in kind.sets.items():
                value = numbers.get(of + place)
                if value is None and of + place in numbers:
                    value = kind.absent
                if value is not None:
                    changes[place] = FaultChange(of + place, value, expression)
            acts = any(
                change.number in varied or kind.can_change(change.value, place)
                for place, change in changes.items()
            )
            if acts and of + kind.needs in {of, *numbers}:
                name = f"{owner}.{kind.name}" if owner else kind.name
                number = replace(kind.magnitude, name=f"faults.{name}", text=kind.text)
                faults_by_name[name] = SceneFault(
                    kind, Varied(number, 0.0), tuple(changes.values())
                )
    return faults_by_name


def put_faults(faults: Iterable[SceneFault], places: dict[str, str]) -> None:
    """Replace numbers by their values under faults, in C++.

    Args:
        faults: that the scene lists.
        places: where the values of varied numbers stand, by their name.
    """
    for fault in faults:
        magnitude = places.get(fault.varied.name)
        if magnitude is None:
            continue  # of a scene whose varied numbers were replaced
        for change in fault.changes:
            value = places.get(change.number) or cxx_literals.format_number(change.value)
            places[change.number] = f"({change.expression.format(x=value, m=magnitude)})"

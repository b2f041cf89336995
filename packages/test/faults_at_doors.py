"""Faults that are done to every door, with the results and the words of refusals.

What doors do stands in faults_at_doors.json beside this file, from which the page of doors has its
table. `FAULTS_AT_DOORS=write pytest packages/test/test_faults_at_*.py` writes it again.
"""

import json
import math
import os
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar

from arm_emulator import Plant, Refusal, load_scene

STORED = Path(__file__).with_suffix(".json")
LINES = ("command_late", "command_lost")
SCENE = load_scene("three_axis", overrides={"faults": [f"elbow.{line}" for line in LINES]})
JOINTS = list(SCENE.joint_names)
ELBOW = JOINTS.index("elbow")
VOLT = SCENE.supply_voltage / 4.0
LATE, FEW, MANY, BREAK = 2.0, 5, 1500, 3  # periods
TINY = 1e-9  # V; loops of drives at rest command less
NO_BREAKPOINTS = "who lets each period pass stops by itself"


class Refused(Exception):
    """The words in which a door has refused a command."""


class Door:
    """A door with a machine behind it, whose elbow is commanded alone.

    Attributes:
        title: of the door, as the page has it.
        lacks: why a fault cannot occur here, by its name.
        raw: whether commands reach the motors as they are, and at known ticks.
        ahead: periods from which on a condition holds that is set.
    """

    title: str
    lacks: ClassVar[Mapping[str, str]] = {}
    raw = True
    ahead = BREAK

    def begin(self) -> None:
        """Begin at tick 0, or where the door begins."""
        self.done: list[Callable[[Plant], object]] = []  # since then, for a plant
        self._begin()

    def give(self, volt: float, tick: int | None = None, name: str = "elbow") -> None:
        """Command the elbow for a period.

        Args:
            volt: the command.
            tick: that it answers; None: the present one.
            name: in the place of the elbow's.

        Raises:
            Refused, Refusal: the door refuses it.
        """
        self._give(volt, tick, name)
        self._note(volt)

    def _note(self, volt: float) -> None:
        """Take note of a period under a command."""
        row = [volt if joint == "elbow" else 0.0 for joint in JOINTS]
        self.done.append(lambda plant: plant.exchange(row))

    def set_fault(self, kind: str, size: float) -> None:
        """Set a fault of the elbow's line."""
        self._set_fault(f"faults.elbow.{kind}", size)
        self.done.append(lambda plant: plant.set_parameter(f"faults.elbow.{kind}", size))

    def power(self, on: bool) -> None:
        """Switch the power of the drives."""
        self._power(on)
        self.done.append(lambda plant: setattr(plant, "powered", on))

    @abstractmethod
    def _begin(self) -> None: ...
    @abstractmethod
    def _give(self, volt: float, tick: int | None, name: str) -> None: ...
    @abstractmethod
    def _set_fault(self, name: str, size: float) -> None: ...
    @abstractmethod
    def _power(self, on: bool) -> None: ...
    @property
    @abstractmethod
    def tick(self) -> int:
        """The present tick."""

    @property
    @abstractmethod
    def applied(self) -> float:
        """Command that the elbow's motor got in the newest period."""

    @property
    def comes(self) -> bool:
        """Whether the elbow's motor gets a command."""
        return abs(self.applied) > TINY

    def measured(self) -> list[float]:
        """Return counts and currents of all joints."""
        return []

    def kept(self) -> object:
        """Return what a refused command leaves as it is."""
        return self.tick, self.measured()

    def wait(self) -> None:
        """Do what a client does for a period without a command."""

    def break_at(self, condition: str) -> None:
        """Stop where a condition begins to hold."""

    def run(self, periods: int) -> None:
        """Go through so many periods under the newest command, or fewer where something stops."""

    def first(self) -> int:
        """Return in which period the elbow's motor gets its first command; 0: none of a few."""
        for period in range(1, 2 * FEW):
            self.give(VOLT)
            if self.comes:
                return period
        return 0

    # --------------------------------------------------------------------------------- the faults

    def late(self) -> str:
        """Return by how much a command is late that is LATE periods late."""
        on_time = self.first()
        assert on_time, "a command comes"
        self.begin()
        self.set_fault("command_late", LATE)
        return f"{self.first() - on_time} periods later"

    def lost(self) -> str:
        """Return what the drive has where every command is lost."""
        self.set_fault("command_lost", 1.0)
        assert not self.first(), "no command comes"
        return "the command before stands"

    def stale(self) -> str:
        """Return the result of an answer to an earlier tick."""
        for _ in range(FEW):
            self.give(VOLT)
        words = self._refusal(lambda: self.give(2.0 * VOLT, tick=self.tick - 1))
        return re.sub(r"\d+", "k", words)

    def silence(self) -> str:
        """Return what a period is like in which no command comes."""
        while not self.comes:
            self.give(VOLT)
        tick, applied = self.tick, self.applied
        self.wait()
        if self.tick == tick:
            return "time stands"
        self._note(VOLT)
        assert self.applied == applied if self.raw else self.comes
        return "the newest command holds"

    def name(self) -> str:
        """Return the result of a joint that does not exist."""
        return self._refusal(lambda: self.give(VOLT, name="wrist"))

    def nan(self) -> str:
        """Return the result of a command that is no number."""
        return self._refusal(lambda: self.give(math.nan))

    def cut(self) -> str:
        """Return what commands are without power."""
        for _ in range(FEW):
            self.give(VOLT)
        self.power(False)
        for _ in range(FEW):
            self.give(VOLT)
            assert self.applied == 0.0
        return "every command is 0"

    def breakpoint(self) -> str:
        """Return where a run ends in whose midst a condition begins to hold."""
        if not self.comes:
            self.give(VOLT)
        last = self.tick + self.ahead
        self.break_at(f"tick >= {last}")
        self.run(MANY)
        assert self.tick == last, (self.tick, last)
        for _ in range(self.ahead):
            self._note(VOLT)
        return "time stands at the tick where it begins to hold"

    def _refusal(self, act: Callable[[], None]) -> str:
        before = self.kept()
        try:
            act()
        except (Refused, Refusal) as no:
            words = str(no).partition(": ")[2]
        else:
            raise AssertionError("it is taken")
        assert self.kept() == before, "a refused command changes nothing"
        tick = self.tick
        self.give(VOLT)
        assert self.tick > tick, "the next one is taken"
        return f"refused: {words}"

    def _as_plant(self) -> None:
        """Compare the machine with a plant to which the same was done."""
        plant = Plant(SCENE)
        for act in self.done:
            act(plant)
        assert self.measured() == measured_of(plant), "the same bits"


def measured_of(plant: Plant) -> list[float]:
    """Return counts and currents of all joints."""
    of = plant.measured
    return [*map(float, of.encoder_counts), *map(float, of.current)]


FAULTS: dict[str, Callable[[Door], str]] = {
    "late": Door.late,
    "lost": Door.lost,
    "stale": Door.stale,
    "silence": Door.silence,
    "name": Door.name,
    "nan": Door.nan,
    "power": Door.cut,
    "breakpoint": Door.breakpoint,
}


def check(door: Door) -> None:
    """Try each fault at a door, and compare the result with the stored one."""
    outcomes: dict[str, str] = {}
    for fault, does in FAULTS.items():
        if fault in door.lacks:
            outcomes[fault] = door.lacks[fault]
            continue
        door.begin()
        outcomes[fault] = getattr(door, does.__name__)()
        if door.raw:
            door._as_plant()
    stored = json.loads(STORED.read_text()) if STORED.exists() else {}
    if os.environ.get("FAULTS_AT_DOORS") == "write":
        STORED.write_text(
            json.dumps(stored | {door.title: outcomes}, indent=1, sort_keys=True) + "\n"
        )
    else:
        assert outcomes == stored.get(door.title), (
            "packages/test/faults_at_doors.json, see its module"
        )

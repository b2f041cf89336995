"""Breakpoints on physics: a condition that is looked at at the end of each exchange, in C."""

from typing import Any

from arm_emulator.base.validation.coerce import coerce_kind
from arm_emulator.machine.plant.formula_rows import CONDITION, formula_library
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.listeners import add_listener, remove_listener
from arm_emulator.runs.condition import Condition, MonitoredCondition


class Breakpoint:
    """A condition on a plant, looked at at the end of each exchange from now on.

    Attributes:
        condition: the condition.
        struct: ``breakpoint``, whose `hit` loops in C look at.

    Args:
        plant: the machine; no exchange may be under way.
        text: see `Condition`.
        where: for refusals.

    Raises:
        Refusal: see `Condition`.
    """

    def __init__(self, plant: Plant, text: str, where: str = "breakpoint") -> None:
        plant = coerce_kind(plant, Plant, where, "plant", "be a Plant")
        self.condition = Condition(text, plant.scene, where)
        self._plant, self._monitored = plant, MonitoredCondition(self.condition.formula, plant)
        self.struct = CONDITION.make_struct("breakpoint", what=self._monitored.struct, tick=-1)
        with plant.turn:  # it stops where it begins to hold
            self.struct.held = self._monitored.is_met()
            add_listener(plant, formula_library().breakpoint_take, self.struct)

    def __repr__(self) -> str:
        return f"<Breakpoint {self.condition.text}>"

    @property
    def is_hit(self) -> bool:
        """Whether it began to hold and this has not been seen yet."""
        return bool(self.struct.hit)

    @property
    def tick(self) -> int:
        """Servo periods of the machine when it began to hold last; -1: never."""
        return int(self.struct.tick)

    @property
    def stop(self) -> Any:
        """Pointer to a flag by which loops stop."""
        return CONDITION.ffi.addressof(self.struct, "hit")

    def take_hit(self) -> bool:
        """Return whether it has begun to hold since the last call."""
        hit, self.struct.hit = self.is_hit, 0
        return hit

    def close(self) -> None:
        """Look no more."""
        remove_listener(self._plant, self.struct)

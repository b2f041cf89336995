"""Actions on a machine in its own process, between two ticks."""

from __future__ import annotations

from collections.abc import Callable

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.external_wrench import ExternalWrench
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.session import Session
from arm_emulator.page.hands import Hands, Vector


def nothing() -> None:
    """Do nothing."""


class MachineHands(Hands):
    """Changes a plant or a session; its owner calls it between two ticks.

    Attributes:
        paused: whether time has to stand still.
        due: ticks that may pass all the same.
        changed: is called after each change.

    Args:
        machine: a plant, or a session.
        steps: whether its owner lets `due` ticks pass while it is paused.
    """

    def __init__(self, machine: Plant | Session, steps: bool = False) -> None:
        self._machine, self._steps = machine, steps
        self.paused, self.due = False, 0
        self.changed: Callable[[], None] = nothing

    def can(self) -> frozenset[str]:
        """Return the actions that this scene and this owner permit."""
        scene = self._machine.scene
        able = set(super().can())
        able -= set() if self._steps else {"step"}
        able -= set() if scene.varied else {"set_varied"}
        return frozenset(able - (set() if scene.external_wrench else {"push"}))

    @property
    def tick(self) -> int:
        """Servo periods that have passed."""
        machine = self._machine
        if isinstance(machine, Session):
            return machine.tick
        return round(machine.t / machine.scene.servo_period)

    @property
    def stands(self) -> bool:
        """Whether no tick may pass now."""
        return self.paused and not self.due

    def pause(self, on: bool) -> str:
        """Let time stand still, or go on."""
        self.paused, self.due = on, 0
        return "paused" if on else "going on"

    def step(self, ticks: int) -> str:
        """Let so many servo periods pass while time stands still."""
        if not self.paused:
            raise Refusal("page", "step", "come while time stands still", "a machine that goes on")
        self.due += ticks
        return f"{ticks} more"

    def power(self, on: bool) -> str:
        """Switch the drives' power."""
        self._machine.powered = on
        self.changed()
        return f"power {'on' if on else 'off'}"

    def set_varied(self, name: str, value: float) -> str:
        """Set a number that the scene lists as varied."""
        machine = self._machine
        put = machine.set_varied if isinstance(machine, Session) else machine.set_parameter
        put(name, value)
        self.changed()
        return f"{name} = {value:g}"

    def push(self, link: str, force: Vector, moment: Vector) -> str:
        """Let a force and a moment act on a link from now on, along the world's axes."""
        self._machine.set_external_wrench(link, ExternalWrench(force, moment, axes="world"))
        self.changed()
        return f"{link} is pushed"

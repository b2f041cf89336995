"""Actions of a page on a running machine; each door has its own."""

from dataclasses import dataclass, field
from typing import Any

Vector = tuple[float, float, float]


@dataclass
class News:
    """Events and states since the last call.

    Attributes:
        state: phase of the machine, in words; empty: as before.
        paused: whether time stands still on request; None: not known.
        powered: whether the drives have power; None: not known.
        events: ticks and texts.
    """

    state: str = ""
    paused: bool | None = None
    powered: bool | None = None
    events: list[tuple[int, str]] = field(default_factory=list)


# Actions, and what they are given. Each returns its answer in words, `gains` numbers by their
# names, and raises a `Refusal` if it is refused.
ACTIONS = {
    "pause": "on: let time stand still, or go on",
    "step": "ticks: let so many servo periods pass while time stands still",
    "rate": "factor: let logical time pass so fast, 1 being real time; 0: as fast as possible",
    "reset": "return to tick 0",
    "power": "on: switch the drives' power",
    "set_varied": "name, value: set a number that the scene lists as varied",
    "push": "link, force [N], moment [N m]: let them act from now on, along the world's axes",
    "aim": "p_WT [m], wxyz: send the tool to a place and an orientation in the world",
    "save": "name: keep the whole machine under a name",
    "restore": "name: go on from a machine that was kept",
    "gains": "return the numbers of the servo that can be changed",
    "set_gain": "name, value: change one of them",
    "break_when": "condition: let time stand still as soon as it holds; empty: never",
}


class Controls:
    """Base of all actions. A page shows the controls of those that a subclass has as methods.

    Attributes:
        factor: that of `rate` at the start.
    """

    factor = 0.0

    def can(self) -> frozenset[str]:
        """Return the names of the actions that are there."""
        return frozenset(action for action in ACTIONS if hasattr(self, action))

    def do_action(self, action: str, *arguments: Any) -> Any:
        """Do an action, and return its answer."""
        return getattr(self, action)(*arguments)

    def news(self) -> News:
        """Return what has happened since the last call."""
        return News()

    def close(self) -> None:
        """Release all resources."""

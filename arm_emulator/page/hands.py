"""Actions of a page on a running machine; each door has its own."""

from __future__ import annotations

from dataclasses import dataclass, field

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


class Hands:
    """Base of all actions. A page shows the controls of the methods that a subclass overrides.

    Each returns its answer in words, and raises a `Refusal` if it is refused.

    Attributes:
        factor: that of `rate` at the start.
    """

    factor = 0.0

    def can(self) -> frozenset[str]:
        """Return the names of the methods that are overridden."""
        own = (name for name, one in vars(Hands).items() if name[0] != "_" and callable(one))
        return frozenset(one for one in own if getattr(type(self), one) is not getattr(Hands, one))

    def news(self) -> News:
        """Return what has happened since the last call."""
        return News()

    def pause(self, on: bool) -> str:
        """Let time stand still, or go on."""
        raise NotImplementedError

    def step(self, ticks: int) -> str:
        """Let so many servo periods pass while time stands still."""
        raise NotImplementedError

    def rate(self, factor: float) -> str:
        """Let logical time pass so fast, 1 being real time; 0: as fast as possible."""
        raise NotImplementedError

    def reset(self) -> str:
        """Return to tick 0."""
        raise NotImplementedError

    def power(self, on: bool) -> str:
        """Switch the drives' power."""
        raise NotImplementedError

    def set_varied(self, name: str, value: float) -> str:
        """Set a number that the scene lists as varied."""
        raise NotImplementedError

    def push(self, link: str, force: Vector, moment: Vector) -> str:
        """Let a force [N] and a moment [N m] act on a link from now on, along the world's axes."""
        raise NotImplementedError

    def aim(self, p_WT: Vector, wxyz: tuple[float, float, float, float]) -> str:
        """Send the tool to a place [m] and an orientation (quaternion) in the world."""
        raise NotImplementedError

    def save(self, name: str) -> str:
        """Keep the whole machine under a name."""
        raise NotImplementedError

    def restore(self, name: str) -> str:
        """Go on from a machine that was kept."""
        raise NotImplementedError

    def gains(self) -> dict[str, float]:
        """Return the numbers of the servo that can be changed."""
        raise NotImplementedError

    def set_gain(self, name: str, value: float) -> str:
        """Change one of them."""
        raise NotImplementedError

    def break_when(self, condition: str) -> str:
        """Let time stand still as soon as a condition holds; empty: never."""
        raise NotImplementedError

    def close(self) -> None:
        """Release all resources."""

"""Result of a tool target, a joint trajectory or a tool path: one report per change."""

import enum
import math
from collections import Counter, deque
from dataclasses import dataclass

CANCELLED = "cancelled"  # the reason of an order that its sender ended
MAX_WAITING = 100  # reports that nobody has taken; a node takes them every period


class Kind(enum.IntEnum):
    """Kind of an order; the numbers are those of msg/MotionStatus.msg."""

    TOOL_TARGET = 1
    JOINT_TRAJECTORY = 2
    TOOL_PATH = 3
    JOG = 4

    @property
    def topic(self) -> str:
        """Topic on which it comes; of jogs that of twists."""
        return "delta_twist_cmds" if self is Kind.JOG else self.name.lower()


class GoalState(enum.IntEnum):
    """The result; the numbers are those of msg/MotionStatus.msg."""

    ACCEPTED = 1
    MOVING = 2
    REACHED = 3
    UNREACHABLE = 4
    REFUSED = 5
    REPLACED = 6
    ABORTED = 7

    @property
    def is_final(self) -> bool:
        """Whether it is final."""
        return self not in (GoalState.ACCEPTED, GoalState.MOVING)


@dataclass(frozen=True)
class GoalProgress:
    """Progress of an order."""

    state: GoalState
    reason: str = ""
    distance: float = math.nan
    """Distance of the tool from its end pose [m]; NaN: unknown."""
    angle: float = math.nan
    """Rotation of the tool from its end pose [rad]; NaN: unknown."""


MOVING = GoalProgress(GoalState.MOVING)


@dataclass(frozen=True, kw_only=True)
class GoalStatus(GoalProgress):
    """One change of one request."""

    kind: Kind
    number: int
    """Number of this request among those of its kind, from 1."""
    stamp_ns: int
    """Logical time from which it holds [ns]; 0: at once."""

    def __str__(self) -> str:
        order, state = self.kind.name.lower().replace("_", " "), self.state.name.lower()
        why = f": {self.reason}" if self.reason else ""
        return f"{order} {self.number} {state}{describe_left(self.distance, self.angle)}{why}"


def describe_left(distance: float, angle: float) -> str:
    """Return the remaining way in words, empty if neither distance [m] nor angle [rad] is known."""
    parts = ((1e3 * distance, "mm"), (angle, "rad"))
    parts_text = ", ".join(f"{value:.3g} {unit}" for value, unit in parts if math.isfinite(value))
    return f", {parts_text} left" if parts_text else ""


class GoalReports:
    """The newest reports that have not been taken yet, and the numbers of orders."""

    def __init__(self) -> None:
        self.numbers: Counter[Kind] = Counter()
        """Number of orders of each kind so far."""
        self.waiting: deque[GoalStatus] = deque(maxlen=MAX_WAITING)

    def take_next_number(self, kind: Kind) -> int:
        """Return the number of a new one."""
        self.numbers[kind] += 1
        return self.numbers[kind]

    def refuse_goal(self, kind: Kind, stamp_ns: int, reason: object) -> None:
        """Report a refused one."""
        refused, number = GoalProgress(GoalState.REFUSED, str(reason)), self.take_next_number(kind)
        self.add_report(refused, kind, number, stamp_ns)

    def add_report(self, progress: GoalProgress, kind: Kind, number: int, stamp_ns: int) -> None:
        """Report the progress of one."""
        status = GoalStatus(**vars(progress), kind=kind, number=number, stamp_ns=stamp_ns)
        self.waiting.append(status)

    @property
    def newest(self) -> GoalStatus | None:
        """The newest report that was not taken yet, or None."""
        return self.waiting[-1] if self.waiting else None

    def take_reports(self) -> list[GoalStatus]:
        """Return the reports, and clear them."""
        taken = list(self.waiting)
        self.waiting.clear()
        return taken

"""A run whose past can be visited, to the last bit, and from which other runs fork."""

from __future__ import annotations

import bisect
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

from arm_emulator.base.non_copyable import NonCopyable
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.count import check_count


@runtime_checkable
class RestorableRun(Protocol):
    """A run that can be saved and restored exactly, such as `OfflineRun`."""

    @property
    def tick(self) -> int:
        """Servo periods since the start."""

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods."""

    def save(self) -> Any:
        """Return all that decides how the run goes on."""

    def restore(self, saved: Any) -> None:
        """Go on from what `save` has returned."""


R = TypeVar("R", bound=RestorableRun)


class TimelineChange(NamedTuple):
    """A change by hand: what was done, after which tick, and the function that did it."""

    tick: int
    name: str
    action: Callable[[Any], object]


class _Checkpoint(NamedTuple):
    """A run after all changes of a tick."""

    tick: int
    saved: Any


class _Place:
    """The timeline at whose tick a run is now; None: at that of none, since it was broken off."""

    def __init__(self, visitor: Timeline[Any] | None) -> None:
        self.visitor = visitor


class Timeline(NonCopyable, Generic[R]):
    """A run with checkpoints: any tick of its past is reached by restoring and driving again.

    What is changed by hand goes through `change`, so that it is not forgotten. Timelines that fork
    from each other share the run: each goes back to its own tick when it is used.

    Attributes:
        run: the run, at `tick` of the timeline that was used last.
        every: ticks between two checkpoints.
        changes: changes by hand, in their order.
        parent: the timeline that this one forked from, or None.
        begins: tick at which it forked from its parent, or at which the run was taken over.
        tick: where this timeline is.
        newest: the last tick that it has reached.

    Args:
        run: a run. All that changes it from now on must go through timelines.
        every: ticks between two checkpoints. Twice as many take half the memory, and twice the
            time to reach a tick.

    Raises:
        Refusal: no run that can be saved, or no such number of ticks.
    """

    instead = "`fork`"

    def __init__(self, run: R, every: int = 1000) -> None:
        if not isinstance(run, RestorableRun):
            raise Refusal("Timeline", "run", "advance, save and restore", run, "an OfflineRun")
        self.every = check_count("Timeline", "every", every, 1)
        self.run = run
        self.changes: list[TimelineChange] = []
        self.parent: Timeline[R] | None = None
        self.begins = self.tick = self.newest = run.tick
        self._checkpoints: list[_Checkpoint] = []
        self._place = _Place(self)
        self._add_checkpoint()

    def __repr__(self) -> str:
        return f"<Timeline at tick {self.tick} of {self.newest}>"

    @property
    def first(self) -> int:
        """The first tick that can be visited."""
        return self._checkpoints[0].tick

    @property
    def bytes(self) -> int:
        """Memory of the checkpoints [B]."""
        return sum(len(checkpoint.saved) for checkpoint in self._checkpoints)

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods, in the past as in the run's first time.

        Raises:
            Refusal: no such count.
            Exception: what the run raises; the timeline ends at the tick that the run has reached.
        """
        check_count("Timeline.advance", "ticks", ticks)
        end = self.tick + ticks
        self.go_to(min(end, self.newest))
        while self.tick < end:
            self._advance_run(min(end - self.tick, self.every - self.tick % self.every))
            if self.tick % self.every == 0:
                self._add_checkpoint()

    def go_to(self, tick: int) -> None:
        """Visit a tick, after the changes by hand that were made there.

        Raises:
            Refusal: a tick before the first checkpoint, or after the newest one.
        """
        check_count("Timeline.go_to", "tick", tick, self.first, self.newest)
        # A run that was advanced separately is at the tick of no timeline.
        here = self._place.visitor is self and self.run.tick == self.tick
        if here and self.tick == tick:
            return
        after = bisect.bisect_right(self._checkpoints, tick, key=lambda checkpoint: checkpoint.tick)
        nearest = self._checkpoints[after - 1]
        if not here or not nearest.tick <= self.tick < tick:
            self._restore_run(nearest.saved)
        if tick > self.run.tick:
            self._advance_run(tick - self.run.tick)

    def find(self, holds: Callable[[R], bool], last: int) -> int | None:
        """Go on tick by tick until something holds, and return that tick; None: it does not.

        Args:
            holds: gets the run at each tick, from the one after the present one on.
            last: the last tick to look at; there the timeline is if it does not hold before.

        Raises:
            Refusal: a last tick that is past, or `holds` is no function.
            Exception: see `advance`.
        """
        check_count("Timeline.find", "last", last, self.tick)
        if not callable(holds):
            raise Refusal("Timeline.find", "holds", "be a function of the run", holds)
        self._enter_tick()
        while self.tick < last:
            self.advance(1)
            if holds(self.run):
                return self.tick
        return None

    def change(self, name: str, change: Callable[[R], object]) -> None:
        """Change the run by hand at its newest tick.

        Args:
            name: of the change, for `changes`.
            change: gets the run; if it raises, the run is as before.

        Raises:
            Refusal: the timeline is in the past, or `change` is no function.
            Exception: what the change raises.
        """
        if self.tick != self.newest:
            rule = f"be {self.newest}, the newest"
            raise Refusal("Timeline.change", "tick", rule, self.tick, "a fork begins here")
        if not callable(change):
            raise Refusal("Timeline.change", "change", "be a function of the run", change)
        self._enter_tick()
        before = self.run.save()
        self._place.visitor = None
        try:
            change(self.run)
            after = _Checkpoint(self.tick, self.run.save())
        except BaseException:
            self._restore_run(before)
            raise
        kept = len(self._checkpoints) - (self._checkpoints[-1].tick == self.tick)
        self._checkpoints[kept:] = [after]
        self.changes.append(TimelineChange(self.tick, name, change))
        self._place.visitor = self

    def fork(self) -> Timeline[R]:
        """Return a timeline with the same past up to this tick, to go on in another way."""
        self._enter_tick()
        forked: Timeline[R] = Timeline.__new__(Timeline)
        forked.run, forked.every, forked.parent = self.run, self.every, self
        forked.begins = forked.tick = forked.newest = self.tick
        forked.changes = [change for change in self.changes if change.tick <= self.tick]
        forked._checkpoints = [
            checkpoint for checkpoint in self._checkpoints if checkpoint.tick <= self.tick
        ]
        forked._place = self._place
        return forked

    def _enter_tick(self) -> None:
        """Bring the run to this timeline's tick."""
        self.go_to(self.tick)

    def _advance_run(self, ticks: int) -> None:
        """Advance the run; broken off, as by Ctrl-C, it may stand within a servo period."""
        self._place.visitor = None
        try:
            self.run.advance(ticks)
        finally:
            self.tick = self.run.tick
            self.newest = max(self.newest, self.tick)
        self._place.visitor = self

    def _restore_run(self, saved: Any) -> None:
        self._place.visitor = None
        self.run.restore(saved)
        self.tick = self.run.tick
        self._place.visitor = self

    def _add_checkpoint(self) -> None:
        self._checkpoints.append(_Checkpoint(self.tick, self.run.save()))

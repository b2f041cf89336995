"""The machine of a recorded run, driven again tick by tick."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from arm_emulator.bags.recorded_ticks import RecordedChange, RecordedTick, read_ticks
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.count import check_count
from arm_emulator.machine.parts.output import FURTHER
from arm_emulator.machine.plant.measured import list_rows
from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator.machine.session.session import Session
from arm_emulator.ros.recording.bag import Bag


class Tick(NamedTuple):
    """One servo period of a recorded run."""

    applied: NDArray[np.float64]
    """Commands that the motors got in the period that ended here, with further ones (1 + I, N)."""
    powered: bool
    """Whether the drives had power in it."""
    published: int
    """Wall time of its motor state [ns]."""


class RecordedMachine:
    """The machine of a run in a bag; a `RestorableRun` of `Timeline`.

    Attributes:
        scene: the machine.
        topics: the bag.
        session: the machine, at `tick`.
        ticks: of the run, from 0 on.
        changes: those made by hand, by the tick at which they were made.

    Args:
        topics: the bag.
        scene: the machine that it is of.
        run: number of the run, from 1 on; -1: the last one. A run begins at tick 0.

    Raises:
        Refusal: no such run, other joints, another servo period, or ticks that are missing.
    """

    def __init__(self, topics: RecordedTopics, scene: Scene, run: int = -1) -> None:
        self.scene, self.topics, self._run = scene, topics, run
        self._where = str(topics.bag.path)
        self.ticks: list[Tick] = []
        self.changes: dict[int, list[RecordedChange]] = {}
        self._read_ticks()
        self.session = Session(scene, "lockstep", "first_answer")
        self._apply_changes()

    @classmethod
    def open_run(cls, path: Path, scene: Scene | str | None = None, run: int = -1) -> Self:
        """Return the machine of a run of a bag; the scene is that which the bag names if None."""
        topics = RecordedTopics(Bag(path))
        loaded = scene if isinstance(scene, Scene) else load_scene(scene or topics.scene)
        return cls(topics, loaded, run)

    @property
    def tick(self) -> int:
        """Servo periods since the start."""
        return self.session.tick

    @property
    def last(self) -> int:
        """The last tick of the record."""
        return len(self.ticks) - 1

    def read_records(self) -> Iterator[RecordedTick]:
        """Yield what is recorded of each tick."""
        every = read_ticks(self.topics, self.scene.joint_names)
        return (record for record in every if record.run == self._run)

    def advance(self, ticks: int) -> None:
        """Advance by so many servo periods of the record.

        Raises:
            Refusal: it ends before.
        """
        check_count(self._where, "ticks", ticks, 0, self.last - self.tick)
        session = self.session
        for tick in self.ticks[self.tick + 1 : self.tick + 1 + ticks]:
            session.powered = tick.powered
            session.advance_under(tick.applied, came=True)
            if session.fault is not None:
                raise session.fault
            self._apply_changes()

    def save(self) -> Any:
        """Return the session as it is now."""
        return _Saved(self.session.save())

    def restore(self, saved: Any) -> None:
        """Go on from a result of `save`."""
        self.session.return_to(saved.session)

    def _apply_changes(self) -> None:
        changes = self.changes.get(self.session.tick)
        if changes:
            self.session.restore(changes[-1].saved)

    def _read_ticks(self) -> None:
        """Read ticks and changes of the run."""
        count, names = 0, ("applied", *list_rows(self.scene)[FURTHER])
        for tick in read_ticks(self.topics, self.scene.joint_names, names):
            count = tick.run
            if self._run not in (-1, tick.run):
                continue
            if tick.tick == 0:
                self.ticks, self.changes = [], {}
            if tick.tick != len(self.ticks):
                rule, actual = f"report tick {len(self.ticks)}", f"tick {tick.tick} next"
                raise Refusal(self._where, "motor_states", rule, actual, "a bag without gaps")
            at, period = tick.stamp * 1e-9, self.scene.servo_period
            if abs(at - tick.tick * period) > 0.5 * period:
                rule = f"be {period:g} s apart, the scene's servo period"
                raise Refusal(self._where, "motor_states", rule, f"tick {tick.tick} at {at:g} s")
            powered = bool(tick.values["powered"][0])
            applied = np.array([tick.values[name] for name in names if name in tick.values])
            self.ticks.append(Tick(applied, powered, tick.published))
            if changes := [*tick.before, *tick.changes]:
                self.changes[tick.tick] = changes
        if not count:
            rule = "hold a run from tick 0 on"
            raise Refusal(self._where, "the bag", rule, "none", "record, then call emulator/reset")
        self._run = (
            count if self._run == -1 else check_count(self._where, "run", self._run, 1, count)
        )


class _Saved(NamedTuple):
    session: dict[str, Any]

    def __len__(self) -> int:
        return len(self.session["machine"])

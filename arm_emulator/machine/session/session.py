"""One run of the machine under command: ticks, answers, phases. Without ROS.

A tick is the start of a servo period. The session publishes nothing. Where its owner lets time
pass, that asks `may_advance` and calls `advance`; where a loop does, it calls `wait` and `take`.
One class: its methods share the state of the run, hence the length.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.synchronized import Synchronized, synchronized
from arm_emulator.base.validation.coerce import coerce_flag
from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.machine.plant.external_wrench import ExternalWrench, move_to_moving_link
from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import PlantState
from arm_emulator.machine.scene.scene import Scene, coerce_scene
from arm_emulator.machine.session.clock import Clock, RealTimeFigures
from arm_emulator.machine.session.command_buffer import CommandBuffer
from arm_emulator.machine.session.firmware_loop import FirmwareLoop
from arm_emulator.machine.session.phase import Phase
from arm_emulator.machine.session.read_cache import ReadCache
from arm_emulator.machine.session.state_of_joints import StateOfJoints
from arm_emulator.toolchain.c_header import CData

CLOCKS = ("lockstep", "realtime")
END_OF_TIME = 2**31 * 10**9  # ns
_PLACE = ("fault", "_powered", "_paused")  # of a session in its run, but for its commands
STARTS = ("free_run", "first_answer", "paused")


class EndOfTime(RuntimeError):
    """Logical time has reached the largest time stamp of messages."""

    def __init__(self) -> None:
        super().__init__("logical time ends at 2**31 s, the largest that a message can report")


class Session(Synchronized):
    """The machine, driven tick by tick by motor commands; as a context it is closed at the end.

    Lock-step: tick k is left only with the command that answers tick k. Real time: the newest
    command is held.

    A session takes turns with its plant, which threads may share. Copies and pickles are sessions
    with a machine of their own at the same tick; one whose time passes by itself is refused.

    Args:
        scene: the machine, or what `load_scene` takes: a name or a file.
        clock: "lockstep" or "realtime".
        start: what goes on until the first command: "free_run" runs under commands of 0,
            "first_answer" stands still at tick 0, "paused" stands still until `paused` is set to
            False and then runs free.
        driver: what lets the periods of its plant pass. A loop runs exactly while the phase allows
            to advance.
        inactive: whether time stands until `inactive` is set to False, beside `paused`.

    Raises:
        Refusal: another clock or start than these.
    """

    def __init__(
        self,
        scene: Scene | str | Path,
        clock: str,
        start: str,
        driver: Callable[[Plant], Clock] = Clock,
        *,
        inactive: bool = False,
    ) -> None:
        for quantity, value, choices in (("clock", clock, CLOCKS), ("start", start, STARTS)):
            if not isinstance(value, str) or value not in choices:
                raise Refusal("Session", quantity, "be known", value, ", ".join(choices))
        self.scene = scene = coerce_scene(scene, "Session")
        self.plant = Plant(scene)
        super().__init__(self.plant)
        self._powered = True
        self.lockstep = clock == "lockstep"
        self.period_ns = round(scene.servo_period * 1e9)
        self._clock = driver(self.plant)
        self._read = ReadCache(self.plant, is_self_clocked=self._clock.is_self_clocked)
        self._ended = False
        self._is_between = False  # between two ticks,
        self._goes_on = False  # after which a loop continues
        self._start, self._inactive = start, inactive
        self._command_buffer = CommandBuffer(scene, self.lockstep)
        self.reset()

    @synchronized
    def __getstate__(self) -> dict[str, Any]:
        if self.is_self_clocked:
            raise Refusal("Session", "its clock", "be advanced by its owner for a copy", "a loop")
        return {name: value for name, value in vars(self).items() if name not in ("turn", "_clock")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__init__(state["plant"])
        vars(self).update(state)
        self._clock = Clock(self.plant)

    def __repr__(self) -> str:
        return f"<Session of {self.scene.name} at tick {self.tick}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __copy__(self) -> Session:
        return copy.deepcopy(self)

    def __deepcopy__(self, memo: dict[int, object]) -> Session:
        memo[id(self.scene)] = self.scene  # nothing changes it
        copied = Session.__new__(Session)
        memo[id(self)] = copied
        copied.__setstate__(copy.deepcopy(self.__getstate__(), memo))
        return copied

    @property
    def step_wall_ns(self) -> int:
        """Wall time that integration steps have taken since this was first read [ns]."""
        return self._clock.spent_ns

    @property
    def is_self_clocked(self) -> bool:
        """Whether a loop lets time pass, the ticks of which are to be taken."""
        return self._clock.is_self_clocked

    @property
    def figures(self) -> RealTimeFigures:
        """Punctuality of a loop; zeros if the owner advances time."""
        return self._clock.figures

    @synchronized
    def reset(self) -> None:
        """Restart at tick 0, as after construction. Power is unchanged."""
        with self.between_ticks():
            self._command_buffer.begin_run(self.tick)
            self.plant.reset()
            self._paused = self._start == "paused"
            self.fault: Diverged | EndOfTime | None = None
            self._read.clear_values()
            self._clock.restart_clock()
            self._goes_on = False

    @property
    def paused(self) -> bool:
        """Whether logical time stands still on request."""
        return self._paused

    @paused.setter
    def paused(self, value: bool) -> None:
        self._paused = coerce_flag(value, "Session", "paused")
        self._follow_phase()

    @property
    def inactive(self) -> bool:
        """Whether logical time stands still because its owner is not active."""
        return self._inactive

    @inactive.setter
    def inactive(self, value: bool) -> None:
        self._inactive = coerce_flag(value, "Session", "inactive")
        self._follow_phase()

    @property
    def powered(self) -> bool:
        """Whether the drives have power."""
        return self._powered

    @powered.setter
    def powered(self, on: bool) -> None:
        with self.between_ticks():
            self._powered = on
            self.plant.powered = on

    @contextmanager
    def between_ticks(self) -> Iterator[None]:
        """Context in which time stands still: the machine can be saved, and changed by hand.

        First take what a loop has reached. Afterwards it goes on as if it had not been stopped:
        periods that it has missed are counted.
        """
        self._check_open()
        if self._is_between:
            yield
            return
        self._goes_on = self._clock.running
        self._clock.stop_time()
        self._is_between = True
        try:
            yield
        finally:
            self._is_between = False
            if self._goes_on and self.may_advance:
                self._clock.go_on()
            else:
                self._follow_phase()

    @synchronized
    def restore(self, saved: bytes) -> None:
        """Continue with a machine that was saved, with its power and its fault.

        The machine's own time is that of the saved one. Ticks go on, and the commands that were
        given hold.

        Raises:
            Refusal: see `Plant.restore`; nothing has changed.
        """
        with self.between_ticks():
            self.plant.restore(saved)
            self.take_note()

    @synchronized
    def save(self) -> dict[str, Any]:
        """Return all that decides how the session goes on, its tick included, for `return_to`."""
        with self.between_ticks():
            fields = {name: getattr(self, name) for name in _PLACE}
            saved = {"machine": self.plant.save(), "answers": self._command_buffer.save_commands()}
            return fields | saved | {"tick": self.tick}

    @synchronized
    def return_to(self, saved: dict[str, Any]) -> None:
        """Go on from the tick at which `save` of this session has returned this.

        Unlike `restore`, it takes ticks and commands back, too: as if what followed had not been.

        Raises:
            Refusal: it is something else; nothing has changed.
        """
        keys = {"machine", "answers", "tick", *_PLACE}
        if not isinstance(saved, dict) or not keys <= saved.keys():
            raise Refusal("Session.return_to", "saved", "be what `save` has returned", type(saved))
        with self.between_ticks():
            self.plant.restore(saved["machine"])
            self.take_note()
            self._command_buffer.restore_commands(saved["answers"])
            self.plant.ticks.tick = saved["tick"]
            for name in _PLACE:
                setattr(self, name, saved[name])

    @synchronized
    def set_state(self, joint_names: Sequence[str], given: Mapping[str, Sequence[float]]) -> None:
        """Set some quantities of some joints; values that are not given do not change.

        Args:
            joint_names: joints of the scene, each at most once.
            given: one value per name, by names of `PlantState`; an empty one is not given. A motor
                behind a rigid gear moves with its link if it is not given.

        Raises:
            Refusal: no or other names, another number of values, values that are not finite, too
                large or contradict each other; nothing has changed.
        """
        state = StateOfJoints(self.plant, joint_names, given)
        with self.between_ticks():
            self.plant.put(state.where, state.make_rows())
            self.take_note()

    @synchronized
    def set_varied(self, name: str, value: float) -> None:
        """Set a number that the scene lists as varied, see `Plant.set_parameter`.

        Raises:
            Refusal: no such number, or out of its range; nothing has changed.
        """
        with self.between_ticks():
            self.plant.set_parameter(name, value)
            self.take_note()

    @synchronized
    def is_acting(self, link: str, wrench: ExternalWrench) -> bool:
        """Return whether this is the wrench that acts, so that setting it would change nothing.

        Raises:
            Refusal: see `Plant.set_external_wrench`.
        """
        place, moved = move_to_moving_link(self.scene, "external wrench", link, wrench)
        return self.plant.external_wrenches[self.scene.chain.links[place].link] == moved

    @synchronized
    def set_external_wrench(self, link: str, wrench: ExternalWrench) -> None:
        """Let a force and a moment act from now on, see `Plant.set_external_wrench`.

        Raises:
            Refusal: see there; nothing has changed.
        """
        with self.between_ticks():
            self.plant.set_external_wrench(link, wrench)
            self.take_note()

    @synchronized
    def take_note(self) -> None:
        """Take note of a machine that was changed, or that code in C has advanced."""
        self._powered = self.plant.powered
        self.fault = self.plant.diverged
        self._read.clear_values()

    @property
    @synchronized
    def state(self) -> PlantState:
        """State of the machine at this tick."""
        return self._read.state

    @property
    @synchronized
    def measured(self) -> Measured:
        """Readings of the sensors at this tick."""
        return self._read.measured

    @property
    @synchronized
    def energy(self) -> float:
        """Energy of the machine at this tick [J]."""
        return self._read.energy

    @property
    def tick(self) -> int:
        """Number of this servo period, from 0."""
        return int(self.plant.ticks.tick)

    @property
    def logical_ns(self) -> int:
        """Logical time [ns]."""
        return self.tick * self.period_ns

    @property
    def is_answered(self) -> bool:
        """Whether a command that answers this tick is there."""
        return self._command_buffer.tick == self.tick

    @property
    def phase(self) -> Phase:
        """Present phase."""
        if self.fault is not None:
            return Phase.STOPPED
        if self._paused or self._inactive:
            return Phase.PAUSED
        if not self._command_buffer.has_command:
            return Phase.WAITING if self._start == "first_answer" else Phase.FREE_RUNNING
        return Phase.WAITING if self.lockstep and not self.is_answered else Phase.RUNNING

    @property
    def may_advance(self) -> bool:
        """Whether the rules of the clock allow to leave this tick now."""
        return self.phase in (Phase.FREE_RUNNING, Phase.RUNNING)

    @synchronized
    def offer(
        self,
        tick: int,
        joint_names: Sequence[str],
        command: Sequence[float],
        further: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        """Take a motor command; it changes nothing if it is refused.

        Args:
            tick: the tick that it answers: this one in lock-step; in real time one that is newer
                than the last and not of the future. The first command may come late in both: it
                ends the free run, and the next one answers in time.
            joint_names: every joint of the scene once, in any order.
            command: one per name [V, N m, A].
            further: inputs of motors beside it, by name, given alike; 0 otherwise.

        Raises:
            DuplicateCommand: the same bits again for one of the two ticks answered last, or an
                answer on its way when the previous run ended.
            Refusal: wrong tick, names, length, an input that no motor has, or a number that is not
                finite or too large.
        """
        self._check_open()
        rows = self._command_buffer.take_command(
            self.tick, tick, joint_names, command, further or {}
        )
        self._clock.hold_command(tick, rows[0], rows[1:])
        self._follow_phase()

    @synchronized
    def advance(self) -> None:
        """Advance by one servo period under the command, or under 0 without one or without power.

        After a `fault`, and only then, tick and state stay as they were.
        """
        self.advance_under(self._command_buffer.rows, self._command_buffer.tick)

    @synchronized
    def advance_under(self, command: Array, answered: int = -1, *, came: bool = False) -> None:
        """Advance by one servo period under commands that answer a tick, see `advance`.

        Args:
            command: (N,), or with further inputs after it (1 + I, N).
            answered: the tick; -1: none.
            came: whether these are what the drives received in an earlier run, as
                `measured.applied` reports it: faults of their lines then leave them.
        """
        self._check_open()
        rows, max_rows = np.atleast_2d(command), 1 + len(self._command_buffer.inputs)
        if len(rows) > max_rows:
            rule = f"be a row for the command, and at most {max_rows - 1} for further inputs"
            raise Refusal("Session.advance_under", "command", rule, np.shape(command))
        if self.logical_ns + self.period_ns >= END_OF_TIME:
            self.fault = EndOfTime()
            return
        try:
            further = dict(zip(self._command_buffer.inputs, rows[1:], strict=False))
            self.plant.exchange(rows[0], answered, came=came, **further)
        except Diverged as fault:
            self.fault = fault
        self._read.clear_values()

    @synchronized
    def advance_in(self, loop: FirmwareLoop, ticks: int) -> None:
        """Advance by so many servo periods, the commands of which control code in C gives.

        After a `fault`, and only then, or a refusal it has come less far.

        Raises:
            Refusal: a command that is not valid, with tick and state in which it was given.
        """
        self._check_open()
        left = (END_OF_TIME - 1 - self.logical_ns) // self.period_ns
        try:
            loop.run_periods(min(ticks, left))
            if ticks > left:
                self.fault = EndOfTime()
        except Diverged as fault:
            self.fault = fault
        finally:
            self._read.clear_values()
            self._command_buffer.set_command(self.tick - 1, self.plant.commanded)

    @property
    def last_tick(self) -> int:
        """The tick at which commands that answer each tick in time do not suffice to go on."""
        waits = self.lockstep and self.phase is Phase.WAITING and self._command_buffer.has_command
        return (END_OF_TIME - 1) // self.period_ns if waits else self.tick

    @property
    def clock(self) -> Clock:
        """The clock."""
        return self._clock

    @property
    def zoh_rows(self) -> Array:
        """The newest commands and further inputs, 0 before the first ones (1 + I, N)."""
        return self._command_buffer.rows

    @property
    def command_buffer(self) -> CData:
        """``tick_answers *``: code in C that takes commands while no call of this runs."""
        return self._command_buffer.pointer

    @synchronized
    def close(self) -> None:
        """Stop the machine for good: it can be read, and no longer changed."""
        self._clock.stop_time()
        self._ended = True

    def _check_open(self) -> None:
        if self._ended:
            raise Refusal("Session", "session", "be open", "a closed one")

    @synchronized
    def break_at(self, stop: CData) -> None:
        """Let loops in C stop behind the period after which an ``int32_t`` in C is not 0.

        Args:
            stop: pointer to it; NULL: it stops nowhere.
        """
        with self.between_ticks():
            self.plant.ticks.stop = stop

    def wait(self, timeout: float) -> bool:
        """Wait at most `timeout` [s] for a tick of a loop."""
        return self._clock.wait_for_tick(timeout)

    @synchronized
    def take(self, *, newest: bool = False) -> bool:
        """Take the next tick that a loop has reached, or the newest; False after the last."""
        reached = self._clock.take_tick(newest=newest)
        if reached is None:
            return False
        self.plant.ticks.tick = reached.tick
        state = self._read.take_values(reached)
        if reached.fault >= 0:
            applied = reached.measured.applied
            self.fault = self.plant.build_divergence(
                reached.fault, state.t, state.q, state.v, applied
            )
        return True

    def _follow_phase(self) -> None:
        if self._is_between:
            return
        if not self.may_advance:
            self._clock.stop_time()
        elif not self._clock.running:
            while self.take():  # ticks that were reached before the loop was stopped
                pass
            self._clock.start_time(self.tick)

    @synchronized
    def step(self) -> str:
        """Advance a paused session by one tick; return why not, or an empty text."""
        if self.fault is not None:
            return f"stopped, reset first: {self.fault}"
        if not self.paused:
            return "not paused, pause first"
        if self.lockstep and self._command_buffer.has_command and not self.is_answered:
            return f"no motor command answers tick {self.tick} yet"
        self.advance()
        return "" if self.fault is None else f"stopped: {self.fault}"

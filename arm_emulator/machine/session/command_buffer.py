"""Motor commands that answer ticks: which are taken, which refused. Knows nothing of ROS."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import COMMAND
from arm_emulator.base.validation.count import LARGEST, check_count
from arm_emulator.base.validation.joint_order import JointOrder
from arm_emulator.machine.plant.inputs import arrange_further_rows, list_further_inputs
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.tick.c import COMMAND_BUFFER, tick_calls
from arm_emulator.toolchain.c_header import make_pointer

NEW, BEFORE_RESET, FUTURE, STALE = (
    COMMAND_BUFFER.get_constant(f"ANSWER_{name}")
    for name in ("NEW", "BEFORE_RESET", "FUTURE", "STALE")
)
_SAVED_FIELDS = ("left", "known", "tick", "tick_before")  # fields beside the commands


class DuplicateCommand(Refusal):
    """A valid command that is not applied.

    Attributes:
        kind: in two or three words.
    """

    def __init__(self, kind: str, rule: str, actual: str) -> None:
        super().__init__("motor_commands", "tick", rule, f"{actual} ({kind})")
        self.kind = kind


class CommandBuffer:
    """The commands of one run, over ``tick_answers`` (tick/c/answers.h).

    Attributes:
        inputs: names of further inputs of the motors.
        pointer: ``tick_answers *``, by which code in C takes commands, too.

    Args:
        scene: the machine.
        lockstep: whether each tick waits for its answer.
    """

    def __init__(self, scene: Scene, lockstep: bool) -> None:
        self._scene, self._lockstep = scene, lockstep
        self._order = JointOrder("motor_commands", scene.joint_names)
        self.inputs = list_further_inputs(scene)
        shape = 1 + len(self.inputs), len(scene.joint_names)
        self._zero, self._newest, self._before = np.zeros((3, *shape))
        self._take = tick_calls().tick_answers_take
        self.pointer = COMMAND_BUFFER.make_struct(
            "tick_answers",
            lockstep=lockstep,
            numbers=self._zero.size,
            newest=self._newest,
            before=self._before,
        )
        self.begin_run(-1)

    def __getstate__(self) -> tuple[Any, ...]:
        return self._scene, self._lockstep, self.save_commands()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        scene, lockstep, saved = state
        self.__init__(scene, lockstep)  # type: ignore[misc]
        self.restore_commands(saved)

    def begin_run(self, left: int) -> None:
        """Begin a run without commands; the run before was left at the tick `left`."""
        self.pointer.left = left
        self.pointer.tick = self.pointer.tick_before = -1
        self.pointer.known = 0

    def set_command(self, tick: int, rows: Array) -> None:
        """Let this command (1 + I, N) be the only one that is known, as the answer to a tick."""
        self.pointer.tick, self.pointer.known = tick, 1
        self._newest[:] = rows

    def save_commands(self) -> tuple[object, ...]:
        """Return the commands that are known now, for `restore_commands`."""
        fields = tuple(getattr(self.pointer, name) for name in _SAVED_FIELDS)
        return *fields, self._newest.tobytes(), self._before.tobytes()

    def restore_commands(self, saved: tuple[Any, ...]) -> None:
        """Know the commands that were known when `save_commands` returned this."""
        *fields, newest, before = saved
        for row, numbers in ((self._newest, newest), (self._before, before)):
            row[:] = np.frombuffer(numbers).reshape(row.shape)
        for name, value in zip(_SAVED_FIELDS, fields, strict=True):
            setattr(self.pointer, name, value)

    @property
    def has_command(self) -> bool:
        """Whether a command of this run is known."""
        return bool(self.pointer.known)

    @property
    def tick(self) -> int:
        """The tick that the newest command answers; -1: none."""
        return int(self.pointer.tick)

    @property
    def rows(self) -> Array:
        """The newest command with further inputs, 0 before the first one (1 + I, N)."""
        return self._newest.copy() if self.has_command else self._zero

    def take_command(
        self,
        now: int,
        tick: int,
        joint_names: Sequence[str],
        command: Sequence[float],
        further: Mapping[str, Sequence[float]],
    ) -> Array:
        """Take a command at the tick `now`, and return it arranged; see `Session.offer`."""
        check_count("motor_commands", "tick", tick, -LARGEST, 2 * LARGEST + 1)
        rows = self.arrange_rows(joint_names, command, further)
        newest_tick = self.pointer.tick
        # Messages have room for ticks that the core's integer has not: they are of the future.
        result = self._take(self.pointer, now, min(tick, LARGEST), make_pointer(rows))
        if result == NEW:
            return rows
        not_after, not_before = (
            f"be at most {now}",
            f"be at least {now if self._lockstep else newest_tick}",
        )
        if result == BEFORE_RESET:
            raise DuplicateCommand("before the reset", not_after, f"{tick}")
        if result == FUTURE:
            raise Refusal("motor_commands", "tick", not_after, f"{tick} (future)")
        if result == STALE:
            raise Refusal("motor_commands", "tick", not_before, f"{tick} (stale)")
        is_newest = tick == newest_tick and not (self._lockstep and tick < now)
        raise DuplicateCommand(
            "repeated", "be answered once" if is_newest else not_before, f"{tick}"
        )

    def arrange_rows(
        self,
        joint_names: Sequence[str],
        command: Sequence[float],
        further: Mapping[str, Sequence[float]],
    ) -> Array:
        """Return commands and further inputs (1 + I, N) in the scene's order of joints.

        Raises:
            Refusal: see `Session.offer`.
        """
        row = self._order.arrange_values(joint_names, command, COMMAND)
        if not further and not self.inputs:
            return row[np.newaxis]
        inputs = {
            name: self._order.arrange_values(joint_names, values, COMMAND.rename(name))
            for name, values in further.items()
        }
        others = arrange_further_rows("motor_commands", self._scene, inputs)
        return np.vstack([row, self._zero[1:] if others is None else others])

"""Motor commands that answer ticks: which are taken, which refused. Knows nothing of ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from arm_emulator.base.bound import COMMAND
from arm_emulator.base.count import LARGEST, check_count
from arm_emulator.base.joint_order import JointOrder
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.machine.inputs import further_inputs, further_rows
from arm_emulator.machine.scene import Scene


class Needless(Refusal):
    """A valid command that is not applied.

    Attributes:
        kind: in two or three words.
    """

    def __init__(self, kind: str, rule: str, got: str) -> None:
        super().__init__("motor_commands", "tick", rule, f"{got} ({kind})")
        self.kind = kind


class Answers:
    """The commands of one run.

    Attributes:
        inputs: names of further inputs of the motors.
        newest: the newest accepted command, with further inputs (1 + I, N); None: no command yet.
        tick: the tick that it answers; -1: none.

    Args:
        scene: the machine.
        lockstep: whether each tick waits for its answer.
    """

    def __init__(self, scene: Scene, lockstep: bool) -> None:
        self._scene = scene
        self._lockstep = lockstep
        self._order = JointOrder("motor_commands", scene.joint_names)
        self.inputs = further_inputs(scene)
        self._zero = np.zeros((1 + len(self.inputs), len(scene.joint_names)))
        self.begin(-1)

    def begin(self, left: int) -> None:
        """Begin a run without commands; the run before was left at the tick `left`."""
        self._left = left
        self.put(-1, None)

    def put(
        self, tick: int, rows: Array | None, before: Array | None = None, answered: int = -1
    ) -> None:
        """Let this be the newest command.

        Args:
            tick: that it answers.
            rows: the command; None: no command.
            before: the one before it, alike.
            answered: the tick that this answered; -1: the one before.
        """
        self.tick, self.newest = tick, rows
        answered = tick - 1 if answered < 0 else answered
        # The accepted one before it.
        self._before: tuple[int, Array | None] = (-1 if before is None else answered, before)

    def save(self) -> tuple[object, ...]:
        """Return the commands that are known now, for `restore`."""
        return self._left, self.tick, self.newest, self._before

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Know the commands that were known when `save` returned this."""
        self._left, self.tick, self.newest, self._before = saved

    @property
    def rows(self) -> Array:
        """The newest command, 0 before the first one (1 + I, N)."""
        return self._zero if self.newest is None else self.newest

    def take(
        self,
        now: int,
        tick: int,
        joint_names: Sequence[str],
        command: Sequence[float],
        further: Mapping[str, Sequence[float]],
    ) -> Array:
        """Take a command at the tick `now`, and return it arranged; see `Session.offer`."""
        check_count("motor_commands", "tick", tick, -LARGEST, 2 * LARGEST + 1)
        if tick > now:
            rule, got = f"be at most {now}", f"{tick} (future)"
            if self.newest is None and tick <= self._left:
                raise Needless("before the reset", rule, f"{tick}")
            raise Refusal("motor_commands", "tick", rule, got)
        if (self._lockstep and self.newest is not None and tick < now) or tick < self.tick:
            rule = f"be at least {now if self._lockstep else self.tick}"
            if self._is_repeated(tick, self.arranged(joint_names, command, further)):
                raise Needless("repeated", rule, f"{tick}")
            raise Refusal("motor_commands", "tick", rule, f"{tick} (stale)")
        rows = self.arranged(joint_names, command, further)
        if tick == self.tick and self._is_repeated(tick, rows):
            raise Needless("repeated", "be answered once", f"{tick}")
        if tick != self.tick:
            self._before = (self.tick, self.newest)
        self.tick, self.newest = tick, rows
        return rows

    def arranged(
        self,
        joint_names: Sequence[str],
        command: Sequence[float],
        further: Mapping[str, Sequence[float]],
    ) -> Array:
        """Return commands and further inputs (1 + I, N) in the scene's order of joints.

        Raises:
            Refusal: see `Session.offer`.
        """
        row = self._order.arrange(joint_names, command, COMMAND)
        if not further and not self.inputs:
            return row[np.newaxis]
        given = {
            name: self._order.arrange(joint_names, values, COMMAND.named(name))
            for name, values in further.items()
        }
        others = further_rows("motor_commands", self._scene, given)
        return np.vstack([row, self._zero[1:] if others is None else others])

    def _is_repeated(self, tick: int, command: Array) -> bool:
        for answered, known in ((self.tick, self.newest), self._before):
            if tick == answered and known is not None and known.tobytes() == command.tobytes():
                return True
        return False

"""A process that gets a row of a machine at each tick, through memory that both share."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.listeners import leave, listen
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.record_ring import RingWriter, SharedRing
from arm_emulator.machine.record_row import RecordRow, columns_of
from arm_emulator.runs.view_of import view_of

HERE = Path(__file__).resolve().parents[2]  # what the other process imports from


class RowProcess:
    """A running module that takes the rows of a plant, until it is closed.

    The module finds its task as a pickled dict on its input, which ends when it has to. On its
    output it puts pickled answers: one when it is ready, which is a `Refusal` if it cannot be, and
    one at its end.

    Attributes:
        ready: its first answer.

    Args:
        plant: the machine.
        module: name of the module.
        task: what it has to know beside the machine.
        where: for refusals.
        waits: whether the machine waits for a slow reader; else rows that find no room are dropped
            and counted.
        files: further descriptors that it inherits.

    Raises:
        Refusal: the module's own.
    """

    def __init__(
        self,
        plant: Plant,
        module: str,
        task: Mapping[str, Any],
        where: str,
        *,
        waits: bool,
        files: tuple[int, ...] = (),
    ) -> None:
        self._plant, self._where = plant, where
        row = RecordRow(plant)
        memory = os.memfd_create("record_ring")
        try:
            os.ftruncate(memory, SharedRing.size(row.rows.dtype))
            self._ring = ring = SharedRing(memory, row.rows.dtype)
            about = _about(plant, memory)
            self._process = process = _begin(module, about | dict(task), (memory, *files))
        finally:
            os.close(memory)
        assert process.stdin is not None
        self.ready = self._answer()
        if isinstance(self.ready, Refusal):
            process.stdin.close()
            process.wait()
            raise self.ready
        self._writer = RingWriter(ring, plant.core, row, process.stdin.fileno(), waits)
        self.take()
        listen(plant, self._writer.take, self._writer.struct)

    @property
    def dropped(self) -> int:
        """Rows that found no room."""
        return self._ring.dropped

    def take(self) -> None:
        """Take a row of the machine as it is now; no exchange may be under way."""
        with self._plant.turn:
            self._writer.take(self._writer.struct, self._plant.machine)

    def close(self) -> Any:
        """Let the process take what waits, and return its last answer."""
        assert self._process.stdin is not None
        leave(self._plant, self._writer.struct)
        self._process.stdin.close()
        answer = self._answer()
        self._process.wait()
        return answer

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except EOFError:
            code = self._process.wait()
            return Refusal(self._where, "its process", "go on", f"exit code {code}")


def _about(plant: Plant, memory: int) -> dict[str, Any]:
    """Return what every such process gets of a machine."""
    return {
        "memory": memory,
        "kind": RecordRow(plant).rows.dtype,
        "columns": columns_of(plant.scene),
        "view": view_of(plant.scene),
        "angle_per_count": plant.link_angle_per_count,
    }


def _begin(module: str, task: dict[str, Any], files: tuple[int, ...]) -> subprocess.Popen[bytes]:
    path = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH"))))
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=files,
        env=os.environ | {"PYTHONPATH": path},
        start_new_session=True,  # Ctrl-C ends the run, and then this
    )
    assert process.stdin is not None
    try:
        pickle.dump(task, process.stdin)
        process.stdin.flush()
    except BrokenPipeError:  # what it writes, or its code, shows why
        pass
    return process

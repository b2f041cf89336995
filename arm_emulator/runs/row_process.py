"""A process that gets a row of a machine at each tick, through memory that both share."""

from __future__ import annotations

import contextlib
import os
import pickle
import select
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.listeners import add_listener, remove_listener
from arm_emulator.machine.session.record_ring import RingWriter, SharedRing
from arm_emulator.machine.session.record_row import RecordRow, list_columns
from arm_emulator.runs.view_of import get_view

HERE = Path(__file__).resolve().parents[2]  # what the other process imports from
START = 120.0  # s, wall: for its imports, on a busy machine

_all: weakref.WeakSet[RowProcess] = weakref.WeakSet()


def dismiss_all(plant: Plant) -> None:
    """Dismiss every process that takes rows of a plant, before one of them is awaited."""
    for process in list(_all):
        if process.plant is plant:
            process.end_input()


class RowProcess:
    """A running module that takes the rows of a plant, until it is closed.

    The module gets its task as a pickled dict on its input. The end of this input asks it to end.
    It returns pickled answers through a pipe that nothing else writes into (`RowEnd`). The first
    answer comes when it is ready, and is a `Refusal` if it cannot be ready; the second comes at its
    end. Its prints go to stderr. It has nothing to do after the last answer, so that it is killed
    then.

    Attributes:
        plant: the machine.
        ready: its first answer.

    Args:
        plant: the machine.
        module: name of the module.
        task: what it has to know beside the machine.
        where: for refusals.
        waits: whether the machine waits for a slow reader; else rows that find no room are dropped
            and counted.
        patience: wall time that it has to end in, from `end_input` on [s]; then it is killed.
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
        patience: float,
        files: tuple[int, ...] = (),
    ) -> None:
        self.plant, self._where, self._patience = plant, where, patience
        self._deadline: float | None = None
        row = RecordRow(plant)
        memory = os.memfd_create("record_ring")
        try:
            os.ftruncate(memory, SharedRing.compute_size(row.rows.dtype))
            self._ring = ring = SharedRing(memory, row.rows.dtype)
            about = _describe_plant(plant, memory)
            process, responses = _start_process(module, about | dict(task), (memory, *files))
            self._process, self._responses = process, responses
        finally:
            os.close(memory)
        assert process.stdin is not None
        self.ready = self._receive_answer(time.monotonic() + START)
        if isinstance(self.ready, Refusal):
            self._end_process()
            raise self.ready
        self._writer = RingWriter(ring, plant.core, row, process.stdin.fileno(), waits)
        self.take_row()
        add_listener(plant, self._writer.take, self._writer.struct)
        _all.add(self)

    @property
    def dropped(self) -> int:
        """Rows that found no room."""
        return self._ring.dropped

    @property
    def process_id(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def trouble(self) -> str:
        """End of the process before its time, in words; empty if it runs."""
        code = self._process.poll()
        return "" if code is None else f"its process has ended, {_describe_exit(code)}"

    def take_row(self) -> None:
        """Take a row of the machine as it is now; no exchange may be under way."""
        with self.plant.turn:
            self._writer.take(self._writer.struct, self.plant.machine)

    def end_input(self) -> float:
        """End the input of the process, the first time; return its deadline, which is then set."""
        if self._deadline is None:
            self._deadline = time.monotonic() + self._patience
            remove_listener(self.plant, self._writer.struct)
            self._close_input()
        return self._deadline

    def close(self) -> Any:
        """Let the process take what waits, and return its last answer."""
        answer = self._receive_answer(self.end_input())
        self._end_process()
        return answer

    def _close_input(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended before it took its task
            self._process.stdin.close()

    def _end_process(self) -> None:
        """End the process, which has given its last answer."""
        self._close_input()
        self._responses.close()
        self._process.kill()
        self._process.wait()

    def _receive_answer(self, deadline: float) -> Any:
        """Return the next answer; kill the process if none comes until a deadline."""
        if not select.select([self._responses], [], [], max(0.0, deadline - time.monotonic()))[0]:
            self._process.kill()
        try:
            return pickle.load(self._responses)
        except (EOFError, pickle.UnpicklingError):
            words = _describe_exit(self._process.wait())
            return Refusal(self._where, "its process", "go on", f"one that has ended, {words}")


def _describe_exit(code: int) -> str:
    """Return an exit code in words."""
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"


def _describe_plant(plant: Plant, memory: int) -> dict[str, Any]:
    """Return what every such process gets of a machine."""
    return {
        "memory": memory,
        "kind": RecordRow(plant).rows.dtype,
        "columns": list_columns(plant.scene),
        "view": get_view(plant.scene),
        "angle_per_count": plant.link_angle_per_count,
    }


def _start_process(
    module: str, task: dict[str, Any], files: tuple[int, ...]
) -> tuple[subprocess.Popen[bytes], BinaryIO]:
    """Return a process that has its task, and the end of the pipe that its answers come from."""
    path = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH"))))
    near, far = os.pipe()
    try:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", module, str(far), str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=_find_stderr(),
            pass_fds=(far, *files),
            env=os.environ | {"PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C ends the run, and then this
        )
    finally:
        os.close(far)
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # what it writes, or its code, shows why
        pickle.dump(task, process.stdin)
        process.stdin.flush()
    return process, os.fdopen(near, "rb")


def _find_stderr() -> int:
    """Return the descriptor for what a process prints: stderr, if there is one."""
    try:
        os.fstat(2)
    except OSError:
        return subprocess.DEVNULL
    return 2

"""A run of a machine kept in a file, or shown, while it goes on, whatever lets its time pass.

The rows go through shared memory to a process of its own. So a run that is killed, or a library
that crashes, leaves a whole file, and files cost the run no time of Python.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from arm_emulator.base.kept import NOTHING, Kept
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.record_ring import RingWriter, SharedRing
from arm_emulator.machine.record_row import RecordRow, columns_of
from arm_emulator.runs.view_of import view_of

HERE = Path(__file__).resolve().parents[2]  # what the other process imports from


class Recorder:
    """Keeps what a plant does from now on; use it in a `with` block.

    Args:
        plant: the machine.
        kept: where to; where nothing is to be kept, nothing is begun.
        waits: whether the machine waits for a slow disk, as it may in lock-step; else rows that
            find no room are dropped and counted.
        stays: whether viewers may look at a run that has ended by itself, until Ctrl-C.

    Raises:
        Refusal: a file that exists or cannot be made, a port that is taken, or a package is
            missing.
    """

    def __init__(self, plant: Plant, kept: Kept, waits: bool, stays: bool = False) -> None:
        self._plant, self._kept = plant, kept
        self._stays = stays and kept.is_port
        self._process: subprocess.Popen[bytes] | None = None
        if kept == NOTHING:
            return
        row = RecordRow(plant)
        memory = os.memfd_create("record_ring")
        try:
            os.ftruncate(memory, SharedRing.size(row.rows.dtype))
            ring = SharedRing(memory, row.rows.dtype)
            self._process = process = _begin(memory, _task(plant, kept, memory))
        finally:
            os.close(memory)
        assert process.stdin is not None and process.stdout is not None
        self._ring = ring
        refusal = self._reported()
        if refusal is not None:
            self._process = None
            process.stdin.close()
            process.wait()
            raise refusal
        self._writer = RingWriter(ring, plant.core, row, process.stdin.fileno(), waits)
        self._writer.listen(plant.machine)

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is None and self._stays:
            self._stay()
        self.close()

    def _stay(self) -> None:
        """Let viewers look at what has ended, until Ctrl-C."""
        print(f"rerun: a viewer may connect to port {self._kept.rerun} until Ctrl-C", flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()

    def close(self) -> None:
        """Let the recorder write what waits.

        Raises:
            Refusal: not all rows are in the file.
        """
        process = self._process
        if process is None:
            return
        assert process.stdin is not None
        self._writer.leave(self._plant.machine)
        process.stdin.close()
        trouble = self._reported()
        process.wait()
        self._process = None
        if not trouble and self._ring.dropped:
            trouble = f"{self._ring.dropped} rows were dropped, the disk is too slow"
        if trouble:
            where = str(self._kept.record or self._kept.rerun)
            raise Refusal("record", where, "accept every row", trouble)

    def _reported(self) -> Any:
        """Return what the other process reports next."""
        assert self._process is not None and self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except EOFError:
            code = self._process.wait()
            return Refusal("record", "the recorder", "go on", f"exit code {code}")


def _task(plant: Plant, kept: Kept, memory: int) -> dict[str, Any]:
    """Return what the other process has to know."""
    scene = plant.scene
    return {
        "memory": memory,
        "kind": RecordRow(plant).rows.dtype,
        "columns": columns_of(scene),
        "record": kept.record,
        "rerun": kept.rerun,
        "view": view_of(scene),
        "angle_per_count": plant.link_angle_per_count,
    }


def _begin(memory: int, task: dict[str, Any]) -> subprocess.Popen[bytes]:
    path = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH"))))
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "arm_emulator.runs.recorder_process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=[memory],
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

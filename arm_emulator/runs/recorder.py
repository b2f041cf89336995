"""A run of a machine kept in a file, or shown, during the run, with any clock.

The rows go through shared memory to a process of its own. So a run that is killed, or a library
that crashes, leaves a whole file, and files cost the run no time of Python.
"""

import contextlib
import os
import shlex
import shutil
import sys
import threading
from pathlib import Path
from typing import Self

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.run_outputs import NOTHING, RunOutputs
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.runs.row_process import RowProcess

PROCESS = "arm_emulator.runs.recorder_process"
PATIENCE = 90.0  # s, wall: for the end of a whole run's files on a slow disk


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

    def __init__(self, plant: Plant, outputs: RunOutputs, waits: bool, stays: bool = False) -> None:
        self._outputs, self._stays = outputs, stays and outputs.is_port
        self._process: RowProcess | None = None
        if outputs != NOTHING:
            task = {"record": outputs.record, "rerun": outputs.rerun}
            self._process = RowProcess(
                plant, PROCESS, task, "record", waits=waits, patience=PATIENCE
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is None and self._stays:
            self._wait_for_ctrl_c()
        self.close()

    def _wait_for_ctrl_c(self) -> None:
        """Let viewers look at what has ended, until Ctrl-C."""
        show = get_viewer_command(f"rerun+http://127.0.0.1:{self._outputs.rerun}/proxy")
        print(f"rerun: until Ctrl-C a viewer may connect: {show}", flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            threading.Event().wait()

    def close(self) -> None:
        """Let the recorder write what waits.

        Raises:
            Refusal: not all rows are in the file.
        """
        process, self._process = self._process, None
        if process is None:
            return
        trouble = process.close()
        if not trouble and process.dropped:
            trouble = f"{process.dropped} rows were dropped, the disk is too slow"
        if trouble:
            where = str(self._outputs.record or self._outputs.rerun)
            raise Refusal("record", where, "accept every row", trouble)


def get_viewer_command(source: str | Path) -> str:
    """Return the command that shows a recording, for a shell in the working folder.

    Args:
        source: file of the recording, or address of a running stream.
    """
    viewer = Path(sys.executable).parent / "rerun"
    by_path = shutil.which("rerun") or not viewer.exists()
    # Without it, rerun takes any process that listens at its own port, 9876, for a viewer, and
    # opens none.
    connect = ["--connect"] if "://" in str(source) else []
    return shlex.join(["rerun" if by_path else os.path.relpath(viewer), *connect, str(source)])
